"""What is worked out once and shared: a change of it shows, whatever holds it, and it is put back where it is."""

from __future__ import annotations

import pickle
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from scipy.sparse import csr_array

from handbench.hand.watched import Watched


class Owner:
    """Somebody else's."""

    def __init__(self) -> None:
        self.mine = np.ones(3)


def read_only(values: np.ndarray) -> np.ndarray:
    values.flags.writeable = False
    return values


MADE = {
    "array": lambda: np.arange(3.0),
    "read-only": lambda: read_only(np.arange(4).reshape(2, 2).T),
    "tensor": lambda: torch.arange(3),
    "sparse tensor": lambda: torch.eye(3).to_sparse().coalesce(),
    "sparse matrix": lambda: csr_array(np.eye(3)),
    "number": lambda: np.array(3.0),
    "flags": lambda: np.array([True, False]),
    "object": lambda: SimpleNamespace(name="x", parts=[{"a": np.arange(3.0)}]),
}
WRITE = {
    "array": lambda value: value.__setitem__(0, 5.0),
    "read-only": lambda value: torch.from_numpy(value).add_(1),
    "tensor": lambda value: value.add_(1),
    "sparse tensor": lambda value: value.values().mul_(2),
    "sparse matrix": lambda value: value.data.__imul__(2),
    "number": lambda value: value.__iadd__(1),
    "flags": lambda value: np.logical_not(value, out=value),
    "object": lambda value: value.parts[0]["a"].sort(),  # changes nothing
}


@pytest.mark.filterwarnings("ignore:The given NumPy array is not writable")
@pytest.mark.parametrize("kind", MADE)
def test_a_change_shows_and_is_undone_in_place(kind: str) -> None:
    kept = Watched()
    value = kept(kind, MADE[kind])
    assert kept(kind, MADE[kind]) is value and kept.changed() == []
    before = pickle.dumps(value)
    WRITE[kind](value)
    assert kept.changed() == ([] if kind == "object" else [kind])
    kept.restore()
    assert kept.changed() == [] and kept(kind, MADE[kind]) is value
    assert pickle.dumps(value) == before


def test_an_exchange_of_equal_values_shows() -> None:
    kept = Watched()
    kept("rows", lambda: np.arange(6.0).reshape(3, 2))[[0, 1]] = [[2.0, 3.0], [0.0, 1.0]]
    assert kept.changed() == ["rows"]


def test_what_is_made_of_the_rest_is_put_back_after_it() -> None:
    kept = Watched()
    first = kept("first", lambda: np.ones(3))
    first *= 2
    second = kept("second", lambda: 10 * first)
    assert kept.changed() == ["first"]
    kept.restore()
    np.testing.assert_array_equal(second, 10.0)


def test_what_belongs_to_others_is_theirs() -> None:
    kept, owner = Watched(Owner), Owner()
    kept("holds it", lambda: {"owner": owner, "own": np.zeros(2)})
    owner.mine[:] = 7.0
    assert kept.changed() == []
    itself = kept("is one", Owner)
    itself.mine[:] = 7.0
    assert kept.changed() == ["is one"]


def test_a_pickle_holds_nothing() -> None:
    kept = Watched(Owner)
    kept("value", lambda: np.zeros(2))
    again = pickle.loads(pickle.dumps(kept))
    assert again.items() == [] and again("value", Owner).mine.shape == (3,)
