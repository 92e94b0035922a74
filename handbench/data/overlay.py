"""A sheet of pictures with what a capture tells drawn over them: mesh, key points, light. A wrong convention shows."""

from __future__ import annotations

from pathlib import Path
from typing import assert_never

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from ..errors import HandbenchError
from ..evenly import evenly
from ..files import whole
from ..hand import hand_model
from ..hand.handmodel import HandModel
from ..render.see.posedmesh import PosedMesh
from ..render.see.raster import Raster
from ..scene import Array, Camera, Directional, Environment, Frame, Light, Mesh, Point, Uncalibrated, Unknown, leaves
from ..scene.colour import eight_bit
from .capture import Capture, read
from .overlap import mesh_of

_HEIGHT, _COLUMNS, _MOST = 256, 4, 12
_BALL = 22  # pixels: radius of the ball that shows the light
_LABEL, _GAP = 16, 4
_PAPER, _INK = (18, 18, 20), (225, 225, 228)
_MESH, _SEEN, _MODEL, _LIGHT = (70, 220, 255), (255, 90, 90), (255, 225, 70), (255, 190, 60)


def sheet(capture: Capture) -> Image.Image:
    """Up to 12 frames, spread over a capture: the mesh's outline in blue, key points as they were detected in red and
    those of the hand model in yellow, and in the corner a white ball as the frame's light falls on it, arrows towards
    single lights."""
    some = evenly(capture.frames(), _MOST)
    cells = [_cell(capture, frame) for frame in some]
    width, height = max(cell.width for cell in cells), _HEIGHT + _LABEL
    rows = -(-len(cells) // _COLUMNS)
    page = Image.new("RGB", (min(len(cells), _COLUMNS) * (width + _GAP), rows * (height + _GAP) + 2 * _LABEL), _PAPER)
    draw, font = ImageDraw.Draw(page), ImageFont.load_default(11)
    told = (("mesh", _MESH), ("key points detected", _SEEN), ("of the model", _MODEL), ("light", _LIGHT))
    at = 4.0
    for name, colour in told:
        draw.text((at, 6), name, colour, font)
        at += font.getlength(name) + 12
    for i, (frame, cell) in enumerate(zip(some, cells, strict=True)):
        x, y = (i % _COLUMNS) * (width + _GAP), 2 * _LABEL + (i // _COLUMNS) * (height + _GAP)
        key = frame.key
        while font.getlength(key) > width - 4 and "/" in key:  # the end says which it is
            key = key.partition("/")[2]
        draw.text((x + 2, y), key, _INK, font)
        page.paste(cell, (x, y + _LABEL))
    return page


def write_sheet(capture: Capture, path: Path) -> None:
    """Write the sheet as PNG; raises `StorageError` if it cannot be written."""
    made = sheet(capture)
    with whole(path, "choose another place with --out") as part:
        made.save(part, format="PNG", optimize=True)


def _cell(capture: Capture, frame: Frame) -> Image.Image:
    width = max(1, round(_HEIGHT * frame.camera.width / frame.camera.height))
    try:
        seen = read(capture, frame)
        if frame.mesh is not None:
            _ = frame.mesh.vertices  # which are read here, if they are not yet
    except HandbenchError:  # `troubles` tells why
        return Image.new("RGB", (width, _HEIGHT), (60, 20, 20))
    picture = Image.fromarray(eight_bit(_exposed(seen.image))).resize((width, _HEIGHT), Image.Resampling.LANCZOS)
    draw, scale = ImageDraw.Draw(picture), _HEIGHT / frame.camera.height
    if not isinstance(frame.camera, Uncalibrated):
        model = None if capture.hand is None or frame.pose is None or frame.shape is None else hand_model(capture.hand)
        mesh = mesh_of(capture, frame)
        if mesh is not None:
            _outline(picture, mesh, frame.camera)
        if model is not None:
            _points(draw, _projected(model, frame), scale, _MODEL)
        _ball(picture, frame.light, frame.camera, mesh)
    if seen.keypoints is not None:
        _points(draw, seen.keypoints[seen.keypoints[:, 2] > 0, :2], scale, _SEEN)
    return picture


def _exposed(image: Array) -> Array:
    """Brightened, if need be, until what is brightest of the hand is nearly white."""
    top = float(np.percentile(image.max(axis=-1), 99))
    return image / top if 0 < top < 0.5 else image


def _outline(picture: Image.Image, mesh: Mesh, camera: Camera) -> None:
    """The border of what the mesh covers, and faintly where its surface folds."""
    raster = Raster(PosedMesh(mesh), camera, 1)
    covered = np.asarray(Image.fromarray((255 * raster.alpha).astype(np.uint8)).resize(picture.size)) > 127
    edge = covered & ~(
        np.roll(covered, 1, 0) & np.roll(covered, -1, 0) & np.roll(covered, 1, 1) & np.roll(covered, -1, 1)
    )
    pixels = np.array(picture)
    pixels[edge] = _MESH
    picture.paste(Image.fromarray(pixels))


def _projected(model: HandModel, frame: Frame) -> Array:
    assert frame.pose is not None and frame.shape is not None
    _, points = model.posed(frame.shape, frame.pose)
    places, depth = frame.camera.project(points[list(model.key_points)])
    return places[depth > 0]


def _points(draw: ImageDraw.ImageDraw, places: Array, scale: float, colour: tuple[int, int, int]) -> None:
    for x, y in (places * scale).tolist():
        draw.ellipse((x - 2, y - 2, x + 2, y + 2), outline=colour)


def _ball(picture: Image.Image, light: Light, camera: Camera, mesh: Mesh | None) -> None:
    """A white, matt ball in the upper left corner, as it would look where the hand is, and an arrow to each light."""
    span = (np.arange(2 * _BALL) - _BALL + 0.5) / _BALL
    x, y = np.meshgrid(span, span)
    inside = x**2 + y**2 < 1
    normal = np.stack([x, y, -np.sqrt(np.maximum(1 - x**2 - y**2, 0))], axis=-1) @ camera.rotation  # in the world
    lit, arrows = np.zeros(x.shape), []
    centre = np.zeros(3) if mesh is None else mesh.vertices.mean(axis=0)
    for each in leaves(light):
        match each:
            case Directional():
                towards, power = each.direction, float(each.irradiance.mean())
            case Point():
                away = each.position - centre
                distance = float(np.linalg.norm(away))
                towards, power = away / max(distance, 1e-9), float(each.intensity.mean()) / max(distance, 1e-9) ** 2
            case Environment():
                lit = lit + _under(each, normal)
                continue
            case Unknown():  # of which no ball can be drawn
                return
            case _:
                assert_never(each)
        lit = lit + power * np.maximum(normal @ towards, 0)
        arrows.append(camera.rotation @ towards)
    shade = eight_bit(lit / max(float(lit[inside].max()), 1e-9))
    pixels = np.array(picture)
    corner = pixels[2 : 2 + 2 * _BALL, 2 : 2 + 2 * _BALL]
    fits = inside[: corner.shape[0], : corner.shape[1]]
    corner[fits] = shade[: corner.shape[0], : corner.shape[1], None][fits].repeat(3, axis=-1)
    picture.paste(Image.fromarray(pixels))
    draw, middle = ImageDraw.Draw(picture), 2 + _BALL
    for across, down, _ in arrows[:8]:
        draw.line((middle, middle, middle + 1.3 * _BALL * across, middle + 1.3 * _BALL * down), _LIGHT)


def _under(environment: Environment, normal: Array) -> Array:
    """Irradiance (H, W) of normals (H, W, 3) under an environment, from few of its texels."""
    from ..light.environment import directions, solid_angles

    height, width = environment.radiance.shape[:2]
    step = max(1, height // 16)
    rows, columns = height // step * step, width // step * step
    grey = environment.radiance[:rows, :columns].mean(axis=-1)
    grey = grey.reshape(rows // step, step, columns // step, step).mean(axis=(1, 3))
    towards, weight = directions(*grey.shape), solid_angles(*grey.shape)
    power = (grey * weight).ravel()
    return np.maximum(normal @ towards.reshape(-1, 3).T, 0) @ power
