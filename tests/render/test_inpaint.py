"""Unseen texels: smooth ones come back, guided ones take the guide's structure and not its colour, all are marked."""

from __future__ import annotations

import numpy as np
import pytest

from handbench.errors import InputError
from handbench.render.uv.inpaint import Guide, inpainted


@pytest.fixture(scope="module")
def sheet() -> np.ndarray:
    """Points (N, 3) of a square sheet of 10 cm."""
    side = np.linspace(0, 0.1, 40)
    return np.stack([*np.meshgrid(side, side), np.zeros((40, 40))], axis=-1).reshape(-1, 3)


@pytest.fixture(scope="module")
def seen(sheet: np.ndarray) -> np.ndarray:
    return np.linalg.norm(sheet - [0.05, 0.05, 0.0], axis=1) > 0.025


def test_what_is_seen_stays_and_what_varies_evenly_comes_back(sheet: np.ndarray, seen: np.ndarray) -> None:
    colour = np.exp(np.stack([10 * sheet[:, 0], -5 * sheet[:, 1], 0 * sheet[:, 0]]) - 1)  # harmonic in logarithms
    found = inpainted(np.where(seen, colour, 0.0), seen, sheet)
    np.testing.assert_array_equal(found.colour[:, seen], colour[:, seen])
    np.testing.assert_allclose(found.colour, colour, rtol=0.01)
    assert found.names == ("seen", "smooth")
    np.testing.assert_array_equal(found.source, np.where(seen, 0, 1))


def test_a_guide_gives_structure_and_the_surroundings_colour(sheet: np.ndarray, seen: np.ndarray) -> None:
    lines = np.exp(0.3 * np.sin(400 * sheet[:, 0]))
    darker = Guide("prior", 0.2 * lines[None], np.ones(len(seen), dtype=bool))
    found = inpainted(np.where(seen, 0.7 * lines, 0.0)[None], seen, sheet, [darker])
    np.testing.assert_allclose(found.colour[0], 0.7 * lines, rtol=1e-3)
    assert {found.names[s] for s in found.source[~seen]} == {"prior"}


def test_the_first_valid_guide_counts_and_guides_are_not_mixed(sheet: np.ndarray, seen: np.ndarray) -> None:
    left = sheet[:, 0] < 0.05
    half = Guide("finger", np.full((1, len(seen)), 0.3), left)
    rest = Guide("prior", np.full((1, len(seen)), 0.9), np.ones(len(seen), dtype=bool))
    found = inpainted(np.where(seen, 0.5, 0.0)[None], seen, sheet, [half, rest])
    np.testing.assert_allclose(found.colour, 0.5, rtol=1e-3)  # both are even: their levels do not show
    assert {found.names[s] for s in found.source[~seen & left]} == {"finger"}
    assert {found.names[s] for s in found.source[~seen & ~left]} == {"prior"}


def test_a_part_that_touches_nothing_seen_gets_the_mean_colour(sheet: np.ndarray, seen: np.ndarray) -> None:
    apart = np.concatenate([sheet, sheet[:50] + np.array([0, 0, 1.0])])
    known = np.concatenate([np.ones(len(sheet), dtype=bool), np.zeros(50, dtype=bool)])
    found = inpainted(np.where(known, 0.4, 0.0)[None], known, apart)
    np.testing.assert_allclose(found.colour[0, ~known], 0.4, rtol=1e-6)


def test_nothing_seen_is_refused(sheet: np.ndarray) -> None:
    with pytest.raises(InputError, match="no texel was seen"):
        inpainted(np.zeros((3, len(sheet))), np.zeros(len(sheet), dtype=bool), sheet)
