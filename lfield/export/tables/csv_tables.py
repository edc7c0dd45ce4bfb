"""CSV tables of a stream, one for each kind of row: events, hops, links, agents, and each device. Pure.

    events.csv               every state event; fields that not all events have are JSON in `fields`
    hops.csv                 a row for each hop, when it is complete or the stream ends
    telemetry_<device>.csv   a column for each number of a quantity, with its unit: `position[0] [m]`
    links.csv, agents.csv    measurements of links, activity of agents
    notices.csv              gaps in the stream

Times are seconds since 1970. Cells are empty where a value is unknown. Control characters are escaped.
"""

from __future__ import annotations

import csv
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import TextIO

import msgspec

from lfield.export.channels import topic_part
from lfield.export.export_input import (
    NO_INFO,
    MissionInfo,
    StreamItem,
    StreamNotice,
    TelemetrySample,
    telemetry_of,
)
from lfield.export.tables.hop_rows import HOP_COLUMNS, HopRows
from lfield.operator.dashboard.timeline.event_timeline import DatedEvent
from lfield.text.terminal_escape import escape_line
from lfield.wire.events import AgentActivity, LinkTelemetry
from lfield.wire.fields import Telemetry
from lfield.wire.subscription_messages import as_fields

#: Opens the table of that name to be written, in UTF-8 without translation of line ends.
OpenTable = Callable[[str], TextIO]

#: The most characters of a device in the name of its table.
_MAX_NAME = 100

#: The bytes of the rows of a device that are kept in memory.
_IN_MEMORY = 1 << 18

_EVENT_COLUMNS = (
    *("time", "host", "incarnation", "number", "at", "up", "kind"),
    *("cause_host", "cause_number", "agent", "device", "peer", "text", "fields"),
)
_LINK_COLUMNS = ("time", "host", "peer", "round_trip [s]", "loss", "sent [B]", "received [B]")
_AGENT_COLUMNS = ("time", "host", "agent", "state", "file", "line", "waits")


def export_csv(
    stream: Iterable[StreamItem], info: MissionInfo = NO_INFO, *, open_table: OpenTable
) -> list[str]:
    """Write a whole stream as tables; returns their names. Raises the errors of the stream and of
    `open_table`.
    """
    tables = CsvTables(info, open_table)
    try:
        for item in stream:
            tables.add(item)
        return tables.finish()
    finally:
        tables.close()


class CsvTables:
    """The tables of one stream; `open_table` is called when the first row of a table is written.

    A table of a device is written at the end, since its last row may add a column.
    """

    def __init__(self, info: MissionInfo, open_table: OpenTable) -> None:
        self._info, self._open_table = info, open_table
        self._tables: dict[str, _Table] = {}
        self._devices: dict[str, _DeviceTable] = {}
        self._hops = HopRows()

    def add(self, item: StreamItem) -> None:
        """Add the next item of the stream."""
        sample = telemetry_of(item)
        if sample is not None:
            self._device_table(sample.device).add(sample)
        elif isinstance(item, StreamNotice):
            self._table("notices.csv", ("time", "host", "text")).add(_time(item.time), item.host, item.text)
        elif isinstance(item, DatedEvent):
            self._add_event(item)

    def finish(self) -> list[str]:
        """Write incomplete rows; returns the names of all tables."""
        for row in self._hops.remaining():
            self._table("hops.csv", HOP_COLUMNS).add(*row)
        names = _unique_names(self._devices)
        for device, table in self._devices.items():
            with self._open_table(names[device]) as file:
                table.write(file)
        for finished in self._tables.values():
            finished.close()
        return sorted([*self._tables, *names.values()])

    def close(self) -> None:
        """Close all files."""
        for table in self._tables.values():
            table.close()
        for device in self._devices.values():
            device.close()

    def _table(self, name: str, columns: Sequence[str]) -> _Table:
        if name not in self._tables:
            self._tables[name] = _Table(self._open_table(name), columns)
        return self._tables[name]

    def _device_table(self, device: str) -> _DeviceTable:
        if device not in self._devices:
            self._devices[device] = _DeviceTable(self._info, device)
        return self._devices[device]

    def _add_event(self, dated: DatedEvent) -> None:
        time, host, event = _time(dated.time), dated.host, dated.event.what
        match event:
            case LinkTelemetry(peer, round_trip, loss, sent, received):
                self._table("links.csv", _LINK_COLUMNS).add(
                    time, host, peer, round_trip, loss, sent, received
                )
            case AgentActivity(agent, state, file, line, waits):
                self._table("agents.csv", _AGENT_COLUMNS).add(time, host, agent, state, file, line, waits)
            case _:
                self._table("events.csv", _EVENT_COLUMNS).add(*_event_row(dated))
                for row in self._hops.rows(dated):
                    self._table("hops.csv", HOP_COLUMNS).add(*row)


