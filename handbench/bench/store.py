"""The results of a run on disk: append-only, one JSON file a cell, whole or absent.

    run.json                        what the last run planned: protocol, metrics, methods, cells, provenance
    cells/<cell key>.json           one finished cell; files of earlier plans stay
    predictions/<cell key>/*.exr    what the method drew, half floats, one file a query ("/" becomes "__")
    priors/<prior key>/             state/ as the method saved it, and train.json
    checkpoints/<key>/              trainings under way, of priors and of cells; gone when they are done
    claims/<key>                    cells and trainings that a process is at work on; gone when they are done

Everything is written under a temporary name beside its place, flushed, and renamed, so a reader or a second
process never sees half a file.
"""

from __future__ import annotations

import errno
import json
import os
import shutil
import socket
import uuid
from collections.abc import Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np

from ..checkpoint import Checkpoints, checkpoints_in
from ..errors import InputError
from ..files import writing
from ..scene import Prediction
from .claims import claim, holder

SCHEMA = 1
_HALF_MAX = float(np.finfo(np.float16).max)


class Store:
    """A run folder. Making one touches nothing on disk; `prepare` creates the folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def prepare(self) -> None:
        """Create the folder and remove what killed processes of this machine left half-written.

        Raises `StorageError` if the folder or one that it keeps results in cannot be written.
        """
        with writing(self.folder):
            self.folder.mkdir(parents=True, exist_ok=True)
        for place in self._places():
            with writing(place):
                probe = _part(place / "probe")
                probe.touch()
                probe.unlink()
        self.sweep()

    def sweep(self) -> None:
        """Remove what killed processes of this machine left: half-written files, and claims that nobody has."""
        for place in self._places():
            with writing(place):
                for path in place.glob(".*.*.*.*.tmp"):
                    if _abandoned(path):
                        _remove(path)
        for path in (self.folder / "claims").glob("*"):
            with self.claim(path.name):  # what nobody has, goes with this
                pass

    def _places(self) -> list[Path]:
        """The folders that hold results, as far as they are there."""
        places = (self.folder, *(self.folder / name for name in ("cells", "predictions", "priors")))
        return [place for place in places if place.exists()]

    @contextmanager
    def claim(self, key: str) -> Iterator[bool]:
        """Whether no other process is at work on a cell or a training: then this one is, inside the block."""
        with ExitStack() as stack:
            with writing(self.folder):
                mine = stack.enter_context(claim(self.folder / "claims" / key))
            yield mine

    def holder(self, *keys: str) -> str:
        """Machine and process of whoever has the first of these claims that is taken, for people."""
        holders = (holder(self.folder / "claims" / key) for key in keys)
        return next((name for name in holders if name is not None), "another process")

    def run(self) -> dict[str, Any] | None:
        """The plan of the last run, or None. Raises `InputError` if a newer version wrote it."""
        return _read(self.folder / "run.json")

    def write_run(self, content: dict[str, Any]) -> None:
        self._write(self.folder / "run.json", content)

    def cell(self, key: str) -> dict[str, Any] | None:
        """A finished cell, or None if it is absent or damaged. Raises `InputError` if a newer version wrote it."""
        cell = _read(self.folder / "cells" / f"{key}.json")
        return cell if cell is not None and cell.get("key") == key else None

    def write_cell(self, cell: dict[str, Any]) -> None:
        self._write(self.folder / "cells" / f"{cell['key']}.json", cell)

    def write_prediction(self, key: str, query: str, prediction: Prediction) -> str:
        """Keep a finite prediction for the reports' figures; values beyond half floats are clipped.

        Returns the folder of the cell's predictions, relative to the run.
        """
        from ..data.exr import rgb, write_exr

        folder = f"predictions/{key}"
        path = self.folder / folder / f"{query.replace('/', '__')}.exr"
        with writing(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            image, alpha = (np.clip(a, -_HALF_MAX, _HALF_MAX) for a in (prediction.image, prediction.alpha))
            write_exr(path, {**rgb(image), "A": alpha.astype(np.float16)})
        return folder

    def prior(self, key: str) -> dict[str, Any] | None:
        """What is known of a kept prior, or None."""
        return _read(self.folder / "priors" / key / "train.json")

    def prior_state(self, key: str) -> Path:
        return self.folder / "priors" / key / "state"

    def remove_prior(self, key: str) -> None:
        folder = self.folder / "priors" / key
        with writing(folder), suppress(FileNotFoundError):  # another process may have been faster
            shutil.rmtree(folder)

    def checkpoints(self, key: str) -> AbstractContextManager[Checkpoints]:
        """Let a training of a prior or a cell keep its state, so that it goes on if it is stopped."""
        return checkpoints_in(self.folder / "checkpoints" / key)

    def remove_checkpoints(self, key: str) -> None:
        _remove(self.folder / "checkpoints" / key)

    @contextmanager
    def writing_prior(self, key: str, about: dict[str, Any]) -> Iterator[Path]:
        """An empty folder for `Prior.save`; it takes its place when the block ends without an error."""
        target = self.folder / "priors" / key
        part = _part(target)
        try:
            with writing(target):
                (part / "state").mkdir(parents=True)
            yield part / "state"
            with writing(target):
                _dump(part / "train.json", {"schema": SCHEMA, **about})
                if self.prior(key) is None:  # absent or damaged: not yet brought in by another process
                    shutil.rmtree(target, ignore_errors=True)
                    try:
                        part.rename(target)
                    except OSError as error:  # another process was faster; its prior has the same key
                        if error.errno not in (errno.ENOTEMPTY, errno.EEXIST):
                            raise
        finally:
            _remove(part)

    def _write(self, path: Path, content: dict[str, Any]) -> None:
        part = _part(path)
        with writing(path):
            try:
                path.parent.mkdir(parents=True, exist_ok=True)
                _dump(part, content)
                part.replace(path)
            finally:
                _remove(part)


def _dump(path: Path, content: dict[str, Any]) -> None:
    with path.open("w", encoding="utf-8") as file:
        json.dump(content, file, indent=1, allow_nan=False)
        file.write("\n")
        file.flush()
        os.fsync(file.fileno())


def _read(path: Path) -> dict[str, Any] | None:
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (FileNotFoundError, NotADirectoryError, ValueError):
        return None  # absent, or damaged by something else than us: computed again
    except OSError as error:
        raise InputError(f"{path} cannot be read ({error.strerror}); check its permissions") from error
    if not isinstance(content, dict):
        return None
    schema = content.get("schema")
    if isinstance(schema, int) and schema > SCHEMA:
        raise InputError(
            f"{path} was written by a newer version (schema {schema}, we read {SCHEMA}); upgrade handbench"
        )
    return content if schema == SCHEMA else None


def _part(path: Path) -> Path:
    """A name beside `path` that says which process writes it."""
    return path.with_name(f".{path.name}.{_host()}.{os.getpid()}.{uuid.uuid4().hex[:8]}.tmp")


def _abandoned(part: Path) -> bool:
    """Whether a temporary file's process lived on this machine and is gone."""
    _, host, pid, *_ = part.name.rsplit(".", 4)
    if host != _host() or not pid.isdigit():
        return False
    try:
        os.kill(int(pid), 0)
    except ProcessLookupError:
        return True
    except OSError:
        return False
    return False


def _host() -> str:
    return socket.gethostname().replace(".", "-")


def _remove(path: Path) -> None:
    if path.is_dir():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)
