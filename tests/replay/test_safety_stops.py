"""Safety stops in replays, debuggers and exports: the operator, the device, the time and the reason."""

from __future__ import annotations

import csv
import io
import json
from pathlib import Path

import pytest
from flight_of_two import write_mission

from lfield.cli.main import main
from lfield.host.recording.recording_target import RecordingDirectory
from lfield.mission.loader import load_mission
from lfield.replay.device_events import safety_stops
from lfield.replay.recording_files import load_team
from lfield.simulate.host_fleet import Fleet, FleetOptions
from lfield.text import log_messages

# : The time at which the operator stops alpha (s).
STOPPED_AT = 3.0


@pytest.fixture(scope="module")
def stopped(tmp_path_factory) -> Path:
    """A recording of two hosts, one of which an operator has stopped, until they end."""
    folder = tmp_path_factory.mktemp("stopped")
    mission = load_mission(write_mission(folder), simulate=True)
    target = RecordingDirectory(folder / "records", 64 << 20)
    fleet = Fleet(mission, 1, options=FleetOptions(time_of_day=1.8e9, record=target))
    fleet.run(STOPPED_AT)
    life = fleet.runs["alpha"]

    def stop() -> None:
        life.host.recorder.on_emergency_stop("anna", "smoke", lifted=False)
        life.host.note(log_messages.EMERGENCY_STOP.line(operator="anna", reason="smoke"))
        life.host.guards.inhibit("smoke")

    life.process.loop.enter(stop)
    fleet.run(3.0)
    for name in list(fleet.runs):
        fleet.stop(name)
    fleet.run(10.0)
    fleet.close()
    return folder / "records"


def test_a_replay_names_the_operator_and_the_host_of_a_stop(stopped, capsys):
    assert main(["replay", "--json", str(stopped)]) == 0
    stop, device = json.loads(capsys.readouterr().out)["stops"]
    assert (stop["host"], stop["by"], stop["reason"]) == ("alpha", "anna", "smoke")
    assert (device["host"], device["device"], device["reason"]) == ("alpha", "one.fc", "smoke")
    assert abs(stop["time"] - 1.8e9 - STOPPED_AT) < 0.5
    assert main(["replay", str(stopped)]) == 0
    assert "EMERGENCY STOP by anna: smoke" in capsys.readouterr().out


def test_the_debugger_finds_the_stop_in_both_directions(stopped, capsys):
    commands = ["-c", "event stopped", "-c", "where", "-c", "end", "-c", "back event stopped", "-c", "where"]
    assert main(["debug", str(stopped), "--plain", *commands]) == 0
    out = capsys.readouterr().out.splitlines()
    found = [line for line in out if " alpha " in line and "turn" in line]
    assert len(found) >= 4
    assert len({line.partition("  ")[0] for line in found[:2] + found[-2:]}) == 1
    assert main(["debug", str(stopped), "--plain", "-c", "event stopped", "-c", "events"]) == 0
    assert "by=anna" in capsys.readouterr().out


def test_the_export_has_the_stop_and_its_log_line_once(stopped, tmp_path, capsys):
    assert main(["export", str(stopped), "--csv", str(tmp_path / "tables")]) == 0
    rows = list(csv.DictReader(io.StringIO((tmp_path / "tables" / "events.csv").read_text())))
    kinds = [row["kind"] for row in rows if "anna" in json.dumps(row)]
    assert sorted(kinds) == ["logged", "stopped"]
    times = [float(row["time"]) for row in rows]
    assert times == sorted(times)


def test_a_stop_by_a_guard_is_found(recording, records, capsys):
    """The guard of this recording has made one.fc safe since its battery is empty."""
    assert [stop.device for stop in safety_stops(recording)] == []
    assert main(["debug", str(records), "--plain", "-c", "event confirmed", "-c", "events"]) == 0
    assert "reason=the battery is empty" in capsys.readouterr().out
    assert load_team([records]).problems == recording.problems
