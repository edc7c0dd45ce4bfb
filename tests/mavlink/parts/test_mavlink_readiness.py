"""Readiness: pre-arm checks and position, with the autopilot's reasons, after a cold or warm start."""

from __future__ import annotations

import asyncio
import math

import pytest
from coroutine_tests import on_bench

from lfield.errors import DeviceError
from lfield_mavlink.contact.vehicle_state import PREARM, VehicleState
from lfield_mavlink.link.dialect import dialect
from lfield_mavlink.modes import ARDUPILOT, PX4
from lfield_mavlink.parts.readiness import missing_condition

GYRO = dialect.MAV_SYS_STATUS_SENSOR_3D_GYRO


def state_after(autopilot, *, present=0, enabled=0, healthy=0, status=3, position=True, armed=False):
    """The state after these messages at 1.0 s."""
    state = VehicleState("copter")
    mode = 3 << 24 | 4 << 16 if autopilot == PX4 else 4
    flags = dialect.MAV_MODE_FLAG_SAFETY_ARMED if armed else 0
    messages = [
        dialect.MAVLink_heartbeat_message(2, autopilot, 1 | flags, mode, status, 3),
        dialect.MAVLink_sys_status_message(present, enabled, healthy, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0),
    ]
    if position:
        messages.append(dialect.MAVLink_local_position_ned_message(0, 0, 0, 0, 0, 0, 0))
    for message in messages:
        state.update(message, 1.0)
    return state


CHECKED = {"present": PREARM | GYRO, "enabled": PREARM | GYRO}


@pytest.mark.parametrize(
    ("autopilot", "reports", "words"),
    [
        (ARDUPILOT, {**CHECKED, "healthy": PREARM | GYRO}, ""),
        (ARDUPILOT, {**CHECKED, "healthy": GYRO}, "the pre-arm checks have failed"),
        (ARDUPILOT, CHECKED, "the pre-arm checks have failed; unhealthy: 3d gyro"),
        # In STABILIZE the bit is set 19 s before a position exists.
        (ARDUPILOT, {**CHECKED, "healthy": PREARM | GYRO, "position": False}, "its position is unknown"),
        # Without enabled checks, none can fail.
        (ARDUPILOT, {"present": PREARM, "healthy": 0}, ""),
        (ARDUPILOT, {**CHECKED, "healthy": PREARM | GYRO, "status": 5}, "its failsafe is active"),
        # PX4 sets the bit in its health only.
        (PX4, {"healthy": PREARM}, ""),
        (PX4, {"healthy": GYRO}, "the pre-arm checks have failed"),
        (PX4, {"armed": True}, ""),
    ],
)  # fmt: skip
def test_missing_condition_by_autopilot_status(autopilot, reports, words):
    state = state_after(autopilot, **reports)
    assert missing_condition(state, 0.5, px4=autopilot == PX4) == words


def test_old_status_is_not_used_for_readiness():
    state = state_after(ARDUPILOT, **CHECKED, healthy=PREARM | GYRO)
    assert missing_condition(state, 2.0, px4=False) == "waiting for the autopilot's pre-arm checks"


@pytest.mark.few(1)
@pytest.mark.parametrize(
    ("kind", "flavour"), [("copter", "ardupilot"), ("rover", "ardupilot"), ("copter", "px4")]
)
@on_bench("bench", warm_up=43.0, options={"connect": 45.0}, given="kind flavour")
async def test_wait_ready_after_a_cold_start_ends_when_arming_works(b, fc, /, kind, flavour):
    assert await fc.execute("isReady", []) is False
    with pytest.raises(DeviceError, match="arm refused"):
        await fc.execute("arm", [])
    await fc.execute("waitReady", [90.0])
    assert await fc.execute("isReady", []) is True
    assert await fc.execute("whyNotReady", []) == ""
    assert 42.0 < b.autopilot.uptime < 50.0
    await fc.execute("arm", [])


