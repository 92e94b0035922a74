"""Shadows: lights at the horizon, inside and on the mesh, on damaged, tiny, huge and far meshes."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial

import numpy as np

from ...light.lightset import LightSet
from ...light.stage import stage_directions
from ...render.see.shadowmap import soft_visibility
from ...render.see.visibility import visibility
from ...render.uv.posed import PosedSurface
from ...render.uv.surface import mesh_normals
from ...scene import Array, Mesh
from .case import Case
from .cases_surface import MESHES
from .judgement import TruthPair, equal, finite
from .scenes import NONE, WHITE, atlas, distant, flipped, globe, hand, moved, plates, torn

FAMILY = "visibility"
SIZE = 32
CLEAR = 0.2
"""Sine of the angle to the horizon beyond which a coarse globe's own facets cannot matter."""

Visible = Callable[[Mesh, Array, Array | None], Array]


def _hard(mesh: Mesh, directions: Array, positions: Array | None = None) -> Array:
    return visibility(mesh, atlas(mesh, SIZE), directions, positions)


def _soft(mesh: Mesh, directions: Array, positions: Array | None = None) -> Array:
    return np.asarray(soft_visibility(mesh, atlas(mesh, SIZE), directions, positions))


KINDS: dict[str, Visible] = {"hard": _hard, "soft": _soft}


def cases() -> Iterator[Case]:
    for kind, visible in KINDS.items():
        yield from _of_kind(kind, visible)
    for scale, shift in ((1e-3, 0.0), (1e3, 0.0), (1.0, 10.0), (1.0, 1000.0)):
        where = f"scale {scale:g}" if scale != 1 else f"{shift:g} m from the origin"
        yield Case(FAMILY, f"hard, the same at {where}", equal(0.02), partial(_invariant, scale, shift), "scale 1 at 0")
    yield Case(FAMILY, "soft, the same 10 m from the origin", equal(0.02), _soft_shifted, "at the origin")
    yield Case(FAMILY, "soft falls by the depth of the shadow", equal(0.05), _falloff, "exp(-d / 8 mm)")
    yield Case(FAMILY, "hard, 10000 lights", equal(), _many, "each light alone")
    yield Case(FAMILY, "hard, kept shadows are those computed", equal(), _kept, "computed anew")


def _of_kind(kind: str, visible: Visible) -> Iterator[Case]:
    for name, mesh in MESHES.items():
        yield Case(FAMILY, f"{kind}, {name}", finite(), partial(_stage, visible, mesh))
    yield Case(FAMILY, f"{kind}, no lights", equal(), partial(_none, visible), "an empty answer")
    within = 0.0 if kind == "hard" else 0.1
    convex = partial(_globe, visible, _ball)
    yield Case(FAMILY, f"{kind}, a globe shadows half of itself", equal(within), convex, "closed form")
    if kind == "hard":  # the soft formula asks for smooth normals
        apart = partial(_globe, visible, lambda: torn(_ball()))
        yield Case(FAMILY, "hard, a globe of separate triangles", equal(within), apart, "closed form")
    places = {
        "light inside the mesh": np.array([[0.1, 0.2, 0.0]]),
        "light in the middle of the mesh": np.zeros((1, 3)),
    }
    for name, place in places.items():
        yield Case(
            FAMILY, f"{kind}, {name} lights nothing", equal(within), partial(_near, visible, globe, place), "zero"
        )
    yield Case(FAMILY, f"{kind}, light on a vertex", finite(), lambda: visible(globe(), NONE, globe().vertices[40:41]))
    for distance in (1e3, 1e6):
        off = partial(_distant_point, visible, distance)
        yield Case(FAMILY, f"{kind}, light {distance:g} m off", equal(within), off, "a distant light")
    turned = partial(_near, visible, lambda: flipped(globe()), np.array([[0.0, 0.0, 3.0]]))
    yield Case(FAMILY, f"{kind}, inverted globe, lit from outside", equal(within), turned, "zero")
    horizon = partial(_plate_horizon, visible)
    yield Case(FAMILY, f"{kind}, lights exactly at the horizon of a plane", finite(), horizon)
    yield Case(FAMILY, f"{kind}, plane under plane", equal(within), partial(_plates, visible), "closed form")


def _stage(visible: Visible, mesh: Callable[[], Mesh]) -> Array:
    return visible(mesh(), stage_directions(24), None)


