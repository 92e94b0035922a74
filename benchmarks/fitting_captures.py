"""Fits to pictures of the open captures, whose hands are known: `python -m benchmarks.fitting_captures`.

Errors against the truth by what is given, by tone and by pose; how often what is wrong with a picture is told, and how
often something is told of pictures with which nothing is wrong.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from typing import TypeAlias

import numpy as np

from handbench.data.openstage import open_capture
from handbench.data.openstage.population import cast
from handbench.data.openstage.presets import CaptureName
from handbench.evenly import evenly
from handbench.hand import HandModel, hand_model
from handbench.hand.fitting import Fit, HandPicture, Unfittable, fit, pictures
from handbench.hand.openhand import OpenHand
from handbench.scene import Camera, Frame

from .fitting import Errors, errors_of
from .spoiled import SPOILS

SEGMENTS: dict[CaptureName, str] = {"openwild": "sequence", "openphone": "scan"}
GIVEN: dict[str, Callable[[HandPicture], HandPicture]] = {
    "key points, mask": lambda picture: replace(picture, depth=None, start=None),
    "key points, mask, pose": lambda picture: replace(picture, depth=None),
    "key points, mask, depth": lambda picture: replace(picture, start=None),
}
USUAL: dict[CaptureName, tuple[str, ...]] = {
    "openwild": ("key points, mask", "key points, mask, pose"),
    "openphone": ("key points, mask", "key points, mask, depth"),
}
"""What is given where a capture is fitted to; a scan by phone has depth and no pose, as in the protocols."""


@dataclass(frozen=True, eq=False)
class KnownPicture:
    """A picture, the frame with its hand as it is, and what kind of picture it is."""

    picture: HandPicture
    truth: Frame
    groups: tuple[str, ...]


Row: TypeAlias = tuple[KnownPicture, Errors | None, str]
"""A picture, how far its hand is off, if one was found, and why it was refused, or \"\"."""


def known(capture: CaptureName, size: str) -> list[list[KnownPicture]]:
    """Every picture that can be enrolled, subject by subject in the order of time."""
    found, source = hand_model(), open_capture(size, capture=capture)
    frames = [frame for frame in source.frames() if frame.segment == SEGMENTS[capture]]
    count = len({frame.subject for frame in frames})
    tones = {one.name: _tone(one.look.melanin) for one in cast(capture, count, OpenHand.load())}
    people = []
    for subject, tone in tones.items():
        own = source.recording(frame for frame in frames if frame.subject == subject)
        truths = {frame.key: source.truth(frame) for frame in own.frames}
        each = [(picture, truths[picture.name]) for picture in pictures(own)]
        people.append([KnownPicture(picture, truth, (tone, *_seen(found, truth))) for picture, truth in each])
    return people


def _tone(melanin: float) -> str:
    return "light skin" if melanin < 0.35 else "medium skin" if melanin < 0.7 else "dark skin"


def _seen(hand: HandModel, truth: Frame) -> tuple[str, str]:
    """Which side of the hand the camera sees, and whether its fingers are straight."""
    assert truth.pose is not None and truth.shape is not None and isinstance(truth.camera, Camera)
    points = hand.posed(truth.shape, truth.pose)[1][list(hand.key_points)]
    flat = hand.posed(truth.shape, hand.named_pose("rest"))[1][list(hand.key_points)]
    wrist, index, little = points[[0, 5, 17]]
    palm = np.cross(index - wrist, little - wrist)  # out of the palm of a right hand
    towards = truth.camera.centre - points.mean(axis=0)
    cosine = float(palm @ towards / np.linalg.norm(palm) / np.linalg.norm(towards))
    side = "palm" if cosine > 0.5 else "back" if cosine < -0.5 else "edge"
    tips = [8, 12, 16, 20]
    reach = np.linalg.norm(points[tips] - wrist, axis=1) / np.linalg.norm(flat[tips] - flat[0], axis=1)
    return f"from the {side}", "straight fingers" if reach.mean() > 0.9 else "bent fingers"


def some(people: Sequence[Sequence[KnownPicture]], each: int) -> list[KnownPicture]:
    """At most some pictures of each person, spread over the sequence."""
    return [picture for own in people for picture in evenly(own, each)]


def found_in(hand: HandModel, truth: Frame, found: Fit, index: int = 0) -> Errors:
    """How far a fitted hand is from that of a frame."""
    pose = found.pictures[index].pose
    assert pose is not None and truth.pose is not None and truth.shape is not None
    assert isinstance(truth.camera, Camera)
    true = hand.posed(truth.shape, truth.pose)[0]
    return errors_of(hand.posed(found.shape, pose)[0], true, truth.camera, pose.translation - truth.pose.translation)


