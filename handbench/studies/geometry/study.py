"""The autoencoder scored on its own: geometry errors on held-out fully lit frames, beside two baselines."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import fmean
from typing import Any

from rich.table import Table

from ...bench.progress import steps
from ...bench.protocol import Protocol
from ...bench.provenance import provenance
from ...bench.resolving import resolve
from ...bench.run import find_protocol
from ...data.capture import Capture, open_capture
from ...errors import StorageError, Unsupported
from ...files import whole
from ...hand import hand_of
from ...method import Progress, Recording, silent
from ...methods.geometry.neutral import full_frames, neutral
from ...methods.geometry.scan import point_cloud
from ...methods.geometry.skeleton import posed_points
from ...methods.geometry.tracker import NAME, GeometryPrior, Tracking, create
from ...metrics.geometry.points import point_error
from ...metrics.geometry.surface import mean, percentile95, surface_distances
from ...results.schema import plain
from ...scene import Array, Frame, Mesh, needed

SCHEMA = 1
RESULT = "geometry.json"
ERRORS = ("surface_mean", "surface_p95", "joint", "vertex")
"""Millimetres: scan points from the surface (mean and 95th percentile), joints, vertices from the tracked mesh."""

ROWS = {
    "autoencoder": "Geometry autoencoder",
    "template": "Template in the true pose (no identity)",
    "tracked": "The capture's tracked mesh (noise floor)",
}
GROUPS = {"trained": "trained subjects, unseen poses", "unseen": "unseen subjects, unseen poses"}


@dataclass(frozen=True)
class FrameErrors:
    """Errors of one frame in millimetres; None where a row is itself what the error is measured from."""

    frame: str
    row: str
    surface_mean: float
    surface_p95: float
    joint: float | None
    vertex: float | None


def geometry_report(prior: GeometryPrior, enrolment: Recording, frames: Recording) -> list[FrameErrors]:
    """The errors of every fully lit frame for every row of `ROWS`.

    Subjects are identified from `enrolment`; poses are tracked from all fully lit frames of `frames`. The scan of a
    frame is what its own depth map shows. Raises `Unsupported` without fully lit frames or without depth.
    """
    lit = full_frames(frames)
    tracking = Tracking(prior, _together(enrolment.of_kind("full"), lit))
    known = {subject: neutral(enrolment.of_subject(subject)) for subject in lit.subjects}
    found = []
    for frame in lit.frames:
        points = point_cloud([(frame, lit.observe(frame))]).points
        true, recorded = known[frame.subject].observed(needed(frame.pose, "pose")), needed(frame.mesh, "mesh")
        for row, (mesh, joints) in _geometries(frame, tracking).items():
            distances = surface_distances(mesh, points)
            found.append(
                FrameErrors(
                    frame.key,
                    row,
                    surface_mean=mean(distances),
                    surface_p95=percentile95(distances),
                    joint=None if joints is None else point_error(joints, true),
                    vertex=None if mesh is recorded else point_error(mesh.vertices, recorded.vertices),
                )
            )
    return found


def _together(one: Recording, other: Recording) -> Recording:
    """The frames of two recordings, each observed by its own."""
    home = {frame.key: recording for recording in (one, other) for frame in recording.frames}
    return Recording((*one.frames, *other.frames), lambda frame: home[frame.key].observe(frame))


def _geometries(frame: Frame, tracking: Tracking) -> dict[str, tuple[Mesh, Array | None]]:
    """Mesh and key points (P, 3) of a frame by row."""
    pose, recorded, own = needed(frame.pose, "pose"), needed(frame.mesh, "mesh"), tracking.of(frame)
    hand, level = hand_of(recorded.topology)
    return {
        "autoencoder": (own.mesh, own.points),
        "template": (hand.mesh(hand.neutral(), pose, level), posed_points(hand, hand.points, pose)),
        "tracked": (recorded, None),
    }


def mean_errors(found: Iterable[FrameErrors]) -> dict[str, dict[str, float | None]]:
    """Row by row the mean over subjects of the means over their frames, in millimetres."""
    by_row: dict[str, dict[str, list[FrameErrors]]] = {}
    for errors in found:
        by_row.setdefault(errors.row, {}).setdefault(errors.frame.split("/")[0], []).append(errors)
    return {
        row: {name: _mean([[getattr(e, name) for e in one] for one in subjects.values()]) for name in ERRORS}
        for row, subjects in by_row.items()
    }


def _mean(subjects: list[list[float | None]]) -> float | None:
    known = [[value for value in values if value is not None] for values in subjects]
    return fmean(map(fmean, known)) if all(known) else None


def evaluate(
    capture: Capture, protocol: Protocol, preset: str = "quick", seed: int = 0, progress: Progress = silent
) -> tuple[GeometryPrior, dict[str, list[FrameErrors]]]:
    """Train on the protocol's fully lit training frames; errors on fully lit frames of other poses by `GROUPS`.

    Trained subjects are identified from training, unseen ones from enrolment. Raises `Unsupported` if a group has no
    such frames, or the capture lacks what the autoencoder needs.
    """
    frames = capture.frames()
    chosen = resolve(protocol, frames)
    train = full_frames(capture.recording(chosen.train))
    prior = create(preset).train(train, seed, progress)
    shown = {frame.pose_key for frame in (*chosen.train, *chosen.enrol)}
    found = {}
    for group, subjects, known in (
        ("trained", protocol.trained, train.frames),
        ("unseen", protocol.unseen, chosen.enrol),
    ):
        if subjects:
            held_out = [f for f in frames if f.subject in subjects and f.kind == "full" and f.pose_key not in shown]
            if not held_out:
                raise Unsupported(f"protocol {protocol.label}: no fully lit frames of {GROUPS[group]} to measure on")
            enrolment = capture.recording(frame for frame in known if frame.subject in subjects)
            found[group] = geometry_report(prior, enrolment, capture.recording(held_out))
    return prior, found


def run(
    protocol_name: str,
    out: Path,
    data: Path | None = None,
    preset: str | None = None,
    seed: int = 0,
    command: list[str] | None = None,
) -> dict[str, Any]:
    """Train, measure, write `geometry.json` and the weights into `out`, and return what was written.

    Raises `InputError` for an unknown protocol or preset, `StorageError` for a folder that cannot be written.
    """
    protocol = find_protocol(protocol_name)
    preset = preset or protocol.preset_of(NAME)
    tracker = create(preset)
    about = plain(provenance(command or sys.argv))
    try:
        (out / "prior").mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StorageError(f"{out} cannot be written ({error}); choose another folder") from error
    with steps() as told:
        capture = open_capture(protocol.capture, protocol.size, data, told)
        prior, found = evaluate(capture, protocol, preset, seed, told(f"geometry {preset}"))
    prior.save(out / "prior")
    result = {
        "schema": SCHEMA,
        "provenance": about,
        "protocol": protocol.label,
        "capture": {"name": capture.name, "digest": capture.digest},
        "preset": preset,
        "config": tracker.config,
        "seed": seed,
        "unit": "mm",
        "table": table(found),
        "frames": {group: [asdict(errors) for errors in one] for group, one in found.items()},
    }
    with whole(out / RESULT) as part:
        part.write_text(json.dumps(result, indent=1, allow_nan=False))
    return result


def table(found: dict[str, list[FrameErrors]]) -> list[dict[str, Any]]:
    """One line per group and row: titles, how many frames, mean errors in millimetres."""
    return [
        {"group": group, "row": row, "title": ROWS[row], "frames": len({e.frame for e in errors}), **means}
        for group, errors in found.items()
        for row, means in mean_errors(errors).items()
    ]


def render(lines: list[dict[str, Any]]) -> Table:
    """The table of `run` for the terminal."""
    shown = Table(box=None, padding=(0, 2, 0, 0), header_style="dim", title="Geometry errors in millimetres")
    for title, side in (("group", "left"), ("mesh", "left"), ("frames", "right"), *((e, "right") for e in ERRORS)):
        shown.add_column(title.replace("_", " "), justify=side)  # type: ignore[arg-type]
    for line in lines:
        errors = ("–" if line[name] is None else f"{line[name]:.2f}" for name in ERRORS)
        shown.add_row(GROUPS[line["group"]], line["title"], str(line["frames"]), *errors)
    return shown
