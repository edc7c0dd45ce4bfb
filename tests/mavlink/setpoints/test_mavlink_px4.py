"""The driver against the PX4 flavour of the fake: the same instructions, other messages."""

from __future__ import annotations

import asyncio
import math

import pytest
from coroutine_tests import on_bench
from takeoff import up

from lfield.errors import DeviceError
from lfield_mavlink.link.dialect import Reader, dialect
from lfield_sim.autopilot.autopilot import Autopilot
from lfield_sim.autopilot.flavours import MavResult
from lfield_sim.autopilot.ground_vehicle import Wheels

TARGET = dialect.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED


@pytest.fixture
def px4(bench):
    return lambda **given: bench(flavour="px4", **given)


def sent(b, kind, since=0):
    """The messages of a kind that the driver sent."""
    reader = Reader()
    return [m for data in b.sent[since:] for m in reader.feed(data) if m.get_msgId() == kind]


@on_bench("px4")
async def test_complete_flight_with_px4(b, fc, /):
    await up(fc, 6.0)
    assert b.values["altitude"] == pytest.approx(6.0, abs=0.6)
    assert b.autopilot.parameters["MIS_TAKEOFF_ALT"] == 2.5  # set by another party, unchanged
    await fc.execute("goTo", [10.0, -4.0, -6.0])
    assert math.dist(b.values["position"], (10.0, -4.0, -6.0)) <= 0.5
    await fc.execute("yaw", [2.0])
    assert b.values["heading"] == pytest.approx(2.0, abs=0.08)
    await fc.execute("hold", [])
    await fc.execute("land", [])
    await fc.execute("disarm", [])
    assert not b.autopilot.armed


@pytest.mark.few(0)
@on_bench("px4", kind="rover", limits={"speed": 2.0, "radius": 8.0})
async def test_px4_rover_drives_a_circle_to_its_heading(b, fc, /):
    await fc.execute("arm", [])
    for heading in (math.pi, -1.0, -1.02):
        before, modes = b.values["position"], len(sent(b, TARGET))
        await fc.execute("yaw", [heading])
        assert math.remainder(b.values["heading"] - heading, math.tau) == pytest.approx(0.0, abs=0.08)
        assert b.values["mode"] == "AUTO.LOITER"
        await asyncio.sleep(2.0)
        assert math.remainder(b.values["heading"] - heading, math.tau) == pytest.approx(0.0, abs=0.08)
        assert math.dist(b.values["position"], before) < 4.0
    assert len(sent(b, TARGET)) == modes, "it already had the heading"
    await fc.execute("goTo", [5.0, 0.0, 0.0])
    with pytest.raises(DeviceError, match=r"to drive round in, refused: .* beyond the limit of 8 m"):
        await fc.execute("yaw", [0.0])


def test_px4_rover_that_cannot_turn_is_given_up(px4):
    b = px4(kind="rover")
    b.autopilot.vehicle.wheels = Wheels(20.0)

    async def mission(fc):
        await fc.execute("arm", [])
        with pytest.raises(DeviceError, match=r"yaw failed: driving round.* or moved 5 m away"):
            await fc.execute("yaw", [2.0])
        assert b.values["mode"] == "AUTO.LOITER"
        await asyncio.sleep(2.0)
        b.autopilot.parameters["GF_MAX_HOR_DIST"] = 8.0
        with pytest.raises(DeviceError, match=r"refused: it needs 5 m .*GF_MAX_HOR_DIST ends at 8 m"):
            await fc.execute("yaw", [2.0])

    b.run(mission)
    assert math.hypot(*b.autopilot.vehicle.place[:2]) < 7.0


