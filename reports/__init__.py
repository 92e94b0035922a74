"""Tables, figures and pages of a run.

table(run_folder) -> Table              the one model every format is made from
render_terminal / latex / csv / markdown(table), as_json(table)
write_reports(run_folder) -> files      all of them and the HTML page, in `report/`
"""

from .build import table
from .latex import render_latex
from .model import Table
from .terminal import render_terminal
from .text import as_json, render_csv, render_markdown
from .write import write_reports

__all__ = [
    "Table",
    "as_json",
    "render_csv",
    "render_latex",
    "render_markdown",
    "render_terminal",
    "table",
    "write_reports",
]
