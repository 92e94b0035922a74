"""The path tracer against Mitsuba's own integrator, against analytic values, and its conventions."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest

from handbench.data.openstage.trace.llvm import choose_variant
from handbench.data.openstage.trace.mitsuba_scene import emitter, lobes, matte, sensor, shape
from handbench.data.openstage.trace.pathtrace import PathTracer, TracedSurface, displace
from handbench.errors import InputError
from handbench.light.environment import directions, solid_angles
from handbench.scene import Camera, Directional, Environment, Group, Light, Mesh, Point, Topology


@pytest.fixture(scope="module")
def tracer() -> PathTracer:
    return PathTracer()


def book(fold: float, albedo: float = 0.6, specular: float = 0.42, roughness: float = 0.4) -> TracedSurface:
    """Two pages, 1 x 2, that meet along the y axis, each lifted by `fold` radians towards +z; a plane for 0."""
    c, s = np.cos(fold), np.sin(fold)
    across, along = np.meshgrid(np.linspace(0, 1, 41), np.linspace(-1, 1, 81))
    pages = [np.stack([side * c * across, along, s * across], axis=-1).reshape(-1, 3) for side in (-1, 1)]
    vertices = np.concatenate(pages)  # each page has an edge of its own, so normals are not smoothed over it
    i = np.arange(across.size).reshape(across.shape)
    a, b, d, e = i[:-1, :-1].ravel(), i[:-1, 1:].ravel(), i[1:, :-1].ravel(), i[1:, 1:].ravel()
    page = np.concatenate([np.stack([a, b, e], axis=1), np.stack([a, e, d], axis=1)])
    faces = np.concatenate([page[:, ::-1], page + across.size])
    uvs = np.stack([(vertices[:, 0] / c + 1) / 2, (vertices[:, 1] + 1) / 2], axis=1)
    rows = np.linspace(0.3, 1.0, 16)[:, None, None] * np.ones((1, 16, 3)) * [1.0, 0.8, 0.6]
    texture = albedo * (rows if fold else np.ones((16, 16, 3)))
    waves = 0.02 * np.sin(np.arange(128) / 8)[None, :] * np.ones((128, 1)) if fold else None
    return TracedSurface(
        Mesh(vertices, Topology(faces, uvs, faces)), texture, np.full((16, 16), roughness), specular, waves
    )


def camera(width: int = 24, height: int = 20, distance: float = 4.0) -> Camera:
    """On the +z axis, looking to -z, +y up in the picture, off-centre principal point."""
    K = np.array([[40.0, 0, width / 2 + 1.5], [0, 40.0, height / 2 - 1.0], [0, 0, 1]])
    return Camera("front", width, height, K, np.array([[1.0, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, distance]]))


def towards(*direction: float) -> np.ndarray:
    return np.array(direction) / np.linalg.norm(direction)


def sky(seed: int = 0) -> Environment:
    """Blocks of 8 x 8 equal texels, one of them a hundred times brighter: Mitsuba's interpolation hardly matters."""
    blocks = np.random.default_rng(seed).uniform(0.2, 1.0, (8, 16, 3))
    blocks[2, 9] = [60.0, 50.0, 30.0]
    return Environment("sky", blocks.repeat(16, axis=0).repeat(16, axis=1))


LIGHTS = (
    Directional(towards(0.5, 0.4, 1.0), np.array([3.0, 2.0, 1.0])),
    Directional(towards(-0.9, 0.1, 0.5), np.array([1.0, 2.0, 3.0])),
    Point(np.array([-0.4, 0.3, 1.2]), np.array([2.0, 2.0, 1.0])),
    sky(),
)


@pytest.mark.parametrize(
    ("surface", "lights", "max_depth"),
    [
        (book(0.9, specular=0.0), LIGHTS, 4),
        (book(0.9, albedo=0.0, specular=1.0), LIGHTS[1:], 2),
        (replace(book(0.9, albedo=0.0, specular=1.0, roughness=0.15), bump=None), LIGHTS[:1], 2),
    ],
    ids=["matte", "lobes", "sharp lobes"],
)
def test_surfaces_look_as_mitsuba_renders_them(
    tracer: PathTracer, surface: TracedSurface, lights: tuple[Light, ...], max_depth: int
) -> None:
    """Mitsuba's `path` integrator with its own BSDFs on the same scene."""
    mi.set_variant(choose_variant())
    bsdf = matte if surface.specular == 0 else lobes
    images = tracer.render(surface, camera(), lights, spp=192, seed=1, max_depth=max_depth)
    for light, image in zip(lights, images, strict=True):
        scene = {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": max_depth, "rr_depth": 1000, "hide_emitters": True},
            "sensor": sensor(camera()),
            "emitter": emitter(light),
            "shape": shape(surface.mesh, bsdf=bsdf(surface)),
        }
        reference = np.array(mi.render(mi.load_dict(scene), spp=512))[..., :3]
        inside = reference.min(axis=2) > 0.05 * reference.max()
        assert image.sum() == pytest.approx(reference.sum(), rel=0.06)
        error = np.abs(image - reference)[inside] / reference[inside]
        assert np.median(error) < (0.08 if isinstance(light, Environment) else 0.01)  # both have noise under the sky


