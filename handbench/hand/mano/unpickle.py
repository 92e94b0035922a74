"""Pickles of others, of which nothing but numpy's arrays, scipy's sparse matrices and chumpy's two classes is made.

A pickle is a program. This reader lets it name no function and no class but those of `_ALLOWED`, each of which is a
stand-in of ours that keeps numbers and does nothing else: what it does not know by name it refuses by name.
"""

from __future__ import annotations

import io
import math
import pickle
import re
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse

from ...errors import InputError, shortened
from ...files import read_bytes
from ...scene import Array

LIMIT = 64 << 20
"""Bytes of the largest pickle that is read; MANO's has 3.9 million."""

_VALUES = 1 << 24  # numbers of one array: MANO's largest has 315,090


class _Ch:
    """What stands for chumpy's `Ch`, a value, and `Select`, some entries of a value in another shape."""

    def __init__(self) -> None:
        self.state: dict[str, Any] = {}

    def __setstate__(self, state: Any) -> None:
        if not isinstance(state, dict):
            raise InputError("a chumpy object has no fields")
        self.state = state


class _Select(_Ch):
    pass


class _Sparse:
    """What stands for scipy's `csc_matrix`."""

    def __init__(self) -> None:
        self.state: dict[str, Any] = {}

    def __setstate__(self, state: Any) -> None:
        self.state = dict(state)


class _Dtype:
    """What stands for `numpy.dtype`: a plain number type."""

    def __init__(self, code: Any, *unused: Any) -> None:
        self.table = code == "O8"  # numpy's way to keep a dict
        if self.table:
            return
        if not isinstance(code, str) or not _PLAIN.fullmatch(code):
            raise InputError(f"it holds numbers of the type {shortened(code)}, which no file of hand data needs")
        self.dtype = np.dtype(code)

    def __setstate__(self, state: Any) -> None:
        if not self.table and state[1] in ("<", ">"):
            self.dtype = self.dtype.newbyteorder(state[1])


class _Kind:
    """What stands for the class `numpy.ndarray`, of which `_reconstruct` alone makes something."""

    def __new__(cls, *unused: Any) -> _Kind:
        raise InputError("it makes an array in a way that no file of hand data needs; do not trust it")


class _Array:
    """What stands for an array until its content comes."""

    def __init__(self, kind: Any, shape: Any, code: Any) -> None:
        self.values: Any = np.zeros(0)

    def __setstate__(self, state: Any) -> None:
        _, shape, kind, by_columns, content = state
        if isinstance(kind, _Dtype) and kind.table:
            if shape != () or not isinstance(content, list) or len(content) != 1:
                raise InputError("it holds an array of objects, which no file of hand data needs")
            self.values = content[0]
            return
        count = math.prod(shape)
        content = content.encode("latin1") if isinstance(content, str) else content
        if not isinstance(kind, _Dtype) or not isinstance(content, bytes) or not 0 <= count <= _VALUES:
            raise InputError(f"it holds an array of shape {shortened(shape)} that no file of hand data needs")
        if len(content) != count * kind.dtype.itemsize:
            raise InputError("an array in it is cut off; get it again")
        self.values = np.frombuffer(content, kind.dtype).reshape(shape, order="F" if by_columns else "C")


def _scalar(kind: Any, content: Any) -> Any:
    content = content.encode("latin1") if isinstance(content, str) else content
    return np.frombuffer(content, kind.dtype, 1)[0]


def _encode(text: Any, encoding: Any) -> bytes:
    if encoding != "latin1":
        raise InputError(f"it encodes text as {shortened(encoding)}; do not trust it")
    return bytes(text.encode("latin1"))


_PLAIN = re.compile(r"[<>|=]?[biuf][1248]")
_NUMPY = ("numpy.core.multiarray", "numpy._core.multiarray")
_ALLOWED: dict[tuple[str, str], Any] = {
    **{(module, "_reconstruct"): _Array for module in _NUMPY},
    **{(module, "scalar"): _scalar for module in _NUMPY},
    ("numpy", "ndarray"): _Kind,
    ("numpy", "dtype"): _Dtype,
    ("chumpy.ch", "Ch"): _Ch,
    ("chumpy.reordering", "Select"): _Select,
    **{(f"scipy.sparse.{module}", "csc_matrix"): _Sparse for module in ("csc", "_csc")},
    ("_codecs", "encode"): _encode,
}


