"""Every registered method at its smallest preset on the shipped capture, asked for what it was not trained for.

The law all obey: an answer is finite, or the call raises `NonFinite` or `Unsupported`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import cache, partial
from typing import Any

import numpy as np
from scipy.ndimage import minimum_filter

from ...errors import HandbenchError, InputError, NonFinite, Unsupported
from ...hand import hand_of
from ...light.stage import stage_directions
from ...method import Recording
from ...registry import METHODS
from ...scene import Array, Camera, Directional, Environment, Group, Light, Mesh, Observation, Point, Query, needed
from .case import Case
from .judgement import Expected, TruthPair, equal, finite, finite_or, or_refused, refused
from .scenes import WHITE, camera, crumpled, flipped, moved, pointlike, torn, unit
from .trained import damaged, lacking, poisoned, smallest, trained_method

LIMIT = 90.0
"""Seconds: the first case of a method trains it."""

LAWFUL = (NonFinite, Unsupported)


def cases(methods: Sequence[str] | None = None) -> Iterator[Case]:
    """The cases of the named methods, or of all registered ones.

    Methods of the same code as an earlier one (ablations of it) get the few cases of `ESSENTIAL`.
    """
    entries = METHODS.entries()
    known: set[str] = set()
    for name in entries if methods is None else methods:
        target = entries[name].target
        yield from (case for case in _of_method(name) if target not in known or case.name in ESSENTIAL)
        known.add(target)


ESSENTIAL = (
    *("can be loaded", "trains and draws", "environment with one hot texel", "light 1e+08 times as strong"),
    *("degenerate triangles", "hand out of the picture", "NaN in all weights"),
)


def _of_method(name: str) -> Iterator[Case]:
    family = f"methods/{name}"

    def case(label: str, expected: Expected, run: Callable[..., Any], *arguments: Any, reference: str = "") -> Case:
        return Case(family, label, expected, partial(run, name, *arguments), reference, LIMIT)

    yield case("can be loaded", finite(), lambda name: len(smallest(name).info.lights))
    try:
        info = smallest(name).info
    except HandbenchError:
        return  # the case above tells
    if lacking(info):
        yield case("a capture without what it needs", refused(Unsupported), _relit, lambda query: query)
        return
    yield case("trains and draws", finite(), _relit, lambda query: query)
    yield case("no training frames", finite_or(Unsupported, InputError), _trained_on_nothing)
    yield case("no enrolment frames", finite_or(Unsupported, InputError), _enrolled, lambda _: None)
    yield case("unknown preset", finite_or(InputError), _unknown_preset)
    if info.truth:  # a calibration row answers with recorded frames alone and has no weights
        yield case("a frame that was not recorded", refused(Unsupported), _relit, partial(_under, Group(())))
        return
    for label, light in _lights().items():
        yield case(label, _drawn_or_refused(), _relit, partial(_under, light))
    for label, change in _queries().items():
        yield case(label, _drawn_or_refused(), _relit, change)
    yield case("near light on a vertex", _drawn_or_refused(), _relit, _touching)
    for factor in (1e-8, 1e8):
        same = or_refused(equal(1e-4), Unsupported)
        yield case(f"light {factor:g} times as strong", same, _proportional, factor, reference="the answer, scaled")
    yield case("light beyond float32", finite_or(*LAWFUL), _relit, partial(_under, _strong(1e38)))
    together = or_refused(equal(1e-2), Unsupported)
    yield case("everything 10 m away", together, _shifted, 10.0, reference="where it was")
    yield case("everything 1 km away", together, _shifted, 1000.0, reference="where it was")
    yield case("hand out of the picture", or_refused(equal(), Unsupported), _out_of_picture, reference="zero")
    yield case("all-zero environment", or_refused(equal(), Unsupported), _dark, reference="zero")
    yield case("NaN in all weights", refused(NonFinite, InputError), poisoned, np.nan, True)
    yield case("NaN in one weight a tensor", refused(NonFinite, InputError), poisoned, np.nan, False)
    yield case("infinite weights", refused(NonFinite, InputError), poisoned, np.inf, True)
    yield case("weights of 1e30", finite_or(NonFinite, InputError), poisoned, 1e30, True)
    yield case("weights cut short", refused(InputError), damaged, lambda data: data[: len(data) // 2])
    yield case("weights of random bytes", refused(InputError), damaged, lambda data: bytes(range(256)) * 4)
    yield case("no weights", refused(InputError), damaged, None)
    yield case("enrolment without a hand", finite_or(*LAWFUL), _enrolled, _no_hand)
    yield case("black enrolment", finite_or(*LAWFUL), _enrolled, partial(_exposed, 0.0))
    yield case("enrolment of 1e38", finite_or(*LAWFUL), _enrolled, partial(_exposed, 1e38))
    yield case("enrolment of 16 pixels", finite_or(*LAWFUL), _enrolled, _few_pixels)


def _relit(name: str, change: Callable[[Query], Query]) -> Any:
    trained = trained_method(name)
    return trained.draw(change(trained.query))


def _drawn_or_refused() -> Expected:
    """For what some methods cannot draw by nature; drawing NaN, even declared, would be wrong here."""
    return finite_or(Unsupported)


# -- lights ---------------------------------------------------------------------------------------------------------


def _under(light: Light, query: Query) -> Query:
    return replace(query, light=light, lighting="stress")


def _strong(power: float) -> Light:
    return Directional(unit(np.array([0.3, 0.5, 1.0])), power * WHITE)


@cache
def _lights() -> dict[str, Light]:
    hot = np.full((16, 32, 3), 1e-3)
    hot[6, 11] = 1e8
    rays = stage_directions(10_000)
    return {
        "no light": Group(()),
        "dark light": _strong(0.0),
        "light of one colour": Directional(np.array([0.0, 0, 1]), np.array([0.0, 1.0, 0.0])),
        "light from straight below": Directional(np.array([0.0, -1.0, 0.0]), WHITE),
        "10000 lights": Group(tuple(Directional(ray, WHITE * 1e-4) for ray in rays)),
        "environment with one hot texel": Environment("hot", hot),
        "environment of one texel": Environment("one", np.ones((1, 1, 3))),
        "environment of radiance 1e-8": Environment("dim", np.full((16, 32, 3), 1e-8)),
        "near light in the hand": Point(np.array([0.0, 0.05, 0.0]), WHITE),
        "near light 1000 km off": Point(np.array([0.0, 0.0, 1e6]), WHITE * 1e12),
        "all kinds of light at once": Group(
            (_strong(1.0), Point(np.ones(3), WHITE), Environment("e", np.ones((4, 8, 3))))
        ),
    }


def _mesh(query: Query) -> Mesh:
    return needed(query.mesh, "mesh")


def _touching(query: Query) -> Query:
    """A light exactly on the vertex that is nearest to the camera."""
    distance = np.linalg.norm(_mesh(query).vertices - query.camera.centre, axis=1)
    return _under(Point(_mesh(query).vertices[distance.argmin()], WHITE), query)


def _proportional(name: str, factor: float) -> Any:
    """A linear method's answer grows as the light does; of another one it is only asked that it answers."""
    trained = trained_method(name)
    query = trained.query
    scaled = trained.draw(_under(query.light.scaled(factor), query))
    if not trained.method.info.linear:
        return TruthPair(scaled, (scaled.image, scaled.alpha))
    return TruthPair(scaled.image.astype(np.float64) / factor, trained.draw(_under(query.light, query)).image, "mean")


