"""Falls, impacts and ordinary descents: the monitor alone, and complete flights on fakes."""

from __future__ import annotations

import asyncio
import math

import pytest
from coroutine_tests import on_bench
from test_mavlink_flight_faults import STACKS, at, fails, up

from lfield_mavlink.monitors.descent_monitor import DESCENT, DescentMonitor, Expected


def flown(monitor, *sinks, height=40.0, began=0.0, step=0.1, velocity=None, last=1.0):
    """The findings during descents at these rates for `last` seconds each, at 10 Hz: seconds and text."""
    monitor.on_armed(True, landed=False, now=began)
    now, found = began, []
    for sink in sinks:
        for number in range(round(last / step)):
            if velocity is not None and number % 2 == 0:
                monitor.on_velocity(velocity + 0.01 * (number % 3), now)
            now, height = now + step, max(0.0, height - sink * step)
            if finding := monitor.on_motion(height, sink, now, is_ours=True):
                found.append((now - began, finding.text))
    return found


def test_descent_faster_than_the_descent_speed_is_a_fall():
    """A motor at 60 %: impact at 2.76 m/s (gauntlet-b); the descent speed of the vehicle was 1.5 m/s."""
    monitor = DescentMonitor()
    monitor.expect(DESCENT)
    monitor.may_descend(1.5, 0.5)
    ((at_, text),) = flown(monitor, 1.5, 2.0, 2.5, 2.5)
    assert text.startswith("it sinks at 2.5 m/s")
    assert at_ < 4.0


@pytest.mark.parametrize("sinks", [(1.5, 2.0, 2.1, 1.5, 1.5), (2.6, 1.5, 2.0), (0.5, 1.7, 0.5)])
def test_descent_slightly_faster_than_the_descent_speed_is_no_fall(sinks):
    """PX4 with 1.5 m/s sank at 2.0 (px4-copter.i-heights)."""
    monitor = DescentMonitor()
    monitor.expect(DESCENT)
    monitor.may_descend(1.5, 0.5)
    assert flown(monitor, *sinks, last=0.5) == []


def test_unknown_descent_speed_allows_a_faster_descent():
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
def test_sink_rate_is_compared_with_the_commanded_velocity(commanded, sinks, falls):
    monitor = DescentMonitor()
    assert bool(flown(monitor, *sinks, velocity=commanded)) == falls


@pytest.mark.parametrize(
    ("landing", "touch", "crashes"),
    [(0.5, 1.9, False), (0.5, 2.7, True), (2.0, 2.2, False), (2.0, 2.7, True), (0.0, 2.7, True)],
)
def test_hard_landing_is_distinguished_from_an_impact(landing, touch, crashes):
    """The maximum of LAND_SPEED is 2 m/s."""
    monitor = DescentMonitor()
    monitor.may_descend(1.5, landing)
    flown(monitor, touch, height=1.2, last=0.5)
    found = monitor.on_motion(0.0, 0.0, 0.6, is_ours=True)
    assert (found is not None and found.crashed) == crashes


@pytest.mark.parametrize("sink", [0.3, 0.5, 0.8, 1.4])
@pytest.mark.parametrize("goal", [40.0, 60.0, math.inf])
def test_height_loss_is_a_fall_at_any_sink_rate(sink, goal):
    """In a hover, on a level leg, and in a climb that fails."""
    monitor = DescentMonitor()
    monitor.may_descend(1.5, 0.5)
    monitor.expect(Expected(goal))
    ((at_, text),) = flown(monitor, 0.0, *[sink] * 6)
    assert text.startswith("it falls: 1.")
    assert at_ < 1.0 + 1.0 / sink + 1.0


@pytest.mark.parametrize("sink", [0.4, 0.8])
def test_height_loss_under_velocity_commands_is_a_fall(sink):
    monitor = DescentMonitor()
    ((at_, text),) = flown(monitor, 0.0, *[sink] * 6, velocity=0.0)
    assert text.startswith("it falls: 1.")
    assert at_ < 1.0 + 1.0 / (sink - 0.18) + 1.0


