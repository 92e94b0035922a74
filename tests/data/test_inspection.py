"""What is wrong with a capture is told by frame."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import handbench.data
from handbench.cli import main
from handbench.data.capture import Capture, by_key
from handbench.data.capture import open_capture as open_registered
from handbench.data.inspection import troubles
from handbench.data.openstage import open_capture
from handbench.errors import InputError
from handbench.method import Progress
from handbench.registry import Entry
from handbench.scene import Frame, Mesh, Observation, Topology

KEY = "s01/pose-0/dorsal/olat-00"


class Few(Capture):
    """Two frames of the light stage that ships, changed by a test."""

    name, digest = "few", "few"

    def __init__(
        self, frame: Callable[[Frame], Frame] = lambda f: f, seen: Callable[[Observation], Observation] = lambda s: s
    ) -> None:
        self._stage, self._seen = open_capture("mini"), seen
        self._frames = tuple(frame(f) for f in self._stage.frames()[:2])

    def frames(self) -> tuple[Frame, ...]:
        return self._frames

    def observe(self, frame: Frame) -> Observation:
        return self._seen(self._stage.observe(frame)) if frame.key == KEY else self._stage.observe(frame)


def meshed(change: Callable[[Mesh], Mesh]) -> Callable[[Frame], Frame]:
    return lambda frame: replace(frame, mesh=change(frame.mesh))


def turned(mesh: Mesh) -> Mesh:
    uvs, uv_faces = mesh.topology.unwrapped
    return Mesh(mesh.vertices, Topology(mesh.topology.faces[:, ::-1], uvs, uv_faces[:, ::-1]))


@pytest.mark.parametrize(
    ("capture", "told"),
    [
        (lambda: Few(meshed(lambda m: Mesh(1000 * m.vertices, m.topology))), f"{KEY}: its mesh is .* millimetres"),
        (lambda: Few(meshed(turned)), f"{KEY}: the faces of its mesh look inwards"),
        (lambda: Few(seen=lambda s: replace(s, image=2.0 + s.image)), f"{KEY}: the median of its hand is"),
        (lambda: Few(seen=lambda s: replace(s, image=s.image * np.nan)), f"{KEY}: .*NaN"),
        (lambda: Few(seen=lambda s: replace(s, alpha=None)), f"{KEY}: it has no mask, which the capture offers"),
        (lambda: Few(lambda f: replace(f, lighting="olat-00")), f"{KEY}: 2 frames have this key"),
    ],
)
def test_each_trouble_is_one_sentence(capture: Callable[[], Capture], told: str) -> None:

    (found,) = troubles(capture())
    assert re.match(told, found)


def test_a_sound_capture_has_none(capsys: pytest.CaptureFixture) -> None:
    assert main(["data", "check", "openstage", "--size", "mini"]) == 0
    assert "frames, all sound" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("frames", "told"),
    [
        (lambda: 1 // 0, r"fails \(ZeroDivisionError: integer division or modulo by zero\); mend it"),
        (lambda: exit("enough"), r"fails \(SystemExit: enough\); mend it"),
        (lambda: (), "has no frames at size 'small'; check where its data are"),
        (lambda: ("frame",), "has a str among its frames; give a handbench.Frame each"),
        (None, "makes a NoneType, expected a handbench.Capture"),
    ],
)
def test_a_plug_ins_capture_that_cannot_be_used_is_told_by_its_name(
    monkeypatch: pytest.MonkeyPatch, frames: Callable[[], tuple] | None, told: str
) -> None:
    def opened(size: str, folder: Path | None, progress: Progress) -> Capture | None:
        if frames is None:
            return None
        capture = Few()
        monkeypatch.setattr(capture, "frames", frames)
        return capture

    monkeypatch.setitem(sys.modules, "foreign", SimpleNamespace(opened=opened))
    entry = Entry("foreign", "foreign:opened", "a capture of others")
    monkeypatch.setattr(handbench.data, "ENTRIES", (*handbench.data.ENTRIES, entry))
    with pytest.raises(InputError, match=f"plug-in 'foreign' at 'foreign:opened' {told}"):
        open_registered("foreign", "small")


def test_keys_are_lines() -> None:
    (frame, _) = Few().frames()
    found = list(troubles(Few(lambda f: replace(f, lighting=f"{f.lighting}\n"))))
    assert repr(f"{KEY}\n") + ": give names that a line can show" in found
    for pose_name in ("fist\x1b[31m", "fist\n", "x" * 2000):
        with pytest.raises(InputError, match="give names that a line can show"):
            by_key([replace(frame, pose_name=pose_name)])
