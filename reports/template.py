"""The templates of pages and their sections: strict about names, safe about text."""

from __future__ import annotations

from functools import cache
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined


@cache
def environment(**filters: Any) -> Environment:
    """The templates of this package with filters by name; compiled once a process, which takes longer than a page."""
    made = Environment(
        loader=PackageLoader("handbench.reports"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    made.policies["json.dumps_kwargs"] = {"separators": (",", ":")}
    made.filters.update(filters)
    return made