@on_bench("px4")
async def test_velocity_is_streamed_only_until_its_ttl(b, fc, /):
    loop = asyncio.get_running_loop()
    await up(fc)
    before, start = len(b.sent), loop.time()
    await fc.execute("setVelocity", [2.0, 0.0, 0.0])
    assert b.values["mode"] == "OFFBOARD"
    assert loop.time() - start < 0.5
    await asyncio.sleep(start + 0.5 - loop.time())
    targets = sent(b, TARGET, before)
    assert 9 <= len(targets) <= 11
    assert {(m.vx, m.type_mask) for m in targets} == {(2.0, 0x0DC7)}
    before = len(b.sent)
    await asyncio.sleep(2.0)
    assert sent(b, TARGET, before) == []
    # Without setpoints PX4's own watchdog leaves OFFBOARD.
    assert b.autopilot.mode == "AUTO.LAND"


@on_bench("px4")
async def test_renewed_velocities_continue_the_flight(b, fc, /):
    await up(fc)
    for _ in range(10):
        await fc.execute("setVelocity", [2.0, 0.0, 0.0])
        await asyncio.sleep(0.3)
    assert b.values["mode"] == "OFFBOARD"
    # PX4 flies slightly slower than commanded.
    assert 1.6 < b.values["velocity"][0] < 2.1
    # Another motion ends the stream at once.
    await fc.execute("hold", [])
    before = len(b.sent)
    await asyncio.sleep(1.0)
    assert {(m.type_mask, round(m.x, 3)) for m in sent(b, TARGET, before)} == {
        (0x0DF8, round(sent(b, TARGET, before)[0].x, 3))
    }
    assert b.values["mode"] == "OFFBOARD"


@on_bench("px4", ttl=2.0)
async def test_accepted_but_unavailable_offboard_is_refused_at_once(b, fc, /):
    await up(fc)
    await fc.execute("setMode", ["AUTO.LOITER"])
    await asyncio.sleep(2.0)
    # As measured: PX4 accepts OFFBOARD without a stream, does not enter it, and sends a text.
    fc.motion.stream.start = lambda message, until: None
    start = asyncio.get_running_loop().time()
    with pytest.raises(DeviceError, match=r"OFFBOARD was refused: .*to Offboard is currently not available"):
        await fc.execute("setVelocity", [1.0, 0.0, 0.0])
    assert asyncio.get_running_loop().time() - start < 0.6
    # The text about OFFBOARD does not refuse another mode.
    await fc.execute("setMode", ["AUTO.RTL"])


@on_bench("px4")
async def test_px4_takeoff_while_disarmed_is_refused_without_mode_change(b, fc, /):
    with pytest.raises(DeviceError, match="the motors are off"):
        await fc.execute("takeoff", [5.0])
    assert b.autopilot.mode == "AUTO.LOITER"


@on_bench("px4", faults=("refuse_arming=Compass 0 missing",))
async def test_refused_px4_arming_has_the_reason(b, fc, /):
    with pytest.raises(DeviceError) as error:
        await fc.execute("arm", [])
    reason = error.value.reason
    assert reason.startswith("arm refused: TEMPORARILY_REJECTED (1), Preflight Fail: Compass 0 missing")
    assert "health failures first" in reason


@pytest.mark.few(1)
@pytest.mark.parametrize(
    ("state", "mode"), [("land", "AUTO.LAND"), ("hold", "AUTO.LOITER"), ("return", "AUTO.RTL")]
)
@on_bench("px4", given="safe_state=state")
async def test_each_px4_safe_state_in_the_air(b, fc, /, state, mode):
    await up(fc)
    await fc.execute("setVelocity", [3.0, 0.0, 0.0])
    await asyncio.sleep(0.3)
    before = len(b.sent)
    await fc.make_safe()
    assert b.autopilot.mode == mode
    assert sent(b, TARGET, before) == []
    await asyncio.sleep(60.0)
    assert b.autopilot.vehicle.airborne == (state == "hold")


@pytest.mark.few(0)
@on_bench("px4")
async def test_px4_orbit_and_return(b, fc, /):
    await up(fc)
    await fc.execute("orbit", [0.0, 0.0, -5.0, 6.0, 3.0, 1.0])
    assert b.values["mode"] == "OFFBOARD"
    await fc.execute("returnHome", [])
    assert b.values["landed"]


