"""What a protocol says, as values: which frames train, enrol and are scored, and how they are chosen.

`handbench.protocols` reads these values from TOML; `resolve` applies them to the frames of a capture.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from fnmatch import fnmatchcase
from functools import cached_property
from itertools import combinations
from typing import Any, Literal, assert_never

import numpy as np

from ..errors import InputError
from ..recording import PARTS, Need, Part, offered
from ..scene import Array, Directional, Environment, Frame, Light, Point, Single, Unknown, kind_of, leaves

# What a scored frame can have in common with training; a column declares in `shares` what it shares on purpose.
AXES = ("subject", "pose", "light")
# How reports average, the only order there is: over a subject's queries, over subjects, over seeds.
AGGREGATION = ("query", "subject", "seed")


@dataclass(frozen=True)
class Selection:
    """Frames by glob patterns; a frame is selected if every field has a pattern that fits it."""

    segments: tuple[str, ...] = ("*",)
    kinds: tuple[str, ...] = ("*",)
    lightings: tuple[str, ...] = ("*",)
    poses: tuple[str, ...] = ("*",)
    cameras: tuple[str, ...] = ("*",)

    def selects(self, frame: Frame) -> bool:
        fields = (
            (self.segments, frame.segment),
            (self.kinds, frame.kind),
            (self.lightings, frame.lighting),
            (self.poses, frame.pose_name),
            (self.cameras, frame.camera.name),
        )
        return all(any(fnmatchcase(value, pattern) for pattern in patterns) for patterns, value in fields)


PerIdentity = Literal["train", "enrol"]
ColumnLight = Literal["given", "as enrolled"]


@dataclass(frozen=True)
class Enrolment:
    """What a method sees of a subject when it personalises.

    count           at most so many frames of each subject, chosen by `sample`; None takes all
    gives           what it sees of these frames
    per_identity    what a method without a universal prior sees: "train" adds the subject's training frames to the
                    others, of which it sees the same; "enrol" adds nothing
    """

    frames: Selection
    count: int | None = None
    gives: frozenset[Part] = PARTS
    per_identity: PerIdentity = "train"

    @property
    def said(self) -> dict[str, Any]:
        """All of it as JSON values; what is as it is by default is left out, so that it changes no digest."""
        rest = {"count": self.count, "gives": sorted(self.gives), "per_identity": self.per_identity}
        usual = {"count": None, "gives": sorted(PARTS), "per_identity": "train"}
        return asdict(self.frames) | {name: value for name, value in rest.items() if value != usual[name]}


@dataclass(frozen=True)
class Column:
    """A group of scored frames that answers one question; `limit` caps how many, None scores all.

    `subjects` is "trained", "unseen", or names of subjects of one of these groups. `light` "as enrolled" asks for
    frames under the one light that enrolment shows the subject in, of which a query tells nothing. `maps` are lights of
    the user's (`data.lights`), under which the column shows the viewpoints of its frames: of these there is no truth.
    """

    name: str
    title: str
    subjects: str | tuple[str, ...]
    frames: Selection
    shares: tuple[str, ...] = ()
    limit: int | None = None
    light: ColumnLight = "given"
    maps: tuple[str, ...] = ()

    @property
    def said(self) -> dict[str, Any]:
        """What of it decides a score, as JSON values, maps by their content; the usual light and no maps are left out,
        so that they change no digest."""
        from ..data.lights import NamedLight

        said = {**asdict(self), "title": None, "maps": [NamedLight.parse(text).digest for text in self.maps]}
        usual = {"light": "given", "maps": []}
        return {name: value for name, value in said.items() if name not in usual or value != usual[name]}


@dataclass(frozen=True)
class Published:
    """Numbers that a paper prints for a method: a row beside the measured ones, never ranked with them.

    `marker` is the paper's own mark of the row, or ""; `values` holds (column, metric, value) as the protocol
    names columns and metrics; `method` need not be registered.
    """

    method: str
    title: str
    marker: str
    source: str
    values: tuple[tuple[str, str, float], ...]


@dataclass(frozen=True)
class Protocol:
    """A protocol as its TOML file says it. `presets` maps methods, or patterns of them, to their presets,
    `preset` serves the others. `trains_on` is name and size of the capture whose subjects are `trained`, None for the
    capture that is scored. `part` says what of a whole protocol this is (`narrowing`), "" if it is one."""

    name: str
    version: int
    title: str
    summary: str
    capture: str
    size: str
    trained: tuple[str, ...]
    unseen: tuple[str, ...]
    train: Selection
    enrol: Enrolment
    columns: tuple[Column, ...]
    metrics: tuple[str, ...]
    methods: tuple[str, ...]
    aggregation: tuple[str, ...]
    seeds: tuple[int, ...] = (0,)
    preset: str = "quick"
    presets: tuple[tuple[str, str], ...] = ()
    sample_seed: int = 0
    published: tuple[Published, ...] = ()
    published_note: str = ""
    trains_on: tuple[str, str] | None = None
    part: str = ""

    @property
    def label(self) -> str:
        return f"{self.name}@{self.version}"

    @property
    def subjects(self) -> tuple[str, ...]:
        """The subjects that some column scores, in the order of the protocol."""
        used = {subject for column in self.columns for subject in self.subjects_of(column)}
        return tuple(subject for subject in (*self.trained, *self.unseen) if subject in used)

    def subjects_of(self, column: Column) -> tuple[str, ...]:
        if isinstance(column.subjects, tuple):
            return column.subjects
        return self.trained if column.subjects == "trained" else self.unseen

    def preset_of(self, method: str) -> str:
        """The preset named for a method, or for the first pattern ("urhand-*") that fits it."""
        named = dict(self.presets)
        fitting = (preset for pattern, preset in self.presets if fnmatchcase(method, pattern))
        return named.get(method) or next(fitting, self.preset)

    @cached_property
    def training_digest(self) -> str:
        """Digest of what decides a prior: the training frames alone."""
        return digest([*(self.trains_on or (self.capture, self.size)), self.trained, asdict(self.train)])

    @cached_property
    def drawing_digest(self) -> str:
        """Digest of what decides pictures beside the training: enrolment and scored frames."""
        return digest([self.training_digest, *self._frames, self.sample_seed, self.capture, self.size])

    @cached_property
    def digest(self) -> str:
        """Digest of everything that decides a score: not titles, default methods, seeds, presets, published numbers."""
        said = [self.name, self.version, self.training_digest, *self._frames]
        scored = [] if self.trains_on is None else [self.capture, self.size]
        return digest([*said, self.metrics, self.sample_seed, *scored])

    @property
    def _frames(self) -> list[Any]:
        """What chooses the frames that are enrolled and scored."""
        return [self.unseen, self.enrol.said, [column.said for column in self.columns]]


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


def digest(content: Any) -> str:
    """Hex SHA-256 of a JSON value."""
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


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


def sample(frames: Iterable[Frame], limit: int | None, seed: int) -> tuple[Frame, ...]:
    """At most `limit` frames, spread evenly over subject, pose, camera and light and over every pair of them.

    Greedy: always take the frame whose values were taken least; ties are broken by a seeded shuffle, so the
    choice does not depend on the order of `frames`. Returned in the order of their keys.
    """
    ordered = sorted(frames, key=lambda frame: frame.key)
    if limit is None or len(ordered) <= limit:
        return tuple(ordered)
    order = np.random.default_rng(seed).permutation(len(ordered))
    values = [(f.subject, f.pose_name, f.camera.name, f.lighting) for f in (ordered[i] for i in order)]
    axes = [(i,) for i in range(4)] + list(combinations(range(4), 2))
    codes = []  # per axis and per pair of axes: the value of each frame as an integer
    for axis in axes:
        keys = [tuple(value[i] for i in axis) for value in values]
        names = {key: code for code, key in enumerate(dict.fromkeys(keys))}
        codes.append(np.array([names[key] for key in keys]))
    # A value's count is weighed by how many values its axis has: what is taken against its fair share. Single axes
    # come first, pairs decide between equals.
    weights = [len(np.unique(code)) * (100 if i < 4 else 1) for i, code in enumerate(codes)]
    taken = [np.zeros(code.max() + 1) for code in codes]
    left = np.zeros(len(values))
    chosen: list[int] = []
    for _ in range(limit):
        cost = left + sum(w * count[code] for w, code, count in zip(weights, codes, taken, strict=True))
        best = int(np.argmin(cost))
        chosen.append(int(order[best]))
        left[best] = np.inf
        for code, count in zip(codes, taken, strict=True):
            count[code[best]] += 1
    return tuple(ordered[i] for i in sorted(chosen))
