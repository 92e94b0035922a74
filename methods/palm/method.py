"""PALM-Net (2025) behind the one interface: a prior of many people, a person out of one picture, relit in new poses."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from handbench.errors import Unsupported
from handbench.hand import hand_model
from handbench.light.gaussians import SphericalGaussians
from handbench.method import Avatar, Method, MethodInfo, PosedAvatar, Prior, Progress, Recording, silent
from handbench.scene import LIGHT_KINDS, Pose, Viewpoint
from handbench.settings import UNCHANGED, Changes, changed

from ..kit.enrolled import enrolled
from ..kit.weights import load_state, save_state
from .drawing import PosedPalm
from .model import LatentCodes, PalmModel
from .person import Person
from .personalise import personalised
from .settings import ABLATIONS, PalmSettings, settings
from .training import trained

NAME = "palm-net"

INFO = MethodInfo(
    name=NAME,
    title="PALM-Net",
    summary="implicit surface and reflectance of many people; codes, pose and light of one picture by fixed networks",
    universal=True,
    linear=True,
    needs=frozenset({"image", "alpha", "camera", "keypoints"}),
    trains_on=frozenset({"image", "alpha", "camera", "pose"}),
    lights=LIGHT_KINDS,
    fidelity="reimplementation from a summary of the paper and its code on another hand model, trained here",
)


class PalmAvatar(Avatar):
    """A person as personalisation found them, and the pose that their hand was found in: none of a kept avatar."""

    def __init__(self, name: str, chosen: PalmSettings, person: Person, found: Mapping[str, Pose]) -> None:
        self.person, self._found = person, found
        self._name, self._settings = name, chosen

    def pose(self, viewpoint: Viewpoint) -> PosedAvatar:
        return PosedPalm.of(self.person, viewpoint, self._settings.drawing)

    @property
    def found(self) -> Mapping[str, Pose]:
        return self._found

    def save(self, folder: Path) -> None:
        """Codes, shape and light; the networks are the prior's, and pictures of the person are not kept."""
        person = self.person
        state = {"shape": person.shape, "phi": person.codes.geometry, "psi": person.codes.appearance}
        state |= {name: getattr(person.light, name) for name in _LIGHT}
        save_state(folder, self._name, _kept(self._settings), {name: part.detach() for name, part in state.items()})


_LIGHT = ("axes", "sharpness", "amplitude")


def _kept(chosen: PalmSettings) -> dict[str, Any]:
    """What a kept prior and its avatars belong to."""
    return {"prior": asdict(chosen.prior), "hand": hand_model().name}


class PalmPrior(Prior):
    """Networks, codes of the training's people, and the studio's light."""

    def __init__(self, name: str, chosen: PalmSettings, model: PalmModel) -> None:
        self.model = model.requires_grad_(False)
        self._name, self._settings = name, chosen

    def personalise(self, enrolment: Recording, seed: int = 0, progress: Progress = silent) -> Avatar:
        """Fits the hand model (`hand.fitting`), then codes, pose and light, to the first picture.

        Raises `Unsupported` with the fit's reason if no hand is found there, for a hand smaller than a patch, and for
        poses of another hand model than the prior's.
        """
        hand = enrolled(enrolment, 1)
        if hand.hand.name != self.model.hand.name:
            raise Unsupported(
                f"the poses of the enrolment are of the hand model {hand.hand.name!r}, and the prior was trained with "
                f"{self.model.hand.name!r}; train it on hands of that model"
            )
        form = self._settings.drawing.gathering.form
        person = personalised(self.model, hand, self._settings.fit, form, seed, progress)
        return PalmAvatar(self._name, self._settings, person, hand.found)

    def save(self, folder: Path) -> None:
        save_state(folder, self._name, _kept(self._settings), self.model.state_dict())

    def restore(self, folder: Path) -> Avatar:
        """The avatar that was kept; its networks are this prior's."""
        prior, hand = self._settings.prior, hand_model()
        shapes: dict[str, tuple[int | None, ...]] = {
            "shape": (hand.shape_size,),
            "phi": (prior.phi,),
            "psi": (prior.psi,),
        }
        shapes |= {"axes": (None, 3), "sharpness": (None,), "amplitude": (None, 3)}
        state = load_state(folder, self._name, _kept(self._settings), shapes)
        light = SphericalGaussians(*(state[name] for name in _LIGHT))
        codes = LatentCodes(state["phi"], state["psi"])
        return PalmAvatar(self._name, self._settings, Person(self.model, codes, state["shape"], light), {})


class Palm(Method):
    """PALM-Net at a preset, or one of its ablations."""

    def __init__(self, preset: str, ablation: str | None = None, changes: Changes = UNCHANGED) -> None:
        name = NAME if ablation is None else f"{NAME}-{ablation}"
        self._settings = chosen = changed(settings(preset, ablation), changes, name)
        self.info = replace(INFO, linear=chosen.drawing.gathering.maps == "lights")
        if ablation is not None:
            about = ABLATIONS[ablation]
            self.info = replace(self.info, name=name, title=about.title, summary=about.summary)

    @property
    def config(self) -> dict[str, Any]:
        return asdict(self._settings)

    def train(self, recording: Recording, seed: int = 0, progress: Progress = silent) -> Prior:
        """Learns of scans of many people in the light of one studio."""
        model = trained(self._settings.prior, hand_model(), recording, seed, progress)
        return PalmPrior(self.info.name, self._settings, model)

    def load(self, folder: Path) -> Prior:
        state = load_state(folder, self.info.name, _kept(self._settings))
        model = PalmModel(self._settings.prior, hand_model(), len(state["phi"]))
        model.load_state_dict(state)
        return PalmPrior(self.info.name, self._settings, model)
