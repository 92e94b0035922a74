"""A contact sheet: subjects, poses and cameras of a capture under every kind of light, on one picture."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from PIL import Image, ImageDraw, ImageFont

from ..evenly import evenly
from ..files import whole
from ..scene import FRAME_KINDS, Directional, Frame
from ..scene.colour import eight_bit
from .capture import Capture

_MARGIN, _LABEL, _GAP = 64, 20, 3
_POSES = 12
_PAPER, _INK = (18, 18, 20), (225, 225, 228)


def contact_sheet(capture: Capture, cell_height: int = 112) -> Image.Image:
    """Rows are subject and camera, columns pose and kind of light; within a kind the lights take turns.

    Of more than `_POSES` poses that many are shown, spread evenly.
    """
    frames = capture.frames()
    subjects, cameras, kinds = (
        list(dict.fromkeys(values))
        for values in (
            [f.subject for f in frames],
            [f.camera.name for f in frames],
            [k for k in FRAME_KINDS if any(f.kind == k for f in frames)],
        )
    )
    poses = evenly(list(dict.fromkeys(f.pose_name for f in frames)), _POSES)
    table: dict[tuple[str, str, str, str], list[Frame]] = {}
    for frame in frames:
        table.setdefault((frame.subject, frame.camera.name, frame.pose_name, frame.kind), []).append(frame)
    camera = frames[0].camera
    size = (round(cell_height * camera.width / camera.height), cell_height)
    shown = {(pose, kind) for _, _, pose, kind in table}
    columns = [(pose, kind) for pose in poses for kind in kinds if (pose, kind) in shown]
    filled = {(subject, name) for subject, name, pose, _ in table if pose in poses}
    rows = [(subject, name) for subject in subjects for name in cameras if (subject, name) in filled]
    sheet = Image.new(
        "RGB", (_MARGIN + len(columns) * (size[0] + _GAP), 2 * _LABEL + len(rows) * (size[1] + _GAP)), _PAPER
    )
    draw, font = ImageDraw.Draw(sheet), ImageFont.load_default(12)
    for j, (pose, kind) in enumerate(columns):
        x = _MARGIN + j * (size[0] + _GAP)
        if j == 0 or columns[j - 1][0] != pose:
            room = (size[0] + _GAP) * sum(other == pose for other, _ in columns)
            title = f"{pose} ({_segment(frames, pose)})"
            draw.text((x + 2, 3), title if font.getlength(title) < room else pose, _INK, font)
        draw.text((x + 2, _LABEL), kind, _INK, font)
    for i, (subject, name) in enumerate(rows):
        y = 2 * _LABEL + i * (size[1] + _GAP)
        draw.text((4, y + 4), f"{subject}\n{name}", _INK, font)
        for j, (pose, kind) in enumerate(columns):
            choices = table.get((subject, name, pose, kind))
            if choices:
                frame = _shown(choices, i // len(cameras), j)
                picture = Image.fromarray(eight_bit(capture.observe(frame).image)).resize(
                    size, Image.Resampling.LANCZOS
                )
                sheet.paste(picture, (_MARGIN + j * (size[0] + _GAP), y))
    return sheet


def _shown(frames: Sequence[Frame], row: int, column: int) -> Frame:
    """The frame of a cell: lights take turns, single ones only among those on the camera's side of the hand."""
    camera = frames[0].camera
    towards = -camera.rotation[2]
    front = [f for f in frames if isinstance(f.light, Directional) and f.light.direction @ towards > 0.2]
    choices = front or frames
    return choices[(5 * row + 7 * column) % len(choices)]


def _segment(frames: Sequence[Frame], pose: str) -> str:
    return next(frame.segment for frame in frames if frame.pose_name == pose)


def summary(capture: Capture) -> str:
    """What a capture holds, one line a fact."""
    frames = capture.frames()
    camera = frames[0].camera
    lines = [
        f"{capture.name}  digest {capture.digest}",
        f"subjects  {', '.join(dict.fromkeys(f.subject for f in frames))}",
        f"cameras   {', '.join(dict.fromkeys(f.camera.name for f in frames))}, {camera.width}x{camera.height} pixels",
    ]
    for segment in dict.fromkeys(f.segment for f in frames):
        poses = {f.pose_key for f in frames if f.segment == segment}
        lines.append(f"segment   {segment}: {len(poses)} poses of all subjects together")
    for kind in dict.fromkeys(f.kind for f in frames):
        names = list(dict.fromkeys(f.lighting for f in frames if f.kind == kind))
        listed = ", ".join(names) if len(names) <= 8 else f"{names[0]} to {names[-1]}, {len(names)} lights"
        lines.append(f"light     {kind}: {listed}")
    lines.append(f"frames    {len(frames)}")
    return "\n".join(lines)


def write_contact_sheet(capture: Capture, path: Path) -> None:
    """Write the contact sheet as PNG; raises `StorageError` if it cannot be written."""
    sheet = contact_sheet(capture)
    with whole(path, "choose another place with --out") as part:
        sheet.save(part, format="PNG", optimize=True)
