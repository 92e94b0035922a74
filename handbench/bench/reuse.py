"""What other run folders have finished already: a cell or training of the same key is the same, wherever it lies."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from ..errors import HandbenchError
from .executor import finished
from .plan import Cell
from .store import Store


def run_folders(folder: Path) -> Iterator[Path]:
    """The run folders that lie in a folder."""
    if folder.is_dir():
        yield from sorted(path.parent for path in folder.glob("*/run.json") if path.is_file())


def take(store: Store, cells: Sequence[Cell], folders: Sequence[Path]) -> int:
    """Take missing cells with their pictures, and missing trainings, from other run folders; how many cells.

    Where only metrics differ, the cell of another plan is taken with its pictures, to be scored again. Files are linked
    where the disk allows it, else copied. What is damaged or not whole there is left, and computed.
    """
    others = [Store(folder) for folder in folders if folder.resolve() != store.folder.resolve()]
    drawings: list[tuple[Store, dict[str, str]]] = []
    own: dict[str, str] | None = None
    taken = 0
    for cell in cells:
        if any(_take_cell(store, other, cell) for other in others):
            taken += 1
        elif others:
            own = store.drawings() if own is None else own
            drawings = drawings or [(other, other.drawings()) for other in others]
            if cell.drawing not in own:
                found = ((other, other.drawn(keys.get(cell.drawing))) for other, keys in drawings)
                any(kept is not None and store.adopt_cell(other, kept) for other, kept in found)
        if store.prior(cell.prior) is None:
            any(store.adopt_prior(other, cell.prior) for other in others)
    return taken


def _take_cell(store: Store, other: Store, cell: Cell) -> bool:
    try:
        record = other.cell(cell.key)
    except HandbenchError:  # of a newer version, or behind a link
        return False
    return record is not None and finished(record) and store.adopt_cell(other, record)
