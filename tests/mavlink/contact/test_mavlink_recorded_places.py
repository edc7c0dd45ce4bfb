"""Recorded positions of real autopilots: local metres and global degrees are one position."""

from __future__ import annotations

import gzip
import json
import math
from pathlib import Path

import pytest

from lfield.driver import Origin, Placement
from lfield_mavlink.contact.vehicle_state import VehicleState
from lfield_mavlink.frames import frame_of
from lfield_mavlink.geodesy import Place, geodesic_offset
from lfield_mavlink.link.dialect import dialect

TRACES = Path(__file__).parents[2] / "sim" / "replay" / "traces"
#: Metres: 1e-7 degrees are 1.1 cm; the height of an ArduRover's estimator is not that of its receiver.
NEAR = {"ardupilot": 0.3, "px4": 0.01}
MESSAGES = {
    "GPS_GLOBAL_ORIGIN": lambda f: dialect.MAVLink_gps_global_origin_message(
        f["latitude"], f["longitude"], f["altitude"], 0
    ),
    "HOME_POSITION": lambda f: dialect.MAVLink_home_position_message(
        *(f[name] for name in ("latitude", "longitude", "altitude", "x", "y", "z")), [1, 0, 0, 0], 0, 0, 0, 0
    ),
    "LOCAL_POSITION_NED": lambda f: dialect.MAVLink_local_position_ned_message(
        *(f[name] for name in ("time_boot_ms", "x", "y", "z", "vx", "vy", "vz"))
    ),
}


def recorded_messages(name):
    """The messages that an autopilot has sent, in order."""
    with gzip.open(TRACES / f"{name}.jsonl.gz", "rt") as lines:
        next(lines)
        sent = (json.loads(line) for line in lines)
        yield from ((each["type"], each["fields"]) for each in sent if each["dir"] == "out")


@pytest.mark.parametrize("name", ["ap-rover.c-speed", "px4-copter.c-speed", "px4-rover.l-px4-rover"])
def test_recorded_local_and_global_positions_agree(name):
    stack = "px4" if name.startswith("px4") else "ardupilot"
    state = VehicleState("rover" if "rover" in name else "copter")
    team = placement = None
    unplaced, by_metres, by_degrees = 0, {}, {}
    for kind, fields in recorded_messages(name):
        if kind == "GLOBAL_POSITION_INT":
            place = Place.scaled(fields["lat"], fields["lon"], fields["alt"])
            by_degrees[fields["time_boot_ms"]] = place
        if kind == "HOME_POSITION" and team is None:
            # The origin of a team is at some distance.
            team = Origin(fields["latitude"] / 1e7 - 0.002, fields["longitude"] / 1e7 + 0.003, 400.0)
            placement = Placement(team)
        if kind not in MESSAGES or None in fields.values():
            continue
        state.autopilot = 12 if stack == "px4" else 3
        state.update(MESSAGES[kind](fields), 0.0)
        if kind == "LOCAL_POSITION_NED" and placement is not None:
            frame = frame_of(placement, state)
            if frame is None:
                unplaced += 1
            else:
                by_metres[fields["time_boot_ms"]] = frame.to_team(state.position)
    both = [at for at in by_metres if by_degrees.get(at) is not None]
    assert len(both) > 10
    for at in both:
        north, east, _ = geodesic_offset(team, by_degrees[at])
        assert math.dist(by_metres[at][:2], (north, east)) < 0.02
        assert by_metres[at][2] == pytest.approx(team.altitude - by_degrees[at].altitude, abs=NEAR[stack])
    # An ArduRover sends local positions 11 s before the origin of their frame.
    assert unplaced > 30 if name == "ap-rover.c-speed" else unplaced == 0
