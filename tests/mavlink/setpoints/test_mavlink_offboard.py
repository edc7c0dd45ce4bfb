"""PX4 in OFFBOARD: causes and effects of its end, and motions that need a waiver."""

from __future__ import annotations

import asyncio
import math

import pytest
from coroutine_tests import on_bench
from takeoff import up

from lfield.errors import DeviceError
from lfield_mavlink.link.dialect import Reader, dialect

TARGET = dialect.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED


@pytest.fixture
def px4(bench):
    return lambda **given: bench(flavour="px4", **{"waivers": ("device_watchdog",), **given})


def targets(b, since):
    reader = Reader()
    return [m for data in b.sent[since:] for m in reader.feed(data) if m.get_msgId() == TARGET]


async def away(fc):
    """Starts a motion to a far goal."""
    await up(fc, 8.0)
    flight = asyncio.create_task(fc.execute("goTo", [150.0, 0.0, -8.0]))
    await asyncio.sleep(6.0)
    return flight


async def ended(flight):
    with pytest.raises(DeviceError) as error:
        await flight
    return error.value.reason


@on_bench("px4")
async def test_stick_takeover_ends_the_setpoints(b, fc, /):
    flight = await away(fc)
    b.faults.apply(["sticks=true"])
    start = b.autopilot.now
    reason = await ended(flight)
    assert b.autopilot.now - start < 1.0
    assert "goTo ended early: the vehicle went to POSCTL" in reason
    assert "Pilot took over using sticks" in reason
    await asyncio.sleep(1.5)
    before = len(b.sent)
    await asyncio.sleep(2.0)
    assert targets(b, before) == [], "a switch to OFFBOARD must find no old target"
    assert b.autopilot.mode == "POSCTL"
    for what, values in (("goTo", [0.0, 0.0, -8.0]), ("hold", [])):
        with pytest.raises(DeviceError, match=f"{what} refused: the vehicle is in POSCTL"):
            await fc.execute(what, values)
    await fc.make_safe()
    assert b.autopilot.mode == "POSCTL", "it is left to the pilot"


@pytest.mark.few(0)
@on_bench("px4")
async def test_disabled_stick_override_is_no_takeover(b, fc, /):
    flight = await away(fc)
    b.autopilot.parameters["COM_RC_OVERRIDE"] = 1
    b.faults.apply(["sticks=true"])
    await asyncio.sleep(2.0)
    assert b.autopilot.mode == "OFFBOARD"
    with pytest.raises(DeviceError, match="COM_RC_OVERRIDE is 1 and must be 3"):
        await fc.check_settings()
    flight.cancel()


@pytest.mark.few(1)
@pytest.mark.parametrize("mode", ["AUTO.LOITER", "AUTO.RTL", "AUTO.LAND", "POSCTL.ORBIT"])
@on_bench("px4")
async def test_mode_change_by_another_station_is_a_takeover(b, fc, /, mode):
    flight = await away(fc)
    b.autopilot.command_mode(mode)
    assert f"goTo ended early: the vehicle went to {mode}" in await ended(flight)
    assert fc.taken_over()
    with pytest.raises(DeviceError, match=rf"goTo refused: .*in {mode}, which this program"):
        await fc.execute("goTo", [0.0, 0.0, -8.0])
    await asyncio.sleep(1.5)
    before = len(b.sent)
    await asyncio.sleep(1.0)
    assert targets(b, before) == []
    assert b.autopilot.mode in (mode, "AUTO.LOITER")
    await fc.execute("release", [])
    await fc.execute("hold", [])
    assert b.autopilot.mode == "OFFBOARD"


@on_bench("px4")
async def test_gps_loss_ends_the_setpoints_and_lands(b, fc, /):
    flight = await away(fc)
    b.faults.apply(["gps_loss=true"])
    await ended(flight)
    while b.autopilot.mode != "AUTO.LAND":
        await asyncio.sleep(0.05)
    await asyncio.sleep(1.5)
    before = len(b.sent)
    await asyncio.sleep(1.0)
    assert targets(b, before) == []


@on_bench("px4")
async def test_fence_breach_in_offboard_takes_control(b, fc, /):
    """As recorded (fact 41), but with no hold before the action: COM_FAIL_ACT_T is 0."""
    flight = await away(fc)
    b.autopilot.parameters.update(GF_MAX_HOR_DIST=15.0, GF_ACTION=3)
    reason = await ended(flight)
    assert "the vehicle went to AUTO.RTL, which its failsafe chose" in reason
    assert "Geofence: exceeding maximum distance to Home" in reason
    assert fc.taken_over()


