"""A mission of two copters, recorded in virtual time into files."""

from __future__ import annotations

from pathlib import Path

from lfield.host.recording.recording_target import RecordingDirectory
from lfield.mission.loader import load_mission
from lfield.mission.mission import Mission
from lfield.simulate.host_fleet import Fleet, FleetOptions

PROGRAM = """
resource Post {
    Mavlink fc;
    init(string[] arg) { }
    portal climb(real height) emit real {
        fc.arm();
        fc.takeoff(height);
        return height;
    }
}
coordinator Boss {
    init(string[] arg) {
        real sum = 0.0;
        sleep(2.0);
        sum = sum + findPost("one").climb(2.0);
        sum = sum + findPost("two").climb(3.0);
        print("climbed " + f2s(sum, 1));
    }
}
"""
DEPLOYMENT = "//Post:one@alpha\n//Post:two@bravo\n//Boss:boss@alpha\n"


def write_mission(folder: Path, program: str = PROGRAM) -> Path:
    """Write the mission; returns its deployment file."""
    (folder / "mission.L").write_text(program)
    (folder / "mission.dL").write_text(DEPLOYMENT)
    return folder / "mission.dL"


def record_flight(folder: Path, seconds: float, time_of_day: float | None = None) -> Mission:
    """Run the mission for so long; its recordings are in `records` of the folder."""
    mission = load_mission(write_mission(folder), simulate=True)
    target = RecordingDirectory(folder / "records", 64 << 20)
    fleet = Fleet(mission, 1, options=FleetOptions(time_of_day=time_of_day, record=target))
    fleet.run(seconds)
    for name in list(fleet.lives):
        fleet.stop(name)
    fleet.run(10.0)
    fleet.run(10.0)
    fleet.close()
    return mission