def test_interreflection_adds_light_in_the_fold(tracer: PathTracer) -> None:
    direct, full = (tracer.render(book(0.9), camera(), LIGHTS[:1], 64, 0, max_depth=d)[0] for d in (2, 4))
    assert full.sum() > 1.08 * direct.sum()
    assert (full >= direct - 1e-6).all()


@pytest.mark.parametrize("direction", [towards(0, 0, 1), towards(0.3, -0.5, 1.0)])
def test_lambert_plane_reflects_albedo_over_pi(tracer: PathTracer, direction: np.ndarray) -> None:
    albedo, irradiance = 0.5, np.array([3.0, 1.0, 0.5])
    surface = book(0.0, albedo=albedo, specular=0.0)
    image = tracer.render(surface, camera(), [Directional(direction, irradiance)], 16, 0)[0]
    assert image[9, 13] == pytest.approx(albedo / np.pi * irradiance * direction[2], rel=1e-4)


def test_light_from_behind_is_dark(tracer: PathTracer) -> None:
    assert tracer.render(book(0.0), camera(), [Directional(towards(0, 0.1, -1), np.ones(3))], 16, 0).max() == 0


def test_group_is_the_sum_of_its_members(tracer: PathTracer) -> None:
    group = Group((LIGHTS[0].scaled(0.5), Group((LIGHTS[2],))))
    both = tracer.render(book(0.9), camera(), [LIGHTS[0].scaled(0.5), group, LIGHTS[2]], 16, 3)
    np.testing.assert_array_equal(both[1], both[0] + both[2])


def test_images_of_a_light_do_not_depend_on_the_others(tracer: PathTracer) -> None:
    surface = replace(book(0.9), mean_free_path=np.array([0.3, 0.1, 0.05]))
    together = tracer.render(surface, camera(), LIGHTS, 48, 3)
    for light, image in zip(LIGHTS, together, strict=True):
        np.testing.assert_array_equal(tracer.render(surface, camera(), [light], 48, 3)[0], image)


def test_pictures_are_equal_to_the_bit_in_another_process_with_other_threads(tmp_path: Path) -> None:
    program = (
        "import sys; sys.path.insert(0, sys.argv[1])\n"
        "import numpy as np, test_pathtrace as t\n"
        "surface = t.replace(t.book(0.9), mean_free_path=np.array([0.3, 0.1, 0.05]))\n"
        "np.save(sys.argv[2], t.PathTracer().render(surface, t.camera(), t.LIGHTS, spp=48, seed=0))\n"
    )
    path, threads = tmp_path / "there.npy", str((os.cpu_count() or 1) + 1)
    names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "TBB_NUM_THREADS")
    environment = {**os.environ, **dict.fromkeys(names, threads)}
    subprocess.run([sys.executable, "-c", program, str(Path(__file__).parent), path], check=True, env=environment)
    surface = replace(book(0.9), mean_free_path=np.array([0.3, 0.1, 0.05]))
    np.testing.assert_array_equal(np.load(path), PathTracer().render(surface, camera(), LIGHTS, spp=48, seed=0))


def test_another_seed_has_other_noise(tracer: PathTracer) -> None:
    first, other = (tracer.render(book(0.9), camera(), [sky()], 16, seed)[0] for seed in (5, 6))
    assert np.abs(first - other).max() > 1e-3


@pytest.mark.parametrize("texel", [(1, 3), (5, 20), (7, 0), (3, 31)])
def test_environment_texel_lies_where_directions_says(tracer: PathTracer, texel: tuple[int, int]) -> None:
    """One bright texel lights a plane like a directional light from `directions(height, width)[texel]`."""
    radiance = np.zeros((16, 32, 3))
    radiance[texel] = 40.0
    direction = directions(16, 32)[texel]
    rotation = np.stack([np.cross([0, 0.6, 0.8], direction), np.zeros(3), direction])
    rotation[0] /= np.linalg.norm(rotation[0])
    rotation[1] = np.cross(rotation[2], rotation[0])
    plane = book(0.0, specular=0.0)
    mesh = Mesh(plane.mesh.vertices @ rotation, plane.mesh.topology)
    turned = TracedSurface(mesh, plane.albedo, plane.roughness, specular=0.0)
    view = camera()
    facing = Camera("facing", view.width, view.height, view.K, view.world_to_camera @ _homogeneous(rotation))
    irradiance = np.full(3, 40.0 * solid_angles(16, 32)[texel])
    lights = [Environment("one", radiance), Directional(direction, irradiance)]
    image = tracer.render(turned, facing, lights, 64, 0)
    assert image[0, 9, 13] == pytest.approx(image[1, 9, 13], rel=0.01)
    assert image[1, 9, 13].min() > 0.01


