"""How well PALM-Net draws its own prior's people from a camera that was kept out: `python -m benchmarks.novel_views`.

Trains the prior of `quick` without one of openscans' cameras, tells its time and greatest memory, and then draws the
radiance field's colours of one pose of each person from that camera and from another one: as `quick` draws pictures,
by the surface's first hits with nine rays a pixel for alpha, and marched through the volume, one ray a pixel. PSNR is
in sRGB: of the mask, of what is more than three pixels inside it, and of the rest, its outline. `--weights` takes a
prior that a run kept (runs/…/priors/…/state) instead, which has seen all cameras.
"""

from __future__ import annotations

import argparse
import resource
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from scipy.ndimage import binary_erosion

from handbench.data.capture import open_capture
from handbench.hand import hand_model
from handbench.method import Prior
from handbench.methods.palm.drawing import DrawingSettings, facing, hits
from handbench.methods.palm.frames import Taken, TrainingCrop, taken
from handbench.methods.palm.method import Palm, PalmPrior
from handbench.methods.palm.model import PalmModel
from handbench.methods.palm.posed import PosedHand, render
from handbench.methods.palm.surface import FieldSurface
from handbench.methods.palm.training import Lesson
from handbench.recording import Recording
from handbench.render.see.posedmesh import PosedMesh
from handbench.render.see.raster import rasterise
from handbench.scene import Array
from handbench.scene.colour import srgb

_INSIDE = 3  # pixels


def drawn(posed: PosedHand, surface: FieldSurface, crop: TrainingCrop) -> tuple[Array, Array]:
    """The radiance field's colours (h, w, 3) and alpha (h, w) of a picture as `quick` draws one, see `surface_view`."""
    model, (height, width) = posed.model, crop.alpha.shape
    raster = rasterise(PosedMesh(surface.mesh), crop.camera, DrawingSettings().supersample)
    hit = hits(surface.canonical, raster)
    normal = facing(hit.normal, hit.view)
    reflected = 2.0 * (hit.view * normal).sum(dim=1, keepdim=True) * normal - hit.view
    feature = model.geometry(hit.x, posed.conditions).feature
    colour = model.radiance(hit.x, feature, reflected, normal, posed.conditions)
    image = np.zeros((raster.alpha.size, 3), dtype=np.float32)
    image[hit.pixel] = (hit.alpha[:, None] * colour).numpy()
    left, top = crop.corner
    part = slice(top, top + height), slice(left, left + width)
    return image.reshape(*raster.alpha.shape, 3)[part], raster.alpha[part]


def marched(posed: PosedHand, crop: TrainingCrop) -> tuple[Array, Array]:
    """The same by a march of one ray a pixel."""
    height, width = crop.alpha.shape
    rows, columns = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
    found = render(posed, *crop.rays(rows.reshape(-1).float(), columns.reshape(-1).float()))
    return found.radiance(posed).view(height, width, 3).numpy(), found.alpha.view(height, width).numpy()


def compared(image: Array, alpha: Array, crop: TrainingCrop) -> tuple[float, ...]:
    """PSNR in the mask, inside, at the outline, and the masks' overlap."""
    mask = crop.alpha.numpy() > 0.5
    inside = binary_erosion(mask, iterations=_INSIDE)
    error = (srgb(image) - srgb(crop.image.numpy())) ** 2
    found = alpha > 0.5
    parts = (mask, inside, mask & ~inside)
    return *(-10.0 * float(np.log10(error[part].mean())) for part in parts), (found & mask).sum() / (found | mask).sum()


@torch.no_grad()
def tell(label: str, model: PalmModel, poses: Sequence[Taken], camera: str) -> None:
    """Means of the pictures of a camera, one pose of each person."""
    lesson = Lesson(model, list(poses))
    last = {pose.person: number for number, pose in enumerate(poses)}
    rows: dict[str, list[tuple[float, ...]]] = {"as quick draws": [], "marched": []}
    for number in last.values():
        posed = lesson.posed(number)
        surface = posed.surface(DrawingSettings().spacing)
        for picture in poses[number].pictures:
            if picture.camera.name == camera:
                rows["as quick draws"].append(compared(*drawn(posed, surface, picture), picture))
                rows["marched"].append(compared(*marched(posed, picture), picture))
    for how, values in rows.items():
        mask, inside, outline, overlap = np.mean(values, axis=0)
        print(
            f"{label} {camera}, {len(values)} pictures {how}: {mask:.2f} dB in the mask, {inside:.2f} inside, "
            f"{outline:.2f} at the outline, IoU {overlap:.3f}",
            flush=True,
        )


def learned(recording: Recording, keep: Path | None) -> Prior:
    """The prior of a recording, its time told as it learns."""
    wall, cpu = time.perf_counter(), time.process_time()

    def spent() -> str:
        return f"{time.perf_counter() - wall:.0f} s, {time.process_time() - cpu:.0f} s of CPU"

    def progress(step: int, total: int, **values: float) -> None:
        if step % 100 == 0:
            print(f"step {step} of {total}: {spent()}", flush=True)

    prior = Palm("quick").train(recording, 0, progress)
    print(f"prior: {spent()}, {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MB", flush=True)
    if keep is not None:
        keep.mkdir(parents=True)
        prior.save(keep)
    return prior


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.novel_views", description="Draw PALM-Net's own people from a camera kept out."
    )
    parser.add_argument("--camera", default="oblique", help="the one that is kept out (default: oblique)")
    parser.add_argument("--own", default="palmar", help="one that is not, for comparison (default: palmar)")
    parser.add_argument("--people", type=int, help="of how many the prior learns (default: all)")
    parser.add_argument("--weights", type=Path, help="the state of a kept prior of quick, instead of training")
    parser.add_argument("--keep", type=Path, help="a new folder that the trained prior is kept in")
    chosen = parser.parse_args()
    capture = open_capture("openscans", "quick")
    frames = [frame for frame in capture.frames() if frame.segment == "scan"]
    people = list(dict.fromkeys(frame.subject for frame in frames))[: chosen.people]
    frames = [frame for frame in frames if frame.subject in people]
    if chosen.weights is None:
        some = capture.recording(frame for frame in frames if frame.viewpoint.camera.name != chosen.camera)
        prior, what = learned(some, chosen.keep), "kept out:"
    else:
        prior, what = Palm("quick").load(chosen.weights), "seen:"
    assert isinstance(prior, PalmPrior)
    poses = taken(capture.recording(frames), hand_model(), prior.model.config.register, 0)
    for label, camera in (("own:", chosen.own), (what, chosen.camera)):
        tell(label, prior.model, poses, camera)


if __name__ == "__main__":
    main()
