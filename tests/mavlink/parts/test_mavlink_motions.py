"""Motions of real autopilots: heights on PX4, turning rovers, fences, end of a landing."""

from __future__ import annotations

import asyncio
import math

import pytest
from coroutine_tests import on_bench
from msgspec.structs import replace
from takeoff import up

from lfield.errors import DeviceError
from lfield_mavlink.contact.vehicle_state import VehicleState
from lfield_mavlink.parts.progress import Arrival, Following, Progress, ReturnProgress, Turning
from lfield_mavlink.setpoints.motion_orders import Circle, ProgressPatience
from lfield_sim.autopilot.autopilot import Autopilot
from lfield_sim.autopilot.body.goals import Reach
from lfield_sim.autopilot.ground_vehicle import Wheels

# -- heights ------------------------------------------------------------------------------------------


@pytest.mark.few(0)
@on_bench("bench", flavour="px4")
async def test_heights_stay_relative_to_takeoff_when_home_drifts(b, fc, /):
    await up(fc, 6.0)
    homes, heights = set(), []
    for way in (3.0, 0.0, 3.0, 0.0):
        await fc.execute("goTo", [way, 0.0, -6.0])
        homes.add(b.autopilot.home[2])
        heights.append(-b.autopilot.vehicle.place[2])
        assert b.values["altitude"] == pytest.approx(heights[-1], abs=0.3)
    assert len(homes) == 4
    assert max(homes) - min(homes) > 0.2
    assert heights == pytest.approx([6.0] * 4, abs=0.6)


@on_bench("bench", kind="rover", limits={"altitude": 20.0})
async def test_rover_ignores_the_height_of_an_early_home(b, fc, /):
    await fc.execute("arm", [])
    await asyncio.sleep(5.0)
    assert b.values["altitude"] == pytest.approx(0.0, abs=0.5)
    await fc.execute("goTo", [6.0, 0.0, b.values["position"][2]])
    assert [note for note in b.notes if "limit exceeded" in note] == []


# -- rovers -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("flavour", ["ardupilot", "px4"])
@on_bench("bench", kind="rover", given="flavour")
async def test_rover_refuses_takeoff_at_once(b, fc, /, flavour):
    await fc.execute("arm", [])
    start = asyncio.get_running_loop().time()
    with pytest.raises(DeviceError, match="takeoff refused: a rover does not fly"):
        await fc.execute("takeoff", [3.0])
    assert asyncio.get_running_loop().time() == start


async def turn_on(fc, times):
    for _ in range(times):
        await fc.execute("setYawRate", [0.5])
        await asyncio.sleep(0.4)


def test_rover_with_differential_drive_turns_by_setpoints(bench):
    b = bench(kind="rover")
    b.autopilot.vehicle.wheels = Wheels()

    async def mission(fc):
        await fc.execute("arm", [])
        for heading in (2.0, -1.0):
            await fc.execute("yaw", [heading])
            assert math.remainder(b.values["heading"] - heading, math.tau) == pytest.approx(0.0, abs=0.08)
        await turn_on(fc, 8)
        assert b.values["yawRate"] == pytest.approx(0.5, abs=0.05)

    b.run(mission)


@on_bench("bench", kind="rover")
async def test_rover_with_car_steering_refuses_turns_in_place(b, fc, /):
    loop = asyncio.get_running_loop()
    await fc.execute("arm", [])
    start = loop.time()
    with pytest.raises(DeviceError, match="did not change for 2 s; this frame can turn only while driving"):
        await fc.execute("yaw", [2.0])
    assert loop.time() - start < 3.5
    with pytest.raises(DeviceError, match="setYawRate has not changed its heading for 2 s; this frame"):
        await turn_on(fc, 10)
    await fc.execute("hold", [])
    # For a goal behind it, it turns while driving away first.
    await fc.execute("goTo", [-12.0, 0.0, 0.0])
    await fc.execute("returnHome", [])
    await fc.execute("land", [])
    assert math.hypot(*b.autopilot.vehicle.place[:2]) < 2.5
    assert b.autopilot.mode == "HOLD"


@pytest.mark.few(0)
@on_bench("bench", kind="rover")
async def test_rover_may_take_a_detour_to_an_orbit(b, fc, /):
    await fc.execute("arm", [])
    await fc.execute("orbit", [-6.0, 0.0, 0.0, 3.0, 0.5, 0.25])
    north, east, _ = b.autopilot.vehicle.place
    assert math.hypot(north + 6.0, east) == pytest.approx(3.0, abs=2.0)


