"""The driver against the PX4 flavour of the fake: the same instructions, other messages."""

from __future__ import annotations

import asyncio
import math

import pytest
from coroutine_tests import on_bench

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


async def up(fc, height=5.0):
    await fc.execute("arm", [])
    await fc.execute("takeoff", [height])


@on_bench("px4")
async def test_a_whole_flight(b, fc, /):
    await up(fc, 6.0)
    assert b.values["altitude"] == pytest.approx(6.0, abs=0.6)
    assert b.autopilot.parameters["MIS_TAKEOFF_ALT"] == 2.5  # it is another's, and stays as it was
    await fc.execute("goTo", [10.0, -4.0, -6.0])
    assert math.dist(b.values["position"], (10.0, -4.0, -6.0)) <= 0.5
    await fc.execute("yaw", [2.0])
    assert b.values["heading"] == pytest.approx(2.0, abs=0.08)
    await fc.execute("hold", [])
    await fc.execute("land", [])
    await fc.execute("disarm", [])
    assert not b.autopilot.armed


@on_bench("px4", kind="rover", limits={"speed": 2.0, "radius": 8.0})
async def test_a_rover_drives_round_to_its_heading_and_holds(b, fc, /):
    await fc.execute("arm", [])
    for heading in (math.pi, -1.0, -1.02):
        before, modes = b.values["position"], len(sent(b, TARGET))
        await fc.execute("yaw", [heading])
        assert math.remainder(b.values["heading"] - heading, math.tau) == pytest.approx(0.0, abs=0.08)
        assert b.values["mode"] == "AUTO.LOITER"
        await asyncio.sleep(2.0)
        assert math.remainder(b.values["heading"] - heading, math.tau) == pytest.approx(0.0, abs=0.08)
        assert math.dist(b.values["position"], before) < 4.0
    assert len(sent(b, TARGET)) == modes, "it was there already"
    await fc.execute("goTo", [5.0, 0.0, 0.0])
    with pytest.raises(DeviceError, match=r"to drive round in, refused: .* beyond the limit of 8 m"):
        await fc.execute("yaw", [0.0])


def test_a_rover_that_does_not_come_round_is_given_up(px4):
    b = px4(kind="rover")
    b.autopilot.vehicle.wheels = Wheels(20.0)

    async def mission(fc):
        await fc.execute("arm", [])
        with pytest.raises(DeviceError, match=r"yaw gave up: driving round .* or 5 m away"):
            await fc.execute("yaw", [2.0])
        assert b.values["mode"] == "AUTO.LOITER"
        await asyncio.sleep(2.0)
        b.autopilot.parameters["GF_MAX_HOR_DIST"] = 8.0
        with pytest.raises(DeviceError, match=r"refused: it needs 5 m .*GF_MAX_HOR_DIST ends at 8 m"):
            await fc.execute("yaw", [2.0])

    b.run(mission)
    assert math.hypot(*b.autopilot.vehicle.place[:2]) < 7.0


@on_bench("px4")
async def test_a_velocity_is_streamed_until_its_time_is_over_and_no_longer(b, fc, /):
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
    # Nobody feeds it any more: PX4's own watchdog has taken it out of OFFBOARD.
    assert b.autopilot.mode == "AUTO.LAND"


@on_bench("px4")
async def test_velocities_that_are_renewed_fly_on(b, fc, /):
    await up(fc)
    for _ in range(10):
        await fc.execute("setVelocity", [2.0, 0.0, 0.0])
        await asyncio.sleep(0.3)
    assert b.values["mode"] == "OFFBOARD"
    # PX4 flies a little slower than it is told.
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
async def test_an_accepted_offboard_that_is_not_available_is_refused_at_once(b, fc, /):
    await up(fc)
    await fc.execute("setMode", ["AUTO.LOITER"])
    await asyncio.sleep(2.0)
    # As measured: PX4 accepts OFFBOARD without a stream, does not enter it, and says so.
    fc.motion.stream.start = lambda message, until: None
    start = asyncio.get_running_loop().time()
    with pytest.raises(DeviceError, match=r"OFFBOARD was refused: .*to Offboard is currently not available"):
        await fc.execute("setVelocity", [1.0, 0.0, 0.0])
    assert asyncio.get_running_loop().time() - start < 0.6
    # The words about OFFBOARD do not speak against another mode.
    await fc.execute("setMode", ["AUTO.RTL"])


@on_bench("px4")
async def test_a_takeoff_while_disarmed_is_not_left_with_px4_for_later(b, fc, /):
    with pytest.raises(DeviceError, match="the motors are off"):
        await fc.execute("takeoff", [5.0])
    assert b.autopilot.mode == "AUTO.LOITER"


@on_bench("px4", faults=("refuse_arming=Compass 0 missing",))
async def test_a_refused_arming_has_the_reason(b, fc, /):
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
async def test_safe_states_in_the_air(b, fc, /, state, mode):
    await up(fc)
    await fc.execute("setVelocity", [3.0, 0.0, 0.0])
    await asyncio.sleep(0.3)
    before = len(b.sent)
    await fc.make_safe()
    assert b.autopilot.mode == mode
    assert sent(b, TARGET, before) == []
    await asyncio.sleep(60.0)
    assert b.autopilot.vehicle.airborne == (state == "hold")


