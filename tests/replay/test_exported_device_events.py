"""Events and log lines of devices, which only the recordings of guards have, in exports."""

from __future__ import annotations

import csv
import io
import json

from mcap.reader import make_reader

from lfield.export.export_input import mission_info
from lfield.export.mcap_writer import export_mcap
from lfield.export.tables.csv_tables import export_csv
from lfield.replay.event_stream import event_stream

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


def test_the_log_of_an_mcap_file_has_what_guards_and_drivers_logged(recording):
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
