"""The one interface of every relighting method, and the laws `handbench check` holds it to.

    Method.train(recording, seed)   -> Prior          what all subjects teach (universal methods work here)
    Prior.personalise(enrolment)    -> Avatar         what one subject's enrolment adds
    Avatar.pose(viewpoint)          -> PosedAvatar    what a pose and a camera add
    PosedAvatar.relight(light)      -> Prediction     a picture

A method whose avatars can be kept also has Avatar.save(folder), and Prior.restore(folder) -> Avatar.

What a method keeps from one light to the next is in the PosedAvatar, which the caller holds for as long as it asks
for that pose and camera: no method needs a cache of its own.

Laws
    no mutation     a call changes neither its arguments nor a later answer of the same call
    no memory       a new PosedAvatar of the same viewpoint answers as one that drew other lights before
    same seed       training twice with one seed gives the same prior on one machine
    round trip      load(save(prior)) answers as the prior does, and restore(save(avatar)) as the avatar, if it is kept
    linear          if declared: relight(a L1 + b L2) = a relight(L1) + b relight(L2)
    finite          an answer is finite, or the call raises `NonFinite` or `Unsupported`
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal, Protocol, final, get_args

from .errors import InputError, Unsupported, unknown_name
from .recording import NEEDS, Need, Recording
from .scene import LIGHT_KINDS, Baked, Camera, Light, LightKind, Pose, Prediction, Query, Viewpoint


class Progress(Protocol):
    """Told how far a long computation is: `progress(step, total, loss=…)`."""

    def __call__(self, step: int, total: int, **values: float) -> None: ...


def silent(step: int, total: int, **values: float) -> None:
    """A `Progress` that says nothing."""


Role = Literal["method", "calibration"]


@dataclass(frozen=True)
class MethodInfo:
    """What the harness and the reader must know of a method.

    universal   one prior serves every subject (False: `train` only prepares, the work is in `personalise`, and the
                protocol says whether that sees the subject's training frames)
    linear      the method obeys the linear law
    role        "calibration" for a row that tells whether a run is right and competes with none: the truth, the floor
    truth       the enrolment must hold the scored frames themselves; only a calibration row may ask for that
    needs       what enrolment must give and queries bring along: parts and kinds of frames; a cell that lacks one is
                refused before anything trains
    trains_on   the same of the training frames
    lights      the kinds of light it can draw: of "directional", "point", "environment", "unknown"
    fidelity    how a table must describe it, e.g. "faithful reimplementation, trained here"
    timed       its answers are computed when it is asked (False: they were made elsewhere, so no time is told)
    """

    name: str
    title: str
    summary: str
    universal: bool = False
    linear: bool = False
    role: Role = "method"
    truth: bool = False
    needs: frozenset[Need] = frozenset()
    trains_on: frozenset[Need] = frozenset()
    lights: frozenset[LightKind] = frozenset({"directional", "environment"})
    fidelity: str = "reference"
    timed: bool = True

    def __post_init__(self) -> None:
        if odd := sorted(set(self.lights) - LIGHT_KINDS):
            raise InputError(f"method {self.name!r}: lights holds {odd[0]!r}; use {', '.join(sorted(LIGHT_KINDS))}")
        if strange := sorted((self.needs | self.trains_on) - NEEDS):
            raise unknown_name(f"need of method {self.name!r}:", strange[0], NEEDS)
        if self.role not in get_args(Role):
            raise InputError(f"method {self.name!r}: role is {self.role!r}; use one of {', '.join(get_args(Role))}")
        if self.truth and self.role != "calibration":
            raise InputError(f'method {self.name!r}: it is given the scored frames; set its role to "calibration"')

    @property
    def said(self) -> dict[str, Any]:
        """All of it as JSON values."""
        return {name: sorted(v) if isinstance(v, frozenset) else v for name, v in asdict(self).items()}

    @classmethod
    def of(cls, said: dict[str, Any]) -> MethodInfo:
        """What `said` gave."""
        sets = {name: frozenset(said[name]) for name in ("lights", "needs", "trains_on")}
        return cls(**{**said, **sets})


class PosedAvatar(ABC):
    """A subject in one pose, seen by one camera, ready for any light."""

    @abstractmethod
    def relight(self, light: Light) -> Prediction:
        """Draw the hand under a light; the picture has the camera's size.

        Asked again with the same light it gives the same picture, whatever it drew in between. What is worked out
        for one light may be kept for the next. Raises `Unsupported` for a light outside the method's abilities.
        """

    def seen_by(self, camera: Camera) -> PosedAvatar:
        """The same pose before another camera: what does not depend on the camera is shared, not worked out again.

        Raises `Unsupported` for a method that has to pose anew, which `Avatar.pose` always can.
        """
        raise Unsupported(f"a {type(self).__name__} is posed anew for another camera")


class Avatar(ABC):
    """One subject, ready to be posed."""

    @abstractmethod
    def pose(self, viewpoint: Viewpoint) -> PosedAvatar:
        """The subject in a pose, before a camera: all that does not depend on the light is worked out here.

        Raises `Unsupported` for a pose or a camera outside the method's abilities.
        """

    def relight(self, query: Query) -> Prediction:
        """Draw one query: `pose`, then `PosedAvatar.relight`. Only a `RecordedAvatar` answers otherwise."""
        return self.pose(query.viewpoint).relight(query.light)

    def save(self, folder: Path) -> None:
        """Write everything `Prior.restore` needs into an existing empty folder, nothing of it a pickle.

        Raises `Unsupported` for a method whose avatars cannot be kept.
        """
        raise Unsupported(f"a {type(self).__name__} cannot be kept; show it from its run, or personalise it anew")

    def baked(self, viewpoint: Viewpoint) -> Baked:
        """The posed surface with its reflectance as textures, for renderers elsewhere; the camera plays no part.

        Raises `Unsupported` for a method whose look is no reflectance, or one that such textures cannot hold.
        """
        raise Unsupported(f"a {type(self).__name__} has no reflectance that can be baked into textures")

    @property
    def found(self) -> Mapping[str, Pose]:
        """The poses in which personalisation found the hand, by `Frame.pose_key`; none for methods that fit no hand."""
        return {}


class RecordedAvatar(Avatar):
    """A subject whose pictures were made elsewhere and are looked up by the names of queries, not drawn."""

    @abstractmethod
    def relight(self, query: Query) -> Prediction:
        """The picture of a query. Raises `Unsupported` if there is none."""

    @final
    def pose(self, viewpoint: Viewpoint) -> PosedAvatar:
        """Raises `Unsupported`: there are pictures of whole queries only."""
        raise Unsupported(f"{viewpoint.key} cannot be posed: recorded pictures are looked up by their queries")


class Prior(ABC):
    """What a method learned from all training subjects."""

    @abstractmethod
    def personalise(self, enrolment: Recording, seed: int = 0, progress: Progress = silent) -> Avatar:
        """The avatar of the enrolment's one subject; what is trained here tells `progress`.

        Raises `Unsupported` if the enrolment lacks what it needs.
        """

    @abstractmethod
    def save(self, folder: Path) -> None:
        """Write everything `Method.load` needs into an existing empty folder."""

    def restore(self, folder: Path) -> Avatar:
        """The avatar that `Avatar.save` wrote. Raises `InputError` for a damaged folder, or one of another method."""
        raise Unsupported(f"avatars of a {type(self).__name__} cannot be kept")


class Method(ABC):
    """A relighting method with its configuration."""

    info: MethodInfo

    @property
    @abstractmethod
    def config(self) -> dict[str, Any]:
        """Every setting that can change a result, as JSON values."""

    @abstractmethod
    def train(self, recording: Recording, seed: int = 0, progress: Progress = silent) -> Prior:
        """Learn from the training frames. Budgets are steps, never seconds, so a run repeats."""

    @abstractmethod
    def load(self, folder: Path) -> Prior:
        """The prior that `Prior.save` wrote. Raises `InputError` for a folder of another method or version."""
