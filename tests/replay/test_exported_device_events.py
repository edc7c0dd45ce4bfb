"""Events and log lines of devices, which exist only in the recordings of guards, in exports."""

from __future__ import annotations

import csv
import io
import json

import msgspec
import pytest
from mcap.reader import make_reader

from lfield.export.export_input import mission_info
from lfield.export.mcap_writer import export_mcap
from lfield.export.tables.csv_tables import export_csv
from lfield.guard.recording.guard_records import NOTIFY, InputRecord, framed
from lfield.guard.recording.guard_segments import read_segment
from lfield.recording.segments import MAGIC
from lfield.replay.device_events import device_events
from lfield.replay.event_stream import event_stream
from lfield.wire.events import LineLogged

LATCHED_AT = 4.0


class Table(io.StringIO):
    """A table that is kept when it is closed."""

    def close(self) -> None:
        self.text = self.getvalue()


def items_of(recording):
    start = min(each.started_at for each in recording.incarnations)
    return event_stream(recording), start


def test_the_tables_have_the_safe_states_of_devices(recording):
    items, start = items_of(recording)
    tables: dict[str, Table] = {}
    export_csv(items, open_table=lambda name: tables.setdefault(name, Table()))
    rows = [
        row for row in csv.DictReader(io.StringIO(tables["events.csv"].text)) if row["device"] == "one.fc"
    ]
    (confirmed,) = (row for row in rows if row["kind"] == "confirmed")
    assert confirmed["host"] == "alpha"
    assert abs(float(confirmed["time"]) - start - LATCHED_AT) < 0.1
    assert json.loads(confirmed["fields"])["reason"] == "the battery is empty"


@pytest.mark.parametrize(
    "decisions", [[None], [[]], [[17]], [["x"]], 5, [[[1]]], [[NOTIFY, 1, 2, 3, 4, 5, 6]]]
)
def test_damaged_decisions_have_no_events(decisions, records, tmp_path):
    (path,) = records.glob("alpha-*/guard-*/guard-*.lfrec")
    segment, copy = read_segment(path), tmp_path / path.name
    damaged = msgspec.Raw(msgspec.msgpack.encode(decisions))
    changed = [
        msgspec.structs.replace(each, decisions=damaged) if isinstance(each, InputRecord) else each
        for each in segment.records
    ]
    copy.write_bytes(MAGIC + b"".join(map(framed, [segment.start, *changed])))
    assert {type(each.what) for each in device_events([copy])} == {LineLogged}


def test_the_log_of_an_mcap_file_has_lines_of_guards_and_drivers(recording):
    items, _ = items_of(recording)
    out = io.BytesIO()
    export_mcap(items, mission_info("", recording.mission), out=out)
    found = [
        (channel.topic, json.loads(message.data))
        for _, channel, message in make_reader(io.BytesIO(out.getvalue())).iter_messages()
    ]
    lines = {data["message"] for topic, data in found if topic == "/log"}
    assert "one.fc: battery at 3 %" in lines
    assert any(line.startswith("one.fc in safe state") for line in lines)
    assert "confirmed" in {data["kind"] for topic, data in found if topic == "/events"}