@on_bench("px4")
async def test_orbit_and_return(b, fc, /):
    await up(fc)
    await fc.execute("orbit", [0.0, 0.0, -5.0, 6.0, 3.0, 1.0])
    assert b.values["mode"] == "OFFBOARD"
    await fc.execute("returnHome", [])
    assert b.values["landed"]


@on_bench("px4", limits={"speed": 2.0})
async def test_the_speed_of_the_binding_is_kept(b, fc, /):
    await up(fc)
    flight = asyncio.create_task(fc.execute("goTo", [15.0, 0.0, -5.0]))
    fastest = 0.0
    while not flight.done():
        await asyncio.sleep(0.1)
        fastest = max(fastest, b.values["groundSpeed"])
    assert 1.6 < fastest <= 2.05


@on_bench("px4")
async def test_global_goals(b, fc, /):
    await up(fc)
    latitude, longitude, _ = b.values["globalPosition"]
    await fc.execute("goToGlobal", [latitude + 1e-4, longitude, 7.0])
    assert b.values["position"] == pytest.approx([11.13, 0.0, -7.0], abs=0.6)


@on_bench("px4")
async def test_parameters_of_whole_numbers_are_packed_by_bytes(b, fc, /):
    found = await fc.parameters.read("NAV_DLL_ACT")
    assert (found, type(found)) == (3, int)


@on_bench("px4", ttl=1.0)
async def test_offboard_is_asked_for_again_when_a_packet_was_lost(b, fc, /):
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
async def test_what_its_failsafe_has_taken_is_told_from_what_a_pilot_has(b, fc, /):
    await up(fc)
    await fc.execute("setVelocity", [1.0, 0.0, 0.0])
    # It is not renewed, and PX4's own failsafe for setpoints lands the vehicle.
    await asyncio.sleep(3.0)
    assert b.values["failsafe"] is True
    with pytest.raises(DeviceError, match="its failsafe, instead of OFFBOARD, has it"):
        await fc.execute("goTo", [1.0, 0.0, -5.0])
    b.autopilot.command_mode("AUTO.RTL")
    await asyncio.sleep(1.5)
    with pytest.raises(DeviceError, match=r"in AUTO.RTL, .* a pilot or another station has it"):
        await fc.execute("goTo", [1.0, 0.0, -5.0])


@on_bench("px4")
async def test_a_setpoint_that_is_called_off_is_not_streamed_on(b, fc, /):
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
async def test_a_refusal_counts_only_for_the_mode_that_it_is_about(b, fc, /, monkeypatch):
    command_mode, waits = Autopilot.command_mode, []

    def late(autopilot, name):
        """The first copy is lost; the words that come then are late ones about an earlier OFFBOARD."""
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


@pytest.mark.few(2)
@pytest.mark.parametrize(
    ("delay", "stays_on", "said"), [(2.0, False, 0), (14.0, False, 1), (600.0, False, 1), (-1.0, True, 0)]
)
def test_a_landing_is_over_when_its_motors_are_off_or_are_to_stay_on(px4, delay, stays_on, said):
    b = px4()
    b.autopilot.parameters["COM_DISARM_LAND"] = delay

    async def mission(fc):
        await up(fc)
        await fc.execute("land", [])
        assert b.values["landed"]
        assert b.values["armed"] is stays_on
        assert len([note for note in b.notes if "switching them off" in note]) == said
        await fc.execute("arm", [])
        await asyncio.sleep(1.5)
        assert b.values["armed"] is True

    b.run(mission)


STOPS = {
    "hold": lambda fc: fc.execute("hold", []),
    "setMode": lambda fc: fc.execute("setMode", ["AUTO.LOITER"]),
    "safe state": lambda fc: fc.make_safe(),
}


@pytest.mark.few(4)
@pytest.mark.parametrize("after", [0.02, 0.2, 4.0])
@pytest.mark.parametrize("stop", STOPS)
@on_bench("px4", safe_state="hold", ttl=2.0)
async def test_whatever_stops_it_stops_a_goal_too(b, fc, /, stop, after):
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
async def test_a_mission_that_is_paused_stops(b, fc, /):
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
async def test_a_rover_that_lands_stops_on_its_way(b, fc, /, state):
    """A rover has no landing: it stays, in the very mode in which it drives to a goal."""
    await fc.execute("arm", [])
    drive = asyncio.create_task(fc.execute("goTo", [60.0, 0.0, 0.0]))
    await asyncio.sleep(4.0)
    drive.cancel()
    await (fc.make_safe() if state == "hold" else fc.execute("land", []))
    await asyncio.sleep(6.0)
    assert math.hypot(*b.autopilot.vehicle.velocity) < 0.1


@on_bench("px4")
async def test_a_goal_that_was_given_up_is_not_followed_on(b, fc, /):
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
