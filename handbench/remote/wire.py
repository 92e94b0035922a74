"""Messages between two Python interpreters: JSON and raw arrays, no pickles, so that their numpy versions may differ.

A message is 8 bytes of length (little-endian), that many bytes of JSON, then the bytes of the arrays that it lists.
Values of `handbench.scene` go as their fields. One that frames and queries share (a mesh, a camera, a light) goes
once: later messages name it by its number.
"""

from __future__ import annotations

import json
import math
import socket
import weakref
from collections.abc import Callable, Iterator
from dataclasses import fields, is_dataclass
from itertools import count
from typing import Any

import numpy as np

from .. import scene
from ..scene import Array, Observation, Prediction, Query, Viewpoint

# made anew for every message; all other values of the scene are shared
_INLINE = (Query, Viewpoint, Observation, Prediction)
_HEADER_LIMIT = 1 << 30
_TICK = 0.2  # seconds between two looks at the other side


class Closed(Exception):
    """The other side is gone."""


class Garbled(Exception):
    """What came is no message."""


class Codec:
    """Values to JSON and arrays and back; remembers what each side has of the other."""

    def __init__(self) -> None:
        self._numbers = count()
        self._sent: dict[int, int] = {}  # the identity of a shared object that the other side has, to its number
        self._gone: list[int] = []  # numbers of those that no longer exist here
        self._known: dict[int, Any] = {}  # the other side's shared objects by their numbers

    def encode(self, content: Any) -> tuple[dict[str, Any], list[Array]]:
        """The header of a message and its arrays. Raises `TypeError` for a value that has no form here."""
        arrays: list[Array] = []
        gone, self._gone = self._gone, []
        told = self._told(content, arrays)
        return {"gone": gone, "content": told, "arrays": [[a.dtype.str, a.shape] for a in arrays]}, arrays

    def decode(self, header: dict[str, Any], arrays: list[Array]) -> Any:
        for number in header["gone"]:
            self._known.pop(number, None)
        return self._value(header["content"], arrays)

    def _told(self, value: Any, arrays: list[Array]) -> Any:
        if value is None or isinstance(value, (bool, int, float, str)):
            return value
        if isinstance(value, np.generic):
            return value.item()
        if isinstance(value, np.ndarray):
            if value.dtype.kind not in "fiub":
                raise TypeError(f"arrays of {value.dtype} cannot be sent to another interpreter")
            arrays.append(value)
            return {"array": len(arrays) - 1}
        if isinstance(value, (list, tuple)):
            return [self._told(item, arrays) for item in value]
        if isinstance(value, dict):
            return {"dict": {str(key): self._told(item, arrays) for key, item in value.items()}}
        if is_dataclass(value) and getattr(scene, type(value).__name__, None) is type(value):
            return self._scene(value, arrays)
        raise TypeError(f"a {type(value).__name__} cannot be sent to another interpreter; give JSON values and arrays")

    def _scene(self, value: Any, arrays: list[Array]) -> dict[str, Any]:
        shared = not isinstance(value, _INLINE)
        if shared and id(value) in self._sent:
            return {"same": self._sent[id(value)]}
        if "_read" in vars(value):  # a pose or a mesh that is read when it is looked at
            for field in fields(value):
                getattr(value, field.name)
        given = (field.name for field in fields(value) if field.name in vars(value))  # an uncalibrated camera has few
        members = {name: self._told(getattr(value, name), arrays) for name in given}
        number = None
        if shared:
            number = self._sent[id(value)] = next(self._numbers)
            weakref.finalize(value, self._forget, id(value), number).atexit = False
        return {"made": type(value).__name__, "number": number, "fields": members}

    def _forget(self, identity: int, number: int) -> None:
        self._sent.pop(identity, None)
        self._gone.append(number)

    def _value(self, told: Any, arrays: list[Array]) -> Any:
        if isinstance(told, list):
            return [self._value(item, arrays) for item in told]
        if not isinstance(told, dict):
            return told
        if "array" in told:
            return arrays[told["array"]]
        if "dict" in told:
            return {key: self._value(item, arrays) for key, item in told["dict"].items()}
        if "same" in told:
            return self._known[told["same"]]
        given = {name: self._value(item, arrays) for name, item in told["fields"].items()}
        made = getattr(scene, told["made"])(**given)
        if told["number"] is not None:
            self._known[told["number"]] = made
        return made


class Channel:
    """One end of a connection.

    `watch` is called every now and then while nothing comes, `pace` with every piece that does; both may raise to end
    the wait.
    """

    def __init__(
        self,
        connection: socket.socket,
        watch: Callable[[], None] | None = None,
        pace: Callable[[], None] | None = None,
    ) -> None:
        self._socket = connection
        self._watch, self._pace = watch, pace
        self._socket.settimeout(_TICK if watch else None)
        self._codec = Codec()

    def send(self, content: Any) -> None:
        """Raises `Closed`, what `watch` raises, and `TypeError` for a value that cannot be sent, before any is."""
        header, arrays = self._codec.encode(content)
        text = json.dumps(header).encode()
        self._write(memoryview(len(text).to_bytes(8, "little") + text))
        for array in arrays:
            self._write(_bytes(np.ascontiguousarray(array)))

    def receive(self) -> Any:
        """The next message. Raises `Closed`, `Garbled`, and what `watch` and `pace` raise."""
        size = bytearray(8)
        self._read(memoryview(size))
        length = int.from_bytes(size, "little")
        if length > _HEADER_LIMIT:
            raise Garbled("a message of an impossible length")
        text = bytearray(length)
        self._read(memoryview(text))
        try:
            header = json.loads(text)
            arrays = list(self._arrays(header["arrays"]))
            return self._codec.decode(header, arrays)
        except (ValueError, LookupError, TypeError, AttributeError, MemoryError, RecursionError) as error:
            raise Garbled(f"a message that cannot be read ({error})") from error

    def close(self) -> None:
        self._socket.close()

    def _arrays(self, described: list[Any]) -> Iterator[Array]:
        for kind, shape in described:
            array = np.empty(math.prod(shape), dtype=np.dtype(kind))
            self._read(_bytes(array))
            array = array.reshape(shape)
            array.flags.writeable = False  # as everything in the scene is
            yield array

    def _write(self, rest: memoryview) -> None:
        while len(rest):
            try:
                rest = rest[self._socket.send(rest) :]
            except TimeoutError:
                self._look()
            except OSError as error:
                raise Closed(str(error)) from error

    def _read(self, rest: memoryview) -> None:
        while len(rest):
            try:
                got = self._socket.recv_into(rest)
            except TimeoutError:
                self._look()
                continue
            except OSError as error:
                raise Closed(str(error)) from error
            if not got:
                raise Closed("end of file")
            if self._pace:
                self._pace()
            rest = rest[got:]

    def _look(self) -> None:
        if self._watch:
            self._watch()


def _bytes(array: Array) -> memoryview:
    """The memory of a contiguous array."""
    return memoryview(array.reshape(-1).view(np.uint8).data)