def _none(visible: Visible) -> TruthPair:
    count = atlas(globe(), SIZE).count
    return TruthPair((visible(globe(), NONE, None), 1.0), (np.zeros((0, count)), 1.0))


def _normals(mesh: Mesh) -> Array:
    return atlas(mesh, SIZE).interpolate(mesh_normals(mesh))


def _ball() -> Mesh:
    """A globe as large as a hand."""
    return moved(globe(32, 64), 0.1)


def _globe(visible: Visible, mesh: Callable[[], Mesh]) -> TruthPair:
    """On a convex surface nothing lies before a texel: a light is seen exactly where it is above the horizon.

    Soft visibility blends 1 m in where a texel turns away from the light, by a sigmoid of ten times the cosine.
    """
    towards = stage_directions(24)
    cosine = towards @ _normals(_ball()).T
    clear = np.abs(cosine) > CLEAR
    truth = (cosine > 0).astype(np.float64)
    if visible is _soft:
        truth = np.exp(-1.0 / (1.0 + np.exp(10.0 * cosine)) / 8e-3)
    return TruthPair(visible(mesh(), towards, None)[clear], truth[clear], least=1.0)


def _near(visible: Visible, mesh: Callable[[], Mesh], place: Array) -> TruthPair:
    seen = visible(mesh(), NONE, place)
    return TruthPair(seen, np.zeros(seen.shape), least=1.0)


def _distant_point(visible: Visible, distance: float) -> TruthPair:
    towards = stage_directions(5)
    clear = np.abs(towards @ _normals(_ball()).T) > CLEAR
    near = visible(_ball(), NONE, distance * towards)
    return TruthPair(near[clear], visible(_ball(), towards, None)[clear], least=1.0)


def _plate_horizon(visible: Visible) -> Array:
    turn = np.linspace(0, 2 * np.pi, 8, endpoint=False)
    return visible(plates(), np.stack([np.cos(turn), np.zeros(8), np.sin(turn)], axis=1), None)


def _plates(visible: Visible) -> TruthPair:
    """Straight above, the lower plate's middle is hidden by the upper one 80 mm over it, all else is seen."""
    mesh = plates(0.08)
    point = atlas(mesh, SIZE).interpolate(mesh.vertices)
    under = (point[:, 1] < 0.04) & (np.abs(point[:, [0, 2]]).max(axis=1) < 0.02)
    free = (point[:, 1] > 0.04) | (np.abs(point[:, [0, 2]]).max(axis=1) > 0.03)
    inner = np.abs(point[:, [0, 2]]).max(axis=1) < 0.048  # a shadow map may be unsure at a border
    seen = visible(mesh, np.array([[0.0, 1.0, 0.0]]), None)[0]
    rim = (point[:, 1] > 0.04) & (np.abs(point[:, [0, 2]]).max(axis=1) > 0.023)
    sure = (under | free) & inner & ~rim
    return TruthPair(seen[sure], (~under)[sure], least=1.0)


def _falloff() -> TruthPair:
    """Under a plate 4 mm up soft visibility is exp(-1/2)."""
    mesh = plates(0.004)
    point = atlas(mesh, SIZE).interpolate(mesh.vertices)
    under = (point[:, 1] < 0.002) & (np.abs(point[:, [0, 2]]).max(axis=1) < 0.02)
    seen = _soft(mesh, np.array([[0.0, 1.0, 0.0]]))[0][under]
    return TruthPair(seen, np.full(seen.shape, np.exp(-0.5)))


def _invariant(scale: float, shift: float) -> TruthPair:
    towards = stage_directions(24)
    return TruthPair(_hard(moved(hand(), scale, shift), towards), _hard(hand(), towards), "mean")


def _soft_shifted() -> TruthPair:
    towards = stage_directions(24)
    return TruthPair(_soft(moved(hand(), 1.0, 10.0), towards), _soft(hand(), towards), "mean")


def _many() -> TruthPair:
    towards = stage_directions(10_000)
    mesh, some = hand(), slice(None, None, 1000)
    return TruthPair(_hard(mesh, towards)[some], _hard(mesh, towards[some]))


def _kept() -> TruthPair:
    towards, place = stage_directions(40), np.array([[0.1, 0.1, 0.3]])
    posed = PosedSurface(hand(), SIZE)
    posed.visibility(distant(towards[::2], np.ones((20, 3))))
    both = posed.visibility(LightSet(towards, np.ones((40, 3)), place, WHITE[None]))
    return TruthPair(both, visibility(hand(), posed.atlas, towards, place))
