"""A method in another interpreter answers as it would here, and whatever happens to it the run goes on."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from flat import flat_cells

from handbench.bench.check import check_method
from handbench.bench.failure import failure
from handbench.bench.plan import make_plan
from handbench.bench.run import run
from handbench.checkpoint import checkpoints_in
from handbench.errors import InputError
from handbench.method import Recording
from handbench.registry import Entry
from handbench.remote import remote_method
from handbench.remote.process import WorkerFailed
from handbench.skips import NONE, skipping, tallied

FAKES = Path(__file__).parent / "fakes"


def ended(process: int) -> bool:
    """Whether a process is gone within 5 seconds; if not, it is ended here."""
    for _ in range(50):
        try:
            if "State:\tZ" in Path(f"/proc/{process}/status").read_text():
                return True
        except OSError:
            return True
        time.sleep(0.1)
    os.kill(process, signal.SIGKILL)
    return False


@pytest.fixture
def frames(toys):
    capture = toys.ToyCapture()
    return capture, [frame for frame in capture.frames() if frame.subject == "s01"]


def ask(method, capture, frames, told=None):
    """Train, save, load, personalise and relight: all answers, and what progress was told."""
    recording = Recording(frames[:6], capture.observe)
    prior = method.train(recording, 3, lambda step, total, **values: told.append((step, total, values)))
    avatar = prior.personalise(recording, 3)
    return prior, [avatar.relight(frame.query) for frame in frames]


def test_answers_are_the_same_bit_for_bit(remote, fakes, frames, tmp_path):
    capture, chosen = frames
    told: dict[str, list] = {"here": [], "there": []}
    answers = {}
    for name, method in (("here", fakes.create()), ("there", remote())):
        prior, answers[name] = ask(method, capture, chosen, told[name])
        folder = tmp_path / name
        folder.mkdir()
        prior.save(folder)
        loaded = method.load(folder).personalise(Recording(chosen[:6], capture.observe), 3)
        again = loaded.relight(chosen[0].query)
        assert again.image.tobytes() == answers[name][0].image.tobytes()
    assert told["here"] == told["there"] and len(told["here"]) == 6
    for here, there in zip(answers["here"], answers["there"], strict=True):
        assert here.image.tobytes() == there.image.tobytes() and here.alpha.tobytes() == there.alpha.tobytes()
        assert here.mesh.vertices.tobytes() == there.mesh.vertices.tobytes() and there.depth.shape == (8, 8)
    assert (tmp_path / "here" / "gain.json").read_bytes() == (tmp_path / "there" / "gain.json").read_bytes()


def test_maps_are_worked_out_when_they_are_asked_for(remote, frames):
    _, answers = ask(remote(), *frames, [])
    assert np.asarray(answers[3].depth)[0, 0] == 1.0  # the first that was drawn at all
    assert np.asarray(answers[1].depth, np.float32)[0, 0] == 2.0


def test_the_laws_hold_through_the_wire(remote, toys, toy_protocol):
    verdicts = check_method(remote(), toy_protocol, toys.ToyCapture())
    assert [verdict.holds for verdict in verdicts] == [True] * 6, verdicts


def test_info_and_config_tell_the_method_and_its_interpreter(remote, fakes, python):
    method = remote()
    assert method.info == fakes.create().info
    config = method.config
    assert config["nested"] == [1, 2.5, None, {"same": 3}]
    assert (
        config["interpreter"]["packages"]["numpy"] == np.__version__
        and "torch" not in config["interpreter"]["packages"]
    )
    assert len(config["interpreter"]["source"]) == 64 and config["interpreter"]["target"] == "remotefakes:create"


def test_dependencies_that_conflict_live_side_by_side(remote, monkeypatch):
    """The other interpreter has a torch of its own, and none of our packages, whatever PYTHONPATH says here."""
    monkeypatch.setenv("PYTHONPATH", str(Path(np.__file__).parents[1]))
    method = remote(target="remotefakes:create_with_old_torch")
    assert method.config["interpreter"]["packages"]["torch"] == "0.4.1"


def test_skips_and_checkpoints_reach_the_method(remote, frames, tmp_path):
    capture, chosen = frames
    with checkpoints_in(tmp_path / "state") as state:
        prior = remote().train(Recording(chosen[:2], capture.observe))
    assert (tmp_path / "state" / "step").read_text() == "1" and state.earlier_s == 7.0
    avatar = prior.personalise(Recording(chosen[:2], capture.observe))
    with tallied() as tally:
        avatar.relight(chosen[0].query)
        with skipping(NONE):
            avatar.relight(chosen[0].query)
    assert (tally.lines()["lights"].total, tally.lines()["lights"].skipped) == (6, 2)


def test_what_is_no_longer_held_here_is_let_go_there(remote, frames):
    method = remote()
    prior, answers = ask(method, *frames, [])
    assert len(method._worker._release) == 2  # the avatar, and what it posed last
    del answers, prior
    assert len(method._worker._release) == 3 + len(frames[1])


@pytest.mark.parametrize(
    ("wrong", "limits", "reason"),
    [
        (
            {"relight": "hang"},
            {"relight_s": "0.6"},
            "failed: no answer to relight within 0.6 s; the process was killed",
        ),
        (
            {"relight": "busy"},
            {"relight_s": "0.6"},
            "failed: no answer to relight within 0.6 s; the process was killed",
        ),
        (
            {"relight": "half"},
            {"relight_s": "0.6"},
            "failed: no answer to relight within 0.6 s; the process was killed",
        ),
        ({"train": "hang"}, {"train_s": "0.6"}, "failed: no answer to train within 0.6 s; the process was killed"),
        ({"train": "flood"}, {"train_s": "0.6"}, "failed: no answer to train within 0.6 s; the process was killed"),
        (
            {"relight": "trickle"},
            {"relight_s": "0.6"},
            "failed: no answer to relight within 0.6 s; the process was killed",
        ),
        ({"personalise": "hang"}, {"personalise_s": "0.6"}, "failed: no answer to personalise within 0.6 s"),
        (
            {"relight": "exit"},
            {},
            "failed: the process ended with exit code 3 during relight; it said: the licence has",
        ),
        ({"train": "sys-exit"}, {}, "failed: the process ended with exit code 1 during train; it said: no licence"),
        (
            {"relight": "kill"},
            {},
            "failed: the process was ended by SIGKILL, as systems do where memory runs short, during",
        ),
        (
            {"relight": "orphan"},
            {},
            "failed: the process was ended by SIGKILL, as systems do where memory runs short, during",
        ),
        ({"relight": "garbage"}, {}, "failed: the process sent a message of an impossible length during relight"),
        ({"relight": "no-json"}, {}, "failed: the process sent a message that cannot be read"),
        ({"relight": "deep"}, {}, "failed: the process sent a message that cannot be read"),
        ({"relight": "other"}, {}, "failed: the process sent the unknown message 'bomb' during relight and was killed"),
        ({"relight": "huge"}, {}, "failed: the process sent a message that cannot be read"),
        ({"train": "memory"}, {}, "out of memory"),
        ({"relight": "gpu"}, {}, "out of memory"),
        ({"relight": "key"}, {}, "crashed: KeyError: 'weights'"),
        ({"relight": "file"}, {}, "crashed: FileNotFoundError: [Errno 2] No such file or directory: '/no/such/file'"),
        ({"relight": "unsupported"}, {}, "unsupported: no such light here"),
        ({"relight": "non-finite"}, {}, "non-finite: the texture overflowed"),
    ],
    ids=lambda value: "-".join(f"{k} {v}" for k, v in value.items()) if isinstance(value, dict) else "",
)
def test_every_end_has_a_reason_and_none_takes_long(remote, frames, wrong, limits, reason, tmp_path, monkeypatch):
    capture, chosen = frames
    orphan = tmp_path / "orphan"
    monkeypatch.setenv("ORPHAN", str(orphan))
    method = remote(**wrong, **limits)
    start = time.monotonic()
    with pytest.raises(Exception) as found:
        avatar = method.train(Recording(chosen[:2], capture.observe)).personalise(
            Recording(chosen[:2], capture.observe)
        )
        avatar.relight(next(frame for frame in chosen if frame.pose_name == "pose-2").query)
    assert failure(found.value).reason.startswith(reason)
    assert time.monotonic() - start < 8
    if orphan.exists():
        assert ended(int(orphan.read_text())), "a child of the worker lives on"
    if "crashed" in reason:
        assert (
            "in the other interpreter" in (failure(found.value).trace or "")
            and "misbehave" in failure(found.value).trace
        )


def test_errors_of_the_system_keep_their_number(remote, frames, tmp_path):
    """A full disk over there is a full disk here."""
    capture, chosen = frames
    prior = remote().train(Recording(chosen[:2], capture.observe))
    with pytest.raises(OSError) as found:
        prior.save(tmp_path / "absent")
    assert isinstance(found.value, FileNotFoundError) and found.value.errno == 2


def test_what_a_method_prints_harms_nothing(remote, frames, capfd):
    _, answers = ask(remote(relight="noise"), *frames, [])
    assert len(answers) == len(frames[1]) and capfd.readouterr() == ("", "")


def test_a_damaged_capture_is_told_as_such(remote, toys):
    capture = toys.ToyCapture(damaged="s01/pose-0/front/olat-00")
    frames = capture.frames()[:3]
    method = remote()
    with pytest.raises(InputError, match="is damaged; make the capture again"):
        method.train(Recording(frames, capture.observe))
    assert method._worker.alive


def test_ctrl_c_ends_the_worker(remote, frames):
    capture, chosen = frames
    method = remote()

    def stop(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        method.train(Recording(chosen, capture.observe), progress=stop)
    assert not method._worker.alive


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"python": "/no/such/python"}, r"interpreter /no/such/python cannot be started \(No such file or directory\)"),
        ({"python": "$NO_SUCH_PYTHON/bin/python"}, r"interpreter \$NO_SUCH_PYTHON/bin/python cannot be started"),
        ({"target": "nowhere:create"}, r"cannot be made by .*ModuleNotFoundError: No module named 'nowhere'"),
        ({"target": "remotefakes:absent"}, r"cannot be made by .*AttributeError: .*absent"),
        ({"preset": "fast"}, r"cannot be made by .*\(unknown preset 'fast'; known: quick\)"),
        ({"create": "exit"}, r"cannot be made by .*\(the process ended with exit code 3 during create"),
        ({"create": "hang", "start_s": "0.6"}, r"cannot be made by .*\(no answer to create within 0.6 s"),
        ({"relight_s": "soon"}, r"setting relight_s .* is 'soon'; give seconds above 0"),
        ({"relight_s": "-1"}, r"setting relight_s .* is '-1'; give seconds above 0"),
    ],
)
def test_an_interpreter_that_cannot_be_used_is_one_sentence(python, changes, message):
    given = {"python": python, "target": "remotefakes:create", "path": str(FAKES), **changes}
    with pytest.raises(InputError, match=message) as found:
        remote_method(**given)
    assert "\n" not in str(found.value)


def test_the_worker_ends_with_the_process_that_started_it(python):
    """Even while it computes, and however that ends."""
    code = (
        "import sys; from handbench.remote import remote_method\n"
        f"m = remote_method(python={python!r}, target='remotefakes:create', path={str(FAKES)!r}, train='busy')\n"
        "print(m._worker._process.pid, flush=True)\n"
        "from handbench.method import Recording\n"
        "m.train(Recording([], None))\n"
    )
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout is not None
        worker = int(parent.stdout.readline())
        time.sleep(0.3)
        os.kill(worker, 0)
        parent.send_signal(signal.SIGKILL)
    assert ended(worker), "the worker outlived its parent"


def test_a_run_goes_on_without_them(python, toy_protocol, tmp_path):
    """One good method and three that fail in other ways: all cells are there, each with its reason."""
    wrongs = {"good": {}, "hangs": {"relight": "hang", "relight_s": "0.6"}}
    wrongs |= {"dies": {"train": "kill"}, "throws": {"relight": "key"}}
    names = tuple(f"remote-{name}" for name in wrongs)
    entries = tuple(
        Entry(
            f"remote-{name}",
            "handbench.remote:remote_method",
            "for tests",
            (("python", python), ("target", "remotefakes:create"), ("path", str(FAKES)), *wrong.items()),
        )
        for name, wrong in wrongs.items()
    )
    outcome = run(toy_protocol, names, out=tmp_path, extra=entries)
    assert outcome.computed == 8 and len(outcome.crashed) == 6
    cells = {}
    for cell in flat_cells(tmp_path):
        cells[cell["method"]["name"], cell["subject"]] = {score["reason"] for score in cell["scores"]}
    assert cells["remote-good", "s01"] == cells["remote-good", "s02"] == {None}
    for subject in ("s01", "s02"):
        assert "failed: no answer to relight within 0.6 s; the process was killed" in cells["remote-hangs", subject]
        assert all(
            reason.startswith("failed: the process was ended by SIGKILL") for reason in cells["remote-dies", subject]
        )
        assert "crashed: KeyError: 'weights'" in cells["remote-throws", subject]


def test_a_cell_is_computed_anew_when_the_code_over_there_changes(python, toy_protocol, tmp_path, monkeypatch):
    """As docs/adding-a-method.md has it: the entry points to a factory of the package that brings it."""
    there = tmp_path / "there"
    there.mkdir()
    (there / "theirs.py").write_text((FAKES / "remotefakes.py").read_text())
    factory = f"return remote_method(preset, python={python!r}, target='theirs:create', path={str(there)!r})"
    text = f"def create(preset='quick'):\n    from handbench.remote import remote_method\n    {factory}\n"
    (tmp_path / "bringstheirs.py").write_text(text)
    monkeypatch.syspath_prepend(str(tmp_path))

    def keys() -> set[str]:
        remote_method.cache_clear()  # as in another process
        entry = Entry("theirs", "bringstheirs:create", "for tests")
        return {cell.key for cell in make_plan(toy_protocol, "digest", ["theirs"], extra=[entry]).cells}

    before = keys()
    assert keys() == before
    (there / "theirs.py").write_text((FAKES / "remotefakes.py").read_text() + "\n# a remark\n")
    assert keys() == before
    (there / "theirs.py").write_text((FAKES / "remotefakes.py").read_text() + "\nSTRENGTH = 2\n")
    assert not keys() & before


def test_a_killed_worker_costs_one_subject(remote, toys, frames, tmp_path):
    """The next subject gets a new worker, which loads the kept prior."""
    capture, chosen = frames
    method = remote()
    recording = Recording(chosen[:6], capture.observe)
    method.train(recording, 3).save(tmp_path)
    prior = method.load(tmp_path)
    avatar = prior.personalise(recording)
    before = avatar.relight(chosen[0].query)
    os.kill(method._worker._process.pid, signal.SIGKILL)
    with pytest.raises(WorkerFailed):
        avatar.relight(chosen[0].query)
    with pytest.raises(WorkerFailed, match="SIGKILL"):  # every further query is answered at once, with the first reason
        avatar.relight(chosen[1].query)
    after = prior.personalise(recording).relight(replace(chosen[0].query))
    assert after.image.tobytes() == before.image.tobytes()


def test_a_worker_killed_between_calls_has_a_reason(remote, frames):
    capture, chosen = frames
    method = remote()
    recording = Recording(chosen[:6], capture.observe)
    avatar = method.train(recording, 3).personalise(recording)
    os.kill(method._worker._process.pid, signal.SIGKILL)
    method._worker._process.wait()
    with pytest.raises(WorkerFailed, match=r"SIGKILL.*between calls"):
        avatar.relight(chosen[0].query)
