"""The results of a run on disk: append-only, one JSON file a cell, whole or absent.

    run.json                        what the last run planned: protocol, metrics, methods, cells, provenance
    cells/<cell key>.json           one finished cell, with a digest of each picture; files of earlier plans stay
    predictions/<cell key>/*.exr    what the method drew, half floats, one file a query ("/" becomes "__")
    priors/<prior key>/             state/ as the method saved it, and train.json with a digest of each file
    checkpoints/<key>/              trainings under way, of priors and of cells; gone when they are done
    lights/<lighting>.png           what is seen around the hand, for the page
    claims/<key>                    cells and trainings that a process is at work on; gone when they are done

Everything is written under a temporary name beside its place, flushed, and renamed, so a reader or a second
process never sees half a file. A record holds a digest of itself: see `record` and `recordfile`. Nothing is read or
written outside of the folder.
"""

from __future__ import annotations

import errno
import shutil
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

import numpy as np

from ..checkpoint import Checkpoints, checkpoints_in
from ..claims import claim, holder
from ..data.predictionfiles import flat_path
from ..errors import Absent, Damaged, HandbenchError, StorageError
from ..files import JSON_LIMIT, check_name, read_bytes, writing
from ..results.measured import CurvePoint
from ..results.record import CellRecord, PriorRecord, RunRecord
from ..results.recordfile import dump, parse
from ..scene import Prediction
from .metering import Meter
from .wholefiles import abandoned, files_in, link, part_of, put, remove, sha256

_Record = TypeVar("_Record", RunRecord, CellRecord, PriorRecord)
_PARTS = ("cells", "predictions", "priors", "checkpoints", "claims")  # of a run folder
_HALF_MAX = float(np.finfo(np.float16).max)


