"""Personalisation: codes, pose, shape and light of one picture, by networks that stay as they are (the seed, Sec. 7).

The released code moves 5 + 5 coefficients of the principal components of the training subjects' codes (without their
mean), pose and shape by a rate of 1e-5, and the light after two fifths of 5,200 steps; the losses are L1 of both
colours in sRGB, mask, codes and patches. Two things are added for short runs, each a setting: coefficients count
standard deviations from the mean, and the light starts where least squares put it (`startlight`).
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from handbench.errors import NonFinite, Unsupported
from handbench.hand.fitting.space import Space
from handbench.hand.skinning import rotation_matrix
from handbench.method import Progress
from handbench.render.see.posedmesh import PosedMesh
from handbench.scene import Array

from ..kit.adam import Adam
from ..kit.colourspace import to_display
from ..kit.crop import Crop
from ..kit.enrolled import Enrolled
from ..kit.perceptual import perceptual_loss
from .drawing import pixel_rays
from .light import StudioLight
from .losses import cross_entropy
from .model import LatentCodes, PalmModel
from .person import Person
from .pixels import SHARES, near_edge, square
from .posed import PosedHand, render
from .reflectance import Form
from .scattering import Scattering
from .settings import PersonaliseSettings
from .shading import physical
from .startlight import as_bright, solved, transfer
from .visibility import MeshOccluder, MovedOccluder

_TELL = 10  # steps
_EDGE = 3  # pixels
_CERTAIN = 1e-4  # a pixel that should be covered costs no more than its logarithm
_FEW = 500  # pixels that a light is started by
_SPACING = 2.5e-3  # metres, of the mesh that hides light


class Basis:
    """The space in which a code (D,) is looked for: principal components of the training subjects' codes (n, D)."""

    def __init__(self, codes: Tensor, components: int, whitened: bool) -> None:
        centred = codes - codes.mean(dim=0)
        _, spread, axes = torch.linalg.svd(centred, full_matrices=False)
        count = min(components, len(spread), max(1, len(codes) - 1))
        deviation = spread[:count] / max(1.0, len(codes) - 1.0) ** 0.5
        self.origin = codes.mean(dim=0) if whitened else torch.zeros_like(codes[0])
        self.axes = deviation[:, None] * axes[:count] if whitened else axes[:count]
        self.count = count

    def code(self, coefficients: Tensor) -> Tensor:
        """The code (D,) of coefficients (count,)."""
        return self.origin + coefficients @ self.axes


def personalised(
    model: PalmModel, enrolled: Enrolled, fit: PersonaliseSettings, form: Form, seed: int, progress: Progress
) -> Person:
    """The person of an enrolment whose hand was found, by its first picture.

    Raises `Unsupported` for a picture whose hand is smaller than a patch, `NonFinite` if a step breaks.
    """
    return _Fitter(model, enrolled, fit, form, seed).run(progress)