@pytest.mark.few(0)
@on_bench("px4", limits={"speed": 2.0})
async def test_px4_keeps_the_speed_limit(b, fc, /):
    await up(fc)
    flight = asyncio.create_task(fc.execute("goTo", [15.0, 0.0, -5.0]))
    fastest = 0.0
    while not flight.done():
        await asyncio.sleep(0.1)
        fastest = max(fastest, b.values["groundSpeed"])
    assert 1.6 < fastest <= 2.05


@on_bench("px4")
async def test_px4_global_goal_is_reached(b, fc, /):
    await up(fc)
    latitude, longitude, _ = b.values["globalPosition"]
    await fc.execute("goToGlobal", [latitude + 1e-4, longitude, 7.0])
    assert b.values["position"] == pytest.approx([11.13, 0.0, -7.0], abs=0.6)


@on_bench("px4")
async def test_px4_integer_parameter_is_decoded_bytewise(b, fc, /):
    found = await fc.parameters.read("NAV_DLL_ACT")
    assert (found, type(found)) == (3, int)


@on_bench("px4", ttl=1.0)
async def test_lost_offboard_request_is_repeated(b, fc, /):
    await up(fc)
    await fc.execute("setMode", ["AUTO.LOITER"])
    send, lost = b.links[0].send, []

    def lose_two(data):
        if data[7] == dialect.MAVLINK_MSG_ID_COMMAND_LONG and len(lost) < 2:
            lost.append(data)
        else:
            send(data)

    b.links[0].send = lose_two
    await fc.execute("setVelocity", [1.0, 0.0, 0.0])
    assert b.values["mode"] == "OFFBOARD"
    assert len(lost) == 2


@on_bench("px4", ttl=0.5)
async def test_px4_failsafe_and_pilot_control_are_distinguished(b, fc, /):
    await up(fc)
    await fc.execute("setVelocity", [1.0, 0.0, 0.0])
    # Without a renewal PX4's own setpoint failsafe lands the vehicle.
    await asyncio.sleep(3.0)
    assert b.values["failsafe"] is True
    with pytest.raises(DeviceError, match="its failsafe, instead of OFFBOARD, controls the vehicle"):
        await fc.execute("goTo", [1.0, 0.0, -5.0])
    b.autopilot.command_mode("AUTO.RTL")
    await asyncio.sleep(1.5)
    with pytest.raises(DeviceError, match=r"in AUTO.RTL, .* a pilot or another station controls the vehicle"):
        await fc.execute("goTo", [1.0, 0.0, -5.0])


@on_bench("px4")
async def test_cancelled_setpoint_is_not_streamed(b, fc, /):
    await up(fc)
    await fc.execute("setMode", ["AUTO.LOITER"])
    call = asyncio.create_task(fc.execute("setVelocity", [1.0, 0.0, 0.0]))
    await asyncio.sleep(0.03)
    call.cancel()
    await asyncio.gather(call, return_exceptions=True)
    before = len(b.sent)
    await asyncio.sleep(0.5)
    assert sent(b, TARGET, before) == []


@on_bench("px4")
async def test_refusal_text_counts_only_for_its_mode(b, fc, /, monkeypatch):
    command_mode, waits = Autopilot.command_mode, []

    def late(autopilot, name):
        """The first copy is lost; the next text is a late one about an earlier OFFBOARD."""
        if name == "AUTO.LAND" and not waits:
            waits.append(name)
            autopilot.say("Switching to Offboard is currently not available\t")
            return MavResult.ACCEPTED
        return command_mode(autopilot, name)

    await up(fc)
    monkeypatch.setattr(Autopilot, "command_mode", late)
    await fc.make_safe()
    assert b.values["mode"] == "AUTO.LAND"
    start = asyncio.get_running_loop().time()
    with pytest.raises(DeviceError, match=r"AUTO.MISSION refused, .*Mission is currently not available"):
        await fc.motion.set_mode("AUTO.MISSION")
    assert asyncio.get_running_loop().time() - start < 1.5