def test_gust_or_new_height_reference_is_no_fall():
    monitor = DescentMonitor()
    monitor.expect(Expected(40.0))
    assert flown(monitor, 0.0, 0.9, 0.9, 0.9, 0.3, -0.3, last=0.4) == [], "it climbs again"
    assert flown(monitor, 0.0, 0.0, 0.0, height=36.0, began=2.5) == [], "home was set to another height"
    assert flown(monitor, *[0.1] * 50, velocity=0.0, began=10.0) == [], "an error of the estimator"
    assert monitor.falling == ""


def test_sinking_below_the_goal_of_a_descent_is_a_fall():
    monitor = DescentMonitor()
    monitor.may_descend(1.5, 0.5)
    monitor.expect(Expected(35.0))
    assert flown(monitor, *[1.0] * 5) == []
    ((_, text),) = flown(monitor, *[0.5] * 5, height=35.0, began=5.1)
    assert text.startswith("it falls: 1.")


def test_fall_ends_on_the_ground():
    monitor = DescentMonitor()
    monitor.expect(Expected(math.inf))
    assert flown(monitor, 1.0, 2.0)
    assert monitor.falling
    monitor.on_armed(True, landed=True, now=9.0)
    assert monitor.falling == ""


# -- on fakes -----------------------------------------------------------------------------------------


@pytest.mark.few(2)
@pytest.mark.parametrize("flavour", STACKS)
@pytest.mark.parametrize("by", ["setVelocity", "setYawRate"])
@on_bench("bench", ttl=1.0, given="flavour")
async def test_fall_ends_a_flight_by_setpoints(b, fc, /, flavour, by):
    await up(fc, 20.0)
    started = at(3.0, lambda: b.faults.apply(["motor_power=0.6"]))

    async def flight():
        for number in range(100):
            # No two setpoints are the same.
            rate = 0.2 + 0.01 * (number % 3)
            await fc.execute(by, [rate] if by == "setYawRate" else [1.0, 0.0, rate])
            await asyncio.sleep(0.2)

    ended, reason = await fails(b, flight())
    assert 0.0 < ended - started < 2.0
    assert f"{by} refused: it sinks at " in reason
    assert b.autopilot.vehicle.place[2] < -10.0


@pytest.mark.parametrize("flavour", STACKS)
@on_bench("bench", given="flavour")
async def test_fall_in_a_hover_allows_only_a_landing(b, fc, /, flavour):
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
async def test_landing_that_ends_in_a_crash_fails(b, fc, /, flavour):
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
def test_fast_landing_by_parameter_causes_no_lock_out(bench, flavour, name, value):
    b = bench(flavour=flavour)
    b.autopilot.parameters[name] = value
    b.autopilot.apply_parameters()

    async def mission(fc):
        await up(fc, 12.0)
        await fc.execute("land", [])

    b.run(mission)
    assert b.lock_outs == []


@pytest.mark.few(2)
@pytest.mark.parametrize("flavour", STACKS)
@pytest.mark.parametrize("what", ["goTo", "yaw", "orbit", "hold", "setVelocity"])
def test_slow_sinking_is_reported_as_a_fall_in_every_motion(bench, flavour, what, monkeypatch):
    """At 0.8 m/s, half of the descent speed: neither the speed nor a status text reveals it."""
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
        started = at(3.0, lambda: b.faults.apply(["motor_power=0.745"]))
        flying = asyncio.ensure_future(flight(fc))
        await b.until(lambda: bool(fc.motion.monitor.falling))
        assert 1.0 < asyncio.get_running_loop().time() - started < (4.0 if what == "setVelocity" else 3.5)
        assert fc.motion.monitor.falling.startswith("it falls: 1.")
        if what != "hold":
            _, reason = await fails(b, flying)
            assert "it falls: 1." in reason
        flying.cancel()

    b.run(mission)
