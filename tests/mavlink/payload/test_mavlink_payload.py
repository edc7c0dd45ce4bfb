"""Payload and maintenance: gripper, winch, servo, camera, home, reboot, raw commands."""

from __future__ import annotations

import asyncio
import math

import pytest
from coroutine_tests import on_bench
from takeoff import up

from lfield.errors import DeviceError
from lfield_mavlink.link.dialect import dialect
from lfield_mavlink.parts.maintenance import REFUSED

ACK = dialect.MAVLINK_MSG_ID_COMMAND_ACK


@pytest.mark.parametrize("flavour", ["ardupilot", "px4"])
def test_payload_instructions_take_effect(bench, flavour):
    b = bench(flavour=flavour)
    payload = b.autopilot.payload

    async def mission(fc):
        await fc.execute("closeGripper", [])
        assert payload.gripped
        await fc.execute("openGripper", [])
        assert not payload.gripped
        await fc.execute("setServo", [3, 0.5])
        assert payload.servos[3] == 1750
        await fc.execute("triggerCamera", [])
        await b.until(lambda: payload.camera.pictures == 1)
        await fc.execute("pointGimbal", [-0.8, 0.4])
        assert (payload.gimbal.pitch, payload.gimbal.yaw) == pytest.approx((-0.8, 0.4), abs=0.06)

    b.run(mission)


@on_bench("bench")
async def test_winch_ends_when_the_line_is_out(b, fc, /):
    start = asyncio.get_running_loop().time()
    await fc.execute("winch", [3.0, 1.0])
    assert asyncio.get_running_loop().time() - start > 2.5
    assert b.autopilot.payload.line == pytest.approx(3.0, abs=0.15)
    assert b.values["winchLine"] == pytest.approx(3.0, abs=0.15)
    await fc.execute("winch", [-2.0, 1.0])
    assert b.autopilot.payload.line == pytest.approx(1.0, abs=0.15)


@on_bench("bench")
async def test_winch_at_the_end_of_its_line_gives_up(b, fc, /):
    start = asyncio.get_running_loop().time()
    with pytest.raises(DeviceError, match="winch failed: no progress for 10 s"):
        await fc.execute("winch", [1000.0, 5.0])
    assert asyncio.get_running_loop().time() - start < 60.0


@on_bench("bench")
async def test_cancelled_winch_holds_its_line(b, fc, /):
    winding = asyncio.ensure_future(fc.execute("winch", [10.0, 1.0]))
    await b.until(lambda: b.autopilot.payload.line > 2.0)
    winding.cancel()
    await fc.execute("stopWinch", [])
    held = b.autopilot.payload.line
    await asyncio.sleep(5.0)
    assert b.autopilot.payload.line == pytest.approx(held, abs=0.1)
    assert 2.0 < held < 4.0


@on_bench("bench")
async def test_relay_is_switched(b, fc, /):
    await fc.execute("setRelay", [1, True])
    assert b.autopilot.payload.relays[1]
    await fc.execute("setRelay", [1, False])
    assert not b.autopilot.payload.relays[1]


def test_servo_that_does_not_move_is_an_error(bench):
    b = bench()

    class Stuck(dict):
        def __setitem__(self, number, pulse):
            pass

    async def mission(fc):
        b.autopilot.payload.servos = Stuck(b.autopilot.payload.servos)
        with pytest.raises(DeviceError, match="setServo was accepted but did not happen"):
            await fc.execute("setServo", [5, 0.0])

    b.run(mission)


@on_bench("bench")
async def test_payload_works_during_a_flight(b, fc, /):
    await up(fc)
    flight = asyncio.create_task(fc.execute("goTo", [15.0, 0.0, -5.0]))
    await asyncio.sleep(0.5)
    await fc.execute("closeGripper", [])
    await fc.execute("winch", [1.0, 1.0])
    assert not flight.done()
    await flight


@pytest.mark.parametrize(
    ("instruction", "arguments"),
    [
        ("winch", [math.nan, 1.0]),
        ("winch", [1.0, 0.0]),
        ("winch", [1.0, 1e-9]),
        ("winch", [1e13, 1e13]),
        ("setServo", [0, 0.0]),
        ("setServo", [1, math.nan]),
        ("setServo", [1, 1.5]),
        ("setRelay", [-1, True]),
        ("pointGimbal", [math.inf, 0.0]),
        ("pointGimbalAt", [1e9, 0.0, 0.0]),
        ("startPictures", [1e39, 0]),
        ("uploadMission", [[47.0, 8.0, 1e39]]),
        ("setHome", [91.0, 0.0, 0.0]),
        ("setHome", [0.0, 0.0, math.nan]),
        ("command", [-1, []]),
    ],
)
@on_bench("bench")
async def test_invalid_argument_is_refused_before_sending(b, fc, /, instruction, arguments):
    sent = len(b.sent)
    with pytest.raises(DeviceError, match=instruction):
        await fc.execute(instruction, arguments)
    assert len(b.sent) == sent


