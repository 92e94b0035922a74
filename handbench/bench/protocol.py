"""What a protocol says, as values: which frames train, enrol and are scored, and how they are chosen.

`handbench.protocols` reads these values from TOML; `resolving` applies them to the frames of a capture.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass
from fnmatch import fnmatchcase
from functools import cached_property
from typing import Any, Literal

from ..recording import PARTS, Part
from ..scene import Frame

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


def digest(content: Any) -> str:
    """Hex SHA-256 of a JSON value."""
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()