def read_pickle(path: Path, what: str, limit: int = LIMIT) -> Any:
    """The value in a pickle of numbers: dicts, lists, texts and numpy arrays, those of chumpy and scipy made plain.

    Raises `InputError` for a file that is missing, larger than `limit`, damaged, or that names anything else.
    """
    return _loaded(io.BytesIO(read_bytes(path, limit, what)), path, what)


def _loaded(file: io.BytesIO, path: Path, what: str) -> Any:
    try:
        value = _Reader(file, encoding="latin1").load()
        return _plain(value, 0)
    except InputError as error:
        raise InputError(f"{what} {path}: {error}") from error
    except Exception as error:  # a damaged pickle raises whatever the bytes lead to
        told = " ".join(str(error).split())[:120]
        raise InputError(f"{what} {path} is no pickle that can be read ({told}); get it again") from error


def read_numpy_object(path: Path, what: str, limit: int = LIMIT) -> Any:
    """The table in a .npy file that holds one, which numpy pickles: under the rules of `read_pickle`."""
    content = read_bytes(path, limit, what)
    file = io.BytesIO(content)
    try:
        version = np.lib.format.read_magic(file)
        read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, _, dtype = read(file)
    except Exception as error:  # of numpy, and of the parser of the header
        raise InputError(f"{what} {path} is damaged or no numpy file; get it again") from error
    if shape != () or not dtype.hasobject:
        raise InputError(f"{what} {path} holds an array of shape {shape}, not a table; get it again")
    return _loaded(file, path, what)


class _Reader(pickle.Unpickler):
    def find_class(self, module: str, name: str) -> Any:
        try:
            return _ALLOWED[module, name]
        except KeyError:
            raise InputError(f"it names {module}.{name}, which no file of hand data needs; do not trust it") from None

    def persistent_load(self, pid: Any) -> Any:
        raise InputError("it refers to objects outside of it; do not trust it")


def _plain(value: Any, depth: int) -> Any:
    if depth > 16:
        raise InputError("it is nested too deep")
    if isinstance(value, dict):
        return {str(key): _plain(inner, depth + 1) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(inner, depth + 1) for inner in value]
    if isinstance(value, _Select):
        return _selected(value.state, depth)
    if isinstance(value, _Ch):
        return _plain(value.state.get("x"), depth + 1)
    if isinstance(value, _Sparse):
        return _dense(value.state)
    if isinstance(value, _Array):
        return value.values if isinstance(value.values, np.ndarray) else _plain(value.values, depth + 1)
    if value is None or isinstance(value, bool | int | float | str | bytes | np.generic):
        return value
    raise InputError(f"it holds a {type(value).__name__}, which no file of hand data needs")


def _selected(state: dict[str, Any], depth: int) -> Array:
    """What chumpy's Select stands for: the entries `idxs` of `a`, flat, in the shape `preferred_shape`."""
    whole = np.asarray(_plain(state.get("a"), depth + 1))
    chosen = np.asarray(_plain(state.get("idxs"), depth + 1))
    shape = tuple(int(size) for size in np.ravel(_plain(state.get("preferred_shape"), depth + 1)))
    if chosen.dtype.kind not in "iu" or (chosen.size and not 0 <= chosen.min() <= chosen.max() < whole.size):
        raise InputError("a chumpy Select points outside its array")
    return whole.ravel()[chosen.ravel()].reshape(shape)


def _dense(state: dict[str, Any]) -> Array:
    shape = tuple(int(size) for size in state.get("_shape", ()))
    if len(shape) != 2 or not 0 < shape[0] * shape[1] <= _VALUES:
        raise InputError(f"it holds a sparse matrix of shape {shape}")
    parts = tuple(np.asarray(_plain(state[name], 0)) for name in ("data", "indices", "indptr"))
    matrix = scipy.sparse.csc_matrix(parts, shape=shape)
    matrix.check_format(full_check=True)
    return matrix.toarray()
