"""The kit of MAVLink vehicles with a team frame: the same checks pass."""

from __future__ import annotations

import pytest
from kit_findings import failed, not_run

FAST = ("--climb", "8", "--cruise", "15", "--descend", "2.4", "--land", "1.9", "--acceleration", "15")
LIMITS = "limits: {speed: 5.0, altitude: 20.0, radius: 50.0}"
#: Fakes start 300 m north of this origin and 20 m above it. The heading of the pose is east.
FRAMES = {
    "origin": {"origin": "{latitude: 47.395044, longitude: 8.545594, altitude: 468.0}"},
    "pose": {"frame": "{north: 40.0, east: -7.0, down: 2.0, heading: 1.5707963}"},
}
SPEEDS = {
    "ardupilot": "--set-up --param WPNAV_SPEED=500",
    "px4": "--set-up --param MPC_XY_VEL_MAX=5 --param MPC_XY_CRUISE=5 --param MPC_VEL_MANUAL=5",
}


@pytest.mark.few(0)
@pytest.mark.parametrize(("frame", "stack"), [("origin", "px4"), ("pose", "ardupilot")])
def test_copter_passes_the_kit_in_a_team_frame(desk, run_kit_on, frame, stack):
    link = desk.fake(
        "mavlink",
        "--listen",
        "udp:127.0.0.1:0",
        "--vehicle",
        f"1:copter:{stack}",
        *SPEEDS[stack].split(),
        *FAST,
    )
    binding = f'endpoint: "{link.endpoint}", system: 1, waivers: [device_watchdog], {LIMITS}'
    found = run_kit_on("mavlink", {"copter": binding}, **FRAMES[frame])
    assert failed(found) == []
    assert not_run(found) == ({("copter", "a plan is flown to its end")} if stack == "px4" else set())
    position = found["copter", "position"].seen
    assert ("(300.0, 0.0, -20.0)" if frame == "origin" else "(40.0, -7.0, 2.0)") in position, position
    assert "in the team's frame" in position