def _dark(name: str) -> Any:
    """A linear method draws no light as black."""
    trained = trained_method(name)
    drawn = trained.draw(_under(Environment("black", np.zeros((16, 32, 3))), trained.query))
    image = drawn.image if trained.method.info.linear else np.zeros_like(drawn.image) * drawn.image
    return TruthPair(image, np.zeros_like(drawn.image))


# -- cameras and meshes ---------------------------------------------------------------------------------------------


def _queries() -> dict[str, Callable[[Query], Query]]:
    return {
        "camera in the hand": lambda query: _seen_by(query, _mesh(query).vertices.mean(axis=0)),
        "camera on a vertex": lambda query: _seen_by(query, _mesh(query).vertices[100]),
        "picture of one pixel": lambda query: _seen_by(query, query.camera.centre, 1),
        "camera 10 km off": lambda query: _seen_by(query, 1e4 * unit(query.camera.centre)),
        "degenerate triangles": lambda query: _of_mesh(query, crumpled(_mesh(query))),
        "hand in one point": lambda query: _of_mesh(query, pointlike(_mesh(query))),
        "inverted normals": lambda query: _of_mesh(query, flipped(_mesh(query))),
        "duplicate vertices": lambda query: _of_mesh(query, torn(_mesh(query))),
        "hand of 1e-3 its size": partial(_resized, scale=1e-3),
        "hand of 1e3 its size": partial(_resized, scale=1e3),
        "self-intersecting pose": partial(_bent, factor=2.5),
        "pose of joints turned by 1e6": partial(_bent, factor=1e6),
    }