SLOW = {
    "orbit": (1.0, ("orbit", [-20.0, 0.0, 0.0, 4.0, 0.3, 0.1])),
    "goTo": (0.2, ("goTo", [-6.0, 0.0, 0.0])),
    "returnHome": (0.2, ("returnHome", [])),
}


@pytest.mark.few(0)
@pytest.mark.parametrize("name", SLOW)
def test_slow_rover_gets_time_for_its_detour(bench, name):
    """The detour of a slow rover is as long in metres as that of a fast rover, and takes longer."""
    speed, (what, values) = SLOW[name]
    b = bench(kind="rover", limits={"speed": speed})

    async def mission(fc):
        await fc.execute("arm", [])
        if what == "returnHome":
            await fc.execute("goTo", [5.0, 0.0, 0.0])
        await fc.execute(what, values)

    b.run(mission)


@on_bench("bench", limits={"speed": 0.2})
async def test_standing_slow_vehicle_is_given_up(b, fc, /):
    await up(fc)
    flight = asyncio.create_task(fc.execute("goTo", [9.0, 0.0, -5.0]))
    await asyncio.sleep(5.0)
    b.autopilot.speed_control.change(0.001)
    start = asyncio.get_running_loop().time()
    with pytest.raises(DeviceError, match=r"goTo failed: no progress for 10 s, 8\.\d m from its goal"):
        await flight
    assert asyncio.get_running_loop().time() - start < 12.0


@on_bench("bench", kind="rover", flavour="px4")
async def test_px4_orbit_is_refused_for_a_rover(b, fc, /):
    await fc.execute("arm", [])
    with pytest.raises(DeviceError, match="orbit refused: PX4 orbits only with flying vehicles; use goTo"):
        await fc.execute("orbit", [9.0, 0.0, 0.0, 4.0, 1.0, 1.0])


def test_yaw_rate_is_judged_by_the_expected_turn():
    turning, slow = Turning(), Turning()
    assert not any(turning.fails(0.5, 0.5 * n * 0.4, 1.0, n * 0.4) for n in range(40))
    assert not any(slow.fails(0.05, 0.0, 1.0, n * 0.4) for n in range(9))
    assert not any(
        turning.fails(0.5, 0.0, 1.0, 50.0 + n * 1.5) for n in range(9)
    )  # commanded again each time
    assert any(turning.fails(0.5, 0.0, 1.0, 90.0 + n * 0.4) for n in range(9))


# -- remaining distance ----------------------------------------------------------------------------------


def test_rover_has_arrived_where_its_autopilot_stops():
    now, moves = 0.0, True
    arrival = Arrival(2.0, lambda: moves, lambda: now)
    assert arrival.remaining(1.9) == 1.9
    moves = False
    assert arrival.remaining(2.2) == 2.2
    now = 1.1
    assert arrival.remaining(2.4) == 2.4  # it has drifted out
    assert arrival.remaining(2.1) == 2.1
    now = 2.2
    assert arrival.remaining(2.1) == 0.0
    assert Arrival(0.0, lambda: False, lambda: now).remaining(0.0) == 0.0


def test_detour_gets_more_time_than_a_standstill():
    patience = ProgressPatience(10.0, 0.1, turning=40.0)
    detour, stand = Progress(patience, 0.0), Progress(patience, 0.0)
    assert not detour.is_over(20.0, True, 0.0)
    assert not detour.is_over(30.0, True, 39.0)
    assert detour.is_over(30.0, True, 41.0)
    assert not stand.is_over(20.0, False, 1.0)
    assert stand.is_over(20.0, False, 11.1)


def test_progress_timeout_grows_at_low_speed():
    drives = ProgressPatience(10.0, 0.1, turning=40.0, detour=30.0)
    bounds = [drives.bound(moves, pace) for moves in (False, True) for pace in (None, 5.0, 0.3, 0.01)]
    assert bounds == pytest.approx([10.0, 10.0, 10.0, 80.0, 40.0, 40.0, 200.0, 6000.0])


def test_hover_during_a_return_is_no_progress():
    """With noise in the position."""
    way = ReturnProgress()
    hover = [way.remaining((0.1 * (n % 3), -0.1 * (n % 2), -10.0)) for n in range(1000)]
    assert set(hover) == {hover[0]}
    assert way.remaining((0.0, 3.0, -10.0)) == pytest.approx(hover[0] - 3.0)


def test_farthest_point_of_a_circle():
    assert Circle((3.0, 4.0, -5.0), 5.0, 1.0, True).farthest == pytest.approx((6.0, 8.0, -5.0))


