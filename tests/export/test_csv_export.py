"""Export of a stream to CSV tables."""

from __future__ import annotations

import csv
import io

from sample_flight import FRAMED, START, Team, flight

from lfield.export.export_input import StreamNotice
from lfield.export.tables.csv_tables import export_csv
from lfield.wire import events


class Folder(dict[str, "Table"]):
    """A folder of tables in memory."""

    def open(self, name: str) -> Table:
        assert name not in self
        self[name] = Table()
        return self[name]

    def rows(self, name: str) -> list[dict[str, str]]:
        return list(csv.DictReader(io.StringIO(self[name].text)))


class Table(io.StringIO):
    """A file in memory that keeps its text after it is closed."""

    text = ""

    def close(self) -> None:
        if not self.closed:
            self.text = self.getvalue()
        super().close()


def exported(stream) -> tuple[Folder, list[str]]:
    folder = Folder()
    names = export_csv(stream, FRAMED, open_table=folder.open)
    assert all(table.closed for table in folder.values())
    assert names == sorted(folder)
    return folder, names


def test_each_kind_and_each_device_has_a_table():
    _, names = exported([*flight(), StreamNotice(START, "bravo", "unreachable")])
    devices = ["telemetry_lead.fc.csv", "telemetry_wing.fc.csv"]
    assert names == ["agents.csv", "events.csv", "hops.csv", "links.csv", "notices.csv", *devices]


def test_events_of_both_hosts_of_a_hop_are_one_row():
    folder, _ = exported([*flight(), Team().event(9.0, "x", events.MigrationArrived("late", 2, 8, "y", 5))])
    first, second, third = folder.rows("hops.csv")
    assert first == first | {"from": "alpha", "to": "bravo", "portal": "climb", "size [B]": "600"}
    assert (first["left"], first["arrived"]) == ("1700000000.200000", "1700000000.210000")
    assert (first["seconds [s]"], first["failed"]) == ("0.01", "")
    assert (second["exception"], second["arrived"]) == ("Unreachable", "")
    assert second["failed"] == "1700000000.700000"
    assert (third["agent"], third["left"], third["arrived"]) == ("late", "", "1700000009.000000")


def test_telemetry_has_a_column_with_its_unit_for_each_number():
    folder, _ = exported(flight())
    rows = folder.rows("telemetry_wing.fc.csv")
    assert [row["position[0] [m]"] for row in rows] == ["30.0", "31.0"]
    assert [row["armed"] for row in rows] == ["true", ""]
    assert [row["host"] for row in rows] == ["bravo", "bravo"]
    assert list(rows[0])[:6] == ["time", "host", "silent [s]", "mode", "armed", "heading [rad]"]


def test_late_columns_are_empty_in_earlier_rows():
    team = Team()
    stream = [
        team.sample(0.0, "alpha", "lead.fc", position=[1.0, 2.0]),
        team.sample(1.0, "alpha", "lead.fc", position=[1.0, 2.0, 3.0], tilt=4),
    ]
    folder, _ = exported(stream)
    first, second = folder.rows("telemetry_lead.fc.csv")
    assert (first["position[2] [m]"], first["tilt"]) == ("", "")
    assert (second["position[2] [m]"], second["tilt"]) == ("3.0", "4")


def test_event_has_its_cause_and_all_fields():
    folder, _ = exported(flight())
    rows = folder.rows("events.csv")
    arrival = next(row for row in rows if row["kind"] == "came")
    assert (arrival["cause_host"], arrival["cause_number"], arrival["agent"]) == ("alpha", "3", "pilot")
    assert arrival["fields"] == '{"generation":1,"sequence":1,"of":"alpha","size":600}'
    # Simple readers would read a line feed as the end of the row.
    assert [row["text"] for row in rows if row["kind"] == "printed"] == ["up, ", "and away\\n"]


def test_devices_with_invalid_file_names_have_separate_tables():
    team = Team()
    stream = [team.sample(0.0, "a", name, x=1) for name in ("a/b.c", "a_b.c", "../c.d", "n" * 300 + ".c")]
    _, names = exported(stream)
    assert {"telemetry_a_b.c.csv", "telemetry_a_b.c_2.csv"} < set(names)
    assert len(names) == 4
    assert all("/" not in name and len(name) < 130 for name in names)
