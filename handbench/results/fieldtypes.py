"""What the types of a record's fields are called, in SQL and in words, and how a value is reached."""

from __future__ import annotations

import json
import types
from collections.abc import Iterator
from dataclasses import fields
from functools import cache
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

from .schema import Json


def sql(hint: Any) -> str:
    """The type in DuckDB's SQL that holds a type."""
    origin, arguments = get_origin(hint), get_args(hint)
    simple = {str: "VARCHAR", int: "BIGINT", float: "DOUBLE", bool: "BOOLEAN", Json: "JSON"}
    if hint in simple:
        return simple[hint]
    if origin is Annotated:
        return sql(arguments[0])
    if origin is Literal:
        return sql(type(arguments[0]))
    if origin in (Union, types.UnionType):
        (one,) = [each for each in arguments if each is not type(None)]
        return sql(one)
    if origin is tuple:
        return f"{sql(arguments[0])}[]"
    if origin is dict:
        return f"MAP(VARCHAR, {sql(arguments[1])})"
    hints = get_type_hints(hint, include_extras=True)
    return f"STRUCT({', '.join(f'{chr(34)}{name}{chr(34)} {sql(hints[name])}' for name in hints)})"


@cache
def sql_at(kind: Any, way: str) -> str:
    """The type in DuckDB's SQL of what lies at the end of a way through records, such as "times.train_s"."""
    for name in way.split("."):
        (kind,) = [each for each in (get_args(kind) or (kind,)) if each is not type(None)]
        kind = get_type_hints(kind, include_extras=True)[name]
    return sql(kind)


def at(record: Any, way: str) -> Any:
    """What lies at the end of a way through records; None where a part is missing."""
    for name in way.split("."):
        record = None if record is None else getattr(record, name)
    return record


def documented(kind: Any) -> Iterator[tuple[str, str, str]]:
    """Name, type in words and description of each field of a record."""
    hints = get_type_hints(kind, include_extras=True)
    for each in fields(kind):
        yield each.name, _words(hints[each.name]), each.metadata["told"]


def _words(hint: Any) -> str:
    origin, arguments = get_origin(hint), get_args(hint)
    simple = {str: "text", int: "whole number", float: "number", bool: "true or false", type(None): "null", Json: "any"}
    if hint in simple:
        return simple[hint]
    if origin is Annotated:
        return f"{_words(arguments[0])} ({arguments[1].told})"
    if origin is Literal:
        return ", ".join(f"`{json.dumps(each)}`" for each in arguments)
    if origin in (Union, types.UnionType):
        return " or ".join(map(_words, arguments))
    if origin is tuple:
        return f"list of {_words(arguments[0])}"
    if origin is dict:
        return f"{_words(arguments[1])} by name"
    return f"[{hint.__name__}](#{hint.__name__.lower()})"