# -- its own fence ------------------------------------------------------------------------------------


def test_goal_ignored_beyond_the_ardupilot_fence_names_the_fence(bench, monkeypatch):
    """As recorded: a setpoint beyond the fence is ignored without a message."""
    b, guide = bench(), Autopilot.guide
    b.autopilot.parameters.update(FENCE_ENABLE=1, FENCE_TYPE=7, FENCE_RADIUS=30, FENCE_ALT_MAX=25)

    def guarded(self, setpoint):
        beyond = isinstance(setpoint.goal, Reach) and self.fence_at(setpoint.goal.place)[0]
        guide(self, replace(setpoint, goal=None) if beyond else setpoint)

    monkeypatch.setattr(Autopilot, "guide", guarded)

    async def mission(fc):
        await up(fc)
        loop = asyncio.get_running_loop()
        for goal, text in (
            ([40.0, 0.0, -5.0], r"goTo refused: the goal is 40.0 m from home, .* FENCE_RADIUS ends at 30 m"),
            ([0.0, 0.0, -26.0], r"goTo refused: the goal is 26.0 m up, .* FENCE_ALT_MAX ends at 25 m"),
        ):
            start = loop.time()
            with pytest.raises(DeviceError, match=text):
                await fc.execute("goTo", goal)
            assert loop.time() - start < 5.0
        await fc.execute("goTo", [10.0, 0.0, -5.0])

    b.run(mission)


def test_velocity_blocked_by_the_fence_is_reported_once(bench):
    """As recorded: avoidance stops ArduPilot before the fence without a message."""
    b = bench()
    b.autopilot.parameters.update(FENCE_ENABLE=1, FENCE_TYPE=7, FENCE_RADIUS=20, FENCE_ALT_MAX=50)

    async def mission(fc):
        await up(fc)
        for _ in range(60):
            await fc.execute("setVelocity", [3.0, 0.0, 0.0])
            await asyncio.sleep(0.3)

    b.run(mission)
    (report,) = [note for note in b.notes if note.code == "mavlink-fence-suspected"]
    assert "setVelocity has hardly moved the vehicle for 2 s, and 5 m ahead is 2" in report
    assert report.endswith(" m from home, but its own fence FENCE_RADIUS ends at 20 m")


def test_zero_velocity_is_followed_by_a_standing_vehicle():
    following, still = Following(), (0.0, 0.0, 0.0)
    assert not any(following.fails(still, still, 0.5, 0.3 * n) for n in range(20))
    slow = [following.fails((0.0, 3.0, 0.0), (1.0, 0.9, 0.0), 0.5, 6.0 + 0.3 * n) for n in range(20)]
    assert slow.count(True) == 1


def test_goal_beyond_the_px4_fence_is_refused_before_the_motion(bench):
    b = bench(flavour="px4")
    b.autopilot.parameters.update(GF_ACTION=2, GF_MAX_HOR_DIST=30)

    async def mission(fc):
        await up(fc)
        start = asyncio.get_running_loop().time()
        with pytest.raises(DeviceError) as raised:
            await fc.execute("goTo", [60.0, 0.0, -5.0])
        assert asyncio.get_running_loop().time() - start < 1.0
        await asyncio.sleep(2.0)
        assert b.autopilot.vehicle.place[0] == pytest.approx(0.0, abs=0.1)
        return raised.value.reason

    reason = b.run(mission)
    assert reason.startswith("goTo refused: the goal is 60.0 m from home, but its own fence GF_MAX_HOR_DIST")
    assert reason.endswith("ends at 30 m")


# -- a landing ----------------------------------------------------------------------------------------


@pytest.mark.few(1)
@pytest.mark.parametrize("flavour", ["ardupilot", "px4"])
@on_bench("bench", given="flavour")
async def test_vehicle_can_fly_again_after_landing_or_return(b, fc, /, flavour):
    for instruction in ("land", "returnHome"):
        await up(fc)
        await fc.execute(instruction, [])
        assert not b.autopilot.armed
    await up(fc)
    assert b.autopilot.vehicle.airborne


@pytest.mark.few(0)
@on_bench("bench")
async def test_landing_continues_below_home(b, fc, /, monkeypatch):
    """A slope: the landing point is 20 m below the takeoff point."""
    await up(fc, 9.0)
    monkeypatch.setattr(VehicleState, "home_offset", (0.0, 0.0, -20.0))
    await fc.execute("land", [])
    assert not b.autopilot.armed
