"""Who is in which capture: one population, of which no person is in two captures.

So what a method learned on one capture tells it nothing of the subjects of another.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from ...hand.openhand import OpenHand
from .cast import Subject, person
from .people import look
from .presets import CaptureName
from .tattoo import HELD_OUT, Tattoo

PEOPLE: dict[CaptureName, range] = {
    "openstage": range(0, 24),
    "openscans": range(24, 72),
    "openwild": range(72, 96),
    "openphone": range(96, 104),
}
"""The persons of each capture by their indices; sizes take the first ones."""


def cast(capture: CaptureName, count: int, hand: OpenHand) -> list[Subject]:
    """The first `count` persons of a capture."""
    people = [person(index, hand) for index in PEOPLE[capture][:count]]
    return [_of_phone(subject, i) for i, subject in enumerate(people)] if capture == "openphone" else people


def people_of_others(capture: str) -> Iterator[tuple[CaptureName, Subject]]:
    """The persons of all captures but one, each with the capture that shows them."""
    hand = OpenHand.load()
    for other, people in PEOPLE.items():
        if other != capture:
            yield from ((other, subject) for subject in cast(other, len(people), hand))


def _of_phone(subject: Subject, i: int) -> Subject:
    """Of four, two are dark and two have a tattoo that no other capture shows: where unknown light is hard."""
    melanin, tattoo = ((0.85, None), (0.3, 0), (0.97, None), (0.55, 1))[i % 4]
    drawn = () if tattoo is None else (Tattoo(HELD_OUT[tattoo]), Tattoo(HELD_OUT[2], y=-0.06, radius=0.022))
    return Subject(subject.name, subject.identity, replace(look(subject.look.seed, melanin), tattoos=drawn))