@pytest.mark.few(0)
@on_bench("px4", limits={"speed": 3.0})
async def test_target_waits_for_an_obstructed_vehicle(b, fc, /):
    flight = await away(fc)
    limits, place = b.autopilot.vehicle.limits, b.autopilot.vehicle.place
    was, limits.top = limits.top, 0.001
    await asyncio.sleep(5.0)
    ahead = targets(b, len(b.sent) - 40)[-1].x - b.autopilot.vehicle.place[0]
    assert b.autopilot.vehicle.place[0] - place[0] < 4.0
    assert ahead <= 1.35 * 3.0 + 0.5 + 0.1
    limits.top, fastest = was, 0.0
    for _ in range(200):
        await asyncio.sleep(0.05)
        fastest = max(fastest, math.hypot(*b.autopilot.vehicle.velocity[:2]))
    assert fastest <= 3.0 * 1.05
    flight.cancel()


@pytest.mark.few(0)
@on_bench("px4")
async def test_hover_between_motions_uses_setpoints(b, fc, /):
    await up(fc, 8.0)
    await fc.execute("goTo", [5.0, 0.0, -8.0])
    place = b.autopilot.vehicle.place
    await asyncio.sleep(60.0)
    assert b.autopilot.mode == "OFFBOARD"
    assert math.dist(b.autopilot.vehicle.place, place) < 0.7
    await fc.execute("land", [])
    assert not b.autopilot.armed


@pytest.mark.few(0)
@pytest.mark.parametrize("loss", [0.2, 0.4])
@on_bench("px4", faults=())
async def test_lost_setpoints_do_not_end_offboard(b, fc, /, loss):
    flight = await away(fc)
    b.faults.apply([f"loss={loss}"])
    await asyncio.sleep(20.0)
    assert b.autopilot.mode == "OFFBOARD"
    flight.cancel()


@pytest.mark.few(3)
@pytest.mark.parametrize(
    ("what", "values"),
    [
        ("returnHome", []),
        ("startMission", []),
        ("setMode", ["AUTO.RTL"]),
        ("setMode", ["AUTO.TAKEOFF"]),
        ("setMode", ["AUTO.LOITER"]),
        ("setMode", ["POSCTL.ORBIT"]),
        ("setMode", ["AUTO.FOLLOW_TARGET"]),
    ],
)
@on_bench("px4")
async def test_autonomous_px4_motion_needs_a_waiver(b, fc, /, what, values):
    await up(fc, 8.0)
    before = len(b.sent)
    with pytest.raises(DeviceError) as error:
        await fc.execute(what, values)
    assert "by itself, and would continue if this computer fails" in error.value.reason
    assert "waivers: {autonomous_motion: REASON}" in error.value.reason
    assert {m.type_mask for m in targets(b, before)} <= {0x0DF8}
    assert b.autopilot.mode == "OFFBOARD"


@pytest.mark.few(1)
@pytest.mark.parametrize(
    "given", [{"waivers": ("device_watchdog", "autonomous_motion")}, {"safe_state": "return"}]
)
def test_px4_return_is_flown_with_waiver_or_as_safe_state(px4, given):
    b = px4(**given)

    async def scenario(fc):
        await up(fc, 8.0)
        await fc.execute("returnHome", [])
        assert not b.autopilot.armed

    b.run(scenario)


@pytest.mark.few(0)
@on_bench("bench", waivers=("device_watchdog",))
async def test_ardupilot_return_needs_no_waiver(b, fc, /):
    await up(fc, 8.0)
    await fc.execute("returnHome", [])


@pytest.mark.parametrize("mode", ["LOITER", "ALT_HOLD", "BRAKE", "STABILIZE"])
@on_bench("bench", waivers=("device_watchdog",))
async def test_pilot_mode_of_a_flying_arducopter_needs_a_waiver(b, fc, /, mode):
    """With bit 4 of FS_OPTIONS its failsafe would not act in a pilot mode when this computer fails."""
    await fc.execute("setMode", [mode])
    await fc.execute("setMode", ["GUIDED"])
    await up(fc, 8.0)
    with pytest.raises(DeviceError) as error:
        await fc.execute("setMode", [mode])
    assert "waivers: {autonomous_motion: REASON}" in error.value.reason
    assert b.autopilot.mode == "GUIDED"


@on_bench("bench", waivers=("device_watchdog", "autonomous_motion"))
async def test_pilot_mode_is_entered_with_a_waiver(b, fc, /):
    await up(fc, 8.0)
    await fc.execute("setMode", ["LOITER"])
    assert b.autopilot.mode == "LOITER"


@pytest.mark.parametrize(("state", "kind"), [("hold", "copter"), ("land", "rover")])
@on_bench("px4", given="safe_state=state kind")
async def test_loiter_is_entered_where_it_is_safe(b, fc, /, state, kind):
    await fc.execute("setMode", ["AUTO.LOITER"])
    await fc.execute("arm", [])
    if kind == "copter":
        await fc.execute("takeoff", [8.0])
    await fc.execute("setMode", ["AUTO.LOITER"])
    assert b.autopilot.mode == "AUTO.LOITER"
