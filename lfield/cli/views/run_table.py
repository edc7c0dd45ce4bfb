"""The runs of this computer: as a table above their pictures, and as JSON."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from datetime import datetime
from typing import Any

from rich.table import Table

from lfield.cli.views import picture
from lfield.cli.views.trees import plain_console
from lfield.errors import LfieldError
from lfield.operator.addressed import Party, Place
from lfield.operator.ask import by_host
from lfield.operator.runs import Run
from lfield.text.visible import clipped, in_one_line
from lfield.wire.observing import Status

#: The longest text of a cell, in characters.
_CELL, _CELL_OF_OTHERS = 4000, 200


def show(runs: Sequence[Run]) -> None:
    """Print the table: what each run is called, whose it is, and which hosts of its mission it runs here."""
    shown = Table(box=None, pad_edge=False)
    for column in ("RUN", "HOSTS", "USER", "UP SINCE", "MISSION"):
        shown.add_column(column, overflow="fold")
    for run in runs:
        note = run.note
        cells = (run.id, " ".join(note.doors), run.owner, _time(note.started), note.mission)
        most = _CELL_OF_OTHERS if run.is_foreign else _CELL
        shown.add_row(*(clipped(in_one_line(cell), most) for cell in cells))
    plain_console().print(shown)


def _time(seconds: float) -> str:
    return datetime.fromtimestamp(seconds).astimezone().isoformat(" ", "seconds")


def as_json(parties: Sequence[Party], answers: Mapping[Place, Status | LfieldError]) -> str:
    """The runs, and what every host says of itself, or why it says nothing."""
    return json.dumps({party.id: _party(party, answers) for party in parties}, indent=2)


def _party(party: Party, answers: Mapping[Place, Status | LfieldError]) -> dict[str, Any]:
    runs = [
        {
            "id": run.id,
            "mission": run.note.mission,
            "user": run.owner,
            "since": _time(run.note.started),
            "hosts": list(run.note.doors),
        }
        for run in party.runs
    ]
    return {"runs": runs, "hosts": picture.as_data(by_host(answers, party))}
