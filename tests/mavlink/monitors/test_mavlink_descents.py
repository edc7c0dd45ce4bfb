"""Falls, impacts and ordinary descents: the monitor alone, and whole flights on fakes."""

from __future__ import annotations

import asyncio
import math

import pytest
from coroutine_tests import on_bench
from test_mavlink_flight_faults import STACKS, at, fails, up

from lfield_mavlink.monitors.descent_monitor import DESCENT, DescentMonitor, Expected


def flown(monitor, *sinks, height=40.0, began=0.0, step=0.1, velocity=None, last=1.0):
    """What is found while it sinks so for `last` seconds each, 10 Hz; seconds and words."""
    monitor.on_armed(True, landed=False, now=began)
    now, found = began, []
    for sink in sinks:
        for number in range(round(last / step)):
            if velocity is not None and number % 2 == 0:
                monitor.on_velocity(velocity + 0.01 * (number % 3), now)
            now, height = now + step, max(0.0, height - sink * step)
            if finding := monitor.on_motion(height, sink, now, judged=True):
                found.append((now - began, finding.text))
    return found


def test_a_descent_faster_than_its_own_speed_is_a_fall_after_a_while():
    """A motor at 60 %: 2.76 m/s when it hit the ground (gauntlet-b); its own speed of descent was 1.5."""
    monitor = DescentMonitor()
    monitor.expect(DESCENT)
    monitor.may_descend(1.5, 0.5)
    ((at_, words),) = flown(monitor, 1.5, 2.0, 2.5, 2.5)
    assert words.startswith("it sinks at 2.5 m/s")
    assert at_ < 4.0


@pytest.mark.parametrize("sinks", [(1.5, 2.0, 2.1, 1.5, 1.5), (2.6, 1.5, 2.0), (0.5, 1.7, 0.5)])
def test_a_descent_may_be_a_little_faster_than_its_speed(sinks):
    """PX4 with 1.5 m/s sank at 2.0 (px4-copter.i-heights)."""
    monitor = DescentMonitor()
    monitor.expect(DESCENT)
    monitor.may_descend(1.5, 0.5)
    assert flown(monitor, *sinks, last=0.5) == []


def test_as_long_as_its_own_speed_is_not_known_more_is_allowed():
    monitor = DescentMonitor()
    monitor.expect(DESCENT)
    assert flown(monitor, 2.4, 2.4, 2.4) == []


@pytest.mark.parametrize(("commanded", "sinks", "falls"), [
    (0.0, (0.2, 0.8, 0.8), False),  # a gust
    (0.0, (1.0, 2.0), True),
    (1.0, (1.0, 1.0, 1.2), False),
    (1.0, (1.5, 2.5), True),
    (3.0, (3.0, 3.3, 3.3), False),
])  # fmt: skip
def test_velocities_are_held_against_what_was_commanded_however_often_that_changes(commanded, sinks, falls):
    monitor = DescentMonitor()
    assert bool(flown(monitor, *sinks, velocity=commanded)) == falls


@pytest.mark.parametrize(
    ("landing", "touch", "crashes"),
    [(0.5, 1.9, False), (0.5, 2.7, True), (2.0, 2.2, False), (2.0, 2.7, True), (0.0, 2.7, True)],
)
def test_a_hard_landing_is_no_impact_and_an_impact_is_one(landing, touch, crashes):
    """LAND_SPEED is 2 m/s at most."""
    monitor = DescentMonitor()
    monitor.may_descend(1.5, landing)
    flown(monitor, touch, height=1.2, last=0.5)
    found = monitor.on_motion(0.0, 0.0, 0.6, judged=True)
    assert (found is not None and found.crashed) == crashes


@pytest.mark.parametrize("sink", [0.3, 0.5, 0.8, 1.4])
@pytest.mark.parametrize("goal", [40.0, 60.0, math.inf])
def test_height_that_is_lost_is_a_fall_at_whatever_speed(sink, goal):
    """In a hover, on a level way, and in a climb that it does not make."""
    monitor = DescentMonitor()
    monitor.may_descend(1.5, 0.5)
    monitor.expect(Expected(goal))
    ((at_, words),) = flown(monitor, 0.0, *[sink] * 6)
    assert words.startswith("it falls: 1.")
    assert at_ < 1.0 + 1.0 / sink + 1.0


@pytest.mark.parametrize("sink", [0.4, 0.8])
def test_height_that_is_lost_by_velocities_is_a_fall(sink):
    monitor = DescentMonitor()
    ((at_, words),) = flown(monitor, 0.0, *[sink] * 6, velocity=0.0)
    assert words.startswith("it falls: 1.")
    assert at_ < 1.0 + 1.0 / (sink - 0.18) + 1.0


def test_a_gust_or_a_change_of_the_reference_of_heights_is_no_fall():
    monitor = DescentMonitor()
    monitor.expect(Expected(40.0))
    assert flown(monitor, 0.0, 0.9, 0.9, 0.9, 0.3, -0.3, last=0.4) == [], "it climbs again"
    assert flown(monitor, 0.0, 0.0, 0.0, height=36.0, began=2.5) == [], "home was set to another height"
    assert flown(monitor, *[0.1] * 50, velocity=0.0, began=10.0) == [], "an error of the estimator"
    assert monitor.falling == ""


