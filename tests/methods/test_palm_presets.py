"""PALM-Net's long presets from a scan to a relit picture: a few steps each, changed in sizes alone."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from handbench.data.openstage import open_capture
from handbench.errors import InputError
from handbench.hand import hand_model
from handbench.method import Recording
from handbench.methods.kit.enrolled import Enrolled, PosedPicture
from handbench.methods.palm.method import Palm, PalmAvatar, PalmPrior
from handbench.methods.palm.model import PalmModel
from handbench.methods.palm.personalise import personalised
from handbench.methods.palm.settings import PRESETS, PalmSettings
from handbench.methods.palm.training import trained
from handbench.scene import Camera, Environment, Frame, Unknown, Viewpoint, needed

LONG = ("seed", "released", "hand-scale")


def small(chosen: PalmSettings) -> PalmSettings:
    """A preset with a few small tables, networks, rays and steps; what it does stays what it is."""
    prior, fit, drawing = chosen.prior, chosen.fit, chosen.drawing
    prior = replace(
        prior,
        spacing=1.6e-2,
        levels=3,
        table=8,
        finest=40.0,
        geometry=(16,),
        appearance=(16,),
        material=(16,),
        samples=4,
        refine=2,
        geometry_steps=min(2, prior.geometry_steps),
        steps=4,
        rays=8,
        patch=16,
        scan_points=min(64, prior.scan_points),
        scattered=8,
        gaussians=4,
    )
    fit = replace(fit, steps=2, rays=12, patch=8, side=48, samples=8, components=2, rebuild=1)
    gathering = replace(drawing.gathering, directions=4)
    return PalmSettings(prior, fit, replace(drawing, scatter=1, spacing=1.6e-2, supersample=1, gathering=gathering))


@pytest.fixture(scope="module")
def scan() -> tuple[Recording, Frame]:
    capture = open_capture("mini", capture="openscans")
    frames = [f for f in capture.frames() if f.subject == "s25" and f.pose_name == "pose-0"]
    return capture.recording(frames), next(f for f in frames if f.camera.name == "palmar")


def thumbnail(camera: Camera) -> Camera:
    """The same view in 9 x 12 pixels."""
    K = np.diag([9 / camera.width, 12 / camera.height, 1.0]) @ camera.K
    return Camera(camera.name, 9, 12, K, camera.world_to_camera)


@pytest.mark.parametrize("name", LONG)
def test_a_long_preset_goes_from_scans_to_a_relit_picture(name: str, scan: tuple[Recording, Frame]) -> None:
    recording, frame = scan
    chosen, told = small(PRESETS[name]), set[str]()
    model = trained(chosen.prior, hand_model(), recording, 0, lambda step, total, **values: told.update(values))
    terms = {"l1", "mask", "perceptual", "normal", "eikonal", "curvature", "physical", "latent"}
    assert terms <= told
    assert ("scan" in told) == (chosen.prior.geometry_steps > 0)  # none of them looks at scans afterwards
    prior = PalmPrior("palm-net", chosen, model)
    pose, shape = needed(frame.pose, "pose"), needed(frame.shape, "shape")
    seen = Enrolled(hand_model(), shape, (PosedPicture("s25/pose-0", frame.camera, recording.observe(frame), pose),))
    fitted = set[str]()
    form = chosen.drawing.gathering.form
    person = personalised(prior.model, seen, chosen.fit, form, 0, lambda step, total, **values: fitted.update(values))
    assert {"radiance", "radiance patch", "physical", "physical patch", "mask", "code"} <= fitted
    assert len(person.light.amplitude) == 4 and np.isfinite(person.codes.appearance.numpy()).all()
    avatar = PalmAvatar("palm-net", chosen, person, {})
    view = Viewpoint("s25", "pose-0", pose, None, thumbnail(frame.camera))
    drawn = avatar.pose(view)
    for light in (Unknown("as enrolled"), Environment("grey", np.full((4, 8, 3), 0.5, dtype=np.float32))):
        found = drawn.relight(light)
        assert found.image.shape == (12, 9, 3) and np.isfinite(found.image).all() and found.image.max() > 0.0
        assert found.mesh is not None and (found.alpha >= 0.0).all() and found.alpha.max() > 0.1


def test_long_presets_disagree_where_seed_and_code_do() -> None:
    """Sizes aside; each of these is named where it is decided."""
    seed, released, hand = (PRESETS[name] for name in LONG)
    assert (seed.prior.normals, released.prior.normals) == ("jacobian", "rotation")
    assert (seed.prior.lipschitz, released.prior.lipschitz) == (False, True)
    assert seed.drawing.visibility == "march" and released.drawing.visibility == "body-march"
    assert seed.prior.canonical == released.prior.canonical == "subject" and hand.prior.canonical == "shared"
    priors = [one.prior for one in (seed, released, hand)]
    assert not any(prior.modulated or prior.skin_features or prior.register for prior in priors)
    assert all(one.fit.weights.radiance == 1.0 and not one.fit.solved and not one.fit.whitened for one in (seed, hand))


def test_a_prior_of_another_encoding_is_refused(tmp_path: Path) -> None:
    chosen = PRESETS["smoke"]
    hashed = replace(chosen, prior=replace(chosen.prior, encoding="hash", table=8))
    PalmPrior("palm-net", hashed, PalmModel(hashed.prior, hand_model(), 1)).save(tmp_path)
    with pytest.raises(InputError, match="were trained with") as told:
        Palm("smoke").load(tmp_path)
    assert "encoding" in str(told.value)
