"""Soft visibility: fast is as readable, its values are known in simple places, and it agrees with rays."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import pytest

from handbench.errors import InputError
from handbench.hand.openhand import OpenHand, named_pose
from handbench.light.stage import stage_directions
from handbench.render.see.rays import RayScene
from handbench.render.see.shadowmap import soft_visibility
from handbench.render.see.visibility import visibility
from handbench.render.uv.atlas import Atlas
from handbench.render.uv.surface import mesh_normals
from handbench.scene import Array, Mesh
from handbench.skips import NONE, skipping, tallied


def geometry(mesh: Mesh, atlas: Atlas) -> tuple[Array, Array]:
    normal = atlas.interpolate(mesh_normals(mesh))
    return atlas.interpolate(mesh.vertices), normal / np.linalg.norm(normal, axis=1, keepdims=True)


def first_hit(scene: RayScene, origin: Array, direction: Array) -> float:
    return float(scene.cast(origin[None], direction[None]).distance[0])


def reference(mesh: Mesh, atlas: Atlas, light: Array, near: bool, size: int) -> Array:
    """One light's soft visibility (N,), texel by texel and tap by tap, in float64."""
    points, normals = geometry(mesh, atlas)
    scene = RayScene(mesh.vertices, mesh.topology.faces)
    z = scene.centre - light if near else -light
    z = z / np.linalg.norm(z)
    x = np.cross(z, np.eye(3)[np.abs(z).argmin()])
    x /= np.linalg.norm(x)
    y = np.cross(z, x)
    eye = light if near else scene.centre - 10.0 * z
    depth = (points - eye) @ z
    where = np.stack([(points - eye) @ x, (points - eye) @ y], axis=1) / (depth[:, None] if near else 1.0)
    low = where.min(axis=0)
    pitch = np.ptp(where, axis=0).max() / (size - 3)

    @cache
    def map_depth(column: int, row: int) -> float:
        u, v = low + pitch * (np.array([column, row]) + 0.5)
        if near:
            return first_hit(scene, eye, z + u * x + v * y)
        return first_hit(scene, eye + u * x + v * y, z)

    answer = []
    for point, normal, (u, v), own in zip(points, normals, where, depth, strict=True):
        column, row = math.floor((u - low[0]) / pitch), math.floor((v - low[1]) / pitch)
        total = weights = 0.0
        for right in (-1, 0, 1):
            for down in (-1, 0, 1):
                surface = map_depth(column + right, row + down)
                if surface < np.inf:
                    weight = math.exp(-(right**2 + down**2) / (2 * 0.8**2))
                    total += weight * max(0.0, own - surface)
                    weights += weight
        towards = light - point if near else light
        s = 1 / (1 + math.exp(-10 * normal @ towards / np.linalg.norm(towards)))
        millimetres = 1e3 * (s * (total / weights if weights else 0.0)) + (1 - s) * 1e3
        answer.append(math.exp(-millimetres / 8))
    return np.array(answer)


@pytest.mark.parametrize("near", [False, True])
def test_the_fast_path_is_the_readable_one(shapes, near: bool) -> None:
    mesh, middle = shapes.torus(16, 32, ring=0.05, tube=0.02), np.array([0.3, 1.0, -0.2])
    mesh = Mesh(mesh.vertices + middle, mesh.topology)
    atlas = Atlas(mesh.topology, 16)
    for direction in np.array([[0.8, 0.0, 0.6], [0.36, 0.48, -0.8]]):
        light = middle + 0.4 * direction if near else direction
        distant, lamps = (np.zeros((0, 3)), light[None]) if near else (light[None], None)
        with skipping(NONE):
            fast = soft_visibility(mesh, atlas, distant, lamps, size=24)[0]
        slow = reference(mesh, atlas, light, near, size=24)
        assert fast.dtype == np.float32 and 0.05 < slow.mean() < 0.4
        # a texel on the border of two map texels may fall on either side in float32
        assert (np.abs(fast - slow) > 1e-4).mean() < 0.01


def roofed(shapes, height: float) -> tuple[Mesh, Atlas, Array]:
    """A floor of 20 cm with a roof of 8 cm over its middle, and where the floor is well under the roof."""
    floor = shapes.plane(0.2, box=(0.02, 0.02, 0.7, 0.98))
    mesh = shapes.join(floor, shapes.plane(0.08, height=height, box=(0.75, 0.4, 0.98, 0.6)))
    atlas = Atlas(mesh.topology, 64)
    position = atlas.interpolate(mesh.vertices)
    return mesh, atlas, (position[:, 1] < height / 2) & (np.abs(position[:, [0, 2]]).max(axis=1) < 0.03)


UP = np.array([[0.0, 1.0, 0.0]])
OPEN = np.exp(-1000 / (1 + np.exp(10)) / 8)  # of a facing texel: 1 - sigmoid(10) of a metre, 0.994


