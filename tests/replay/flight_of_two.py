"""A mission of two copters, recorded in virtual time into files."""

from __future__ import annotations

from pathlib import Path

from recorded_teams import run_into

from lfield.mission.loader import load_mission
from lfield.mission.mission import Mission

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
    """Run the mission for some seconds; its recordings are in `records` of the folder."""
    mission = load_mission(write_mission(folder), simulate=True)
    run_into(folder / "records", mission, seconds, time_of_day)
    return mission