def _event_row(dated: DatedEvent) -> Iterator[object]:
    fields, cause = as_fields(dated.event), dated.cause
    yield from (_time(dated.time), dated.host, dated.incarnation)
    for name in ("number", "at", "up", "kind"):
        yield fields.pop(name)
    del fields["cause"]
    yield from ("", "") if cause is None else (cause.host, cause.number)
    for name in ("agent", "device", "peer", "text"):
        yield fields.pop(name, "")
    yield msgspec.json.encode(fields).decode() if fields else ""


def _time(time: float) -> str:
    return f"{time:.6f}"


def _cell(value: object) -> object:
    match value:
        case None:
            return ""
        case bool():
            return "true" if value else "false"
        case str():
            return escape_line(value)
        case _:
            return value


class _Table:
    """A table with fixed columns."""

    def __init__(self, file: TextIO, columns: Sequence[str]) -> None:
        self._file = file
        self._writer = csv.writer(file, lineterminator="\n")
        self._writer.writerow(columns)

    def add(self, *row: object) -> None:
        """Add a row."""
        self._writer.writerow(map(_cell, row))

    def close(self) -> None:
        """Close its file."""
        self._file.close()


class _DeviceTable:
    """The telemetry of one device. Rows are kept in a temporary file until all columns are known."""

    def __init__(self, info: MissionInfo, device: str) -> None:
        self._quantities = info.quantities(device)
        # Hosts may report more devices than a process may have files.
        self._rows = tempfile.SpooledTemporaryFile(_IN_MEMORY, "w+", encoding="utf-8", newline="")  # noqa: SIM115  # closed with the table
        self._writer = csv.writer(self._rows, lineterminator="\n")
        self._columns = {("time", ""): 0, ("host", ""): 1, ("silent", "s"): 2}
        for name, quantity in self._quantities.items():
            if not quantity.type.endswith("[]"):
                self._column(name)

    def add(self, sample: TelemetrySample) -> None:
        """Add the values of a moment."""
        row: dict[int, object] = {0: _time(sample.time), 1: sample.host, 2: sample.silent}
        for name, value in _numbers(sample.values):
            row[self._column(name)] = value
        self._writer.writerow(_cell(row.get(place, "")) for place in range(max(row) + 1))

    def write(self, file: TextIO) -> None:
        """Write the whole table."""
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(f"{name} [{unit}]" if unit else name for name, unit in self._columns)
        self._rows.seek(0)
        for row in csv.reader(self._rows):
            writer.writerow([*row, *[""] * (len(self._columns) - len(row))])

    def close(self) -> None:
        """Remove the temporary file."""
        self._rows.close()

    def _column(self, name: str) -> int:
        quantity = self._quantities.get(name.partition("[")[0])
        key = escape_line(name), quantity.unit if quantity is not None else ""
        return self._columns.setdefault(key, len(self._columns))


def _numbers(values: Mapping[str, Telemetry]) -> Iterator[tuple[str, object]]:
    """The values of all quantities, of arrays each element."""
    for name, value in values.items():
        if isinstance(value, list):
            yield from ((f"{name}[{index}]", each) for index, each in enumerate(value))
        else:
            yield name, value


def _unique_names(devices: Iterable[str]) -> dict[str, str]:
    """The names of the tables of devices."""
    found: dict[str, str] = {}
    for device in devices:
        plain = topic_part(device).replace("/", ".")[:_MAX_NAME]
        name, count = f"telemetry_{plain}.csv", 2
        while name in found.values():
            name, count = f"telemetry_{plain}_{count}.csv", count + 1
        found[device] = name
    return found
