"""Implicit hands, as PALM-Net has them: error against time of their parts, what skips save, how cost grows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from ...method import Progress, silent
from ...methods.palm.model import PalmModel
from . import fields
from .gathering import gathered
from .record import Implicit, Scaling
from .scaling import fit
from .volume import PersonView, skipped, textured

_PARTS = 6


def of_implicit(quick: bool, progress: Progress = silent) -> Implicit:
    """Everything of `Implicit`: about a minute of one core, a third of that if `quick`. Times are of CPU."""
    skin = fields.DistanceSamples.of_neutral()
    steps = 40 if quick else 120
    models, parts = [], []
    for done, (name, config) in enumerate(fields.VARIANTS.items(), start=1):
        model, part = fields.learned(name, config, skin, steps)
        models.append(model)
        parts.append(part)
        progress(done, _PARTS)
    drawn = textured(models[0])
    saved = skipped(PersonView.of(drawn, 64 if quick else 256))
    progress(4, _PARTS)
    lit = gathered(24 if quick else 40, 1 if quick else 2)
    progress(5, _PARTS)
    grown = (_rays(drawn, quick), _samples(drawn, quick), _rows(skin, quick))
    progress(_PARTS, _PARTS)
    return Implicit(tuple(parts), saved, lit, grown)


def _rays(model: PalmModel, quick: bool) -> Scaling:
    heights = (32, 64, 128) if quick else (32, 64, 128, 256)
    views = [PersonView.of(model, height) for height in heights]
    sizes = tuple(len(view.towards) for view in views)
    return _growth("rays", "Rays of a frame", sizes, [_repeated(view, model) for view in views])


def _samples(model: PalmModel, quick: bool) -> Scaling:
    counts = (4, 8, 16, 32) if quick else (4, 8, 16, 32, 64)
    view = PersonView.of(model, 48)
    times = [_repeated(view, model, samples=count) for count in counts]
    return _growth("samples", "Samples of a ray, 48 rows", counts, times)


def _rows(skin: fields.DistanceSamples, quick: bool) -> Scaling:
    """A step of training grows with its tables: Adam goes over all of them."""
    planes = (64, 128, 256) if quick else (64, 128, 256, 512)
    config = fields.VARIANTS["dense grids and tri-plane"]
    found = [
        fields.step_of(replace(config, plane=plane, grids=(plane // 16, plane // 8, plane // 4)), skin)
        for plane in planes
    ]
    sizes, seconds = tuple(rows for rows, _ in found), [(took,) for _, took in found]
    return _growth("rows", "Rows of the tables, a step of training", sizes, seconds)


def _repeated(view: PersonView, model: PalmModel, samples: int | None = None) -> tuple[float, ...]:
    """Seconds of two drawings; None for as many samples a ray as the model has."""
    config = model.config if samples is None else replace(model.config, samples=samples)
    return tuple(view.drawn(config=config)[0] for _ in range(2))


def _growth(axis: str, title: str, sizes: tuple[int, ...], seconds: Sequence[tuple[float, ...]]) -> Scaling:
    return Scaling(axis, title, sizes, tuple(seconds), fit(sizes, [min(times) for times in seconds]))
