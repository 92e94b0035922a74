"""The whole study: scenes, curves, equal-error table, scaling, methods, implicit hands; one record for reports.

On the clock of a new pose is all that a new mesh asks for: smooth normals, the ray tracer's tree, what the camera sees,
shadows, shading, the picture. On that of a known pose is a picture under another map: ours keeps raster and transfer,
the naive one maps, shadows and raster, Mitsuba its scene. Off the clock for everybody is what depends on the map
alone (clustered lights, Mitsuba's emitter tables) or on the topology alone (the atlas).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from statistics import median
from typing import Any, Literal, TypeAlias

import numpy as np

from ...bench.progress import Steps
from ...bench.provenance import provenance
from ...errors import Unsupported
from ...method import Progress, silent
from ...registry import METHODS
from ...scene import Array
from ...tuning import tune
from . import methods, truth
from .competitors import Mitsuba, Naive
from .configurations import known_pose_sweep, new_pose_sweep
from .core import Core
from .equal_error import TARGETS, table
from .implicit import of_implicit
from .measure import ErrorCurve, Trial, timed
from .record import MITSUBA, Goal, Learned, Reference, Residual, SceneStudy, SpeedRecord
from .scaling import scalings
from .scene import Scene, moved, scenes
from .truth import Truth

OURS, NAIVE = "handbench", "naive torch"

GOALS = (Goal("lambert-sun", error=0.01, new=3.0, known=30.0),)
"""How many times faster than Mitsuba a new and a known pose should be."""


def study(chosen: Sequence[str] | None, quick: bool, command: list[str], steps: Steps) -> SpeedRecord:
    """Measure everything; `chosen` names methods, None means all, or if `quick` those of the smoke protocol.

    Nothing is written.

    Raises `InputError` for an unknown method.
    """
    every = methods.protocol().methods if quick else METHODS.entries()
    names = list(every if chosen is None else chosen)
    for name in names:
        METHODS.entry(name)
    about = provenance(command)
    tune()
    drawn = [of_scene(scene, quick, steps(f"speed {scene.name}")) for scene in scenes(quick)]
    counted, growth = 0, steps("speed scaling")

    def count() -> None:
        nonlocal counted
        counted += 1
        growth(counted, _AXES[quick])

    grown = tuple(scalings(scenes(True)[0], quick, count))
    tried, told = [], steps("speed methods")
    for done, name in enumerate(names, start=1):
        tried.append(methods.study(name, quick))
        told(done, len(names))
    implicit = of_implicit(quick, steps("speed implicit"))
    return SpeedRecord(quick, about, tuple(drawn), GOALS, grown, tuple(tried), implicit)


_AXES = {True: 16, False: 22}
"""Sizes that `scalings` measures."""


def of_scene(scene: Scene, quick: bool, progress: Progress = silent) -> SceneStudy:
    """A scene: its reference, all curves, the equal-error table, and where Mitsuba converges to."""
    samples = (16, 64, 256) if quick else (4, 16, 64, 256, 1024)
    expected = truth.truth(scene, *((512, 4) if quick else (truth.DIRECTIONS, truth.GRID)))
    repeats = 3 if quick else 5
    jobs = _ours(scene, expected, quick, repeats) + _naive(scene, expected, quick, repeats)
    notes, residual = [], None
    if scene.roughness is None:
        try:
            jobs += _mitsuba(scene, expected, samples, repeats)
            residual = converged(scene, expected, 4 if quick else 16)
        except Unsupported as error:
            notes.append(str(error))
    else:
        notes.append("Mitsuba has no BRDF of these terms, so it is compared on the Lambert scenes only")
    points: dict[tuple[str, _Pose], list[Trial]] = {}
    kept: list[Learned] = []
    for done, (renderer, pose, job) in enumerate(jobs, start=1):
        for point in job(kept):
            points.setdefault((renderer, pose), []).append(point)
        progress(done, len(jobs))
    curves = [ErrorCurve(renderer, pose, tuple(found)) for (renderer, pose), found in points.items()]
    return SceneStudy(
        name=scene.name,
        title=scene.title,
        triangles=len(scene.mesh.topology.faces),
        picture=(scene.camera.width, scene.camera.height),
        truth=Reference(len(expected.pixels), expected.noise),
        mitsuba_residual=residual,
        notes=tuple(notes),
        learn=tuple(kept),
        curves=tuple(curves),
        equal_error=table(curves, TARGETS),
    )


_Pose: TypeAlias = Literal["new", "known"]
_Job: TypeAlias = tuple[str, _Pose, Callable[[list[Learned]], list[Trial]]]


def _ours(scene: Scene, expected: Truth, quick: bool, repeats: int) -> list[_Job]:
    def new(knob: str, core: Core) -> list[Trial]:
        work = timed(lambda step: moved(scene.mesh, step), core.new_pose, repeats)
        return [_point(knob, core.configuration.label, expected, *work)]

    def known(knob: str, core: Core, kept: list[Learned]) -> list[Trial]:
        seconds, answers = timed(lambda step: moved(scene.mesh, step), core.learn, 1)
        kept.append(Learned(core.configuration.label, seconds[0]))
        work = timed(lambda step: scene.environment, answers[0].picture, 3 * repeats)
        return [_point(knob, core.configuration.label, expected, *work)]

    jobs: list[_Job] = [
        (OURS, "new", lambda kept, k=knob, c=c: new(k, Core(scene, c)))  # type: ignore[misc]
        for knob, c in new_pose_sweep(quick)
    ]
    jobs += [
        (OURS, "known", lambda kept, k=knob, c=c: known(k, Core(scene, c), kept))  # type: ignore[misc]
        for knob, c in known_pose_sweep(quick)
    ]
    return jobs


def _naive(scene: Scene, expected: Truth, quick: bool, repeats: int) -> list[_Job]:
    settings = [(64, (8, 16)), (64, (16, 32)), (128, (8, 16)), (128, (16, 32))]
    settings += [] if quick else [(192, (16, 32)), (384, (8, 16))]
    few = max(2, repeats // 2)

    def run(texture: int, grid: tuple[int, int], pose: _Pose) -> list[Trial]:
        naive = Naive(scene, texture, grid)
        label = f"{texture}^2, {grid[0]}x{grid[1]} grid"
        if pose == "new":
            return [_point("texture", label, expected, *timed(lambda s: moved(scene.mesh, s), naive.new_pose, few))]
        naive.learn(scene.mesh)
        return [_point("texture", label, expected, *timed(lambda s: s, lambda s: naive.known_pose(), few))]

    return [
        (NAIVE, pose, lambda kept, t=texture, g=grid, p=pose: run(t, g, p))  # type: ignore[misc]
        for pose in ("new", "known")
        for texture, grid in settings
    ]


def _mitsuba(scene: Scene, expected: Truth, samples: Sequence[int], repeats: int) -> list[_Job]:
    few = max(2, repeats // 2)
    jobs: list[_Job] = []
    for setting, name in MITSUBA.items():
        renderer = Mitsuba(scene, setting)
        most = samples[-1] * (4 if setting == "default" else 1)  # plain random samples need more of them
        for count in [*samples, most] if most > samples[-1] else samples:

            def new(kept: list[Learned], r: Mitsuba = renderer, n: int = count) -> list[Trial]:
                def posed(mesh: Any) -> Array:
                    r.pose(mesh)
                    return r.picture(n)

                return [_point("samples", f"{n} spp", expected, *timed(lambda s: moved(scene.mesh, s), posed, few))]

            def known(kept: list[Learned], r: Mitsuba = renderer, n: int = count) -> list[Trial]:
                return [_point("samples", f"{n} spp", expected, *timed(lambda s: s, lambda s: r.picture(n), few))]

            jobs += [(name, "new", new), (name, "known", known)]
    return jobs


def _point(knob: str, label: str, expected: Truth, seconds: tuple[float, ...], pictures: list[Array]) -> Trial:
    return Trial(knob, label, median(expected.error(picture) for picture in pictures), seconds)


def converged(scene: Scene, expected: Truth, pictures: int, samples: int = 256) -> Residual:
    """How far Mitsuba's converged picture is from the reference: relative RMSE over the mean of many pictures.

    noise: what is left in that mean, from its two halves.
    """
    renderer = Mitsuba(scene, "tuned")
    halves = [np.mean([renderer.picture(samples) for _ in range(pictures // 2)], axis=0) for _ in range(2)]
    between = expected.error((halves[0] - halves[1]).reshape(halves[0].shape) / 2 + _filled(expected, halves[0]))
    return Residual(expected.error(np.mean(halves, axis=0)), between)


def _filled(expected: Truth, like: Array) -> Array:
    """The reference as a picture, so that a difference's size is its distance from it."""
    picture = np.zeros((like.shape[0] * like.shape[1], 3))
    picture[expected.pixels] = expected.values
    return picture.reshape(like.shape)
