"""No method can change what another one sees: not the data, not the process; one that tries is told by name."""

from __future__ import annotations

import os
import random
import sys
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
import torch
from flat import flat_cells

from handbench.bench.check import check
from handbench.bench.isolation import isolated
from handbench.bench.lending import Lender
from handbench.bench.resolving import resolve
from handbench.bench.run import run
from handbench.bench.store import Store
from handbench.errors import Changed, InputError
from handbench.hand import known
from handbench.hand.fitting.rig import Rig
from handbench.hand.openhand import create
from handbench.render.uv.atlas import Atlas
from handbench.scene import Environment, Light, Mesh, Pose, Topology, Viewpoint, leaves
from handbench.tuning import matrix_libraries

ROGUE = "toy-lossy"


def spoil(array: np.ndarray) -> None:
    """Write through the read-only flag, as an in-place operation of torch does."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        torch.from_numpy(array).add_(1)


def cells(folder: Path, method: str) -> list[dict]:
    return [cell for cell in flat_cells(folder) if cell["method"]["name"] == method]


def scores(folder: Path, method: str) -> list[dict]:
    return [score for cell in cells(folder, method) for score in cell["scores"]]


def reasons(folder: Path, method: str) -> set[str | None]:
    return {score["reason"] for score in scores(folder, method)}


@dataclass
class Asked:
    viewpoint: Viewpoint
    light: Light


@pytest.fixture
def rogue(fakes, monkeypatch) -> Callable[..., None]:
    """Lets the method `ROGUE` do something in one of its calls, before it answers."""

    def doing(call: str, deed: Callable[..., object]) -> None:
        owner, name = {
            "train": (fakes.Toy, "train"),
            "personalise": (fakes.ToyPrior, "personalise"),
            "pose": (fakes.ToyAvatar, "pose"),
            "relight": (fakes.ToyAvatar, "draw"),
        }[call]
        honest = getattr(owner, name)

        def wrapped(self, given, *rest, **named):
            if (self.info.name if call == "train" else self._name) == ROGUE:
                deed(Asked(given, *rest) if call == "relight" else given)
            return honest(self, given, *rest, **named)

        monkeypatch.setattr(owner, name, wrapped)

    return doing


@pytest.fixture(scope="module")
def found_alone() -> list[dict]:
    """Where the first test that asks for `alone` puts it."""
    return []


@pytest.fixture
def alone(found_alone, fakes, toy_protocol, tmp_path) -> list[dict]:
    """The scores of "toy" when nobody else is there."""
    if not found_alone:
        run(toy_protocol(), methods=["toy"], out=tmp_path / "alone")
        found_alone += scores(tmp_path / "alone", "toy")
    return found_alone


ARRAYS = {
    "the mesh of s0": lambda q: q.viewpoint.mesh.vertices,
    "the topology of s0": lambda q: q.viewpoint.mesh.topology.uvs,
    "the camera of s0": lambda q: q.viewpoint.camera.K,
    "the pose of s0": lambda q: q.viewpoint.pose.joints,
    "the light of s0": lambda q: next(
        leaf.radiance if isinstance(leaf, Environment) else leaf.irradiance for leaf in leaves(q.light)
    ),
}


@pytest.mark.parametrize("named", ARRAYS)
def test_who_changes_a_query_is_named_and_harms_nobody(rogue, alone, toy_protocol, tmp_path, named):
    rogue("relight", lambda query: spoil(ARRAYS[named](query)))
    outcome = run(toy_protocol(), methods=[ROGUE, "toy"], out=tmp_path / "run")
    assert scores(tmp_path / "run", "toy") == alone
    assert {score["value"] for score in scores(tmp_path / "run", ROGUE)} == {None}
    assert all(reason.startswith(f"changed what it was given: {named}") for reason in reasons(tmp_path / "run", ROGUE))
    assert len(outcome.crashed) == 2 and "changed what it was given" in outcome.crashed[0]
    assert run(toy_protocol(), methods=["toy"], out=tmp_path / "run").reused == 2, "what was computed beside it holds"
    assert scores(tmp_path / "run", "toy") == alone


FIELDS = {
    "the camera of s0": lambda q: (q.viewpoint.camera, "width", 5),
    "the mesh of s0": lambda q: (q.viewpoint.mesh, "vertices", 2 * q.viewpoint.mesh.vertices),
    "the light of s0": lambda q: (next(leaves(q.light)), "direction", np.array([0.0, 0.0, 1.0])),
}


@pytest.mark.parametrize("named", FIELDS)
def test_who_puts_another_value_into_a_field_is_named_too(rogue, alone, toy_protocol, tmp_path, named):
    rogue("relight", lambda query: object.__setattr__(*FIELDS[named](query)))
    run(toy_protocol(), methods=[ROGUE, "toy"], out=tmp_path / "run")
    assert scores(tmp_path / "run", "toy") == alone
    assert all(reason.startswith(f"changed what it was given: {named}") for reason in reasons(tmp_path / "run", ROGUE))


def test_poses_and_meshes_that_are_read_late_are_watched_when_they_are_read(fakes, toy_protocol):
    read: list[str] = []

    def vertices() -> np.ndarray:
        read.append("mesh")
        return np.eye(3, dtype=np.float32)  # of another type than a mesh has

    def pose() -> Pose:
        return Pose(np.ones((1, 3)))

    frame = replace(
        fakes.ToyCapture().frames()[0], pose=Pose.unread(pose), mesh=Mesh.unread(vertices, Topology([[0, 1, 2]]))
    )
    selected = resolve(toy_protocol(), fakes.ToyCapture().frames())
    for part, field in (("mesh", "vertices"), ("pose", "joints")):
        lender = Lender()
        (lent,) = lender.lend(replace(selected, train=(frame,)), "one").train
        read.clear()
        lender.check()
        assert not read, "what nobody looked at is not read to see whether it changed"
        assert np.array_equal(getattr(getattr(lent, part), field), getattr(getattr(frame, part), field))
        lender.check()
        spoil(getattr(getattr(lent, part), field))
        with pytest.raises(Changed, match=f"the {part} of {frame.key}"):
            lender.check()


@pytest.mark.parametrize("call", ["train", "personalise"])
def test_frames_of_a_recording_are_watched_too(rogue, alone, toy_protocol, tmp_path, call):
    rogue(call, lambda recording: spoil(recording.frames[0].mesh.vertices))
    run(toy_protocol(), methods=[ROGUE, "toy"], out=tmp_path / "run")
    assert scores(tmp_path / "run", "toy") == alone
    assert all("changed what it was given: the mesh of s0" in reason for reason in reasons(tmp_path / "run", ROGUE))
    kept = [Store(tmp_path / "run").prior(cell["prior"]) for cell in cells(tmp_path / "run", ROGUE)]
    assert (kept == [None, None]) == (call == "train"), "what it learned from spoiled data is not kept"


@pytest.mark.parametrize("call", ["train", "personalise"])
def test_images_belong_to_who_asked_for_them(rogue, fakes, alone, toy_protocol, tmp_path, monkeypatch, call):
    shared: dict[str, object] = {}  # a capture that keeps what it has read, and hands it out again
    honest = fakes.ToyCapture.observe
    monkeypatch.setattr(
        fakes.ToyCapture, "observe", lambda self, f: shared.setdefault(f.key, honest(self, f)) if f.mesh else None
    )

    def deed(recording):
        for frame in recording.frames:
            spoil(recording.observe(frame).image)
            spoil(recording.observe(frame).alpha)

    rogue(call, deed)
    run(toy_protocol(), methods=[ROGUE, "toy", "oracle"], out=tmp_path / "run")
    assert scores(tmp_path / "run", "toy") == alone
    assert {score["value"] for score in scores(tmp_path / "run", "oracle")} == {100.0}


OF_THE_HAND = {
    "its points": lambda hand: hand.points,
    "its template": lambda hand: hand.template.shapes,
    "weights it worked out": lambda hand: hand.weights(1),
    "a surface it worked out": lambda hand: hand.topology(1).uvs,
    "what fitting works out of it": lambda hand: Rig.of(hand, 0).weights,
}


@pytest.mark.parametrize(("call", "part"), [*zip(["train", *["relight"] * 4], OF_THE_HAND, strict=True)])
def test_who_changes_the_hand_model_is_named_and_harms_nobody(rogue, alone, toy_protocol, tmp_path, call, part):
    known.forget("openhand")  # what a hand works out is first asked for by the rogue itself
    hand = known.hand_model()
    rogue(call, lambda _: spoil(OF_THE_HAND[part](hand)))
    run(toy_protocol(), methods=[ROGUE, "toy"], out=tmp_path / "run")
    assert scores(tmp_path / "run", "toy") == alone
    assert reasons(tmp_path / "run", ROGUE) == {"changed what it was given: the hand model openhand"}
    sound = create()
    for array in OF_THE_HAND.values():
        np.testing.assert_array_equal(array(hand), array(sound))


def test_frames_share_what_the_originals_share(fakes, toy_protocol):
    selected = resolve(toy_protocol(), fakes.ToyCapture().frames())
    lender = Lender()
    lent = lender.lend(selected, "one")
    assert lender.lend(selected, "one") is lent and lender.lend(selected, "other") is not lent
    one, two = selected.train[:2]
    mine, other = lent.train[:2]
    assert one.mesh is two.mesh and mine.mesh is other.mesh and mine.mesh is not one.mesh
    assert mine.key == one.key and np.array_equal(mine.mesh.vertices, one.mesh.vertices)
    assert not mine.mesh.vertices.flags.writeable
    assert lent.enrol[0].mesh.topology is mine.mesh.topology


def test_answers_drawn_into_one_array_are_told_apart(fakes, toy_protocol, tmp_path, monkeypatch):
    run(toy_protocol(), out=tmp_path / "fresh")
    honest, canvas = fakes.ToyAvatar.draw, np.zeros((8, 8, 3), np.float32)

    def draw(self, viewpoint, light):
        answer = honest(self, viewpoint, light)
        canvas[:] = answer.image
        return replace(answer, image=canvas)

    monkeypatch.setattr(fakes.ToyAvatar, "draw", draw)
    run(toy_protocol(), out=tmp_path / "reused")
    assert scores(tmp_path / "reused", "toy") == scores(tmp_path / "fresh", "toy")


def _state() -> dict[str, object]:
    libraries = matrix_libraries()  # first: finding them loads threadpoolctl, which sets a variable
    return {
        "directory": Path.cwd(),
        "variables": dict(os.environ),
        "path": list(sys.path),
        "errors": np.geterr(),
        "filters": list(warnings.filters),
        "random": random.getstate(),
        "legacy": np.random.get_state()[1].tolist(),  # noqa: NPY002
        "output": sys.stdout,
        "grad": torch.is_grad_enabled(),
        "dtype": torch.get_default_dtype(),
        "device": torch.get_default_device(),
        "threads": torch.get_num_threads(),
        "products": [library.get_num_threads() for library in libraries],
        "deterministic": torch.are_deterministic_algorithms_enabled(),
        "precision": torch.get_float32_matmul_precision(),
        "benchmark": torch.backends.cudnn.benchmark,
        "seed": torch.get_rng_state().tolist(),
    }


def _disturb(_: object = None) -> None:
    os.chdir("/")
    os.environ["OMP_NUM_THREADS"] = "7"
    os.environ["HANDBENCH_DATA"] = "/nowhere"
    os.environ.pop("HOME", None)
    sys.path.insert(0, "/nowhere")
    np.seterr(all="raise")
    warnings.simplefilter("error")
    random.seed(1)
    np.random.seed(1)  # noqa: NPY002
    sys.stdout = sys.stderr
    torch.set_grad_enabled(False)
    torch.set_default_dtype(torch.float64)
    torch.set_default_device("meta")
    torch.set_num_threads(torch.get_num_threads() + 1)
    for library in matrix_libraries():
        library.set_num_threads(library.get_num_threads() % 2 + 1)
    torch.use_deterministic_algorithms(True)
    torch.set_float32_matmul_precision("medium")
    torch.backends.cudnn.benchmark = True
    torch.manual_seed(12345)


def test_the_process_is_put_back():
    before = _state()
    with pytest.raises(ValueError, match="on the way"), isolated():
        _disturb()
        assert all(now != before[name] for name, now in _state().items())
        raise ValueError("on the way")
    assert _state() == before


@pytest.mark.parametrize("call", ["train", "personalise", "relight"])
def test_a_method_that_changes_the_process_disturbs_nobody(
    rogue, alone, toy_protocol, tmp_path, monkeypatch, call, capsys
):
    monkeypatch.chdir(tmp_path)
    rogue(call, _disturb)
    before = _state()
    outcome = run(toy_protocol(), methods=[ROGUE, "toy"], out=Path("run"))
    assert {k: v for k, v in _state().items() if k != "output"} == {k: v for k, v in before.items() if k != "output"}
    assert outcome.folder == Path("run") and scores(tmp_path / "run", "toy") == alone
    assert all(path.is_relative_to(tmp_path) for path in tmp_path.rglob("*.json"))


@pytest.mark.parametrize("call", ["train", "personalise", "pose", "relight"])
@pytest.mark.parametrize("code", [0, None, "enough"])
def test_a_method_that_ends_the_process_has_crashed(rogue, alone, toy_protocol, tmp_path, call, code):
    rogue(call, lambda _: sys.exit(code))
    outcome = run(toy_protocol(), methods=[ROGUE, "toy"], out=tmp_path / "run")
    assert scores(tmp_path / "run", "toy") == alone
    assert len(outcome.crashed) == 2 and "crashed: SystemExit" in outcome.crashed[0]
    assert all(reason.startswith("crashed: SystemExit") for reason in reasons(tmp_path / "run", ROGUE))


class Mute(Exception):
    def __str__(self) -> str:
        raise ValueError("no words")


@pytest.mark.parametrize(
    ("error", "told"), [(Mute(), "Mute: what it says cannot be told"), (OSError("x\udcff"), "OSError: x\\udcff")]
)
def test_a_failure_is_told_whatever_it_says(rogue, toy_protocol, tmp_path, error, told):
    def fail(_):
        raise error

    rogue("relight", fail)
    run(toy_protocol(), methods=[ROGUE], out=tmp_path / "run")
    assert reasons(tmp_path / "run", ROGUE) == {f"crashed: {told}"}


def test_an_interrupt_stays_one(rogue, toy_protocol, tmp_path):
    def interrupt(_):
        raise KeyboardInterrupt

    for call in ("relight", "personalise", "train"):
        rogue(call, interrupt)
        with pytest.raises(KeyboardInterrupt):
            run(toy_protocol(), methods=[ROGUE], out=tmp_path / call)


def test_check_tells_the_same(rogue, toy_protocol, tmp_path):
    before = _state()
    rogue("train", lambda recording: spoil(recording.frames[0].mesh.topology.uvs))
    rogue("relight", _disturb)
    laws = {verdict.law: verdict for verdict in check(ROGUE, toy_protocol())}
    assert laws["no mutation"].holds is False
    assert laws["no mutation"].detail == "the topology of s01/pose-0/front/olat-00 was changed"
    assert _state() == before
    rogue("train", lambda _: sys.exit(0))
    (verdict,) = check(ROGUE, toy_protocol())
    assert (verdict.holds, verdict.detail) == (False, "crashed: SystemExit: 0")


def test_writing_through_the_flag_is_real():
    """What the tests above rest on: a read-only array is no protection."""
    array = np.zeros(3)
    array.flags.writeable = False
    spoil(array)
    assert array.tolist() == [1, 1, 1]


def test_what_is_kept_of_a_topology_is_not_handed_on(fakes, toy_protocol):
    selected = resolve(toy_protocol(), fakes.ToyCapture().frames())
    truth = Atlas(selected.train[0].mesh.topology, 8)
    lender = Lender()
    spoilt = lender.lend(selected, "one").train[0].mesh.topology
    spoil(spoilt.uvs)
    with pytest.raises(InputError, match="no texel"):
        Atlas.of(spoilt, 8)
    torch.from_numpy(spoilt.uvs).mul_(0.5)
    Atlas.of(spoilt, 8)
    with pytest.raises(Changed, match="the topology of s01/pose-0"):
        lender.check()
    mine = Atlas.of(lender.lend(selected, "one").train[0].mesh.topology, 8)
    assert np.array_equal(mine.barycentric, truth.barycentric)
    mine.barycentric[:] = 0.0
    theirs = Atlas.of(lender.lend(selected, "other").train[0].mesh.topology, 8)
    assert np.array_equal(theirs.barycentric, truth.barycentric)