def test_camera_trigger_with_lost_acknowledgement_is_not_repeated(bench):
    b = bench()
    deliver = b.filter

    def without_acks(link, packet):
        if packet[7] != dialect.MAVLINK_MSG_ID_COMMAND_ACK:
            deliver(link, packet)

    async def mission(fc):
        b.filter = without_acks
        with pytest.raises(DeviceError, match="may have been executed") as error:
            await fc.execute("triggerCamera", [])
        assert error.value.kind == "DeviceTimeoutException"

    b.run(mission)
    assert b.autopilot.payload.camera.pictures == 1


@on_bench("bench")
async def test_home_is_set_only_while_disarmed(b, fc, /):
    latitude, longitude, altitude = b.values["globalPosition"]
    await fc.execute("setHome", [latitude + 1e-4, longitude, altitude])
    await asyncio.sleep(1.0)
    assert b.values["position"][0] == pytest.approx(-11.13, abs=0.1)
    await fc.execute("arm", [])
    with pytest.raises(DeviceError, match="the vehicle is armed"):
        await fc.execute("setHome", [latitude, longitude, altitude])


@on_bench("bench")
async def test_reboot_ends_when_telemetry_is_set_up_again(b, fc, /):
    await asyncio.sleep(20.0)
    before = b.autopilot.uptime
    await fc.execute("reboot", [])
    assert b.autopilot.uptime < before
    b.values.clear()
    await asyncio.sleep(2.0)
    assert "position" in b.values
    await fc.execute("arm", [])
    with pytest.raises(DeviceError, match="reboot refused: the vehicle is armed"):
        await fc.execute("reboot", [])


@pytest.mark.few(1)
@pytest.mark.parametrize("seconds", [2.0, 5.0])
@pytest.mark.parametrize("answered", [True, False])
def test_reboot_with_delay_or_lost_acknowledgement(bench, monkeypatch, seconds, answered):
    """As measured on ArduPilot: accepted, the link closes, heartbeats resume 2 to 5 s later."""
    monkeypatch.setattr("lfield_sim.autopilot.pilot.REBOOT", seconds)
    b = bench()
    deliver = b.filter

    async def mission(fc):
        await asyncio.sleep(20.0)
        b.filter = lambda link, data: deliver(link, data) if answered or data[7] != ACK else None
        asyncio.get_running_loop().call_later(1.0, setattr, b, "filter", deliver)
        start = asyncio.get_running_loop().time()
        await fc.execute("reboot", [])
        # A vehicle that is back before the last repetition reboots a second time, without harm.
        assert 1 <= b.autopilot.boots <= (1 if answered else 2)
        assert asyncio.get_running_loop().time() - start < 2.0 * seconds + 5.0
        await fc.execute("waitReady", [60.0])
        await fc.execute("arm", [])

    b.run(mission)


@on_bench("bench")
async def test_raw_command_returns_its_result(b, fc, /):
    known = await fc.execute("command", [int(dialect.MAV_CMD_DO_SET_RELAY), [0.0, 1.0]])
    unknown = await fc.execute("command", [31010, []])
    assert (known, unknown) == (0, 3)


MOVING = [
    dialect.MAV_CMD_NAV_TAKEOFF,
    dialect.MAV_CMD_NAV_WAYPOINT,
    dialect.MAV_CMD_DO_REPOSITION,
    dialect.MAV_CMD_DO_ORBIT,
    dialect.MAV_CMD_DO_SET_MODE,
    dialect.MAV_CMD_COMPONENT_ARM_DISARM,
    dialect.MAV_CMD_DO_FLIGHTTERMINATION,
    dialect.MAV_CMD_DO_MOTOR_TEST,
    dialect.MAV_CMD_DO_CHANGE_SPEED,
    dialect.MAV_CMD_DO_PARACHUTE,
    dialect.MAV_CMD_DO_FENCE_ENABLE,
    dialect.MAV_CMD_CONDITION_YAW,
    dialect.MAV_CMD_MISSION_START,
    dialect.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN,
    dialect.MAV_CMD_PREFLIGHT_STORAGE,
    dialect.MAV_CMD_DO_SET_HOME,
    dialect.MAV_CMD_DO_FOLLOW,
    dialect.MAV_CMD_DO_PAUSE_CONTINUE,
]


@on_bench("bench")
async def test_raw_motion_commands_are_refused_before_sending(b, fc, /):
    for number in map(int, MOVING):
        sent = len(b.sent)
        with pytest.raises(DeviceError, match="use an instruction"):
            await fc.execute("command", [number, []])
        assert len(b.sent) == sent
        assert number in REFUSED


def test_unanswered_px4_payload_command_suggests_missing_hardware(bench):
    """As measured: PX4 leaves commands unanswered for which it has no driver, such as 203 and 205."""
    b = bench(flavour="px4")
    deliver = b.filter

    async def mission(fc):
        b.filter = lambda link, data: None if data[7] == ACK else deliver(link, data)
        with pytest.raises(DeviceError, match="it may have no camera; it may have been executed") as raised:
            await fc.execute("triggerCamera", [])
        assert raised.value.kind == "DeviceTimeoutException"

    b.run(mission)
