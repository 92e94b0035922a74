"""The path tracer against Mitsuba's own integrator, against analytic values, and its conventions."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest

from handbench.data.openstage.trace.llvm import VECTORISED, choose_variant
from handbench.data.openstage.trace.mitsuba_scene import emitter, sensor, shape
from handbench.data.openstage.trace.pathtrace import PathTracer, TracedSurface, displace
from handbench.errors import InputError
from handbench.light.environment import directions, solid_angles
from handbench.scene import Camera, Directional, Environment, Group, Mesh, Point, Topology


@pytest.fixture(scope="module")
def tracer() -> PathTracer:
    return PathTracer(choose_variant())


def book(fold: float, albedo: float = 0.6, specular: float = 0.42, roughness: float = 0.4) -> TracedSurface:
    """Two unit pages that meet along the y axis, each lifted by `fold` radians towards +z; a plane for 0."""
    c, s = np.cos(fold), np.sin(fold)
    vertices = np.array([[-c, -1, s], [0, -1, 0], [c, -1, s], [-c, 1, s], [0, 1, 0], [c, 1, s]], float)
    left, right = [[0, 1, 4], [0, 4, 3]], [[1, 2, 5], [1, 5, 4]]
    if fold:  # pages with an edge of their own, so normals are not smoothed across it
        vertices = np.concatenate([vertices, vertices[[1, 4]]])
        right = [[6, 2, 5], [6, 5, 7]]
    faces = np.array(left + right)
    uvs = np.stack([(vertices[:, 0] / c + 1) / 2, (vertices[:, 1] + 1) / 2], axis=1)
    rows = np.linspace(0.3, 1.0, 16)[:, None, None] * np.ones((1, 16, 3)) * [1.0, 0.8, 0.6]
    texture = albedo * (rows if fold else np.ones((16, 16, 3)))
    waves = 0.02 * np.sin(np.arange(16))[None, :] * np.ones((16, 1)) if fold else None
    mesh = Mesh(vertices, Topology(faces, uvs, faces))
    return TracedSurface(mesh, texture, np.full((16, 16), roughness), specular=specular, bump=waves)


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


def mitsuba_path(surface: TracedSurface, light: object, spp: int, max_depth: int) -> np.ndarray:
    """Mitsuba's `path` integrator on the same scene, each page a shape of its own making."""
    scene = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": max_depth, "rr_depth": 1000, "hide_emitters": True},
        "sensor": sensor(camera()),
        "emitter": emitter(light),  # type: ignore[arg-type]
        "shape": shape(surface),
    }
    return np.array(mi.render(mi.load_dict(scene), spp=spp))[..., :3]


@pytest.mark.parametrize("max_depth", [2, 4])
def test_multilight_agrees_with_mitsuba_path(tracer: PathTracer, max_depth: int) -> None:
    if mi.variant() != VECTORISED:
        pytest.skip("scalar_rgb renders with Mitsuba's integrator itself")
    surface = book(0.9)
    images = tracer.render(surface, camera(), LIGHTS, spp=1024, seed=1, max_depth=max_depth)
    for light, image in zip(LIGHTS, images, strict=True):
        reference = mitsuba_path(surface, light, 2048, max_depth)
        inside = reference.min(axis=2) > 0.05 * reference.max()
        assert inside.sum() > 80
        # shadow edges fall on 4 x 4 places in a pixel, so only their sum is a little off
        assert image.sum() == pytest.approx(reference.sum(), rel=0.03)
        error = np.abs(image - reference)[inside] / reference[inside]
        assert np.median(error) < 0.02


def test_scalar_variant_gives_the_same_picture() -> None:
    """In a process of its own, as variants do not mix: every kind of light, same pixels within noise."""
    if choose_variant() != VECTORISED:
        pytest.skip("only scalar_rgb works here")
    program = (
        "import sys; sys.path.insert(0, sys.argv[1])\n"
        "import numpy as np, test_pathtrace as t\n"
        "tracer = t.PathTracer('scalar_rgb')\n"
        "np.save(sys.argv[2], tracer.render(t.book(0.9), t.camera(), t.LIGHTS, spp=256, seed=0))\n"
    )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scalar.npy"
        subprocess.run([sys.executable, "-c", program, str(Path(__file__).parent), str(path)], check=True)
        scalar = np.load(path)
    images = PathTracer(VECTORISED).render(book(0.9), camera(), LIGHTS, spp=256, seed=0)
    for one, many in zip(scalar, images, strict=True):
        inside = one.min(axis=2) > 0.1 * one.max()
        assert np.median(np.abs(one - many)[inside] / one[inside]) < 0.04


