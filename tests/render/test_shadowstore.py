"""Shadows on disk: what comes back is what went in, in a bounded folder, whatever happens to it."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from handbench.bench.priors import Priors, Training
from handbench.bench.store import Store
from handbench.render.see import shadowstore
from handbench.render.see.shadowstore import ShadowStore, kept_on_disk, shadow_store, surface_key
from handbench.scene import Array

SURFACE, OTHER = surface_key([np.arange(3)], "a"), surface_key([np.arange(3)], "b")


def lights(count: int, first: int = 0) -> dict[bytes, Array]:
    """Rows of 64 bytes that follow from their light's name."""
    return {b"d%08d" % i: np.random.default_rng(i).integers(0, 256, 64, np.uint8) for i in range(first, first + count)}


def same(found: object, rows: dict[bytes, Array]) -> bool:
    held = dict(found)  # type: ignore[call-overload]
    return held.keys() == rows.keys() and all(np.array_equal(held[name], row) for name, row in rows.items())


def used(folder: Path) -> int:
    return sum(path.stat().st_size for path in folder.iterdir())


def test_what_is_written_is_read_by_another_store_and_by_no_other_surface(tmp_path: Path) -> None:
    rows = lights(5)
    ShadowStore(tmp_path / "new", 1 << 20).write(SURFACE, rows)
    assert same(ShadowStore(tmp_path / "new", 1 << 20).read(SURFACE, 64), rows)
    assert not ShadowStore(tmp_path / "new", 1 << 20).read(OTHER, 64)
    assert not ShadowStore(tmp_path / "none", 1 << 20).read(SURFACE, 64)


def test_single_lights_are_merged_into_few_files(tmp_path: Path) -> None:
    store = ShadowStore(tmp_path, 1 << 20)
    rows = lights(100)
    for name, row in rows.items():
        store.write(SURFACE, {name: row})
    assert len(list(tmp_path.iterdir())) <= 16
    assert same(ShadowStore(tmp_path, 1 << 20).read(SURFACE, 64), rows)


def test_the_folder_is_bounded_and_what_was_read_last_stays(tmp_path: Path) -> None:
    limit = 40_000
    store = ShadowStore(tmp_path, limit)
    names = [surface_key([], i) for i in range(12)]
    for age, name in enumerate(names):
        if age > 2:
            assert ShadowStore(tmp_path, limit).read(names[0], 64)  # in use all the time
        store.write(name, lights(80))
        assert used(tmp_path) <= limit
        for path in tmp_path.glob(f"{name}*"):
            os.utime(path, (1000 + age, 1000 + age))
    kept = [bool(ShadowStore(tmp_path, limit).read(name, 64)) for name in names]
    assert kept[0] and kept[-1] and not kept[1] and 3 <= sum(kept) <= 6


def test_rows_larger_than_the_bound_are_not_kept(tmp_path: Path) -> None:
    store = ShadowStore(tmp_path, 1500)
    store.write(SURFACE, lights(2))
    store.write(OTHER, lights(200))
    assert used(tmp_path) <= 1500 and not ShadowStore(tmp_path, 1500).read(OTHER, 64)


def _cut(content: bytes) -> bytes:
    return content[: len(content) // 2]


def _flip(content: bytes) -> bytes:
    middle = len(content) // 2
    return content[:middle] + bytes([content[middle] ^ 1]) + content[middle + 1 :]


@pytest.mark.parametrize("damage", [_cut, _flip, lambda c: b"", lambda c: b"\x93NUMPY", lambda c: b"PK\x03\x04" + c])
def test_damaged_files_are_ignored_and_go(tmp_path: Path, damage) -> None:
    ShadowStore(tmp_path, 1 << 20).write(SURFACE, lights(50))
    ShadowStore(tmp_path, 1 << 20).write(SURFACE, lights(50, first=50))
    path = next(tmp_path.iterdir())
    path.write_bytes(damage(path.read_bytes()))
    found = ShadowStore(tmp_path, 1 << 20).read(SURFACE, 64)
    intact = [rows for rows in (lights(50), lights(50, first=50), lights(100)) if same(found, rows)]
    assert intact and (len(found) == 100 or not path.exists())


def test_rows_of_another_width_are_not_taken(tmp_path: Path) -> None:
    ShadowStore(tmp_path, 1 << 20).write(SURFACE, lights(3))
    assert not ShadowStore(tmp_path, 1 << 20).read(SURFACE, 65)


def test_a_folder_that_cannot_be_written_is_no_cache(tmp_path: Path) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("")
    store = ShadowStore(blocked / "shadows", 1 << 20)
    store.write(SURFACE, lights(2))
    assert not ShadowStore(blocked / "shadows", 1 << 20).read(SURFACE, 64)


def test_a_full_disk_leaves_nothing_behind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(file, **arrays) -> None:
        file.write(b"PK")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np, "savez", full)
    ShadowStore(tmp_path, 1 << 20).write(SURFACE, lights(2))
    assert not list(tmp_path.iterdir())


