"""The data of the page's viewer: every scored frame, as the truth and as each method drew it, with the scores.

All pictures of a frame are cut and exposed alike (`frames.Framing`), as WebP. A page stays small: with many pixels to
show, each column gives the same number of frames, spread evenly over its own order.
"""

from __future__ import annotations

import base64
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from handbench.bench.scoring import SHOWN
from handbench.bench.store import Store
from handbench.evenly import evenly
from handbench.files import read_bytes
from handbench.scene import Array

from .conclusion import leader
from .figures import ERROR_SCALE
from .frames import KINDS, Answer, Framing, answers
from .model import Table
from .pictures import KNEE, STOPS, beyond_white, palette, webp
from .printed import number
from .run import Run
from .truth import truth_of

PIXELS = 60e6  # in all pictures of a page together: about 10 MB
_LAMP_LIMIT = 1 << 20  # bytes of the picture of a light
SIDE = 512  # pixels, the greatest side of a picture


@dataclass(frozen=True)
class Viewer:
    """`data` as the page's script reads it; `seed` is that of the pictures where there are several.

    Of the `scored` frames some were `chosen`, all or an even share, and of those some are `shown`: the truth of the
    others is lost.
    """

    data: dict[str, Any]
    shown: int
    chosen: int
    scored: int
    seed: int | None


def viewer(run: Run, table: Table) -> Viewer | None:
    """The viewer opens with the truth beside the method that the conclusion is about, or the last.

    None for a run whose truth is not known: there is nothing to hold a method against.
    """
    given, truth = answers(run), truth_of(run)
    methods = [method for method in run.plan.methods if not method.truth and method.name in given]
    columns = {column.name: dict.fromkeys(column.queries) for column in run.plan.protocol.columns}
    scored = list(dict.fromkeys(query for queries in columns.values() for query in queries))
    first = next((pair for query in scored if (pair := truth(query)) is not None), None)
    if first is None or not methods:
        return None
    chosen = _spread(columns, per_column(first[0].shape[:2], 1 + len(methods), len(columns)))

    oracle = next((method.name for method in run.plan.methods if method.truth), "")

    def frame(query: str) -> dict[str, Any] | None:
        pair = truth(query)
        of_query = [given[method.name].get(query) for method in methods]
        names = [name for name, queries in columns.items() if query in queries]
        if pair is None and not any(answer is not None and answer.frame.reason == SHOWN for answer in of_query):
            return None
        return _frame(run, query, pair, of_query, names, _file(given[oracle].get(query), query))

    with ThreadPoolExecutor() as pool:  # pictures are decoded and coded outside of Python
        drawn = pool.map(frame, (query for query in scored if query in chosen))
        frames = [found for found in drawn if found is not None]
    names, best = [method.name for method in methods], leader(table)
    data = {
        "best": 1 + names.index(best.name) if best and best.name in names else len(names),
        "titles": ["Truth", *(method.title for method in methods)],
        "metrics": [{"title": metric.title, "unit": metric.unit} for metric in run.plan.protocol.metrics],
        "columns": {column.name: column.title for column in run.plan.protocol.columns},
        "kinds": KINDS,
        "scale": ERROR_SCALE,
        "knee": KNEE,
        "stops": STOPS,
        "names": ["truth", *names],
        "colours": palette().tobytes().hex(),
        "lamps": _lamps(run, frames),
        "frames": frames,
    }
    seeds = table.seeds
    return Viewer(data, len(frames), len(chosen), len(scored), seeds[0] if len(seeds) > 1 else None)


def _lamps(run: Run, frames: Sequence[dict[str, Any]]) -> list[str]:
    """The pictures of the frames' lights as base64, each once; sets each frame's place in them, or None."""
    found: dict[Path, int] = {}
    for frame in frames:
        query = "/".join(frame[part] for part in ("subject", "pose", "camera", "light"))
        stores = [Store(folder) for folder in (run.folder, *run.others)]
        paths = (store.own(store.light(name)) for store in stores for name in (query, frame["light"]))
        path = next((path for path in paths if path.is_file()), None)
        frame["lamp"] = None if path is None else found.setdefault(path, len(found))
    return [base64.b64encode(read_bytes(path, _LAMP_LIMIT)).decode() for path in found]


def per_column(size: tuple[int, int], pictures: int, columns: int) -> int:
    """How many frames a column shows, given the size of a picture, (H, W), and the pictures of a frame."""
    shrunk = min(1.0, SIDE / max(size))
    return max(1, int(PIXELS / (size[0] * size[1] * shrunk**2 * pictures * columns)))


def _spread(columns: Mapping[str, Mapping[str, None]], limit: int) -> set[str]:
    """Up to `limit` queries of each column, evenly spread; those of several columns count in each."""
    return {query for queries in columns.values() for query in evenly(list(queries), limit)}


def _frame(
    run: Run,
    query: str,
    truth: tuple[Array, Array] | None,
    given: Sequence[Answer | None],
    columns: list[str],
    file: str,
) -> dict[str, Any] | None:
    """A frame's pictures; without a truth, under a map of the user's, they are cut and exposed as the first one is.

    `file` is where the truth's half floats are.
    """
    subject, pose, camera, light = query.split("/", 3)
    drawn = [answer.picture(run, query) if answer else (None, "not computed") for answer in given]
    shown = truth or next(((image, image.max(axis=-1) > 0) for image, _ in drawn if image is not None), None)
    if shown is None:
        return None
    view = Framing.of(*shown)
    return {
        "subject": subject,
        "pose": pose,
        "camera": camera,
        "light": light,
        "kind": next((answer.kind for answer in given if answer), ""),
        "columns": columns,
        "exposure": f"{view.exposure:.2g}",
        "pictures": [
            None if truth is None else webp(beyond_white(view.linear(truth[0])), SIDE),
            *_pictures(view, drawn),
        ],
        "files": [file, *(_file(answer, query) for answer in given)],
        "reasons": [SHOWN if truth is None else "", *(reason for _, reason in drawn)],
        "scores": [None, *(_scores(run, answer) for answer in given)],
    }


def _pictures(view: Framing, drawn: Sequence[tuple[Array | None, str]]) -> Iterator[str | None]:
    for picture, _ in drawn:
        yield None if picture is None else webp(beyond_white(view.linear(picture)), SIDE)


def _file(answer: Answer | None, query: str) -> str:
    """Where the run folder keeps the half floats of a picture, "" if nowhere."""
    if answer is None or query not in answer.cell.predictions:
        return ""
    return Store(Path()).picture(answer.cell.key, query).as_posix()


def _scores(run: Run, answer: Answer | None) -> list[str]:
    """As text, in the order of the protocol's metrics."""
    metrics = run.plan.protocol.metrics
    return [number(answer.value(m.signature) if answer else None, m.decimals) for m in metrics]