def test_interreflection_adds_light_in_the_fold(tracer: PathTracer) -> None:
    direct, full = (tracer.render(book(0.9), camera(), LIGHTS[:1], 64, 0, max_depth=d)[0] for d in (2, 4))
    assert full.sum() > 1.08 * direct.sum()
    assert (full >= direct - 1e-6).all()


@pytest.mark.parametrize("direction", [towards(0, 0, 1), towards(0.3, -0.5, 1.0)])
def test_lambert_plane_reflects_albedo_over_pi(tracer: PathTracer, direction: np.ndarray) -> None:
    """Without specular and at the roughness where Burley's diffuse lobe is flattest, E cos / pi within its bounds."""
    albedo, irradiance = 0.5, np.array([3.0, 1.0, 0.5])
    surface = book(0.0, albedo=albedo, specular=0.0, roughness=0.5)
    image = tracer.render(surface, camera(), [Directional(direction, irradiance)], 16, 0)[0]
    expected = albedo / np.pi * irradiance * direction[2]
    # Burley: (1 + (Fd90 - 1)(1 - cos_i)^5) (1 + (Fd90 - 1)(1 - cos_o)^5), Fd90 = 1/2 + 2 roughness cos_d^2
    wo = towards(0, 0, 1)
    half = towards(*(direction + wo))
    fd90 = 0.5 + 2 * 0.5 * (half @ wo) ** 2
    expected *= 1 + (fd90 - 1) * (1 - direction[2]) ** 5
    assert image[9, 13] == pytest.approx(expected, rel=2e-3)


def test_light_from_behind_is_dark(tracer: PathTracer) -> None:
    assert tracer.render(book(0.0), camera(), [Directional(towards(0, 0.1, -1), np.ones(3))], 16, 0).max() == 0


def test_group_is_the_sum_of_its_members(tracer: PathTracer) -> None:
    group = Group((LIGHTS[0].scaled(0.5), Group((LIGHTS[2],))))
    both = tracer.render(book(0.9), camera(), [LIGHTS[0].scaled(0.5), group, LIGHTS[2]], 16, 3)
    np.testing.assert_array_equal(both[1], both[0] + both[2])


def test_seed_repeats_and_differs(tracer: PathTracer) -> None:
    first, again, other = (tracer.render(book(0.9), camera(), [sky()], 16, s)[0] for s in (5, 5, 6))
    np.testing.assert_allclose(first, again, rtol=1e-4, atol=1e-6)  # threads add in any order
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


def test_constant_environment_is_noise_free_on_a_white_plane(tracer: PathTracer) -> None:
    """A map without bright texels is found by BSDF sampling alone; its mean is the white-furnace reflectance."""
    image = tracer.render(book(0.0, 1.0, 0.0), camera(), [Environment("white", np.ones((8, 16, 3)))], 256, 0)[0]
    assert image[9, 13] == pytest.approx(np.ones(3), rel=0.08)


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


def test_displace_moves_along_normals_and_keeps_seams_closed() -> None:
    surface = book(0.0)
    topology = surface.mesh.topology
    split = Topology(topology.faces, np.concatenate([topology.uvs, topology.uvs * 0.5]), topology.uv_faces.copy())
    uv_faces = np.array(split.uv_faces)
    uv_faces[2:] += len(topology.uvs)  # the right page reads another place of the map
    mesh = Mesh(surface.mesh.vertices, Topology(topology.faces, split.uvs, uv_faces))

    class Bump:
        displacement = np.tile(np.linspace(0.0, 0.1, 64), (64, 1))

    moved = displace(mesh, Bump())
    np.testing.assert_allclose(moved.vertices[:, :2], mesh.vertices[:, :2], atol=1e-12)
    left, middle = moved.vertices[0, 2], moved.vertices[1, 2]
    assert left == pytest.approx(0.0, abs=1e-3)
    assert middle == pytest.approx((0.05 + 2 * 0.025) / 3, abs=2e-3)  # one face on the left, two on the right


def test_unknown_variant_is_refused() -> None:
    with pytest.raises(InputError, match="cuda_rgb"):
        PathTracer("cuda_rgb")
