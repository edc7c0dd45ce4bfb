"""Checks that move a vehicle: a copter climbs to 3 m, a rover stays on the ground.

The checks move the vehicle by 3 m, and farther to approach a speed limit.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager

from lfield.driver import DeviceError
from lfield.driver.kit import Bench, CheckFailed, Kit, NotTried, cancelled, held, refused, rested
from lfield_mavlink.files.plan_file import NumberedItem, PlanFile, mission_item
from lfield_mavlink.files.plan_text import plan_text
from lfield_mavlink.geodesy import Place
from lfield_mavlink.kit.plan_checks import MISSION, restored
from lfield_mavlink.link.dialect import dialect
from lfield_mavlink.modes import AUTONOMOUS
from lfield_mavlink.parts.guidance import CANNOT_TURN, HEADING_TOLERANCE
from lfield_mavlink.services.plan_items import WAYPOINT

MOTION = Kit()

#: Metres: height of a copter, and distance of all vehicles.
HEIGHT, TRIP_DISTANCE = 3.0, 3.0
#: Turn in radians.
QUARTER = math.pi / 2
#: Seconds at the speed limit that would reveal an excess, and the least share of it that must be reached for
#: a result.
RUN_TIME, MIN_SHARE = 5.0, 0.6
#: m/s: setpoint; moving above; at rest below.
SPEED, MOVING_SPEED, REST_SPEED = 1.0, 0.3, 0.2
#: Seconds that a latch may be reported late by the guard.
LATE = 0.5


@MOTION.check("takeoff() is refused while disarmed", moves=True)
async def takeoff_disarmed(bench: Bench) -> str:
    """A takeoff of a disarmed vehicle is refused: PX4 would accept it and fly when it is armed later."""
    if _kind(bench) != "copter":
        raise NotTried(f"a {_kind(bench)} does not take off")
    reason = await refused(bench, "takeoff", _height(bench))
    if bench.query("armed") or not bench.query("landed"):
        raise CheckFailed("takeoff() was refused, but it flies")
    return reason


@MOTION.check("motors on and off", moves=True)
async def arming(bench: Bench) -> str:
    """The armed bit follows the instructions."""
    await bench.call("arm")
    try:
        _require(bench.query("armed"), "arm() returned, but it is not armed")
        mode = bench.query("mode")
    finally:
        await bench.call("disarm")
    _require(not bench.query("armed"), "disarm() returned, but it is armed")
    return f"armed in {mode}, disarmed"


@MOTION.check("a short trip", moves=True)
async def trip(bench: Bench) -> str:
    """Takeoff, there and back, a turn, hold; goTo() returns on arrival, hold() in its mode."""
    async with _under_way(bench):
        start = bench.query("position")
        errors = []
        for distance in (_trip_distance(bench), 0.0):
            goal = (start[0] + distance, start[1], start[2])
            await bench.call("goTo", *goal)
            errors.append(math.dist(bench.query("position")[:2], goal[:2]))
        _require(max(errors) <= await _tolerance(bench), f"goTo() returned {max(errors):.2f} m from its goal")
        turn = await _turn(bench)
        await bench.call("hold")
        await _await_stop(bench)
        return (
            f"at {bench.query('altitude'):.1f} m; {errors[0]:.2f} m off at {_trip_distance(bench):g} m, "
            f"{errors[1]:.2f} m off after return; {turn}; held in {bench.query('mode')}"
        )


@MOTION.check("a cancelled motion holds", moves=True)
async def cancels(bench: Bench) -> str:
    """A cancelled vehicle stops where it was, free for the next goal; a landing is completed."""
    async with _under_way(bench):
        north, east, down = bench.query("position")
        outcomes = [
            await cancelled(bench, lambda: _moves(bench), "goTo", north + _trip_distance(bench), east, down)
        ]
        await _await_stop(bench)
        remaining = math.dist(bench.query("position")[:2], (north + _trip_distance(bench), east))
        _require(
            remaining > float(bench.binding.option("tolerance")), "its goTo() was cancelled but was completed"
        )
        if _kind(bench) == "copter":
            outcomes.append(await cancelled(bench, lambda: bench.query("climb") < -MOVING_SPEED, "land"))
            _require(not bench.query("armed"), "land() returned, but its motors are on")
            await bench.call("arm")
            climb = cancelled(bench, lambda: bench.query("climb") > MOVING_SPEED, "takeoff", _height(bench))
            outcomes.append(await climb)
            await bench.until(lambda: abs(bench.query("climb")) < REST_SPEED, 10.0, "it to stop climbing")
            _require(bench.query("altitude") < _height(bench), "its takeoff was cancelled but continued")
        return "; ".join(outcomes)


@MOTION.check("a plan is flown to its end", moves=True)
async def plan(bench: Bench) -> str:
    """Two waypoints of a plan file, by the autopilot itself; flyPlan() returns at the last one."""
    if bench.identity.startswith("PX4") and not bench.binding.waives(AUTONOMOUS):
        raise NotTried(f"its binding does not waive {AUTONOMOUS}, which a plan of PX4 needs")
    async with restored(bench, MISSION), _under_way(bench):
        start = Place(*bench.query("globalPosition"))
        goals = [start.shifted((north, 0.0, 0.0)) for north in (_trip_distance(bench), 0.0)]
        await bench.call("flyPlan", _plan_of(goals, bench.query("altitude")))
        reached = bench.query("missionReached")
        _require(
            reached == 1,
            f"flyPlan() returned, but item {reached} is the last that it has reached, of 0 and 1",
        )
        await bench.call("hold")
        await _await_stop(bench)
        error = math.hypot(*start.vector_to(Place(*bench.query("globalPosition")))[:2])
        return f"2 waypoints, {_trip_distance(bench):g} m away and back; {error:.1f} m off at the end"


def _plan_of(goals: Sequence[Place], height: float) -> str:
    """A plan without a takeoff: the vehicle is under way."""
    values = [(0.0, 0.0, 0.0, 0.0, goal.latitude, goal.longitude, height) for goal in goals]
    items = [mission_item(WAYPOINT, dialect.MAV_FRAME_GLOBAL_RELATIVE_ALT, entry) for entry in values]
    return plan_text(PlanFile("kit.plan", tuple(NumberedItem(n, entry) for n, entry in enumerate(items, 1))))


@MOTION.check("its speed limit is enforced", moves=True)
async def speed_limit(bench: Bench) -> str:
    """The highest horizontal speed on a sufficiently long way, after a takeoff and after a hold."""
    limit = bench.binding.limits.get("speed")
    if limit is None:
        raise NotTried("its binding has no 'limits'")
    run_distance = min(RUN_TIME * limit, bench.binding.limits.get("radius", math.inf) / 2)
    async with _under_way(bench):
        start, fastest = bench.query("position"), []
        for distance in (run_distance, 0.0):
            fastest.append(await _fastest(bench, start[0] + distance, start[1], start[2]))
            await bench.call("hold")
        allowed = limit * (1.0 + float(bench.binding.option("limit_tolerance")))
        outcome = f"{' and '.join(f'{speed:.2f}' for speed in fastest)} m/s at most, of {limit:g}"
        _require(max(fastest) <= allowed, outcome)
        _require(
            max(fastest) >= MIN_SHARE * limit, f"{outcome}: {run_distance:g} m are too short for a result"
        )
        return outcome


@MOTION.check("a velocity that is not renewed ends", moves=True)
async def velocity(bench: Bench) -> str:
    """The guard brings the vehicle into the safe state after the time-to-live, where it comes to rest."""
    async with _under_way(bench):
        sent_at = await _drive(bench, min(SPEED, bench.binding.limits.get("speed", math.inf)))
        ttl = bench.binding.ttl
        await bench.until(lambda: bool(bench.latched), ttl + 2.0, "the guard to end it")
        elapsed = bench.now - sent_at
        _require(elapsed <= ttl + LATE, f"it ended only after {elapsed:.2f} s")
        reason = bench.latched
        reports = await rested(bench)
        if bench.binding.safe_state == "hold" or _kind(bench) == "rover":
            await _await_stop(bench)
        else:
            _require(bool(reports), "it landed without reporting it")
            await bench.until(lambda: not bench.query("armed"), LATE, "its motors to be off, as reported")
        report = f", then {reports[0]}" if reports else ""
        return f"after {elapsed:.2f} s, {reason}{report}; then it was in {bench.query('mode')}"


@MOTION.check("a host that stops responding during a motion", moves=True)
async def hang(bench: Bench) -> str:
    """The guard makes the vehicle safe."""
    async with _under_way(bench):
        await bench.fall_silent(3 * bench.silence)
        reason = await held(bench, 1.0)
        return f"in {bench.query('mode')} because {reason}"


@MOTION.check("it is at rest at the end", moves=True)
async def ends_safely(bench: Bench) -> str:
    """On the ground, motors off, free."""
    await bench.until(
        lambda: bench.query("landed") and not bench.query("armed"), 10.0, "it to be at rest, disarmed"
    )
    _require(not bench.latched, f"it is latched: {bench.latched}")
    return f"in {bench.query('mode')}, motors off"


@asynccontextmanager
async def _under_way(bench: Bench) -> AsyncIterator[None]:
    """Armed, a copter in the air; in every case landed and disarmed afterwards."""
    if _kind(bench) not in ("copter", "rover"):
        raise NotTried(f"a {_kind(bench)} is not moved by this kit")
    try:
        await bench.call("arm")
        if _kind(bench) == "copter":
            await bench.call("takeoff", _height(bench))
        yield
    finally:
        if bench.latched:
            await held(bench, 0.0)
        await bench.call("land" if _kind(bench) == "copter" else "hold")
        await bench.call("disarm")


async def _drive(bench: Bench, speed: float) -> float:
    """Repeats a velocity to the north until the vehicle moves; returns the time of the last setpoint."""
    pause = bench.binding.ttl / 4.0
    end = bench.now + 5.0
    while bench.now < end:
        sent_at = bench.now
        await bench.call("setVelocity", speed, 0.0, 0.0)
        if math.hypot(*bench.query("velocity")[:2]) >= MOVING_SPEED * speed:
            return sent_at
        await asyncio.sleep(pause)
    raise CheckFailed(f"setVelocity({speed:g}, 0, 0) does not move it")


async def _fastest(bench: Bench, *goal: float) -> float:
    """The highest horizontal speed on the way to a position."""
    motion, highest = asyncio.ensure_future(bench.call("goTo", *goal)), 0.0
    try:
        while not motion.done():
            await asyncio.wait([motion], timeout=0.05)
            highest = max(highest, math.hypot(*bench.query("velocity")[:2]))
        await motion
    finally:
        motion.cancel()
    return highest


def _moves(bench: Bench) -> bool:
    return math.hypot(*bench.query("velocity")[:2]) > MOVING_SPEED


async def _await_stop(bench: Bench) -> None:
    await bench.until(lambda: math.hypot(*bench.query("velocity")[:2]) < REST_SPEED, 10.0, "it to stop")


async def _turn(bench: Bench) -> str:
    """A quarter turn to the right; a car-like rover may report that it cannot turn on the spot."""
    heading = bench.query("heading") + QUARTER
    try:
        await bench.call("yaw", heading)
    except DeviceError as error:
        if CANNOT_TURN in str(error):
            return "it can turn only while driving"
        raise
    deviation = abs(math.remainder(bench.query("heading") - heading, math.tau))
    _require(deviation <= 2.0 * HEADING_TOLERANCE, f"yaw() returned {deviation:.2f} rad from its heading")
    return f"turned, {deviation:.2f} rad off"


def _kind(bench: Bench) -> str:
    return str(bench.binding.option("kind"))


async def _tolerance(bench: Bench) -> float:
    """Metres: telemetry is slightly older than the driver's data. ArduPilot stops a rover at WP_RADIUS."""
    stop_radius = 0.0
    if _kind(bench) == "rover" and bench.identity.startswith("ArduPilot"):
        stop_radius = await bench.call("parameter", "WP_RADIUS")
    return max(2.0 * float(bench.binding.option("tolerance")), stop_radius + 0.5)


def _height(bench: Bench) -> float:
    return min(HEIGHT, bench.binding.limits.get("altitude", math.inf))


def _trip_distance(bench: Bench) -> float:
    return min(TRIP_DISTANCE, bench.binding.limits.get("radius", math.inf) / 2)


def _require(condition: bool, failure: str) -> None:
    if not condition:
        raise CheckFailed(failure)
