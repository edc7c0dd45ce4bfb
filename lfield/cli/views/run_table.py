"""The runs of this computer: as a table above their pictures, and as JSON."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime

from rich.table import Table

from lfield.cli.views.trees import plain_console
from lfield.operator.runs import Run
from lfield.text.terminal_escape import escape_line, truncate

#: The longest text of a cell, in characters.
_CELL, _CELL_OF_OTHERS = 4000, 200


def show(runs: Sequence[Run]) -> None:
    """Print the table: the name and owner of each run, and the hosts of its mission that it runs here."""
    table = Table(box=None, pad_edge=False)
    for column in ("RUN", "HOSTS", "USER", "UP SINCE", "MISSION"):
        table.add_column(column, overflow="fold")
    for run in runs:
        note = run.manifest
        cells = (run.id, " ".join(note.control_sockets), run.owner, _time(note.started), note.mission)
        limit = _CELL_OF_OTHERS if run.is_foreign else _CELL
        table.add_row(*(truncate(escape_line(cell), limit) for cell in cells))
    plain_console().print(table)


def _time(seconds: float) -> str:
    return datetime.fromtimestamp(seconds).astimezone().isoformat(" ", "seconds")