def _of_mesh(query: Query, mesh: Mesh, seen_by: Camera | None = None) -> Query:
    return replace(query, mesh=mesh, camera=seen_by or query.camera, pose_name="stress", lighting="stress")


def _seen_by(query: Query, eye: Array, size: int = 48) -> Query:
    target = _mesh(query).vertices.mean(axis=0)
    target = target if np.linalg.norm(target - eye) > 1e-6 else target + np.array([0.0, 0.0, 1.0])
    return replace(query, camera=camera(eye, target, size), lighting="stress")


def _resized(query: Query, scale: float) -> Query:
    """The hand and its camera scaled about the origin."""
    old = query.camera
    moved_camera = replace(old, world_to_camera=old.world_to_camera * [1.0, 1.0, 1.0, scale])
    return _of_mesh(query, moved(_mesh(query), scale), moved_camera)


def _bent(query: Query, factor: float) -> Query:
    """The neutral hand in the query's pose bent by a factor, over the capture's topology."""
    (model, level), pose = hand_of(_mesh(query).topology), needed(query.pose, "pose")
    pose = replace(pose, joints=pose.joints * factor)
    mesh = model.mesh(model.neutral(), pose, level)
    return replace(_of_mesh(query, Mesh(mesh.vertices, _mesh(query).topology)), pose=pose)


def _shifted(name: str, distance: float) -> Any:
    """The hand and its camera moved together under a distant light."""
    trained = trained_method(name)
    query = _under(_strong(1.0), trained.query)
    shift = np.array([0.6, 0.0, 0.8]) * distance
    matrix = query.camera.world_to_camera
    rotation = matrix[:, :3]
    away = np.column_stack([rotation, matrix[:, 3] - rotation @ shift])
    mesh = Mesh(_mesh(query).vertices + shift, _mesh(query).topology)
    far = trained.draw(_of_mesh(query, mesh, replace(query.camera, world_to_camera=away)))
    return TruthPair(far.image, trained.draw(query).image, "mean")


def _out_of_picture(name: str) -> Any:
    trained = trained_method(name)
    query = trained.query
    eye = query.camera.centre
    beside = camera(eye, eye + (eye - _mesh(query).vertices.mean(axis=0)), 48)
    drawn = trained.draw(replace(query, camera=beside, lighting="stress"))
    return TruthPair(drawn, (np.zeros_like(drawn.image), np.zeros_like(drawn.alpha)))


# -- recordings ----------------------------------------------------------------------------------------------------


def _trained_on_nothing(name: str) -> Any:
    trained = trained_method(name)
    prior = trained.method.train(Recording((), trained.reader), seed=0)
    return trained.draw(trained.query, prior.personalise(trained.enrolment, seed=0))


def _enrolled(name: str, change: Callable[[Observation], Observation | None]) -> Any:
    """The answer of an avatar that was personalised with changed observations (None: without any frame)."""
    trained = trained_method(name)
    known = {frame.key: change(trained.enrolment.observe(frame)) for frame in trained.enrolment.frames}
    frames = [frame for frame in trained.enrolment.frames if known[frame.key] is not None]
    changed = Recording(frames, lambda frame: known[frame.key])  # type: ignore[arg-type, return-value]
    return trained.draw(trained.query, trained.prior.personalise(changed, seed=0))


def _no_hand(seen: Observation) -> Observation:
    return Observation(np.zeros_like(seen.image), np.zeros_like(seen.alpha))


def _exposed(factor: float, seen: Observation) -> Observation:
    return replace(seen, image=np.minimum(seen.image.astype(np.float64) * factor, 1e38))


def _few_pixels(seen: Observation) -> Observation:
    """Only 4 x 4 pixels in the hand are covered."""
    few = np.zeros_like(seen.alpha)
    rows, columns = np.nonzero(minimum_filter(seen.alpha, 9) > 0.99)
    row, column = rows[len(rows) // 2], columns[len(columns) // 2]
    few[row : row + 4, column : column + 4] = 1.0
    return Observation(seen.image * few[..., None], few)


def _unknown_preset(name: str) -> Any:
    method = METHODS.load(name)(preset="no such preset")
    return len(method.config) + 1.0
