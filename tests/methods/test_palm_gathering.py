"""What a hand hides from its places, and the light that they gather."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from handbench.errors import InputError, Unsupported
from handbench.lean import open3d
from handbench.light.stage import stage_directions
from handbench.methods.palm.gathering import Gatherer, Gathering
from handbench.methods.palm.reflectance import Material, coloured, responses
from handbench.methods.palm.scattering import Scattering
from handbench.methods.palm.visibility import (
    BODY_SCALE,
    HAND_SCALE,
    DensityOccluder,
    March,
    MeshOccluder,
    MovedOccluder,
)
from handbench.render.see.posedmesh import PosedMesh
from handbench.scene import Array, Directional, Environment, Group, Mesh, Point, Topology, Unknown
from handbench.skips import Skips, skipping

RADIUS, HEIGHT = 0.008, 0.0234  # a finger's, across the z axis above the place
FOOT = 4e-4  # width of the density's rise


def finger() -> PosedMesh:
    """A cylinder along z, of a finger's thickness."""
    made = open3d().geometry.TriangleMesh.create_cylinder(RADIUS, 0.2, resolution=96, split=4)
    vertices = np.asarray(made.vertices) + np.array([0.0, HEIGHT, 0.0])
    return PosedMesh(Mesh(vertices, Topology(np.asarray(made.triangles))))


def density(points: Tensor) -> Tensor:
    """The same finger, endless, with a Laplace density."""
    sdf = (points[:, :2] - torch.tensor([0.0, HEIGHT])).norm(dim=1) - RADIUS
    return (0.5 - 0.5 * sdf.sign() * -torch.expm1(-sdf.abs() / FOOT)) / FOOT


def ground(count: int = 12) -> Scattering:
    """Places on the ground below the finger, each of a material of its own, seen from above."""
    rng = np.random.default_rng(2)
    point = np.stack([np.linspace(-0.03, 0.03, count), np.zeros(count), np.zeros(count)], axis=1)
    view = rng.normal(size=(count, 3)) * [1.0, 0.2, 1.0] + [0.0, 2.0, 0.0]
    values = torch.from_numpy(rng.uniform(0.2, 0.8, (count, 5))).float()
    return Scattering(
        count,
        torch.arange(count),
        torch.from_numpy(rng.uniform(0.5, 1.0, count)).float(),
        torch.from_numpy(point).float(),
        torch.tensor([[0.0, 1.0, 0.0]]).repeat(count, 1),
        torch.nn.functional.normalize(torch.from_numpy(view).float(), dim=1),
        Material(values[:, :3], values[:, 3], values[:, 4]),
    )


def hidden(points: Array, towards: Array) -> Array:
    """Whether the endless finger is in the way, in closed form: (P, D)."""
    across = np.array([0.0, HEIGHT]) - points[:, None, :2]
    flat = towards[None, :, :2]
    length = np.linalg.norm(flat, axis=2)
    along = (across * flat).sum(axis=2) / length
    away = np.sqrt(np.maximum((across**2).sum(axis=2) - along**2, 0.0))
    return (away < RADIUS) & (along > 0)


def test_mesh_and_hand_scale_march_hide_what_the_finger_hides_and_the_released_march_does_not() -> None:
    places, towards = ground(), stage_directions(400)
    towards = towards[np.abs(towards[:, 2]) < 0.85]  # those that do not run along it
    expected = ~hidden(places.point.numpy(), towards) & (towards[:, 1] > 0)
    ways = torch.from_numpy(towards).float()
    above = towards[:, 1] > 0.05
    by_mesh = MeshOccluder(finger()).of_all(places.point, places.normal, ways).numpy()
    assert ((by_mesh > 0) == expected)[:, above].mean() > 0.995
    by_march = DensityOccluder(density, HAND_SCALE).of_all(places.point, places.normal, ways).numpy()
    assert np.abs(by_march - expected)[:, above].mean() < 0.03
    released = DensityOccluder(density, BODY_SCALE).of_all(places.point, places.normal, ways).numpy()
    missed = (released > 0.5) & ~expected
    assert missed[:, above].sum() > 0.15 * (~expected)[:, above].sum()


def test_near_lights_are_hidden_by_what_is_before_them_only() -> None:
    occluder, place = MeshOccluder(finger()), torch.zeros(1, 3)
    assert occluder.of_near(place, np.array([0.0, 0.5, 0.0])).item() == 0.0
    assert occluder.of_near(place, np.array([0.0, 0.5 * HEIGHT, 0.0])).item() == 1.0
    assert occluder(place, torch.tensor([[0.0, 1.0, 0.0]])).item() == 0.0


def test_a_moved_occluder_hides_what_it_would_hide_there() -> None:
    places, towards = ground(), torch.from_numpy(stage_directions(100)).float()
    turn = torch.linalg.qr(torch.from_numpy(np.random.default_rng(5).normal(size=(3, 3))).float())[0]
    turn, offset = turn * turn.det(), torch.tensor([0.3, -0.1, 0.2])
    inner = MeshOccluder(finger())
    # what is now at turn^T (x - offset) was at x
    moved = MovedOccluder(inner, turn, offset)
    now = (places.point - offset) @ turn, places.normal @ turn, towards @ turn
    assert (moved.of_all(*now) == inner.of_all(places.point, places.normal, towards)).float().mean() > 0.99
    assert (moved(now[0], now[2][:1].expand(len(now[0]), 3)) == inner(places.point, towards[:1].expand(12, 3))).all()
    light = np.array([0.0, 0.5, 0.0])
    back = turn.T.double().numpy() @ (light - offset.double().numpy())
    assert torch.equal(moved.of_near(now[0], back), inner.of_near(places.point, light))