@pytest.mark.parametrize("height", [0.002, 0.008, 0.03])
@pytest.mark.parametrize("lamps", [None, 0.6 * UP])
def test_light_falls_with_the_depth_behind_the_first_surface(shapes, height: float, lamps: Array | None) -> None:
    mesh, atlas, under = roofed(shapes, height)
    seen = soft_visibility(mesh, atlas, UP if lamps is None else UP[:0], lamps, size=256)[0]
    roof = atlas.interpolate(mesh.vertices)[:, 1] > height / 2
    if lamps is None:
        assert seen[under] == pytest.approx(OPEN * np.exp(-height / 0.008), rel=1e-3)
        assert seen[roof] == pytest.approx(OPEN, rel=1e-4)
    else:  # the light comes aslant: the sigmoid is a little lower
        assert seen[under] == pytest.approx(OPEN * np.exp(-height / 0.008), rel=5e-3)
        assert seen[roof] == pytest.approx(OPEN, rel=5e-3)


@pytest.mark.parametrize("lamp", [(0.0, 0.0, 0.0), (0.02, 0.01, 0.0), (0.0, 0.05, 0.06), (0.05, 0.0, 0.0)])
def test_a_lamp_within_or_beside_the_mesh_sees_along_straight_lines(shapes, lamp: tuple[float, float, float]) -> None:
    mesh = shapes.torus(16, 32, ring=0.05, tube=0.02)  # the lamp is in its hole, above it or in its tube
    atlas = Atlas(mesh.topology, 24)
    points, normals = geometry(mesh, atlas)
    light = np.array(lamp)
    seen = soft_visibility(mesh, atlas, UP[:0], light[None], size=64)[0]
    distance = np.linalg.norm(points - light, axis=1)
    scene = RayScene(mesh.vertices, mesh.topology.faces)
    first = scene.cast(np.broadcast_to(light, points.shape), (points - light) / distance[:, None]).distance
    s = 1 / (1 + np.exp(-10 * (normals * (light - points)).sum(axis=1) / distance))
    expected = np.exp(-(s * np.maximum(distance - first, 0) + (1 - s)) / 0.008)
    assert np.abs(seen - expected).max() < 2e-3
    assert seen.max() > 0.9 or np.hypot(abs(lamp[0]) - 0.05, lamp[1]) < 0.02  # light does not leave the tube


def test_a_lamp_on_the_surface_is_finite(shapes) -> None:
    mesh = shapes.torus(16, 32, ring=0.05, tube=0.02)
    atlas = Atlas(mesh.topology, 24)
    lamps = np.concatenate([mesh.vertices[:2], atlas.interpolate(mesh.vertices)[:2]])
    with skipping(NONE):
        for seen in (soft_visibility(mesh, atlas, UP[:0], lamps), visibility(mesh, atlas, UP[:0], lamps)):
            assert np.isfinite(seen).all() and seen.min() >= 0 and seen.max() <= 1


def test_it_agrees_with_hard_shadows_on_the_hand() -> None:
    hand = OpenHand.load()
    mesh = hand.mesh(hand.neutral(), named_pose("fist"), 1)
    atlas = Atlas(mesh.topology, 48)
    lights = stage_directions(20)
    facing = lights @ geometry(mesh, atlas)[1].T > 0.7  # nearer the horizon soft visibility fades by design
    hard = visibility(mesh, atlas, lights)[facing]
    soft = soft_visibility(mesh, atlas, lights)[facing] > 0.4
    assert (hard & soft).sum() / (hard | soft).sum() > 0.95  # intersection over union of what is lit
    assert (~hard & ~soft).sum() / (~hard | ~soft).sum() > 0.8  # and of what is not


def test_orthographic_maps_are_the_limit_of_distant_lamps() -> None:
    hand = OpenHand.load()
    mesh = hand.mesh(hand.neutral(), named_pose("open"), 0)
    atlas = Atlas(mesh.topology, 32)
    lights = stage_directions(6)
    distant = soft_visibility(mesh, atlas, lights, size=512)
    lamps = soft_visibility(
        mesh, atlas, lights[:0], RayScene(mesh.vertices, mesh.topology.faces).centre + 100.0 * lights, size=512
    )
    assert (np.abs(distant - lamps) > 0.02).mean() < 0.01


def test_what_lies_below_the_horizon_is_dark_anyway(shapes) -> None:
    mesh = shapes.torus(24, 48, ring=0.05, tube=0.02)
    atlas = Atlas(mesh.topology, 32)
    lights, lamps = stage_directions(10), 0.5 * stage_directions(3)
    with tallied() as tally:
        some = soft_visibility(mesh, atlas, lights, lamps, size=64)
    with skipping(NONE), tallied() as whole_tally:
        everything = soft_visibility(mesh, atlas, lights, lamps, size=64)
    assert some.shape == (13, atlas.count)
    assert np.abs(some - everything).max() < 4e-7
    assert np.array_equal(some[some > 0], everything[some > 0])
    saved = tally.lines()["shadow rays"]
    assert saved.total == some.size and 0.5 < saved.skipped / saved.total < 0.7
    assert whole_tally.lines()["shadow rays"].skipped == 0


def test_maps_too_small_for_taps_are_refused(shapes) -> None:
    mesh = shapes.plane(0.1)
    with pytest.raises(InputError, match="shadow maps of 4 texels"):
        soft_visibility(mesh, Atlas(mesh.topology, 8), UP, size=4)
