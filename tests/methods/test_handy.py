"""Handy-style inversion: the generator and its file, textures found in pictures, and the two rows."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from safetensors.torch import load_file

from handbench.checkpoint import checkpoints_in
from handbench.data.openstage import open_capture
from handbench.data.openstage.cast import person
from handbench.data.openstage.population import PEOPLE
from handbench.data.openstage.skin import make_skin
from handbench.errors import InputError, Unsupported
from handbench.hand import hand_model
from handbench.hand.openhand import OpenHand
from handbench.methods import handy
from handbench.methods.handy import generator as module
from handbench.methods.handy import pictures
from handbench.methods.handy.config import PRESETS, HandyConfig
from handbench.methods.handy.generator import LAYERS, SIZE, Generator, Modulated, built, shipped
from handbench.methods.handy.inversion import inverted
from handbench.methods.handy.lobe import lobe
from handbench.methods.handy.method import HandyAvatar
from handbench.methods.handy.pictures import DisplayCrop, Sitting, sitting
from handbench.methods.kit.enrolled import Enrolled, PosedPicture
from handbench.metrics.networks import features, network_weights
from handbench.recording import PARTS, Recording
from handbench.render.uv.atlas import Atlas
from handbench.scene import Array, Directional, Frame, Group, Mesh, Topology, Unknown, needed
from handbench.scene.colour import linear, srgb, unclipped_linear

CREATE = {"phong": handy.create_phong, "ggx": handy.create_ggx}


def silent(step: int, total: int, **values: float) -> None: ...


def decibels(image: Array, truth: Array, where: Array) -> float:
    return float(-10 * np.log10(np.square(srgb(image) - srgb(truth))[where].mean()))


# --- the generator ----------------------------------------------------------------------------------------------------


def test_modulation_is_that_of_stylegan2() -> None:
    """Against the weights of every sample, scaled and demodulated (Karras et al. 2020, Eqs. 1 and 3)."""
    torch.manual_seed(0)
    layer, x, w = Modulated(5, 4, 6, 3), torch.randn(2, 4, 8, 8), torch.randn(2, 5)
    for one in range(2):
        weight = layer.weight * layer.style(w)[one][None, :, None, None]
        weight = weight / weight.square().sum(dim=(1, 2, 3), keepdim=True).add(1e-8).sqrt()
        expected = torch.nn.functional.conv2d(x[one : one + 1], weight, padding=1)
        assert torch.allclose(layer(x, w)[one], expected[0], atol=1e-5)


def test_one_code_for_all_layers_is_w_and_codes_of_their_own_are_more() -> None:
    made, codes = shipped(), torch.randn(2, shipped().code, generator=torch.Generator().manual_seed(1))
    whole = made(codes)
    same = codes[:, None].repeat(1, LAYERS, 1)
    assert whole.shape == (2, 3, SIZE, SIZE) and torch.equal(made(same), whole)
    for layer in range(LAYERS):
        changed = same.clone()
        changed[:, layer] = 0.0
        assert not torch.equal(made(changed), whole), layer


def test_texels_outside_the_charts_are_as_their_nearest_inside() -> None:
    atlas = Atlas.of(hand_model().topology(1), SIZE)
    drawn = shipped()(torch.zeros(1, shipped().code))[0]
    assert torch.equal(atlas.dilate(drawn), drawn)


def test_the_file_is_small_half_precision_and_for_the_texels_of_every_level() -> None:
    path = Path(module.__file__).parent / "weights" / "generator.safetensors"
    assert path.stat().st_size < 6e6
    state = load_file(path)
    assert {v.dtype for name, v in state.items() if name != "texels"} == {torch.float16}
    assert all(value.isfinite().all() for value in state.values())
    for level in (0, 1, 3):
        assert np.array_equal(state["texels"].numpy(), Atlas.of(hand_model().topology(level), SIZE).texels)
    notice = (path.parent / "NOTICE").read_text()
    assert "trained here" in notice and "not the texture model of Handy" in notice


def test_random_codes_are_natural_people() -> None:
    """Skin is brighter in red than in blue at nearly every texel, and people differ in tone."""
    made = shipped()
    drawn = made(made.map(torch.randn(12, made.code, generator=torch.Generator().manual_seed(2))))
    seen = drawn.flatten(2)[:, :, made.texels.long()]
    assert float((seen[:, 0] > seen[:, 2]).float().mean()) > 0.97
    assert 0.0 < float(seen.quantile(0.002)) < float(seen[:, 0, :5000].quantile(0.998)) < 1.1  # type: ignore[arg-type]
    assert float(seen.mean(dim=(1, 2)).std()) > 0.05


def test_nobody_of_a_capture_is_among_those_trained_on() -> None:
    text = (Path(__file__).parents[2] / "maintainer" / "make_handy_generator.py").read_text()
    first = int(text.split("FIRST, UNSEEN = ")[1].split(",")[0])
    assert max(people.stop for people in PEOPLE.values()) <= first


@cache
def unseen(index: int) -> torch.Tensor:
    """The skin of a person of the light stage without tattoos and polish, (1, 3, SIZE, SIZE), display values."""
    hand = OpenHand.load()
    look = person(index, hand).look
    assert not look.tattoos and look.nails.polish is None
    albedo = make_skin(hand, hand.neutral(), look, SIZE).albedo
    return torch.from_numpy(srgb(albedo)).permute(2, 0, 1)[None]


def test_unseen_skins_are_nearer_than_their_components_to_the_eye_and_no_farther_in_colour() -> None:
    made, true = shipped(), torch.cat([unseen(index) for index in (0, 1, 4)])
    flat = true.flatten(2)[:, :, made.texels.long()]
    basis = made.basis.flatten(1)
    codes = ((flat - made.mean).flatten(1) @ basis.T) / basis.square().sum(dim=1)
    both = {"components": made.linear(codes), "generator": made(codes)}
    apart = {name: lpips("alex", drawn, true) for name, drawn in both.items()}
    off = {
        name: float((drawn - true).flatten(2)[:, :, made.texels.long()].square().mean()) for name, drawn in both.items()
    }
    assert apart["generator"] < 0.95 * apart["components"]
    assert off["generator"] < 1.03 * off["components"]


def lpips(network: str, drawn: torch.Tensor, true: torch.Tensor) -> float:
    """The mean LPIPS of textures (B, 3, H, W) of display values."""
    total = 0.0
    for layer, (one, two) in enumerate(
        zip(*(features(network, part.clamp(0, 1)) for part in (drawn, true)), strict=True)
    ):
        one, two = (torch.nn.functional.normalize(part, dim=1) for part in (one, two))
        total += float(
            (one - two).square().mean(dim=(0, 2, 3)) @ network_weights(f"lpips_{network}")[f"head{layer}.weight"]
        )
    return total


def test_a_damaged_file_is_one_sentence(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "generator.safetensors").write_bytes(b"nothing")
    monkeypatch.setattr(module, "_FILE", tmp_path / "generator.safetensors")
    with pytest.raises(InputError, match="cannot be read"):
        module.shipped.__wrapped__()


def test_the_curve_there_and_back() -> None:
    values = torch.linspace(0.0, 1.0, 101)
    assert np.abs(unclipped_linear(values).numpy() - linear(values.numpy())).max() < 1e-6
    assert float(unclipped_linear(torch.tensor(-0.5))) == 0.0 < 1.0 < float(unclipped_linear(torch.tensor(1.2)))


# --- inversion: the mini light stage ----------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def capture() -> Any:
    return open_capture("mini")


def enrolment(capture: Any, subject: str = "s01", gives: frozenset[Any] = PARTS) -> Recording:
    frames = [f for f in capture.frames() if f.subject == subject and f.segment == "train" and f.kind == "full"]
    return Recording(frames, capture.observe, gives)


CONFIG = replace(PRESETS["smoke"], steps=20, frames=4, batch=1, rate=(0.2, 0.1))


@pytest.fixture(scope="module")
def seen(capture: Any) -> Sitting:
    return sitting(enrolment(capture), CONFIG, lobe("ggx", 0.45), silent)


@pytest.fixture(scope="module")
def drawn(seen: Sitting) -> tuple[torch.Tensor, tuple[DisplayCrop, ...]]:
    """A known albedo, and the pictures with what it looks like in them."""
    made = shipped()
    code = 0.7 * torch.randn(1, made.code, generator=torch.Generator().manual_seed(4))
    albedo = unclipped_linear(made(code)[0])
    one = torch.ones(1)
    shots = [replace(s, image=torch.from_numpy(srgb(s.drawn(albedo, one).numpy()))) for s in seen.shots]
    return albedo, tuple(shots)


def off(found: torch.Tensor, true: torch.Tensor) -> float:
    """Mean difference at the covered texels, in display values."""
    texels = shipped().texels.long()
    both = (srgb(albedo.flatten(1)[:, texels].numpy()) for albedo in (found, true))
    return float(np.abs(next(both) - next(both)).mean())


@pytest.fixture(scope="module")
def found(drawn: tuple[torch.Tensor, tuple[DisplayCrop, ...]]) -> tuple[torch.Tensor, torch.Tensor]:
    """The texture that is found in those pictures, and their brightness."""
    return inverted(shipped(), drawn[1], CONFIG, 0, silent)


@pytest.mark.parametrize("space", ["w", "w+", "pca"])
def test_a_texture_is_found_in_pictures_of_it(
    space: Any,
    drawn: tuple[torch.Tensor, tuple[DisplayCrop, ...]],
    found: tuple[torch.Tensor, torch.Tensor],
) -> None:
    albedo, shots = drawn
    start = unclipped_linear(shipped()(torch.zeros(1, shipped().code))[0])
    config = replace(CONFIG, space=space)
    texture, exposure = found if config == CONFIG else inverted(shipped(), shots, config, 0, silent)
    assert off(texture, albedo) < 0.35 * off(start, albedo)
    assert exposure.tolist() == [1.0], "light that is told leaves no brightness free"


def test_shading_ends_in_the_albedo_where_pictures_are_drawn_without_their_light(
    drawn: tuple[torch.Tensor, tuple[DisplayCrop, ...]], found: tuple[torch.Tensor, torch.Tensor]
) -> None:
    albedo, shots = drawn
    bare = [DisplayCrop(shot.image, shot.inside, shot.raster) for shot in shots]
    baked, exposure = inverted(shipped(), bare, CONFIG, 0, silent)
    assert off(baked, albedo) > 1.5 * off(found[0], albedo)
    assert exposure.shape == (1,) and 0.2 < float(exposure) < 5.0
    _, coloured = inverted(shipped(), bare, replace(CONFIG, exposure="colour", steps=1), 0, silent)
    assert coloured.shape == (3,)


def test_the_same_seed_gives_the_same_texture_and_another_start_another(
    drawn: tuple[torch.Tensor, tuple[DisplayCrop, ...]],
) -> None:
    config = replace(CONFIG, start="random", steps=3)
    one, two, other = (inverted(shipped(), drawn[1], config, seed, silent)[0] for seed in (3, 3, 4))
    assert torch.equal(one, two) and not torch.equal(one, other)


class Stop(Exception):
    pass


def test_an_inversion_that_was_stopped_goes_on_as_if_it_had_not_been(
    drawn: tuple[torch.Tensor, tuple[DisplayCrop, ...]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("handbench.methods.kit.checkpoint.EVERY", 0.0)
    monkeypatch.setattr("handbench.methods.kit.engine._TELL", 3)
    config = replace(CONFIG, steps=5, batch=1)
    bare = [DisplayCrop(shot.image, shot.inside, shot.raster) for shot in drawn[1]]

    def stop(step: int, total: int, **values: float) -> None:
        raise Stop

    for shots in (drawn[1], bare):
        whole = inverted(shipped(), shots, config, 0, silent)
        with checkpoints_in(tmp_path / str(len(list(tmp_path.iterdir())))) as kept:
            with pytest.raises(Stop):
                inverted(shipped(), shots, config, 0, stop)
            went_on = inverted(shipped(), shots, config, 0, silent)
        assert kept.earlier_s > 0.0
        assert all(torch.equal(a, b) for a, b in zip(whole, went_on, strict=True))


# --- the rows ---------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module", params=["phong", "ggx"])
def avatar(request: pytest.FixtureRequest, capture: Any) -> Iterator[HandyAvatar]:
    method = CREATE[request.param]("smoke")
    seen = enrolment(capture)
    yield method.train(seen).personalise(seen)  # type: ignore[misc]


def scored(capture: Any, kind: str) -> list[Frame]:
    return [f for f in capture.frames() if f.subject == "s01" and f.segment == "held-out" and f.kind == kind]


def test_new_poses_under_new_light_are_nearer_than_grey_skin(capture: Any, avatar: HandyAvatar) -> None:
    dull = torch.full_like(avatar.albedo, 0.3)
    grey = HandyAvatar(avatar.reflectance, avatar.config, dull, avatar.exposure, None)
    for frame in scored(capture, "group")[:2]:
        truth = capture.observe(frame)
        ours, plain = (a.relight(frame.query).image for a in (avatar, grey))
        where = truth.alpha > 0.5
        assert decibels(ours, truth.image, where) > max(22.0, decibels(plain, truth.image, where) + 1.0)


def test_relighting_is_linear_in_known_light(capture: Any, avatar: HandyAvatar) -> None:
    assert handy.create_ggx().info.linear
    one, two = scored(capture, "environment")[0], scored(capture, "group")[0]
    posed = avatar.pose(one.viewpoint)
    both = posed.relight(Group((one.light.scaled(2.0), two.light.scaled(0.5)))).image
    expected = 2.0 * posed.relight(one.light).image + 0.5 * posed.relight(two.light).image
    assert expected.max() > 0.1 and np.abs(both - expected).max() < 1e-5 * expected.max()


def test_the_rows_differ_in_their_highlights_alone(capture: Any, avatar: HandyAvatar) -> None:
    frame = scored(capture, "group")[0]
    whole = {}
    for black in (False, True):
        albedo = torch.zeros_like(avatar.albedo) if black else avatar.albedo
        for reflectance in ("phong", "ggx"):
            drawn = HandyAvatar(reflectance, avatar.config, albedo, avatar.exposure, None).relight(frame.query)  # type: ignore[arg-type]
            whole[reflectance, black] = drawn.image
    matt = [whole[reflectance, False] - whole[reflectance, True] for reflectance in ("phong", "ggx")]
    np.testing.assert_allclose(matt[0], matt[1], atol=1e-5)
    assert all(whole[reflectance, True].mean() > 1e-3 for reflectance in ("phong", "ggx"))
    assert np.abs(whole["phong", True] - whole["ggx", True]).max() > 0.02


def test_avatars_are_kept_and_come_back(capture: Any, avatar: HandyAvatar, tmp_path: Path) -> None:
    method = CREATE[avatar.reflectance]("smoke")
    avatar.save(tmp_path)
    again = method.train(Recording((), lambda frame: None)).restore(tmp_path)  # type: ignore[arg-type, return-value]
    query = scored(capture, "group")[0].query
    np.testing.assert_array_equal(again.relight(query).image, avatar.relight(query).image)
    if avatar.reflectance == "ggx":
        baked = again.baked(query.viewpoint)
        np.testing.assert_array_equal(baked.albedo, avatar.albedo.permute(1, 2, 0).numpy())
    else:
        with pytest.raises(Unsupported, match="no reflectance that can be baked"):
            again.baked(query.viewpoint)
    posed = again.pose(query.viewpoint)
    other = next(f for f in scored(capture, "group") if f.camera.name != query.camera.name)
    np.testing.assert_array_equal(
        posed.seen_by(other.camera).relight(query.light).image,
        again.relight(replace(query, camera=other.camera)).image,
    )
    with pytest.raises(InputError, match="asked for"):
        CREATE[avatar.reflectance]("quick").train(enrolment(capture)).restore(tmp_path)


def test_in_unknown_light_the_picture_is_the_texture(capture: Any) -> None:
    seen = enrolment(capture, gives=PARTS - {"light"})
    avatar = handy.create_ggx("smoke").train(seen).personalise(seen)
    frame = seen.frames[0]
    truth = seen.observe(frame)
    found = avatar.relight(replace(frame.query, light=Unknown("as enrolled"))).image
    assert decibels(found, truth.image, truth.alpha > 0.5) > 22.0
    with pytest.raises(Unsupported, match="not told"):
        avatar.pose(frame.viewpoint).relight(Group((Unknown("as enrolled"), Directional([0, 1, 0], [1, 1, 1]))))


def test_where_no_mesh_is_given_the_hand_is_fitted_and_posed(
    capture: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    told = enrolment(capture)
    posed = [(frame, told.observe(frame)) for frame in told.frames]
    seen = tuple(PosedPicture(f.pose_key, f.camera, o, needed(f.pose, "pose"), f.light) for f, o in posed)
    hand = Enrolled(hand_model(), needed(told.frames[0].shape, "shape"), seen)
    monkeypatch.setattr(pictures, "enrolled", lambda *_, **__: hand)
    method = handy.create_ggx("smoke")
    prior = method.train(told)
    avatar = prior.personalise(enrolment(capture, gives=frozenset({"image", "alpha", "camera", "keypoints", "light"})))
    assert avatar.found.keys() == {frame.pose_key for frame in told.frames}
    frame = scored(capture, "group")[0]
    truth, query = capture.observe(frame), replace(frame.query, mesh=None)
    image = avatar.relight(query).image
    assert decibels(image, truth.image, truth.alpha > 0.5) > 20.0
    avatar.save(tmp_path)
    np.testing.assert_array_equal(prior.restore(tmp_path).relight(query).image, image)


def test_without_a_mesh_of_the_open_hand_and_without_key_points_there_is_no_texture(capture: Any) -> None:
    with pytest.raises(Unsupported, match="tracked meshes of the open hand, or on a hand fitted"):
        sitting(enrolment(capture, gives=frozenset({"image", "alpha", "camera"})), CONFIG, lobe("ggx", 0.45), silent)
    told = enrolment(capture, gives=PARTS - {"keypoints"})
    topology = told.frames[0].mesh.topology  # type: ignore[union-attr]
    uvs, uv_faces = topology.unwrapped
    flipped = Topology(topology.faces, uvs[:, ::-1].copy(), uv_faces)
    strange = [replace(f, mesh=Mesh(f.mesh.vertices, flipped)) for f in told.frames]  # type: ignore[union-attr]
    with pytest.raises(Unsupported, match="tracked meshes of the open hand"):
        sitting(Recording(strange, capture.observe, told.gives), CONFIG, lobe("ggx", 0.45), silent)


def test_a_hand_of_another_model_has_no_texture(capture: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """The generator's textures are laid out for the open hand: on another's UVs they would be a wrong picture."""
    told = enrolment(capture, gives=frozenset({"image", "alpha", "camera", "keypoints", "pose"}))
    monkeypatch.setattr(pictures, "hand_of_poses", lambda poses: SimpleNamespace(name="mano-right"))
    with pytest.raises(Unsupported, match="those of mano-right, and textures here are for the open hand"):
        sitting(told, CONFIG, lobe("ggx", 0.45), silent)


def test_pictures_without_a_hand_are_refused(capture: Any) -> None:
    told = enrolment(capture)

    def empty(frame: Frame) -> Any:
        found = told.observe(frame)
        return replace(found, alpha=np.zeros_like(found.alpha))

    with pytest.raises(Unsupported, match="mask of an enrolled picture is empty"):
        sitting(Recording(told.frames, empty), CONFIG, lobe("ggx", 0.45), silent)
    with pytest.raises(Unsupported, match="no frames"):
        sitting(Recording((), told.observe), CONFIG, lobe("ggx", 0.45), silent)


@pytest.mark.parametrize("reflectance", ["phong", "ggx"])
def test_presets_and_priors(reflectance: str, tmp_path: Path) -> None:
    method = CREATE[reflectance]("smoke")
    method.train(Recording((), lambda frame: None)).save(tmp_path)  # type: ignore[arg-type, return-value]
    assert method.load(tmp_path) is not None and method.info.name == f"handy-{reflectance}"
    with pytest.raises(InputError, match="trained with"):
        CREATE[reflectance]("quick").load(tmp_path)
    with pytest.raises(InputError, match="unknown preset"):
        CREATE[reflectance]("swift")
    assert CREATE[reflectance]("quick", {"space": "w+"}).config["space"] == "w+"


def test_the_seeds_inversion_is_as_it_says() -> None:
    seed = PRESETS["seed"]
    assert isinstance(seed, HandyConfig)
    assert (seed.space, seed.start, seed.prior, seed.steps, seed.rate) == ("w", "random", 0.0, 50_000, (1e-3, 1e-3))


def test_a_small_generator_is_built_from_its_own_tensors() -> None:
    made = Generator(3, shipped().texels)
    again = built(made.state_dict())
    codes = torch.randn(1, 3)
    assert torch.equal(made(codes), again(codes)) and not any(p.requires_grad for p in again.parameters())
    assert torch.equal(made(codes), made.linear(codes)), "before training nothing is added to the components"