@pytest.mark.parametrize("values", [(0, 0.0, 0.3), (8, 0.3, 0.3), (8, -0.1, 0.3)])
def test_impossible_marches_are_refused(values: tuple[int, float, float]) -> None:
    with pytest.raises(InputError, match="no march"):
        March(*values)


class Counting(MeshOccluder):
    asked = 0

    def of_all(self, points: Tensor, normal: Tensor, towards: Tensor) -> Tensor:
        self.asked += len(towards)
        return super().of_all(points, normal, towards)


def room(seed: int) -> Environment:
    rng = np.random.default_rng(seed)
    radiance = np.full((16, 32, 3), rng.uniform(0.1, 0.3, 3))
    radiance[2, int(rng.integers(32))] = 30.0
    return Environment(f"room {seed}", radiance)


def test_distant_light_is_one_sample_exactly() -> None:
    places, way = ground(), np.array([0.6, 0.8, 0.0])
    gatherer = Gatherer(places, MeshOccluder(finger()), Gathering())
    found = gatherer.colours(Directional(way, np.array([3.0, 2.0, 1.0])))
    towards = torch.from_numpy(way[None]).float()
    answers = responses(places.normal, places.view, places.material.roughness, towards)
    lit = torch.from_numpy(~hidden(places.point.numpy(), way[None]))
    expected = coloured(places.material, answers, torch.tensor([[3.0, 2.0, 1.0]])) * lit
    assert 0 < lit.sum() < len(lit)
    assert torch.allclose(found, places.total(expected), rtol=1e-5)


def test_a_far_point_light_is_a_distant_one_and_light_adds() -> None:
    places, way, power = ground(), np.array([0.6, 0.8, 0.0]), np.array([3.0, 2.0, 1.0])
    gatherer = Gatherer(places, MeshOccluder(finger()), Gathering())
    far, sun = Point(1e3 * way, 1e6 * power), Directional(way, power)
    assert torch.allclose(gatherer.colours(far), gatherer.colours(sun), rtol=1e-3, atol=1e-6)
    lights = (sun, Point(np.array([0.1, 0.3, 0.2]), power), room(1))
    alone = sum(gatherer.colours(light) for light in lights)
    assert torch.allclose(gatherer.colours(Group(lights)), alone, rtol=2e-2)
    twice = gatherer.colours(sun.scaled(2.0))
    assert torch.allclose(twice, 2.0 * gatherer.colours(sun), rtol=1e-5)


@pytest.mark.parametrize("how", ["strata", "light", "combined"])
def test_sampled_maps_come_to_what_their_lights_come_to(how: str) -> None:
    # of a map with a lamp: most of its light comes from one texel
    occluder = MeshOccluder(finger())
    every = Gatherer(ground(), occluder, Gathering(error=0.0)).colours(room(3))
    count, most = (8192, 0.25) if how == "strata" else (2048, 0.1)
    few = Gatherer(ground(), occluder, Gathering(maps=how, directions=count)).colours(room(3))  # type: ignore[arg-type]
    assert float((few - every).norm() / every.norm()) < most
    fresh = Gathering(maps=how, directions=count, fresh=True)  # type: ignore[arg-type]
    alone = Gatherer(ground(), occluder, fresh).colours(room(3))
    assert float((alone - every).norm() / every.norm()) < most


def test_a_second_map_asks_only_for_its_own_lights() -> None:
    occluder = Counting(finger())
    gatherer = Gatherer(ground(), occluder, Gathering())
    first = gatherer.colours(room(1))
    asked = occluder.asked
    gatherer.colours(room(2))
    assert 0 < occluder.asked - asked < asked / 5
    assert torch.equal(gatherer.colours(room(1)), first)
    before = occluder.asked
    with skipping(Skips(known=False)):
        plain = gatherer.colours(room(1))
    assert occluder.asked - before == asked
    assert torch.equal(plain, first)


def test_unknown_light_and_darkness() -> None:
    gatherer = Gatherer(ground(), MeshOccluder(finger()), Gathering())
    with pytest.raises(Unsupported, match="not told"):
        gatherer.colours(Unknown("own"))
    assert not gatherer.colours(Group(())).any()
    assert not gatherer.colours(Environment("night", np.zeros((4, 8, 3)))).any()


def test_march_in_the_place_of_a_mesh() -> None:
    places = ground()
    by_mesh = Gatherer(places, MeshOccluder(finger()), Gathering()).colours(room(4))
    by_march = Gatherer(places, DensityOccluder(density), Gathering()).colours(room(4))
    assert float((by_march - by_mesh).norm() / by_mesh.norm()) < 0.1
    shaded = Gatherer(replace(places, point=places.point + 10.0), MeshOccluder(finger()), Gathering()).colours(room(4))
    assert (by_mesh <= shaded + 1e-5).all()