def test_what_killed_writers_left_goes_and_foreign_files_stay(tmp_path: Path) -> None:
    foreign, part, fresh = tmp_path / "notes.part", tmp_path / ".a-b.shadows.7.part", tmp_path / ".a-c.shadows.7.part"
    for path in (foreign, part, fresh):
        path.write_text("x")
    for path in (foreign, part):
        os.utime(path, (time.time() - 7200,) * 2)
    ShadowStore(tmp_path, 4000).write(SURFACE, lights(2))
    assert foreign.exists() and fresh.exists() and not part.exists()


_WORKER = """
import sys
from pathlib import Path
import numpy as np
from handbench.render.see.shadowstore import ShadowStore, surface_key

store, first = ShadowStore(Path(sys.argv[1]), 60_000), int(sys.argv[2])
for i in range(40):
    surface = surface_key([], i % 5)
    names = range(first + i, first + i + 10)
    wanted = {b"d%08d" % j: np.random.default_rng(j).integers(0, 256, 64, np.uint8) for j in names}
    found = store.read(surface, 64)
    assert all(np.array_equal(found[name], row) for name, row in wanted.items() if name in found)
    store.write(surface, wanted)
"""


def test_processes_share_a_folder(tmp_path: Path) -> None:
    workers = [subprocess.Popen([sys.executable, "-c", _WORKER, str(tmp_path), str(5 * k)]) for k in range(3)]
    assert [worker.wait(60) for worker in workers] == [0, 0, 0]
    assert used(tmp_path) <= 1.2 * 60_000
    every = lights(60)
    for i in range(5):
        for name, row in ShadowStore(tmp_path, 60_000).read(surface_key([], i), 64).items():
            assert np.array_equal(row, every[name])


def test_it_is_off_unless_asked_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert shadow_store() is None
    with kept_on_disk(tmp_path, 100):
        assert shadow_store().folder == tmp_path
    assert shadow_store() is None
    monkeypatch.setenv("HANDBENCH_DATA", str(tmp_path))
    assert shadowstore.default_folder() == tmp_path / "shadows"


def test_digests_tell_shapes_types_and_parameters_apart() -> None:
    a = np.zeros((2, 3))
    keys = [surface_key([a]), surface_key([a.reshape(3, 2)]), surface_key([a.astype(int)]), surface_key([a], 1)]
    assert len(set(keys)) == 4 and surface_key([a.copy()]) == keys[0]


def test_training_keeps_its_shadows_in_the_cache_and_only_training(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setenv("HANDBENCH_DATA", str(tmp_path / "data"))
    told: list[Path | None] = []

    class Told:
        """A method and a prior that tell which folder shadows are kept in."""

        info, config = SimpleNamespace(name="told"), {}

        def train(self, recording: object, seed: int, progress: object) -> Told:
            told.append(shadow_store().folder)
            return self

        def save(self, folder: Path) -> None:
            told.append(shadow_store())

        def load(self, folder: Path) -> Told:
            told.append(shadow_store())
            return self

    training = Training("key", Told(), 0, lambda: None, lambda: None)
    Priors(Store(tmp_path / "run")).get(training, lambda *told, **values: None)
    assert told == [tmp_path / "data" / "shadows", None, None]