def test_a_way_down_ends_at_its_goal():
    monitor = DescentMonitor()
    monitor.may_descend(1.5, 0.5)
    monitor.expect(Expected(35.0))
    assert flown(monitor, *[1.0] * 5) == []
    ((_, words),) = flown(monitor, *[0.5] * 5, height=35.0, began=5.1)
    assert words.startswith("it falls: 1.")


def test_what_stands_falls_no_more():
    monitor = DescentMonitor()
    monitor.expect(Expected(math.inf))
    assert flown(monitor, 1.0, 2.0)
    assert monitor.falling
    monitor.on_armed(True, landed=True, now=9.0)
    assert monitor.falling == ""


# -- on fakes -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("flavour", STACKS)
@pytest.mark.parametrize("by", ["setVelocity", "setYawRate"])
@on_bench("bench", ttl=1.0, given="flavour")
async def test_a_flight_by_setpoints_is_told_of_a_fall(b, fc, /, flavour, by):
    await up(fc, 20.0)
    began = at(3.0, lambda: b.faults.apply(["motor_power=0.6"]))

    async def flight():
        for number in range(100):
            # No two setpoints are the same.
            rate = 0.2 + 0.01 * (number % 3)
            await fc.execute(by, [rate] if by == "setYawRate" else [1.0, 0.0, rate])
            await asyncio.sleep(0.2)

    ended, reason = await fails(b, flight())
    assert 0.0 < ended - began < 2.0
    assert f"{by} refused: it sinks at " in reason
    assert b.autopilot.vehicle.place[2] < -10.0


@pytest.mark.parametrize("flavour", STACKS)
@on_bench("bench", given="flavour")
async def test_a_fall_in_a_hover_lets_no_motion_begin_but_a_landing(b, fc, /, flavour):
    await up(fc, 20.0)
    b.faults.apply(["motor_power=0.6"])
    await asyncio.sleep(3.0)
    _, reason = await fails(b, fc.execute("goTo", [10.0, 0.0, -20.0]))
    assert "goTo refused: it falls: " in reason
    landing = asyncio.ensure_future(fc.execute("land", []))
    await asyncio.sleep(1.0)
    assert b.autopilot.mode in ("LAND", "AUTO.LAND")
    _, reason = await fails(b, landing)
    assert reason.startswith("land ended early: ")


@pytest.mark.parametrize("flavour", STACKS)
@on_bench("bench", given="flavour")
async def test_a_landing_that_ends_in_a_crash_is_none(b, fc, /, flavour):
    await up(fc, 5.0)
    landing = asyncio.ensure_future(fc.execute("land", []))
    await b.until(lambda: b.autopilot.vehicle.place[2] > -1.0)
    b.autopilot.disarm(force=True)
    _, reason = await fails(b, landing)
    assert reason.startswith("land ended early: it")
    assert len(b.lock_outs) == 1


@pytest.mark.parametrize(("flavour", "name", "value"), [
    ("ardupilot", "LAND_SPEED", 200.0), ("px4", "MPC_LAND_SPEED", 2.3),
])  # fmt: skip
def test_a_vehicle_that_lands_fast_by_its_own_parameters_is_not_locked_out(bench, flavour, name, value):
    b = bench(flavour=flavour)
    b.autopilot.parameters[name] = value
    b.autopilot.apply_parameters()

    async def mission(fc):
        await up(fc, 12.0)
        await fc.execute("land", [])

    b.run(mission)
    assert b.lock_outs == []


@pytest.mark.few(3)
@pytest.mark.parametrize("flavour", STACKS)
@pytest.mark.parametrize("what", ["goTo", "yaw", "orbit", "hold", "setVelocity"])
def test_a_copter_that_sinks_slowly_is_falling(bench, flavour, what, monkeypatch):
    """At 0.8 m/s, half of its own speed of descent; neither its speed nor a text tells."""
    monkeypatch.setattr("lfield_sim.autopilot.flight_modes.WARNS_AFTER", math.inf)
    b = bench(flavour=flavour, ttl=1.0, limits={"speed": 2.0})
    values = {
        "goTo": [60.0, 0.0, -20.0],
        "orbit": [10.0, 0.0, -20.0, 10.0, 1.0, 3.0],
        "setVelocity": [0.5, 0.0, 0.0],
        "hold": [],
    }

    async def flight(fc):
        for turn in range(40):
            await fc.execute(what, [0.5 * turn] if what == "yaw" else values[what])
            await asyncio.sleep(0.3)

    async def mission(fc):
        await up(fc, 20.0)
        await fc.execute("hold", [])
        began = at(3.0, lambda: b.faults.apply(["motor_power=0.745"]))
        flying = asyncio.ensure_future(flight(fc))
        await b.until(lambda: bool(fc.motion.monitor.falling))
        assert 1.0 < asyncio.get_running_loop().time() - began < (4.0 if what == "setVelocity" else 3.5)
        assert fc.motion.monitor.falling.startswith("it falls: 1.")
        if what != "hold":
            _, reason = await fails(b, flying)
            assert "it falls: 1." in reason
        flying.cancel()

    b.run(mission)
