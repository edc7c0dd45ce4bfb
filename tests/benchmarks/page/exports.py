"""The cost of exporting 60,000 events of two copters and a hopping coordinator, in each format.

Six of ten events are telemetry with 20 quantities, four belong to a portal call with its hop.
"""

from __future__ import annotations

import io
import math
from collections.abc import Iterator

from harness.checkout import Checkout
from harness.figure import Figure, Opener
from harness.number_text import BYTES
from harness.processes import Processes
from harness.samples import Contender, timed

from lfield.client.event_json import event_json
from lfield.export.mcap_writer import export_mcap
from lfield.export.tables.csv_tables import export_csv
from lfield.operator.dashboard.timeline.event_timeline import DatedEvent
from lfield.wire import events
from lfield.wire.events import Event, StateEvent

COUNT = 60_000
START = 1_700_000_000.0
HOSTS = ("alpha", "bravo")
#: Seconds between two events.
STEP = 0.02


def stream() -> list[DatedEvent]:
    """The events in order."""
    return [
        DatedEvent(host, 1, Event(n + 1, START + n * STEP, n * STEP, 0, what), None)
        for n, (host, what) in zip(range(COUNT), _flight(), strict=False)
    ]


def _flight() -> Iterator[tuple[str, StateEvent | events.DeviceTelemetry]]:
    for hop in range(COUNT):
        source, target = HOSTS[hop % 2], HOSTS[(hop + 1) % 2]
        for turn in range(6):
            yield HOSTS[turn % 2], _measured(HOSTS[turn % 2], hop * 10 + turn)
        yield source, events.MigrationStarted("boss", 1, hop, target, f"{target}_copter", "go", 600)
        yield target, events.MigrationArrived("boss", 1, hop, source, 600)
        yield target, events.PortalCallEnded(hop, "boss", f"{target}_copter", "go", 0.1, "done")
        yield source, events.MigrationConfirmed("boss", 1, hop, target, 0.004)


def _measured(host: str, n: int) -> events.DeviceTelemetry:
    angle = n * STEP / 20
    north, east = 50 * math.cos(angle), 50 * math.sin(angle)
    place = [47.4 + north / 111_000, 8.5 + east / 75_000, 420.0]
    values = {"globalPosition": place, "attitude": [0.01, 0.02, angle % 6.28], "heading": angle % 6.28}
    figures = {f"quantity{k}": math.sin(angle * k) for k in range(17)}
    return events.DeviceTelemetry(f"{host}_copter.fc", {**values, **figures}, 0.05)


def _mcap(items: list[DatedEvent]) -> int:
    out = io.BytesIO()
    export_mcap(items, out=out)
    return len(out.getvalue())


class _Table(io.StringIO):
    """A table in memory that records its size when it is closed."""

    size = 0

    def close(self) -> None:
        self.size = self.size or self.tell()
        super().close()


def _csv(items: list[DatedEvent]) -> int:
    tables: list[_Table] = []

    def new_table(name: str) -> _Table:
        tables.append(_Table())
        return tables[-1]

    export_csv(items, open_table=new_table)
    return sum(table.size for table in tables)


def _json(items: list[DatedEvent]) -> int:
    return sum(len(event_json(item)) + 1 for item in items)


def writing(format: str) -> Opener:
    """The seconds and bytes of all events in a format."""
    write = {"MCAP": _mcap, "CSV": _csv, "JSON lines": _json}[format]

    def opener(checkout: Checkout, processes: Processes) -> Contender:
        items = stream()
        return lambda: {"60,000 events": [timed(lambda: write(items))], "their bytes": [write(items)]}

    return opener


FIGURE = Figure(
    "A recording of 60,000 events",
    {name: writing(name) for name in ("JSON lines", "MCAP", "CSV")},
    base=("JSON lines",),
    rounds=3,
    units={"their bytes": BYTES},
    one_size="a recording is as long as the mission",
    notes=("MCAP also has tracks, poses and arrows, and is compressed",),
)
