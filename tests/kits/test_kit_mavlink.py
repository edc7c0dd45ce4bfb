"""The kit of MAVLink vehicles on the fake: every check passes, and each fault fails its check."""

from __future__ import annotations

import asyncio

import pytest
from kit_findings import failed, not_run
from pymavlink.dialects.v20 import common as mavlink

FAST = ("--climb", "8", "--cruise", "15", "--descend", "2.4", "--land", "1.9", "--acceleration", "15")
WAIVED = "waivers: [device_watchdog]"
FLIES_PLANS = 'waivers: {device_watchdog: "simulated", autonomous_motion: "simulated"}'
LIMITS = "limits: {speed: 5.0, altitude: 20.0, radius: 50.0}"


def vehicles(desk, *specs):
    """A vehicle at its own endpoint for each specification, set up for the bindings of these tests."""
    return [
        desk.fake("mavlink", "--listen", "udp:127.0.0.1:0", "--vehicle", *spec.split(), *FAST)
        for spec in specs
    ]


def full_kit_findings(run_kit_on, binding):
    """The findings of the complete kit on a copter; every check must run and pass."""
    found = run_kit_on("mavlink", {"copter": f"{binding}, {LIMITS}"})
    assert failed(found) == []
    assert not_run(found) == set()
    assert "m/s at most, of 5" in found["copter", "its speed limit is enforced"].seen
    assert "motors off" in found["copter", "it is at rest at the end"].seen
    return found


def test_ardupilot_copter_passes_the_kit(desk, run_kit_on):
    (link,) = vehicles(desk, "1:copter:ardupilot --set-up --param WPNAV_SPEED=500")
    found = full_kit_findings(run_kit_on, f'endpoint: "{link.endpoint}", system: 1, ttl: 1.0')
    assert found["copter", "motors on and off"].seen == "armed in GUIDED, disarmed"
    assert "then it was in LAND" in found["copter", "a velocity that is not renewed ends"].seen


@pytest.mark.few(0)
def test_px4_copter_passes_the_kit(desk, run_kit_on):
    speeds = "--param MPC_XY_VEL_MAX=5 --param MPC_XY_CRUISE=5 --param MPC_VEL_MANUAL=5"
    (link,) = vehicles(desk, f"3:copter:px4 --set-up hold {speeds}")
    found = full_kit_findings(
        run_kit_on, f'endpoint: "{link.endpoint}", system: 3, safe_state: hold, {FLIES_PLANS}'
    )
    assert "then it was in AUTO.LOITER" in found["copter", "a velocity that is not renewed ends"].seen


@pytest.mark.few(0)
def test_rovers_of_both_autopilots_pass_the_kit(desk, run_kit_on):
    rover, px4 = vehicles(
        desk,
        "2:rover:ardupilot --set-up --param WP_SPEED=5",
        "5:rover:px4 --set-up hold --param RO_SPEED_LIM=5",
    )
    takeoff, expiry = "takeoff() is refused while disarmed", "a velocity that is not renewed ends"
    binding = f'endpoint: "{px4.endpoint}", system: 5, kind: rover, safe_state: hold'
    found = run_kit_on(
        "mavlink",
        {
            "rover": f'endpoint: "{rover.endpoint}", system: 2, kind: rover, ttl: 1.5, {LIMITS}',
            "px4": f"{binding}, {WAIVED}, {LIMITS}",
        },
    )
    assert failed(found) == []
    assert not_run(found) == {("rover", takeoff), ("px4", takeoff), ("px4", "a plan is flown to its end")}
    assert "only while driving" in found["rover", "a short trip"].seen
    assert "; turned, " in found["px4", "a short trip"].seen
    assert "then it was in HOLD" in found["rover", expiry].seen


def test_faulty_vehicle_fails_its_checks(desk, run_kit_on):
    links = vehicles(desk, "1 --set-up", "2 --set-up", "3 --set-up")
    faults = ("refuse_arming@1=compass not calibrated", "motor_failure@2=true", "gps_loss@3=true")
    for link, fault in zip(links, faults, strict=True):
        link.fault(fault)
    fence = "a fence is set, read back and cleared"
    checks = ("motors on and off", "a short trip", "files", fence)
    found = run_kit_on(
        "mavlink",
        {
            f"v{system}": f'endpoint: "{link.endpoint}", system: {system}, {WAIVED}'
            for system, link in enumerate(links, 1)
        },
        only=checks,
    )
    assert "compass not calibrated" in found["v1", "motors on and off"].seen
    assert found["v1", "a short trip"].outcome == "failed"
    assert found["v1", "files"].outcome == "passed"
    assert found["v2", "motors on and off"].outcome == "passed"
    # With a failed motor the copter tips over on the ground, and the autopilot reports a crash.
    assert found["v2", "a short trip"].outcome == "failed"
    assert "crashed" in found["v2", "a short trip"].seen
    assert found["v2", fence].outcome == "passed"
    assert "globalPosition" in found["v3", fence].seen


async def command_speed_from_another_station(endpoint, speed):
    """Another ground station, which commands the speed of the vehicle repeatedly."""
    _, host, port = endpoint.split(":")
    _, writer = await asyncio.open_connection(host, int(port))
    station = mavlink.MAVLink(writer, srcSystem=254)
    while True:
        station.command_long_send(1, 1, mavlink.MAV_CMD_DO_CHANGE_SPEED, 0, 1.0, speed, -1.0, 0, 0, 0, 0)
        await asyncio.sleep(0.05)


@pytest.mark.few(0)
def test_speed_beyond_the_limit_fails_its_check(desk, run_kit_on):
    (link,) = vehicles(desk, "1:copter:ardupilot --set-up --param WPNAV_SPEED=500")
    check = "its speed limit is enforced"
    # The long `limit_time` disables the driver's own correction.
    device = f'endpoint: "{link.endpoint}", system: 1, ttl: 1.0, limit_time: 30.0, {LIMITS}'
    found = run_kit_on(
        "mavlink",
        {"fast": device},
        only=(check,),
        first=lambda: asyncio.ensure_future(command_speed_from_another_station(link.endpoint, 9.0)),
    )
    assert found["fast", check].outcome == "failed"
    assert "m/s at most, of 5" in found["fast", check].seen
    assert "too short a way" not in found["fast", check].seen
