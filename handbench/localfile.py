"""A method from a Python file of the user's own: no package, no entry point."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path
from types import ModuleType

from .errors import InputError
from .method import Method
from .registry import Entry

_WANTED = 'define create(preset="quick"), which returns a handbench.method.Method'


def is_file(name: str) -> bool:
    """Whether a method is named by the path of a file."""
    return name.endswith(".py")


def entry_of(path: Path) -> Entry:
    """The plug-in that a file holds: its `create(preset)`, under the name that the method's `info` tells.

    The file's folder is put on Python's path, as it is for a script, so the file may import others beside it; its own
    code and the folder `weights/` beside it are part of a cell's key, and what it imports is not.
    Raises `InputError` for a file that cannot be used.
    """
    module = _module(path)
    if not hasattr(module, "create"):
        raise InputError(f"method file {path} has no create; {_WANTED}")
    try:
        method = module.create(preset="quick")
    except (Exception, SystemExit) as error:  # whatever foreign code raises
        raise InputError(f"method file {path}: create fails ({_told(error)}); {_WANTED}") from error
    if not isinstance(method, Method):
        raise InputError(f"method file {path}: create makes a {type(method).__name__}; {_WANTED}")
    return Entry(method.info.name, f"{module.__name__}:create", method.info.summary)


def _module(path: Path) -> ModuleType:
    if not path.is_file():
        raise InputError(f"method file {path} does not exist; check its path")
    name, folder = path.stem, str(path.resolve().parent)
    if not name.isidentifier():
        raise InputError(f"method file {path} has no name that Python can import; use letters, digits and underscores")
    if folder not in sys.path:
        sys.path.insert(0, folder)
    try:
        module = importlib.import_module(name)
    except (Exception, SystemExit) as error:  # whatever foreign code raises
        raise InputError(f"method file {path} cannot be loaded ({_told(error)}); mend it") from error
    if module.__file__ is None or Path(module.__file__).resolve() != path.resolve():
        raise InputError(f"method file {path} has the name of another module, {module.__file__}; rename it")
    return module


def _told(error: BaseException) -> str:
    return " ".join(f"{type(error).__name__}: {error}".split())
