"""A protocol applied to a capture: the frames it trains on, enrols and scores, and whether they are kept apart."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, assert_never

import numpy as np

from ..errors import InputError
from ..recording import Need, offered
from ..scene import Array, Directional, Environment, Frame, Light, Point, Single, Unknown, kind_of, leaves
from .protocol import AXES, Column, Protocol
from .sampling import sample


@dataclass(frozen=True)
class Selected:
    """A protocol applied to a capture: frames of training, of enrolment, and scored ones by column name.

    They are whole; `bench.given` says what a method sees of them. `offers` is what the capture has, `teaches` what that
    has which is trained on.
    """

    protocol: Protocol
    train: tuple[Frame, ...]
    enrol: tuple[Frame, ...]
    scored: dict[str, tuple[Frame, ...]]
    offers: frozenset[Need] = frozenset()
    teaches: frozenset[Need] = frozenset()

    @cached_property
    def as_enrolled(self) -> frozenset[str]:
        """Keys of the scored frames that are asked for under the light as enrolled."""
        return self._of(lambda column: column.light == "as enrolled")

    @cached_property
    def without_truth(self) -> frozenset[str]:
        """Keys of the frames under maps of the user's: they are drawn and shown, and there is nothing to score with."""
        return self._of(lambda column: bool(column.maps))

    def _of(self, chosen: Callable[[Column], bool]) -> frozenset[str]:
        names = {column.name for column in self.protocol.columns if chosen(column)}
        return frozenset(frame.key for name, frames in self.scored.items() if name in names for frame in frames)


def resolve(
    protocol: Protocol,
    frames: Iterable[Frame],
    offers: frozenset[Need] | None = None,
    teaches: frozenset[Need] | None = None,
) -> Selected:
    """Choose the frames a protocol names; `offers` is what their capture has, None for what the frames tell.

    `teaches` is the same of the capture that is trained on, None for the same one.

    Raises `InputError` for a subject the capture lacks, a selection without frames, a subject that cannot be
    enrolled, and a column that has in common with training what it does not declare in `shares`. Lights are
    compared one by one, by direction, position or environment, in enrolment too, so no group hides one.
    """
    frames = tuple(frames)
    owner = f"protocol {protocol.label}"
    present = {frame.subject for frame in frames}
    for subject in (*protocol.trained, *protocol.unseen):
        if subject not in present:
            raise InputError(f"{owner}: the capture has no subject {subject!r}; it has {', '.join(sorted(present))}")
    train = tuple(f for f in frames if f.subject in protocol.trained and protocol.train.selects(f))
    if not train:
        raise InputError(f"{owner}: [train] selects no frame of the capture; check its segments, kinds and lightings")
    enrol = _enrolled(owner, protocol, frames)
    scored = {}
    for column in protocol.columns:
        subjects = protocol.subjects_of(column)
        chosen = tuple(frame for frame in frames if frame.subject in subjects and column.frames.selects(frame))
        if not chosen:
            raise InputError(f"{owner}: column {column.name!r} selects no frame; check its segments and lightings")
        if column.maps:
            chosen = _under_maps(f"{owner}: column {column.name!r}", column.maps, chosen)
        _check_sharing(owner, column, chosen, train, enrol)
        if column.light == "as enrolled":
            _check_enrolled_light(owner, column, chosen, enrol)
        scored[column.name] = sample(chosen, column.limit, protocol.sample_seed)
    has = offered(frames) if offers is None else offers
    selected = Selected(protocol, train, enrol, scored, has, has if teaches is None else teaches)
    for column in protocol.columns:
        both = [f.key for f in scored[column.name] if column.light == "given" and f.key in selected.as_enrolled]
        if both:
            raise InputError(
                f"{owner}: column {column.name!r} gives the light of {both[0]}, which another column asks for "
                "under the light as enrolled; select other frames in one of them"
            )
    return selected


def _under_maps(owner: str, maps: Sequence[str], frames: Iterable[Frame]) -> tuple[Frame, ...]:
    """The viewpoints of frames, each under every map. Raises `InputError` for two maps of one name."""
    from ..data.lights import NamedLight

    lights: dict[str, Environment] = {}
    for text in maps:
        light = NamedLight.parse(text)
        name = "map-" + re.sub(r"[^A-Za-z0-9.+-]+", "-", light.label)
        if name in lights:
            raise InputError(f"{owner} has two maps named {name}; rename one of the files")
        lights[name] = light.read()
    views = {frame.viewpoint.key: frame for frame in frames}
    return tuple(
        replace(frame, lighting=name, light=light, kind="environment")
        for frame in views.values()
        for name, light in lights.items()
    )