class Store:
    """A run folder. Making one touches nothing on disk; `prepare` creates the folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def prepare(self) -> None:
        """Create the folder and remove what killed processes of this machine left half-written.

        Raises `StorageError` if the folder or one that it keeps results in cannot be written.
        """
        check_name(self.folder)
        with writing(self.folder):
            self.folder.mkdir(parents=True, exist_ok=True)
        for name in _PARTS:
            self.own(self.folder / name)
        for place in self._places():
            with writing(place):
                probe = part_of(place / "probe")
                probe.touch()
                probe.unlink()
        self.sweep()

    def sweep(self) -> None:
        """Remove what killed processes of this machine left: half-written files, and claims that nobody has."""
        for place in self._places():
            with writing(place):
                for path in place.glob(".*.*.*.*.tmp"):
                    if abandoned(path):
                        remove(path)
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

    def run(self) -> RunRecord | None:
        """The plan of the last run, None if it is absent or damaged. Raises `InputError` for a newer version's."""
        return _unless_damaged(self.read_run)

    def read_run(self) -> RunRecord | None:
        """The plan of the last run, or None if it is absent. Raises `Damaged`, naming the field, and as `run` does."""
        return self._read(RunRecord, self.folder / "run.json")

    def write_run(self, run: RunRecord) -> None:
        self._write(self.folder / "run.json", run)

    def cell(self, key: str) -> CellRecord | None:
        """A finished cell, None if it is absent or damaged. Raises `InputError` for a newer version's."""
        return _unless_damaged(lambda: self.read_cell(key))

    def read_cell(self, key: str) -> CellRecord | None:
        """A finished cell, or None if it is absent. Raises `Damaged`, naming the field, and as `cell` does."""
        path = self.folder / "cells" / f"{key}.json"
        cell = self._read(CellRecord, path)
        if cell is not None and cell.key != key:
            raise Damaged(f"{path} is damaged: key is {cell.key!r}, not its name; run again into this folder")
        return cell

    def write_cell(self, cell: CellRecord) -> None:
        self._write(self.folder / "cells" / f"{cell.key}.json", cell)

    def write_prediction(self, key: str, query: str, prediction: Prediction) -> str:
        """Keep a finite prediction for the reports' figures; values beyond half floats are clipped.

        Returns the SHA-256 of its file.
        """
        from ..data.exr import rgb, write_exr

        path = self.picture(key, query)
        with writing(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            image, alpha = (np.clip(a, -_HALF_MAX, _HALF_MAX) for a in (prediction.image, prediction.alpha))
            write_exr(path, {**rgb(image), "A": alpha.astype(np.float16)})
            return sha256(path)

    def picture(self, key: str, query: str) -> Path:
        """Where a cell keeps its picture of a query."""
        return flat_path(self.folder / "predictions" / key, query)

    def light(self, name: str) -> Path:
        """Where the picture of a light is, by the name of its lighting or the key of its frame."""
        return flat_path(self.folder / "lights", name, ".png")

    def write_light(self, name: str, content: bytes) -> None:
        """Keep the picture of a light."""
        path = self.own(self.light(name))
        part = part_of(path)
        with writing(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            part.write_bytes(content)
            part.replace(path)

    def read_prediction(self, cell: CellRecord, query: str) -> Prediction:
        """The picture that a cell kept of a query, in half floats.

        Raises `Damaged` if it is not what was written, and `InputError` if it is not there or no picture.
        """
        from ..data.exr import read_exr, stack

        path = self.picture(cell.key, query)
        if path.exists():
            self._check(path, cell.predictions.get(query, ""), "run again into an empty folder")
        channels = read_exr(path)
        return Prediction(stack(channels, ("R", "G", "B"), path), stack(channels, ("A",), path)[..., 0])

    def prior(self, key: str) -> PriorRecord | None:
        """What is known of a kept training; None if it is absent or damaged."""
        return _unless_damaged(lambda: self.read_prior(key))

    def read_prior(self, key: str) -> PriorRecord | None:
        """What is known of a kept training, or None if it is absent. Raises `Damaged`, naming the field."""
        return self._read(PriorRecord, self.folder / "priors" / key / "train.json")

    def sound_state(self, key: str) -> Path:
        """The folder for `Method.load`, each file of it as it was written. Raises `Damaged` if one is not."""
        state = self.prior_state(key)
        record = self.read_prior(key)
        for name, digest in (record.files if record else {}).items():
            self._check(state / name, digest, "run again into this folder, which trains again")
        return state

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
        remove(self.folder / "checkpoints" / key)

    @contextmanager
    def writing_prior(self, key: str, method: str, seed: int, config: object) -> Iterator[NewPrior]:
        """A new training, whose state goes into an empty folder; it takes its place if the block ends well."""
        target = self.folder / "priors" / key
        part = part_of(target)
        new = NewPrior(part / "state")
        try:
            with writing(target):
                new.state.mkdir(parents=True)
            yield new
            with writing(target):
                files = {file.relative_to(new.state).as_posix(): sha256(file) for file in files_in(new.state)}
                about = (method, seed, new.train_s, files, new.curve)
                taken = (new.meter.peak_mb, new.meter.vram_mb, new.meter.energy_j)
                record = PriorRecord(*about, *taken, config)
                put(part / "train.json", dump(record))
                if self.prior(key) is None:  # absent or damaged: not yet brought in by another process
                    shutil.rmtree(target, ignore_errors=True)
                    try:
                        part.rename(target)
                    except OSError as error:  # another process was faster; its prior has the same key
                        if error.errno not in (errno.ENOTEMPTY, errno.EEXIST):
                            raise
        finally:
            remove(part)

    def adopt_cell(self, other: Store, cell: CellRecord) -> bool:
        """Take a finished cell of another folder, pictures first; False if one of them is not there as it was kept."""
        pictures = [(other.picture(cell.key, query), self.picture(cell.key, query)) for query in cell.predictions]
        try:
            for (source, _), digest in zip(pictures, cell.predictions.values(), strict=True):
                other._check(source, digest, "it is not taken")
        except (HandbenchError, OSError):
            return False
        for source, target in pictures:
            with writing(target):
                target.parent.mkdir(parents=True, exist_ok=True)
                link(source, self.own(target))
        self.write_cell(cell)
        return True

    def drawings(self) -> dict[str, str]:
        """The cells of this and earlier plans that did not crash, by the key of their pictures."""
        keys = (path.stem for path in sorted((self.folder / "cells").glob("*.json")))
        return {cell.drawing: key for key in keys if (cell := self.drawn(key)) is not None and cell.drawing}

    def drawn(self, key: str | None) -> CellRecord | None:
        """A cell that did not crash, None if it is absent, damaged or another version's."""
        try:
            cell = None if key is None else self.cell(key)
        except HandbenchError:  # of a newer version, or behind a link
            return None
        return cell if cell is not None and cell.error is None else None

    def share_pictures(self, cell: CellRecord, key: str) -> None:
        """Give the cell of another key the pictures of a cell of this folder."""
        for query in cell.predictions:
            target = self.own(self.picture(key, query))
            with writing(target):
                target.parent.mkdir(parents=True, exist_ok=True)
                link(self.picture(cell.key, query), target)

    def adopt_prior(self, other: Store, key: str) -> bool:
        """Take a training of another folder; False if it has none that is whole."""
        try:
            record = other.read_prior(key)
            if record is None:
                return False
            state = other.sound_state(key)
        except (HandbenchError, OSError):
            return False
        with self.writing_prior(key, record.method, record.seed, record.config) as new:
            new.train_s, new.curve = record.train_s, record.curve
            new.meter = Meter(record.peak_mb, record.vram_mb, record.energy_j)
            for name in record.files:
                (new.state / name).parent.mkdir(parents=True, exist_ok=True)
                link(state / name, new.state / name)
        return True

    def own(self, path: Path) -> Path:
        """A path of this folder. Raises `StorageError` if a link leads out of it: a run folder may be a stranger's."""
        if not path.resolve().is_relative_to(self.folder.resolve()):
            raise StorageError(f"{path} leads out of {self.folder} by a link; put the file itself there")
        return path

    def _read(self, kind: type[_Record], path: Path) -> _Record | None:
        try:
            return parse(kind, read_bytes(self.own(path), JSON_LIMIT), path)
        except Absent:
            return None

    def _write(self, path: Path, record: RunRecord | CellRecord) -> None:
        text = dump(record)
        part = part_of(self.own(path))
        with writing(path):
            try:
                path.parent.mkdir(parents=True, exist_ok=True)
                put(part, text)
                part.replace(path)
            finally:
                remove(part)

    def _check(self, path: Path, digest: str, remedy: str) -> None:
        """Whether a file is what was written; records of version 1 cannot tell."""
        if not self.own(path).is_file():
            raise Damaged(f"{path} is not there or no file; {remedy}")
        if digest and sha256(path) != digest:
            raise Damaged(f"{path} is damaged: it was changed after it was written; {remedy}")


@dataclass
class NewPrior:
    """A training to be kept: the folder for `Prior.save`, and what is told of it."""

    state: Path
    train_s: float = 0.0
    curve: tuple[CurvePoint, ...] = ()
    meter: Meter = field(default_factory=Meter)


def _unless_damaged(read: Callable[[], _Record | None]) -> _Record | None:
    try:
        return read()
    except Damaged:  # by something else than us: computed again
        return None
