"""What a method says of itself is checked when it says it, and records keep it."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import pytest

from handbench.bench.reading import role_of
from handbench.errors import InputError
from handbench.method import MethodInfo
from handbench.registry import METHODS


def test_truth_and_floor_calibrate_and_methods_compete() -> None:
    roles = {name: METHODS.load(name)(preset="quick").info.role for name in ("oracle", "mean", "phong", "urhand")}
    assert roles == {"oracle": "calibration", "mean": "calibration", "phong": "method", "urhand": "method"}


def test_the_role_is_read_from_the_record_and_not_from_prose() -> None:
    floor = MethodInfo("f", "F", "a floor", role="calibration", fidelity="the floor")
    praised = MethodInfo("p", "P", "a method", fidelity="calibration of colours is built in")
    assert role_of(asdict(floor)) == "calibration" and role_of(asdict(praised)) == "method"


@pytest.mark.parametrize(
    ("truth", "fidelity", "role"),
    [(True, "the truth", "calibration"), (False, "calibration: the floor", "calibration"), (False, "other", "method")],
)
def test_runs_before_there_was_a_role_are_still_read(truth: bool, fidelity: str, role: str) -> None:
    assert role_of({"truth": truth, "fidelity": fidelity}) == role


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"role": "judge"}, "method 'm': role is 'judge'; use one of method, calibration"),
        ({"truth": True}, "method 'm': it is given the scored frames; set its role to \"calibration\""),
    ],
)
def test_impossible_roles_are_refused(given: dict[str, Any], says: str) -> None:
    with pytest.raises(InputError, match=says):
        MethodInfo("m", "M", "a method", **given)
