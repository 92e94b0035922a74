"""All reports of a run, written when something changed."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING

import handbench
from handbench.errors import Absent
from handbench.files import JSON_LIMIT, read_bytes, read_text, whole, writing
from handbench.results.schema import plain

from .agreement import as_json
from .build import build
from .latex import render_latex
from .run import Run, merged, read_run
from .text import render_csv, render_markdown

if TYPE_CHECKING:
    from .model import Table
    from .page import PageContent

STAMP = ".inputs"  # digest of what the reports were made from; written last
FIGURES = "figures"
_STAMP_LIMIT = 1 << 20  # bytes
_FILE = re.compile(rf"({FIGURES}/)?[^/\\]+")
_REMEDY = "make it writable, or copy the run to a folder of yours and report that"


def write_reports(
    run_folder: Path,
    figures: bool = False,
    table: Table | None = None,
    others: Sequence[Path] = (),
    baseline: str | None = None,
    out: Path | None = None,
) -> dict[str, Path]:
    """Write `report/` in the run folder: index.html, table.tex, table.csv, table.md.

    A run with published orders of methods has agreement.json, with every pair of methods, as well. With `figures`
    there are figures/*.png and *.pdf for papers too; a report that once had them keeps them up to date.
    `table` is the table of this run, if it has been made already. `others` are runs that share the page, `baseline`
    the method whose differences it shows; such a report goes into `out`, by default `compared/` in the run folder.

    Returns the files by their path inside the report's folder. When the runs have not changed since the last call,
    nothing is computed. A file is replaced whole or not at all. Raises `InputError` for a folder without
    a readable run and runs that cannot share a table, and `StorageError` if a file cannot be written.
    """
    run = merged([read_run(folder) for folder in (run_folder, *others)])
    folder = out or run_folder / ("compared" if others or baseline else "report")
    if out is None:
        for place in (folder, folder / FIGURES):
            run.store.own(place)
    digest = _digest(run.parts or (run,), baseline)
    asked = figures or (folder / FIGURES).is_dir()
    written = _written(folder, digest, asked)
    if written is None:
        contents = _contents(run, asked, table or build(run, baseline=baseline))
        written = sorted(contents)
        with writing(folder, _REMEDY):
            _write(folder, contents, digest)
    return {name: folder / name for name in written}


def _contents(run: Run, figures: bool, table: Table) -> dict[str, bytes]:
    from .curves import loss_figures  # imports matplotlib, which a cached report does without
    from .figures import panels
    from .page import PageContent, render_page
    from .pareto import plots
    from .viewer import viewer

    shown = PageContent(tuple(panels(run)), tuple(loss_figures(run)), plots(table), viewer(run, table))
    texts = {
        "index.html": render_page(table, run, shown),
        "table.tex": render_latex(table),
        "table.csv": render_csv(table),
        "table.md": render_markdown(table),
    }
    if table.agreements:
        texts["agreement.json"] = json.dumps([as_json(each) for each in table.agreements], indent=1) + "\n"
    return {name: text.encode() for name, text in texts.items()} | (_figures(shown, table) if figures else {})


def _figures(shown: PageContent, table: Table) -> dict[str, bytes]:
    from .pareto_figures import pareto_figures
    from .pictures import grid

    found = {f"{FIGURES}/losses-{each.name}.png": each.png for each in shown.losses}
    by_kind = groupby(shown.panels, key=lambda panel: panel.kind)
    grids = [(kind, grid(tuple(of_kind), table.metrics[0])) for kind, of_kind in by_kind]
    for name, files in (*grids, *pareto_figures(shown.plots)):
        found |= {f"{FIGURES}/{name}.{kind}": content for kind, content in files.items()}
    return found


def _digest(runs: Sequence[Run], baseline: str | None) -> str:
    """Of all a report is made from: plans, cells, trainings, studies, and the code and templates that show them."""
    digest = hashlib.sha256(json.dumps([handbench.__version__, baseline]).encode())
    here = Path(__file__).parent
    for path in (*sorted(here.glob("*.py")), *sorted((here / "templates").iterdir())):
        digest.update(f"\0{path.name}\0".encode() + path.read_bytes())
    for run in runs:
        origin = replace(run.plan.provenance, started="")  # a run that had nothing to do leaves the page
        plan = plain(replace(run.plan, provenance=origin))
        digest.update(json.dumps([str(run.folder) if len(runs) > 1 else "", plan], sort_keys=True).encode())
        cells = (run.folder / "cells" / f"{key}.json" for key in run.plan.cells)
        trainings = sorted((run.folder / "priors").glob("*/train.json"))
        studies = [
            path for path in sorted(run.folder.glob("*.json")) if path.name != "run.json"
        ]  # speed, stress, audit
        for path in (*cells, *trainings, *studies):
            with suppress(Absent):
                digest.update(f"\0{path.name}\0".encode() + read_bytes(run.store.own(path), JSON_LIMIT))
    return digest.hexdigest()


def _written(folder: Path, digest: str, figures: bool) -> list[str] | None:
    """The files of an earlier report of the same digest, with figures if they are wanted, or None."""
    try:
        found, *names = read_text(folder / STAMP, _STAMP_LIMIT).splitlines()
    except ValueError:  # absent, damaged or empty: written again
        return None
    if found != digest or (figures and not any(name.startswith(f"{FIGURES}/") for name in names)):
        return None
    return names if all(_FILE.fullmatch(name) and (folder / name).is_file() for name in names) else None


def _write(folder: Path, contents: dict[str, bytes], digest: str) -> None:
    for name, content in contents.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        with whole(folder / name, _REMEDY) as part:
            part.write_bytes(content)
    for figure in {*(folder / FIGURES).glob("*.png"), *(folder / FIGURES).glob("*.pdf")}:
        if figure.relative_to(folder).as_posix() not in contents:
            figure.unlink()
    with whole(folder / STAMP, _REMEDY) as part:
        part.write_text("\n".join([digest, *sorted(contents)]))