def _enrolled(owner: str, protocol: Protocol, frames: Sequence[Frame]) -> tuple[Frame, ...]:
    """The frames of enrolment in the order of the capture, at most `count` of each subject."""
    chosen = [f for f in frames if f.subject in protocol.subjects and protocol.enrol.frames.selects(f)]
    kept = set()
    for subject in protocol.subjects:
        of_subject = [frame for frame in chosen if frame.subject == subject]
        if not of_subject:
            raise InputError(f"{owner}: [enrol] selects no frame of subject {subject!r}; check its segments and kinds")
        kept |= {frame.key for frame in sample(of_subject, protocol.enrol.count, protocol.sample_seed)}
    return tuple(frame for frame in chosen if frame.key in kept)


def _check_sharing(
    owner: str, column: Column, scored: Sequence[Frame], train: Sequence[Frame], enrol: Sequence[Frame]
) -> None:
    # Poses belong to a subject ("s01/pose-3"), so an unseen subject shares none.
    common = {
        "subject": {f.subject for f in scored} & {f.subject for f in train},
        "pose": {f.pose_key for f in scored} & {f.pose_key for f in train},
        "light": _common_lights(scored, (*train, *enrol)),
    }
    for axis in AXES:
        if common[axis] and axis not in column.shares:
            examples = ", ".join(sorted(common[axis])[:3])
            raise InputError(
                f"{owner}: column {column.name!r} scores a {axis} that training saw ({examples}); "
                f"select others, or add {axis!r} to its shares if that is meant"
            )
    seen = {(f.pose_key, f.lighting) for f in enrol}
    again = sorted(f"{f.pose_key} under {f.lighting}" for f in scored if (f.pose_key, f.lighting) in seen)
    if again and set(column.shares) != set(AXES):
        raise InputError(f"{owner}: column {column.name!r} scores {again[0]}, which enrolment shows; select others")


def _check_enrolled_light(owner: str, column: Column, scored: Sequence[Frame], enrol: Sequence[Frame]) -> None:
    for subject in dict.fromkeys(frame.subject for frame in scored):
        shown = sorted({frame.lighting for frame in enrol if frame.subject == subject})
        if len(shown) > 1:
            raise InputError(
                f"{owner}: column {column.name!r} asks for the light as enrolled, but enrolment shows {subject} under "
                f"{', '.join(shown[:3])}; select one lighting in [enrol]"
            )
        odd = sorted({frame.lighting for frame in scored if frame.subject == subject} - set(shown))
        if odd:
            raise InputError(
                f"{owner}: column {column.name!r} asks for the light as enrolled and selects {odd[0]}, but enrolment "
                f"shows {subject} under {shown[0]}; select that lighting"
            )


def _common_lights(scored: Iterable[Frame], seen: Iterable[Frame]) -> set[str]:
    """The scored lightings with a single light that `seen` frames show too, whatever group it is in there."""
    shown = {single: name for name, light in _lightings(seen) for single in _singles(light)}
    common = set()
    for name, light in _lightings(scored):
        for single in _singles(light):
            if single in shown:
                common.add(name if shown[single] == name else f"{name} has a light of {shown[single]}")
    return common


def _lightings(frames: Iterable[Frame]) -> list[tuple[str, Light]]:
    """Each light once: frames share them by the thousand."""
    return list({id(frame.light): (frame.lighting, frame.light) for frame in frames}.values())


def _singles(light: Light) -> set[tuple[Any, ...]]:
    """What tells the single lights of a light apart, whatever their brightness."""

    def place(vector: Array) -> tuple[float, ...]:
        return tuple((np.round(vector, 5) + 0.0).tolist())  # + 0.0: no negative zero

    def told(single: Single) -> tuple[Any, ...]:
        match single:
            case Directional():
                return ("direction", *place(single.direction))
            case Point():
                return ("position", *place(single.position))
            case Environment() | Unknown():
                return (kind_of(single), single.name)
            case _:
                assert_never(single)

    return {told(single) for single in leaves(light)}