def _homogeneous(rotation: np.ndarray) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3] = rotation
    return matrix


@pytest.mark.parametrize("specular", [0.0, 0.42])
def test_a_white_plane_returns_an_even_sky(tracer: PathTracer, specular: float) -> None:
    image = tracer.render(book(0.0, 1.0, specular), camera(), [Environment("white", np.ones((8, 16, 3)))], 384, 0)[0]
    assert image[9, 13] == pytest.approx(np.ones(3), rel=0.01)


def test_textures_are_not_flipped(tracer: PathTracer) -> None:
    albedo = np.zeros((2, 2, 3))
    albedo[0, 0], albedo[0, 1], albedo[1, 0] = [1, 0, 0], [0, 1, 0], [0, 0, 1]
    plane = book(0.0, specular=0.0)
    surface = TracedSurface(plane.mesh, albedo, plane.roughness, specular=0.0)
    image = tracer.render(surface, camera(), [Directional(towards(0, 0, 1), np.ones(3))], 16, 0)[0]
    cx, cy = 13, 9  # the middle of the plane, which spans ±10 pixels
    assert image[cy - 7, cx - 7].argmax() == 0 and image[cy - 7, cx + 7].argmax() == 1
    assert image[cy + 7, cx - 7].argmax() == 2 and image[cy + 7, cx + 7].max() < 0.02


def test_gbuffer_is_where_the_plane_is(tracer: PathTracer) -> None:
    surface = book(0.0)
    buffer = tracer.gbuffer(surface, camera(), 16)
    image = tracer.render(surface, camera(), [Environment("white", np.ones((8, 16, 3)))], 64, 0)[0]
    np.testing.assert_array_equal(buffer.alpha > 0, image.max(axis=2) > 0)
    inside = buffer.alpha > 0
    np.testing.assert_allclose(buffer.normal[inside], np.broadcast_to([0, 0, 1], (inside.sum(), 3)), atol=1e-6)
    np.testing.assert_allclose(buffer.depth[inside], 4.0, rtol=1e-5)
    u = (np.arange(24) + 0.5 - 13.5) / 20 + 0.5
    whole = buffer.alpha[9] == 1
    assert whole.sum() >= 18
    np.testing.assert_allclose(buffer.uv[9, whole, 0], u[whole], atol=0.02)  # within half a subsample


def test_what_a_camera_saw_last_is_not_taken_for_what_another_sees(tracer: PathTracer) -> None:
    light, near, far = Directional(towards(0, 0, 1), np.ones(3)), camera(), camera(distance=5.0)
    for surface, fold in ((book(0.0), False), (book(0.6), True)):
        for view, depth in ((near, 4.0), (far, 5.0)):
            tracer.render(surface, view, [light], 16, 0)
            for samples in (16, 4):
                buffer, fresh = (one.gbuffer(surface, view, samples) for one in (tracer, PathTracer()))
                np.testing.assert_array_equal(buffer.depth, fresh.depth)
                assert fold or abs(buffer.depth.max() - depth) < 1e-4


def test_displace_moves_along_normals_and_keeps_seams_closed() -> None:
    across, along = np.meshgrid([-1.0, 0.0, 1.0], [-1.0, 1.0])
    vertices = np.stack([across, along, 0 * across], axis=-1).reshape(-1, 3)
    topology = Topology(
        faces := np.array([[0, 1, 4], [0, 4, 3], [1, 2, 5], [1, 5, 4]]), (vertices[:, :2] + 1) / 2, faces
    )
    split = Topology(topology.faces, np.concatenate([topology.uvs, topology.uvs * 0.5]), topology.uv_faces.copy())
    uv_faces = np.array(split.uv_faces)
    uv_faces[2:] += len(topology.uvs)  # the right page reads another place of the map
    mesh = Mesh(vertices, Topology(topology.faces, split.uvs, uv_faces))

    class Bump:
        displacement = np.tile(np.linspace(0.0, 0.1, 64), (64, 1))

    moved = displace(mesh, Bump())
    np.testing.assert_allclose(moved.vertices[:, :2], mesh.vertices[:, :2], atol=1e-12)
    left, middle = moved.vertices[0, 2], moved.vertices[1, 2]
    assert left == pytest.approx(0.0, abs=1e-3)
    assert middle == pytest.approx((0.05 + 2 * 0.025) / 3, abs=2e-3)  # one face on the left, two on the right


@pytest.mark.parametrize(("spp", "max_depth"), [(0, 4), (16, 1)])
def test_too_few_samples_or_segments_are_refused(tracer: PathTracer, spp: int, max_depth: int) -> None:
    with pytest.raises(InputError, match=f"spp {spp} .*max_depth {max_depth} "):
        tracer.render(book(0.0), camera(), LIGHTS, spp, 0, max_depth)