class _Fitter:
    """One person's unknowns, the crop that they are fitted to, and the steps."""

    def __init__(self, model: PalmModel, enrolled: Enrolled, fit: PersonaliseSettings, form: Form, seed: int) -> None:
        self.model, self.fit, self.form = model, fit, form
        seen = enrolled.pictures[0]
        assert seen.observation.alpha is not None
        self._crop = crop = Crop.of(seen.camera, seen.observation.image, seen.observation.alpha, fit.side)
        if min(crop.alpha.shape) < fit.patch:
            height, width = crop.alpha.shape
            raise Unsupported(
                f"the hand of the enrolled picture is {width}x{height} pixels, less than a patch of {fit.patch}; "
                "give a larger picture"
            )
        self._origin = torch.from_numpy(crop.camera.centre.copy()).float()
        self._towards = pixel_rays(crop.camera, crop.camera.whole)[1]
        self._image, self._alpha = torch.from_numpy(crop.image).reshape(-1, 3), torch.from_numpy(crop.alpha).flatten()
        self._groups = _groups(crop)
        self._random = np.random.default_rng([37, seed])

        self._bases = [Basis(codes.detach(), fit.components, fit.whitened) for codes in (model.phi, model.psi)]
        self._coefficients = [torch.zeros(basis.count, requires_grad=True) for basis in self._bases]
        space = Space.of(enrolled.hand, 0)
        self._shape = torch.tensor(np.asarray(enrolled.shape, dtype=np.float64)).float()
        self._shapes = torch.from_numpy(space.shape_basis).float()
        free = torch.zeros(3 * len(enrolled.hand.parents)).index_fill(0, torch.from_numpy(space.free), 1.0)
        self._free = free.reshape(-1, 3)
        pose = (seen.pose.joints, seen.pose.rotation, seen.pose.translation)
        self._pose = [torch.tensor(part, dtype=torch.float32) for part in pose]
        self._moves = [torch.zeros(self._shapes.shape[1]), *(torch.zeros_like(part) for part in self._pose)]
        for move in self._moves:
            move.requires_grad_()
        self._light = StudioLight(len(model.light.gaussians()))
        self._light.load_state_dict(model.light.state_dict())
        self._posed: PosedHand
        self._built: tuple[MeshOccluder, Tensor, Tensor]

    # -- the unknowns -----------------------------------------------------------------------------------------------

    def _hand(self) -> tuple[Tensor, ...]:
        """Shape, joints, rotation and translation as they stand."""
        shape, joints, rotation, translation = self._moves
        moves = (self._shapes @ shape, self._free * joints, rotation, translation)
        return tuple(start + move for start, move in zip((self._shape, *self._pose), moves, strict=True))

    def _codes(self) -> LatentCodes:
        return LatentCodes(*(basis.code(c) for basis, c in zip(self._bases, self._coefficients, strict=True)))

    def _rebuild(self) -> None:
        """The posed hand and what it hides, as they stand."""
        with torch.no_grad():
            hand = self._hand()
            self._posed = PosedHand(self.model, self._codes(), *hand)
            self._built = MeshOccluder(PosedMesh(self._posed.mesh(_SPACING))), rotation_matrix(hand[2]), hand[3]

    @torch.no_grad()
    def _occluder(self) -> MovedOccluder:
        """What the hand hides where it is now: as it was built, moved with its placement."""
        occluder, turn, place = self._built
        _, _, rotation, translation = self._hand()
        back = turn @ rotation_matrix(rotation).T
        return MovedOccluder(occluder, back, place - back @ translation)

    # -- the run ----------------------------------------------------------------------------------------------------

    def run(self, progress: Progress) -> Person:
        fit = self.fit
        lights: list[Tensor] = [] if fit.light == "fixed" else [*self._light.parameters()]
        moved = {"codes": self._coefficients, "pose": self._moves[1:], "shape": self._moves[:1], "light": lights}
        adams = {name: Adam(some, 0.0) for name, some in moved.items() if some}
        for step in range(fit.steps):
            lit = step >= fit.lit_from * fit.steps
            if step % fit.rebuild == 0:
                self._rebuild()
            if lit and step - 1 < fit.lit_from * fit.steps:
                self._start_light()
            left = 1.0 - fit.falling * step / fit.steps
            rates = fit.rates
            rate = {"codes": rates.code, "pose": rates.pose, "shape": rates.shape, "light": rates.light * lit}
            for name, adam in adams.items():
                adam.rate = rate[name] * left
                adam.forget()
            losses = self._losses(lit)
            loss = torch.stack([*losses.values()]).sum()
            if not bool(loss.detach().isfinite()):
                bad = next(name for name, value in losses.items() if not bool(value.detach().isfinite()))
                raise NonFinite(f"palm-net: {bad} of step {step + 1} of a fit is not finite; lower the rates")
            loss.backward()
            for name, adam in adams.items():
                if any(u.grad is not None and not bool(u.grad.isfinite().all()) for u in adam.parameters):
                    raise NonFinite(
                        f"palm-net: the gradient to {name} in step {step + 1} of a fit is not finite; lower the rates"
                    )
            for adam in adams.values():
                adam.step()
            if (step + 1) % _TELL == 0 or step + 1 == fit.steps:
                values = {name: float(value.detach()) for name, value in losses.items()}
                progress(step + 1, fit.steps, loss=float(loss.detach()), **values)
        return self._found()

    def _found(self) -> Person:
        with torch.no_grad():
            return Person(self.model, self._codes(), self._hand()[0], self._light.gaussians())

    def _losses(self, lit: bool) -> dict[str, Tensor]:
        """The weighted losses of a step."""
        fit, weights = self.fit, self.fit.weights
        chosen, patch = self._chosen()
        towards, truth, mask = self._towards[chosen], self._image[chosen], self._alpha[chosen]
        codes, (shape, joints, rotation, translation) = self._codes(), self._hand()
        posed = self._posed.moved(codes=codes, shape=shape, joints=joints, rotation=rotation, translation=translation)
        origins = self._origin.expand(len(towards), 3)
        rendering = render(posed, origins, towards, self.model.config.marching, self._random)
        wanted = to_display(truth, "linear")
        losses = {
            "mask": weights.mask * cross_entropy(rendering.alpha, mask.clamp(0.0, 1.0), _CERTAIN),
            "code": weights.code * sum((c.square().sum() for c in self._coefficients), start=torch.zeros(())),
        }
        drawn = {"radiance": rendering.radiance(posed)} if weights.radiance > 0 else {}
        if lit:
            drawn["physical"] = physical(
                posed,
                rendering,
                self._light.gaussians(),
                self._occluder(),
                fit.samples,
                self._random,
                self.form,
                fit.places,
            )
        for name, colour in drawn.items():
            shown, weight = to_display(colour, "linear"), getattr(weights, name)
            losses[name] = weight * (shown - wanted).abs().mean()
            if patch and weights.perceptual > 0:
                picture, true = (_square(values[-(patch**2) :], patch) for values in (shown, wanted))
                losses[f"{name} patch"] = weight * weights.perceptual * perceptual_loss(picture, true)[0]
        return losses

    def _chosen(self) -> tuple[Tensor, int]:
        """The pixels of a step: single ones by where they are, then a square patch about the hand, row by row."""
        fit, rng = self.fit, self._random
        single = [rng.choice(group, round(share * fit.rays)) for group, share in zip(self._groups, SHARES, strict=True)]
        patch = []
        if fit.patch:
            rows, columns = square(self._crop.alpha > 0.5, fit.patch, rng)
            patch.append(rows * self._crop.alpha.shape[1] + columns)
        return torch.from_numpy(np.concatenate([*single, *patch])), fit.patch

    @torch.no_grad()
    def _start_light(self) -> None:
        """The light as bright as the picture, or where least squares put it."""
        inner = np.flatnonzero(self._crop.inner(1).ravel())
        inner = inner if len(inner) else self._groups[0]
        some = torch.from_numpy(self._random.choice(inner, min(_FEW, len(inner)), replace=False))
        towards = self._towards[some]
        origins = self._origin.expand(len(towards), 3)
        rendering = render(self._posed, origins, towards, self.model.config.marching, None)
        places = Scattering.of(self._posed, rendering).drawn(1)
        light = self._light.gaussians()
        known = transfer(places, light, self._occluder(), self.form)
        how = solved if self.fit.solved and self.fit.light == "fitted" else as_bright
        self._light.amplitude.copy_(how(known, self._image[some], light.amplitude))


def _groups(crop: Crop) -> tuple[Array, Array, Array]:
    """Flat pixels of a crop on the hand, near its edge, and elsewhere; all of them where a group is empty."""
    hand = crop.alpha > 0.5
    edge = near_edge(hand, _EDGE)
    found = [np.flatnonzero(where.ravel()) for where in (hand, edge, ~hand & ~edge)]
    first, second, third = (where if len(where) else np.arange(hand.size) for where in found)
    return first, second, third


def _square(values: Tensor, side: int) -> Tensor:
    """A patch (1, 3, 2 side, 2 side) of rows (side * side, 3): twice as large, as the released code shows it."""
    picture = values.T.reshape(1, 3, side, side)
    return torch.nn.functional.interpolate(picture, scale_factor=2, mode="bilinear")
