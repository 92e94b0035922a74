"""Every method's own error against time: fewer lights, smaller maps, skips, against its own full picture.

Methods are trained on the capture that ships with handbench at its `smoke` protocol, for seconds: what is measured
is the cost of drawing, which does not depend on how good the weights are.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from dataclasses import is_dataclass, replace
from functools import partial
from typing import Any, Literal, TypeAlias

import numpy as np

from ...bench import given
from ...bench.failure import failure
from ...bench.isolation import isolated
from ...bench.lending import Lender
from ...bench.protocol import Protocol
from ...bench.reader import CaptureReader
from ...bench.resolving import Selected, resolve
from ...bench.run import find_protocol
from ...data.capture import open_capture
from ...light.environment import rotate
from ...light.reduction import reduced
from ...method import Avatar, Prior
from ...recording import Recording
from ...registry import METHODS
from ...scene import Directional, Environment, Frame, Group, Light, Query, needed
from ...skips import NONE, Skips, skipping
from .measure import Trial, timed
from .record import MethodStudy, PoseCurve
from .scene import moved
from .truth import relative_rmse

PROTOCOL = "smoke"
_LIGHTS = (8, 32, 128)
_FULL = Skips()
_TURN = 0.7  # radians between the lights of a known pose

Lit: TypeAlias = Callable[[Light], Light]


def protocol() -> Protocol:
    """The protocol whose methods' presets, frames and capture are used."""
    return find_protocol(PROTOCOL)


def study(name: str, quick: bool) -> MethodStudy:
    """A method's points, or the reason why there are none. It is lent copies of the capture's arrays, as in a run.

    Raises `InputError` for an unknown method. New poses and known ones have a curve each.
    """
    tried = protocol()
    method = METHODS.load(name)(preset=tried.preset_of(name))
    found = MethodStudy(name, method.info.title)
    if method.info.truth:
        return replace(found, reason="a calibration row: it reads its answers")
    capture = open_capture(tried.capture, tried.size)
    reader, lender = CaptureReader(capture), Lender()
    try:
        with isolated():
            selected = lender.lend(resolve(tried, capture.frames(), capture.offers), name)
            frame = _environment_frame(selected)
            prior = method.train(given.training(selected, reader), seed=0)
            enrolment = given.enrolment(selected, method.info, frame.subject, reader)
            curves = _curves(prior, enrolment, given.asked(selected, method.info, frame), quick)
        lender.check()
    except (Exception, SystemExit) as error:  # a method's error is its own row's reason, not the study's end
        return replace(found, reason=failure(error).reason)
    return replace(found, query=frame.key, curves=curves)


def _environment_frame(selected: Selected) -> Frame:
    return next(f for frames in selected.scored.values() for f in frames if f.kind == "environment")


def _curves(prior: Prior, enrolment: Recording, query: Query, quick: bool) -> tuple[PoseCurve, ...]:
    avatar = prior.personalise(enrolment)
    with skipping(NONE):  # an avatar of its own: what one keeps fits the skips it was kept under
        without = prior.personalise(enrolment)
        expected = without.relight(query).image.astype(np.float64)
    kinds: dict[Literal["new", "known"], list[Trial]] = {"new": [], "known": []}
    repeats = 2 if quick else 5

    def add(knob: str, label: str, one: Avatar, lit: Lit = lambda light: light, skips: Skips = _FULL) -> None:
        def new(step: int) -> Query:
            mesh = moved(needed(query.mesh, "mesh"), step + 1)
            return replace(query, mesh=mesh, light=lit(query.light))

        with skipping(skips):
            seconds, images = timed(new, lambda q: one.relight(q).image, repeats)
            kinds["new"].append(Trial(knob, label, relative_rmse(images[-1], expected), seconds))
            posed = one.pose(query.viewpoint)
            seconds, _ = timed(lambda step: lit(_turned(query.light, step)), posed.relight, repeats)
            image = posed.relight(lit(query.light)).image
            kinds["known"].append(Trial(knob, label, relative_rmse(image, expected), seconds))

    add("default", "as it is", avatar)
    add("skips", "no skips", without, skips=NONE)
    if isinstance(query.light, Environment):
        for count in _LIGHTS[1:2] if quick else _LIGHTS:
            add("lights", f"{count} lights", avatar, partial(_few, count=count))
    for field, label, value in [] if quick else _settings(prior):
        add(field, label, with_setting(prior, field, value).personalise(enrolment))
    return tuple(PoseCurve(pose, tuple(points)) for pose, points in kinds.items())


def _turned(light: Light, step: int) -> Light:
    """A light that a known pose has not seen: an environment is turned, another light is made brighter."""
    if isinstance(light, Environment):
        return rotate(light, _TURN * step)
    return light.scaled(1.0 + step)


def _few(light: Light, count: int) -> Light:
    """An environment as a group of few lights."""
    assert isinstance(light, Environment)
    return Group(tuple(Directional(d, e) for d, e in zip(*reduced(light, count), strict=True)))


def _settings(prior: Prior) -> list[tuple[str, str, Any]]:
    """Settings of a prior's configuration that its weights do not depend on."""
    config = _config(prior)
    found: list[tuple[str, str, Any]] = []
    if hasattr(config, "texture") and _weightless(prior):
        found += [("texture", f"{side}^2 texels", side) for side in (config.texture // 2, config.texture * 2)]
    # a network that takes the map itself is made for one size of it
    if hasattr(config, "environment") and getattr(config, "encoder", None) != "environment":
        rows, columns = config.environment
        found += [("environment", f"{rows // 2}x{columns // 2} map", (rows // 2, columns // 2))]
    return found


def _config(prior: Prior) -> Any:
    owner = _owner(prior)
    return None if owner is None else owner.config


def _owner(prior: Prior) -> Any:
    """The prior, or the network in it, whichever holds the configuration."""
    for one in (prior, getattr(prior, "model", None)):
        if is_dataclass(getattr(one, "config", None)):
            return one
    return None


def _weightless(prior: Prior) -> bool:
    """Whether a prior holds its configuration itself, as those do that have no network trained at one size."""
    return _owner(prior) is prior


def with_setting(prior: Prior, field: str, value: Any) -> Prior:
    """A prior that shares its weights but differs in one setting."""
    changed: Any = copy(prior)
    if _owner(prior) is prior:
        changed.config = replace(changed.config, **{field: value})
        return changed
    changed.model = copy(changed.model)
    changed.model.config = replace(changed.model.config, **{field: value})
    return changed
