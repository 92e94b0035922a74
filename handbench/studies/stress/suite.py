"""The declared suite: every family of cases, in a fixed order."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from fnmatch import fnmatchcase

from ...errors import InputError
from .case import Case
from .runner import Source

TARGET = f"{__name__}:suite"


def suite(methods: Sequence[str] | None = None) -> tuple[Case, ...]:
    """All cases over the core, and over the named methods (None: all registered ones)."""
    from . import (
        cases_brdf,
        cases_disney,
        cases_hand,
        cases_light,
        cases_methods,
        cases_metrics,
        cases_raster,
        cases_reduction,
        cases_shading,
        cases_surface,
        cases_visibility,
    )

    families = [module.cases() for module in (cases_brdf, cases_disney, cases_shading, cases_surface, cases_raster)]
    families += [module.cases() for module in (cases_visibility, cases_light, cases_reduction, cases_hand)]
    families += [cases_metrics.cases(), cases_methods.cases(methods)]
    found = tuple(case for family in families for case in family)
    twice = [name for name, count in Counter(case.id for case in found).items() if count > 1]
    if twice:
        raise InputError(f"stress: two cases are named {twice[0]!r}; rename one")
    return found


def source(methods: Sequence[str] | None = None) -> Source:
    """How a worker builds the suite."""
    return Source(TARGET, (methods,))


def select(cases: Sequence[Case], only: str | None) -> tuple[Case, ...]:
    """The cases whose "family/name" fits a glob; `InputError` if none does."""
    if only is None:
        return tuple(cases)
    found = tuple(case for case in cases if fnmatchcase(case.id, only))
    if not found:
        families = ", ".join(dict.fromkeys(case.family for case in cases))
        raise InputError(f"stress: no case fits {only!r}; try 'FAMILY/*' with one of {families}, or --list")
    return found
