"""Recordings of a team and of a guard in virtual time."""

from __future__ import annotations

from pathlib import Path

import pytest
from flight_of_two import record_flight

from lfield.clock import ManualClock
from lfield.guard.core import GuardCore
from lfield.guard.effects import Notify
from lfield.guard.messages import Latched, Note
from lfield.guard.recording.guard_inputs import TimerExpired
from lfield.guard.recording.guard_records import (
    InputRecord,
    NoteRecord,
    SegmentStart,
    TelemetryRecord,
    decisions_of,
    framed,
    recorded_device,
)
from lfield.mission.mission import Mission
from lfield.recording.folders import SUFFIX, guard_folder
from lfield.recording.segments import MAGIC
from lfield.replay.recording_files import TeamRecording, load_team

# : Seconds after the start at which the guard's recording has positions (north), and at which its device
# latches.
NORTH = {1.0: 0.0, 2.0: 4.0, 3.0: 8.0}
LATCHED_AT = 4.0


@pytest.fixture(scope="session")
def records(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A directory with the recordings of two hosts, and of the guard of one.fc."""
    folder = tmp_path_factory.mktemp("replayed")
    mission = record_flight(folder, 8.0, time_of_day=1.8e9)
    for path in (folder / "records").glob(f"*/guard-*/*{SUFFIX}"):
        path.unlink()
    (alpha,) = (folder / "records").glob("alpha-*")
    incarnations = load_team([folder / "records"]).incarnations
    (start,) = (each.parts[0].start for each in incarnations if each.host == "alpha")
    write_guard(alpha, mission, start.at, start.wall)
    return folder / "records"


def write_guard(folder: Path, mission: Mission, at: float, wall: float) -> None:
    (binding,) = (each for each in mission.bindings.all if each.name == "one.fc")
    driver = mission.drivers.by_driver[binding.driver]
    manifest = driver.manifests[binding.type].device
    core = GuardCore([("one.fc", manifest, 0.5, 30.0)], ManualClock(at), silence=0.5)
    position = [quantity.name for quantity in manifest.telemetry].index("position")
    records = [
        SegmentStart(
            *("", "alpha", "", "", "1", 0, wall, at, 0.5, [recorded_device(binding, driver)]),
            *(core.state, [], [{}]),
        ),
        *(
            TelemetryRecord(at + seconds, 0, {position: [north, 0.0, -2.0]})
            for seconds, north in NORTH.items()
        ),
        InputRecord(
            at + LATCHED_AT,
            TimerExpired(),
            decisions_of([Notify(Latched("one.fc", "the battery is empty", confirmed=True))]),
        ),
        NoteRecord(at + LATCHED_AT, *note_fields(Note("one.fc", "battery at 3 %"))),
    ]
    data = MAGIC + b"".join(map(framed, records))
    (guard_folder(folder, "one.fc") / f"guard-000001{SUFFIX}").write_bytes(data)


def note_fields(note: Note) -> tuple[str, str, str, str]:
    return note.device, note.text, note.code, note.level


@pytest.fixture
def recording(records: Path) -> TeamRecording:
    return load_team([records])
