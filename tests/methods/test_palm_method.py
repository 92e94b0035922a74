"""PALM-Net as a method: presets and ablations, priors and avatars on disk, a real field in the place of the ball."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from handbench.errors import InputError
from handbench.hand.openhand import OpenHand
from handbench.lean import open3d
from handbench.methods.kit.adam import Adam
from handbench.methods.palm import create, method, posed
from handbench.methods.palm.method import PalmAvatar, PalmPrior
from handbench.methods.palm.model import PalmModel
from handbench.methods.palm.person import Person
from handbench.methods.palm.settings import settings
from handbench.metrics.geometry.surface import mean, surface_distances
from handbench.registry import METHODS
from handbench.scene import Camera, Directional, Unknown, Viewpoint

HAND = OpenHand.load()
SMOKE = settings("smoke", None)
CAMERA = Camera(
    "front", 48, 64, np.array([[140.0, 0, 24], [0, 140.0, 44], [0, 0, 1]]), np.c_[np.diag([1.0, -1, -1]), [0, 0, 0.45]]
)
SUN = Directional(np.array([0.6, 0.0, 0.8]), np.array([3.0, 2.5, 2.0]))


@pytest.fixture(scope="module")
def prior() -> PalmPrior:
    """Whose people all have the neutral hand: its geometry is that mesh, the rest is as it begins."""
    torch.manual_seed(0)
    model = PalmModel(SMOKE.prior, HAND, 3)
    field = model.field
    scene, tensor = open3d().t.geometry.RaycastingScene(), open3d().core.Tensor
    faces = np.ascontiguousarray(HAND.topology(field.level).faces, dtype=np.uint32)
    scene.add_triangles(tensor.from_numpy(field.rest.numpy()), tensor.from_numpy(faces))
    shape, joints = torch.tensor(np.asarray(HAND.neutral())).float(), torch.zeros(len(HAND.parents), 3)
    with torch.no_grad():
        model.pose.weight.zero_()
    adam, rng = Adam(model.geometry_field.parameters(), 1e-2), np.random.default_rng(0)
    for _ in range(150):
        places = field.rest.numpy()[rng.integers(len(field.rest), size=600)] + rng.normal(0.0, 4e-3, (600, 3))
        places = places.astype(np.float32)
        distance = torch.from_numpy(scene.compute_signed_distance(tensor.from_numpy(places)).numpy())
        found = model.geometry(torch.from_numpy(places), model.conditions(model.codes(0), shape, joints))
        adam.forget()
        ((found.sdf - distance) / 5e-3).abs().mean().backward()
        adam.step()
    return PalmPrior("palm-net", SMOKE, model.requires_grad_(False))


def avatar(prior: PalmPrior) -> PalmAvatar:
    shape = torch.tensor(np.asarray(HAND.neutral())).float()
    codes = prior.model.codes(1)
    return PalmAvatar("palm-net", SMOKE, Person(prior.model, codes, shape, prior.model.light.gaussians()), {})


def viewpoint(camera: Camera = CAMERA) -> Viewpoint:
    return Viewpoint("s1", "pinch", HAND.named_pose("pinch"), None, camera)


def test_a_posed_hand_is_drawn_where_the_hand_is(prior: PalmPrior) -> None:
    found = avatar(prior).pose(viewpoint()).relight(SUN)
    true = HAND.mesh(HAND.neutral(), HAND.named_pose("pinch"), 1)
    assert mean(surface_distances(found.mesh, true.vertices)) < 2.0  # millimetres
    assert found.alpha.sum() > 300 and found.image[found.alpha > 0.9].mean() > 0.05


def test_first_hits_search_no_root(prior: PalmPrior, monkeypatch: pytest.MonkeyPatch) -> None:
    def searched(*asked: object) -> None:
        raise AssertionError("a root was searched")

    monkeypatch.setattr(posed, "canonicalise", searched)
    found = avatar(prior).pose(viewpoint()).relight(SUN)
    assert found.alpha.any()


def test_another_camera_shares_the_pose(prior: PalmPrior) -> None:
    moved = np.c_[np.diag([1.0, -1, -1]), [0.02, 0, 0.5]]
    other = Camera("other", 48, 64, CAMERA.K, moved)
    shared = avatar(prior).pose(viewpoint()).seen_by(other).relight(SUN)
    assert np.array_equal(shared.image, avatar(prior).pose(viewpoint(other)).relight(SUN).image)


def test_priors_and_avatars_answer_alike_from_disk(
    prior: PalmPrior, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("prior", "avatar"):
        (tmp_path / name).mkdir()
    own = avatar(prior)
    prior.save(tmp_path / "prior")
    own.save(tmp_path / "avatar")
    kept = create("smoke").load(tmp_path / "prior").restore(tmp_path / "avatar")
    for light in (SUN, Unknown("as enrolled")):
        first, second = (one.pose(viewpoint()).relight(light) for one in (own, kept))
        assert np.array_equal(first.image, second.image)
    with pytest.raises(InputError, match="were trained with"):
        create("quick").load(tmp_path / "prior")
    with monkeypatch.context() as patched:
        patched.setattr(method, "hand_model", lambda: SimpleNamespace(name="another hand"))
        with pytest.raises(InputError, match="another hand"):
            create("smoke").load(tmp_path / "prior")
    with pytest.raises(InputError, match="are of 'palm-net' of schema"):
        create("smoke", "fixed-light").load(tmp_path / "prior")


def test_presets_and_ablations_are_named() -> None:
    assert {name for name in METHODS.entries() if name.startswith("palm-net")} == {
        "palm-net",
        "palm-net-fixed-light",
        "palm-net-no-normals",
    }
    assert create("quick").info.linear and not create("released").info.linear
    assert create("quick", "no-normals").config["prior"]["normal"] == 0.0
    assert create("quick", "fixed-light").config["fit"]["light"] == "fixed"
    assert create("quick", "fixed-light").config["prior"] == create("quick").config["prior"]
    with pytest.raises(InputError, match="unknown preset of palm-net"):
        create("slow")
    with pytest.raises(InputError, match="unknown ablation of palm-net"):
        create("quick", "no-light")


@pytest.mark.parametrize("name", ["rays", "side", "samples", "places", "components", "rebuild"])
def test_a_fit_of_nothing_is_refused(name: str) -> None:
    with pytest.raises(InputError, match=f"{name} of a fit is 0"):
        replace(SMOKE.fit, **{name: 0})


@pytest.mark.parametrize("name", ["scatter", "supersample", "spacing"])
def test_a_drawing_of_nothing_is_refused(name: str) -> None:
    with pytest.raises(InputError, match="give at least 1 of both"):
        replace(SMOKE.drawing, **{name: 0})
