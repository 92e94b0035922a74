"""What a method says of itself is checked when it says it, and records keep it."""

from __future__ import annotations

from typing import Any

import pytest

from handbench.errors import InputError
from handbench.method import MethodInfo
from handbench.registry import METHODS
from handbench.results.record import MethodRecord


def test_truth_and_floor_calibrate_and_methods_compete() -> None:
    roles = {name: METHODS.load(name)(preset="quick").info.role for name in ("oracle", "mean", "phong", "urhand")}
    assert roles == {"oracle": "calibration", "mean": "calibration", "phong": "method", "urhand": "method"}


def test_the_role_is_declared_and_not_read_from_prose() -> None:
    praised = MethodInfo("p", "P", "a method", fidelity="calibration of colours is built in")
    assert praised.role == "method" and MethodRecord("p", "P", fidelity=praised.fidelity).role == "method"


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
