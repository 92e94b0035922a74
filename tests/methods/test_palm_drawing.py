"""PALM-Net's pictures, of a ball in the place of a hand: first hits and march, sizes, light, what is refused."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from handbench.errors import Unsupported
from handbench.hand.openhand import OpenHand
from handbench.light.gaussians import SphericalGaussians
from handbench.methods.palm import drawing
from handbench.methods.palm.drawing import DrawingSettings, PosedPalm
from handbench.methods.palm.gathering import Gathering
from handbench.methods.palm.person import Person, check_pose
from handbench.scene import Camera, Directional, Environment, Point, Pose, Unknown, Viewpoint

from .palmball import RADIUS, Ball, render

HAND = OpenHand.load()
CAMERA = Camera(
    "front", 48, 64, np.array([[150.0, 0, 24], [0, 150.0, 32], [0, 0, 1]]), np.c_[np.diag([1.0, -1, -1]), [0, 0, 0.4]]
)
SUN = Directional(np.array([0.6, 0.0, 0.8]), np.array([3.0, 2.5, 2.0]))
LIGHT = SphericalGaussians(torch.tensor([[0.0, 1.0, 0.0]]), torch.tensor([2.0]), torch.tensor([[1.0, 0.9, 0.8]]))


class BallPerson(Person):
    """Whose hand is a ball about the wrist."""

    def posed(self, pose: Pose) -> Ball:
        check_pose(HAND, pose)
        middle = torch.from_numpy(pose.translation).float()
        return Ball(middle, torch.tensor([0.6, 0.4, 0.3]))


def person() -> BallPerson:
    return BallPerson(SimpleNamespace(hand=HAND), None, torch.zeros(1), LIGHT)  # type: ignore[arg-type]


def viewpoint(place: tuple[float, float, float] = (0.0, 0.0, 0.0), camera: Camera = CAMERA) -> Viewpoint:
    pose = HAND.named_pose("rest")
    return Viewpoint("s1", "rest", replace(pose, translation=np.array(place)), None, camera)


@pytest.fixture(autouse=True)
def analytic(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(drawing, "render", render)


def test_first_hits_and_the_march_draw_one_picture() -> None:
    surface = PosedPalm.of(person(), viewpoint(), DrawingSettings())
    volume = PosedPalm.of(person(), viewpoint(), DrawingSettings(places="volume", visibility="march"))
    for light in (SUN, Point(np.array([0.2, 0.2, 0.3]), np.array([0.3, 0.2, 0.2]))):
        first, second = surface.relight(light), volume.relight(light)
        inner = (first.alpha > 0.99) & (second.alpha > 0.99)
        assert inner.sum() > 600 and abs(first.alpha.sum() / second.alpha.sum() - 1.0) < 0.08
        error = np.abs(first.image - second.image)[inner]
        assert error.mean() < 0.02 * first.image[inner].mean()


def test_the_picture_is_the_reflectance_of_the_ball() -> None:
    """Lambert and the lobe at the point that a pixel's middle sees, worked out apart."""
    found = PosedPalm.of(person(), viewpoint(), DrawingSettings(spacing=1e-3)).relight(SUN)
    row, column = 30, 27
    towards = np.linalg.inv(CAMERA.K) @ [column + 0.5, row + 0.5, 1.0] @ CAMERA.rotation
    towards /= np.linalg.norm(towards)
    b = CAMERA.centre @ towards
    distance = -b - np.sqrt(b * b - CAMERA.centre @ CAMERA.centre + RADIUS**2)
    normal = (CAMERA.centre + distance * towards) / RADIUS
    half = (SUN.direction - towards) / np.linalg.norm(SUN.direction - towards)
    cosine, view, c = normal @ SUN.direction, -normal @ towards, half @ SUN.direction
    d = 0.25 / (np.pi * ((normal @ half) ** 2 * (0.25 - 1.0) + 1.0) ** 2)
    k = 1.5**2 / 8.0
    g = 1.0 / ((cosine * (1 - k) + k) * (view * (1 - k) + k))
    f = 0.04 + 0.96 * 2 ** ((-5.55473 * c - 6.98316) * c)
    expected = cosine * (np.array([0.6, 0.4, 0.3]) / np.pi + d * g * f / 4.0) * SUN.irradiance
    assert found.image[row, column] == pytest.approx(expected, rel=0.01)


def test_what_is_seen_faces_the_viewer() -> None:
    """Smooth normals at an outline may not, which would be black pixels there."""
    rng = np.random.default_rng(0)
    normal, view = (torch.nn.functional.normalize(torch.from_numpy(rng.normal(size=(500, 3))), dim=1) for _ in "nv")
    turned, cosine = drawing.facing(normal, view), (normal * view).sum(dim=1)
    assert (turned * view).sum(dim=1).min() > 0.01
    assert torch.allclose(turned[cosine > 0.02], normal[cosine > 0.02])
    assert torch.allclose(torch.linalg.cross(normal, view, dim=1).mul(turned).sum(dim=1), torch.zeros(500).double())
    lamp = Directional(np.array([0.0, 0.0, 1.0]), np.ones(3))
    found = PosedPalm.of(person(), viewpoint(), DrawingSettings()).relight(lamp)
    assert (found.image[found.alpha > 0] > 0).all()


def test_the_mesh_of_the_picture_is_told() -> None:
    place = (0.003, -0.005, 0.01)
    found = PosedPalm.of(person(), viewpoint(place), DrawingSettings()).relight(SUN)
    distance = np.linalg.norm(found.mesh.vertices - place, axis=1)
    assert distance == pytest.approx(np.full(len(distance), RADIUS), rel=1e-5)


def test_a_known_pose_answers_alike_whatever_it_drew_before() -> None:
    posed = PosedPalm.of(person(), viewpoint(), DrawingSettings())
    room = Environment("room", np.random.default_rng(0).uniform(0.0, 1.0, (16, 32, 3)))
    first = posed.relight(room)
    posed.relight(SUN)
    again, fresh = posed.relight(room), PosedPalm.of(person(), viewpoint(), DrawingSettings()).relight(room)
    assert np.array_equal(first.image, again.image) and np.array_equal(first.image, fresh.image)


def test_unknown_light_is_the_persons_own() -> None:
    posed = PosedPalm.of(person(), viewpoint(), DrawingSettings(gathering=Gathering(error=0.0)))
    own = posed.relight(Unknown("as enrolled")).image
    given = posed.relight(LIGHT.to_environment(32, 64)).image
    assert np.abs(own - given).mean() < 0.02 * given.mean()


def test_what_cannot_be_drawn_is_refused() -> None:
    with pytest.raises(Unsupported, match="inside the hand"):
        PosedPalm.of(person(), viewpoint((0.0, 0.0, 0.41)), DrawingSettings())
    pose = HAND.named_pose("rest")
    with pytest.raises(Unsupported, match="has 3 joints"):
        check_pose(HAND, Pose(pose.joints[:3]))
    bent = pose.joints.copy()
    bent[HAND.joint_names.index("index2"), 0] = np.radians(160.0)
    with pytest.raises(Unsupported, match=r"bends index2 57 degrees beyond its limit"):
        check_pose(HAND, Pose(bent))


def test_a_hand_out_of_sight_is_an_empty_picture() -> None:
    found = PosedPalm.of(person(), viewpoint((5.0, 0.0, 0.0)), DrawingSettings()).relight(SUN)
    assert not found.alpha.any() and not found.image.any()