@pytest.mark.few(1)
@pytest.mark.parametrize("after", [5.0, 15.0, 25.0, 33.0, 36.5])
@pytest.mark.parametrize("kind", ["copter", "rover"])
@on_bench("bench", warm_up=43.0, options={"connect": 45.0}, given="kind")
async def test_checks_passed_in_another_mode_are_no_readiness(b, fc, /, kind, after):
    """The first mode needs no position, so its bit is set early; waitReady waits for the arming mode."""
    await asyncio.sleep(after)
    if reason := await fc.execute("whyNotReady", []):
        assert "Arm: " in reason or f"checks are for {b.autopilot.mode}, but it is armed in GUIDED" in reason
    await fc.execute("waitReady", [90.0])
    await fc.execute("arm", [])
    assert 42.0 < b.autopilot.uptime < 50.0


@pytest.mark.parametrize("flavour", ["ardupilot", "px4"])
@on_bench("bench", refuse_arming="Compass not calibrated", given="flavour")
async def test_wait_ready_times_out_with_the_reason(b, fc, /, flavour):
    assert await fc.execute("isReady", []) is False
    with pytest.raises(DeviceError, match="Compass not calibrated"):
        await fc.execute("arm", [])
    before = len(b.sent)
    assert "Compass not calibrated" in await fc.execute("whyNotReady", [])
    assert any(data[7] == dialect.MAVLINK_MSG_ID_COMMAND_LONG for data in b.sent[before:])
    start = asyncio.get_running_loop().time()
    with pytest.raises(DeviceError, match=r"cannot be armed after 10 s: .*Compass not calibrated"):
        await fc.execute("waitReady", [10.0])
    assert asyncio.get_running_loop().time() - start < 13.0
    assert "mavlink-not-armable" in [note.code for note in b.notes]


@pytest.mark.parametrize("seconds", [-1.0, math.nan, math.inf])
@on_bench("bench")
async def test_wait_ready_refuses_an_invalid_timeout(b, fc, /, seconds):
    with pytest.raises(DeviceError, match="requires seconds of at least 0"):
        await fc.execute("waitReady", [seconds])


@on_bench("bench")
async def test_vehicle_without_contact_is_not_ready(b, fc, /):
    assert await fc.execute("isReady", []) is True
    b.cut = True
    await asyncio.sleep(4.0)
    assert await fc.execute("isReady", []) is False
    assert "no message for" in await fc.execute("whyNotReady", [])


@pytest.mark.few(4)
@pytest.mark.parametrize("gap", [n * 0.02 for n in range(50)])
def test_warm_copter_is_armed_directly_after_open(bench, gap):
    """As measured: its GCS failsafe is active, and ends up to 0.35 s after a heartbeat."""
    b = bench(ttl=1.0, waivers=())
    b.autopilot.parameters |= {"FS_GCS_ENABLE": 5, "FS_GCS_TIMEOUT": 2}

    async def mission(fc):
        # A station was connected and stopped.
        await b.until(lambda: b.autopilot.failsafes.gcs_contact_at is not None)
        b.driver.quiet()
        await asyncio.sleep(4.0 + gap)
        assert b.autopilot.failsafes.gcs_lost
        b.driver.resume()
        await fc.open()
        await fc.execute("arm", [])

    b.run(mission, opened=False)
    assert b.autopilot.armed


def test_arming_is_repeated_while_the_gcs_failsafe_clears(bench, monkeypatch):
    # Otherwise the failsafe would clear during the query of the unique id.
    monkeypatch.setattr("lfield_mavlink.vehicle.SECOND", 0.0)
    b = bench(ttl=1.0, waivers=())
    deliver = b.filter

    async def mission(fc):
        await fc.execute("setMode", ["GUIDED"])
        # Its failsafe is active, and no heartbeat has reported it.
        b.filter = lambda link, data: None if data[7] == 0 else deliver(link, data)
        b.driver.quiet()
        await asyncio.sleep(4.0)
        b.driver.resume()
        asyncio.get_running_loop().call_later(0.2, setattr, b, "filter", deliver)
        await fc.execute("arm", [])
        assert "GCS failsafe on" in str(fc.texts.since(0.0))

    b.run(mission)
    assert b.autopilot.armed