def alone(capture: CaptureName, size: str, each: int) -> None:
    """Errors of pictures that are fitted one by one."""
    hand, people = hand_model(), some(known(capture, size), each)
    for given in USUAL[capture]:
        rows: list[Row] = []
        took = []
        for one in people:
            start = time.process_time()
            try:
                found = fit(hand, [GIVEN[given](one.picture)])
            except Unfittable as wrong:
                rows.append((one, None, wrong.problems[0].kind))
                print(f"  {wrong}", flush=True)
                continue
            took.append(time.process_time() - start)
            missed = [problem for problem in found.problems if problem.fatal]
            error = found_in(hand, one.truth, found)
            rows.append((one, error, missed[0].kind if missed else ""))
            for problem in found.problems:
                print(f"  {1e3 * error.absolute:.1f} mm: {problem}", flush=True)
        print(f"\n{capture} {size}, one picture: {given}; {np.median(took):.1f} s of a core")
        _table(rows)


def together(capture: CaptureName, size: str) -> None:
    """Errors of whole sequences of one person."""
    hand, given = hand_model(), USUAL[capture][-1]
    rows: list[Row] = []
    took = []
    for own in known(capture, size):
        start = time.process_time()
        found = fit(hand, [GIVEN[given](one.picture) for one in own])
        took.append(time.process_time() - start)
        for i, (one, fitted) in enumerate(zip(own, found.pictures, strict=True)):
            missed = [problem for problem in fitted.problems if problem.fatal]
            error = None if fitted.pose is None else found_in(hand, one.truth, found, i)
            rows.append((one, error, missed[0].kind if missed else ""))
            for problem in fitted.problems:
                print(f"  {1e3 * error.absolute if error else np.nan:.1f} mm: {problem}", flush=True)
    print(f"\n{capture} {size}, a sequence: {given}; {np.median(took):.1f} s of a core")
    _table(rows)


def _table(rows: Sequence[Row]) -> None:
    """Mean and worst errors of what was returned as a hand, by kind of picture, and how many were refused; fine
    are those of them whose hand is within 10 mm up to a scaling about the camera."""
    print(
        f"{'':18}{'pictures':>9}{'mean mm':>9}{'worst':>8}{'scaled':>8}{'worst':>8}{'refused':>9}{'of these fine':>15}"
    )
    kinds = ["all", *dict.fromkeys(chain.from_iterable(one.groups for one, _, _ in rows))]
    for kind in kinds:
        own = [row for row in rows if kind == "all" or kind in row[0].groups]
        good = [error for _, error, missed in own if error is not None and not missed]
        fine = sum(error is not None and error.scaled < 0.010 for _, error, missed in own if missed)
        line = f"{kind:18}{len(own):9}"
        for name in ("absolute", "scaled"):
            values = 1e3 * np.array([getattr(error, name) for error in good] or [np.nan])
            line += f"{values.mean():{9 if name == 'absolute' else 8}.1f}{values.max():8.1f}"
        print(f"{line}{len(own) - len(good):9}{fine:15}", flush=True)


def told(capture: CaptureName, size: str, each: int, names: Iterable[str]) -> None:
    """How often what is wrong with a picture is told: as fatal, as a doubt, not at all; and as what."""
    hand, people = hand_model(), some(known(capture, size), each)
    print(f"\n{capture} {size}: what is wrong, and of {len(people)} pictures how many are refused, doubted, silent")
    for given in USUAL[capture]:
        for name in names:
            if "millimetres" in name and "depth" not in given:
                continue
            fatal, doubted, silent, far = 0, 0, 0, 0
            kinds: dict[str, int] = {}
            for number, one in enumerate(people):
                picture = SPOILS[name](GIVEN[given](one.picture), np.random.default_rng([number, 9]))
                try:
                    found = fit(hand, [picture])
                except Unfittable as error:
                    problems, reason = error.problems, True
                else:
                    problems, reason = found.problems, not found.converged
                    if not problems:
                        far += found_in(hand, one.truth, found).scaled > 0.010
                first = sorted(problems, key=lambda problem: not problem.fatal)[:1]
                for problem in first:
                    kinds[problem.kind] = kinds.get(problem.kind, 0) + 1
                fatal, doubted, silent = fatal + reason, doubted + (bool(first) and not reason), silent + (not first)
            told = ", ".join(f"{kind} {count}" for kind, count in sorted(kinds.items(), key=lambda one: -one[1]))
            print(f"{name:26}{given:26}{fatal:5}{doubted:5}{silent:5}  far {far}  {told}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.fitting_captures", description=__doc__)
    parser.add_argument("what", choices=["alone", "together", "told"])
    parser.add_argument("capture", choices=list(SEGMENTS))
    parser.add_argument("--size", default="quick")
    parser.add_argument("--each", type=int, default=4, help="pictures of each person, if not all (default: 4)")
    parser.add_argument("--wrong", nargs="*", choices=list(SPOILS), default=list(SPOILS), help="what is spoiled")
    arguments = parser.parse_args()
    match arguments.what:
        case "alone":
            alone(arguments.capture, arguments.size, arguments.each)
        case "together":
            together(arguments.capture, arguments.size)
        case "told":
            told(arguments.capture, arguments.size, arguments.each, arguments.wrong)


if __name__ == "__main__":
    main()