@pytest.mark.few(1)
@pytest.mark.parametrize(
    ("delay", "stays_on", "note_count"),
    [(2.0, False, 0), (14.0, False, 1), (600.0, False, 1), (-1.0, True, 0)],
)
def test_px4_landing_ends_when_motors_are_off_or_kept_on(px4, delay, stays_on, note_count):
    b = px4()
    b.autopilot.parameters["COM_DISARM_LAND"] = delay

    async def mission(fc):
        await up(fc)
        await fc.execute("land", [])
        assert b.values["landed"]
        assert b.values["armed"] is stays_on
        assert len([note for note in b.notes if "switching them off" in note]) == note_count
        await fc.execute("arm", [])
        await asyncio.sleep(1.5)
        assert b.values["armed"] is True

    b.run(mission)


STOPS = {
    "hold": lambda fc: fc.execute("hold", []),
    "setMode": lambda fc: fc.execute("setMode", ["AUTO.LOITER"]),
    "safe state": lambda fc: fc.make_safe(),
}


@pytest.mark.few(2)
@pytest.mark.parametrize("after", [0.02, 0.2, 4.0])
@pytest.mark.parametrize("stop", STOPS)
@on_bench("px4", safe_state="hold", ttl=2.0)
async def test_every_stop_ends_a_motion_to_a_goal(b, fc, /, stop, after):
    await up(fc)
    await fc.execute("setVelocity", [2.0, 0.0, 0.0])
    assert b.values["mode"] == "OFFBOARD"
    flight = asyncio.create_task(fc.execute("goTo", [80.0, 0.0, -5.0]))
    await asyncio.sleep(after)
    flight.cancel()
    await STOPS[stop](fc)
    await asyncio.sleep(5.0)
    assert math.hypot(*b.autopilot.vehicle.velocity) < 0.1
    assert b.autopilot.vehicle.place[0] < 30.0
    assert b.autopilot.mode == ("OFFBOARD" if stop == "hold" else "AUTO.LOITER")


@on_bench("px4")
async def test_paused_px4_mission_stops(b, fc, /):
    await up(fc)
    latitude, longitude, _ = b.values["globalPosition"]
    await fc.execute("uploadMission", [[latitude + 1e-3, longitude, 5.0]])
    await fc.execute("startMission", [])
    await asyncio.sleep(4.0)
    await fc.execute("pauseMission", [])
    await asyncio.sleep(5.0)
    assert math.hypot(*b.autopilot.vehicle.velocity) < 0.1
    assert b.autopilot.vehicle.place[0] < 60.0


@pytest.mark.parametrize("state", ["hold", "land"])
@on_bench("px4", kind="rover", given="safe_state=state")
async def test_px4_rover_stops_for_land_or_safe_state(b, fc, /, state):
    """A rover has no landing: it stays in the same mode in which it drives to a goal."""
    await fc.execute("arm", [])
    drive = asyncio.create_task(fc.execute("goTo", [60.0, 0.0, 0.0]))
    await asyncio.sleep(4.0)
    drive.cancel()
    await (fc.make_safe() if state == "hold" else fc.execute("land", []))
    await asyncio.sleep(6.0)
    assert math.hypot(*b.autopilot.vehicle.velocity) < 0.1


@pytest.mark.few(0)
@on_bench("px4")
async def test_goal_that_was_given_up_is_not_pursued(b, fc, /):
    await up(fc)
    limits = b.autopilot.vehicle.limits
    flight = asyncio.create_task(fc.execute("goTo", [80.0, 0.0, -5.0]))
    await asyncio.sleep(3.0)
    was, limits.top = limits.top, 0.001
    with pytest.raises(DeviceError, match="no progress for 10 s"):
        await flight
    limits.top = was
    before = b.autopilot.vehicle.place[0]
    await asyncio.sleep(5.0)
    assert b.autopilot.vehicle.place[0] == pytest.approx(before, abs=1.0)
