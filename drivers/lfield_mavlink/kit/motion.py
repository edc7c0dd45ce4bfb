"""Checks that move a vehicle: a copter climbs to 3 m, a rover stays on the ground.

Both go 3 m far, and where there is a speed limit as far as it takes to come near it.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from lfield.driver import DeviceError
from lfield.driver.kit import Bench, CheckFailed, Kit, NotTried, cancelled, held, refused, rested
from lfield_mavlink.parts.guidance import CANNOT_TURN, HEADING_TOLERANCE

MOTION = Kit()

#: Metres: how high a copter flies, and how far everything goes.
HEIGHT, FAR = 3.0, 3.0
#: Radians that it turns.
QUARTER = math.pi / 2
#: Seconds of flight at the speed limit that are enough to be faster than it, and the least share of it that
#: a vehicle must have come to for that to be known.
RUN, TRIED = 5.0, 0.6
#: m/s of setpoints, and above what it is seen to move and below what it stands.
SPEED, MOVES, STANDS = 1.0, 0.3, 0.2
#: Seconds that the guard may be late with a latch, as the host hears of it.
LATE = 0.5


@MOTION.check("it does not take off with its motors off", moves=True)
async def takeoff_disarmed(bench: Bench) -> str:
    """PX4 would accept the command, and fly off when it is armed later."""
    if _kind(bench) != "copter":
        raise NotTried(f"a {_kind(bench)} does not take off from where it stands")
    reason = await refused(bench, "takeoff", _height(bench))
    if bench.query("armed") or not bench.query("landed"):
        raise CheckFailed("takeoff() was refused and it flies")
    return reason


@MOTION.check("motors on and off", moves=True)
async def arming(bench: Bench) -> str:
    """The armed bit follows."""
    await bench.call("arm")
    try:
        _see(bench.query("armed"), "arm() returned and it is not armed")
        mode = bench.query("mode")
    finally:
        await bench.call("disarm")
    _see(not bench.query("armed"), "disarm() returned and it is armed")
    return f"armed in {mode}, disarmed"


@MOTION.check("a short trip", moves=True)
async def trip(bench: Bench) -> str:
    """Up, over and back, a turn, hold; goTo() returns when it is there, hold() when it is in the mode."""
    async with _under_way(bench):
        start = bench.query("position")
        off = []
        for way in (_far(bench), 0.0):
            goal = (start[0] + way, start[1], start[2])
            await bench.call("goTo", *goal)
            off.append(math.dist(bench.query("position")[:2], goal[:2]))
        _see(max(off) <= await _tolerance(bench), f"goTo() returned {max(off):.2f} m from its goal")
        turned = await _turn(bench)
        await bench.call("hold")
        await _stops(bench)
        return (
            f"at {bench.query('altitude'):.1f} m; {off[0]:.2f} m off when {_far(bench):g} m away, "
            f"{off[1]:.2f} m off when back; {turned}; held in {bench.query('mode')}"
        )


@MOTION.check("what is cancelled on its way holds", moves=True)
async def cancels(bench: Bench) -> str:
    """It stays where it was given up, free for the next goal; a landing goes on to its end."""
    async with _under_way(bench):
        north, east, down = bench.query("position")
        told = [await cancelled(bench, lambda: _moves(bench), "goTo", north + _far(bench), east, down)]
        await _stops(bench)
        left = math.dist(bench.query("position")[:2], (north + _far(bench), east))
        _see(left > float(bench.binding.option("tolerance")), "its goTo() was cancelled and it went there")
        if _kind(bench) == "copter":
            told.append(await cancelled(bench, lambda: bench.query("climb") < -MOVES, "land"))
            _see(not bench.query("armed"), "land() returned and its motors are on")
            await bench.call("arm")
            climbs = cancelled(bench, lambda: bench.query("climb") > MOVES, "takeoff", _height(bench))
            told.append(await climbs)
            await bench.until(lambda: abs(bench.query("climb")) < STANDS, 10.0, "it to climb no more")
            _see(bench.query("altitude") < _height(bench), "its takeoff was cancelled and went on")
        return "; ".join(told)


@MOTION.check("its speed limit is kept", moves=True)
async def speed_limit(bench: Bench) -> str:
    """The highest speed over ground of a way that is long enough, after a takeoff and after a hold."""
    limit = bench.binding.limits.get("speed")
    if limit is None:
        raise NotTried("its binding has none: give it 'limits'")
    far = min(RUN * limit, bench.binding.limits.get("radius", math.inf) / 2)
    async with _under_way(bench):
        start, fastest = bench.query("position"), []
        for way in (far, 0.0):
            fastest.append(await _fastest(bench, start[0] + way, start[1], start[2]))
            await bench.call("hold")
        allowed = limit * (1.0 + float(bench.binding.option("limit_tolerance")))
        told = f"{' and '.join(f'{speed:.2f}' for speed in fastest)} m/s at most, of {limit:g}"
        _see(max(fastest) <= allowed, told)
        _see(max(fastest) >= TRIED * limit, f"{told}: {far:g} m are too short a way to tell")
        return told


@MOTION.check("a velocity that is not renewed ends", moves=True)
async def velocity(bench: Bench) -> str:
    """Past its time-to-live the guard brings it into the safe state, where it comes to rest and says so."""
    async with _under_way(bench):
        last = await _drive(bench, min(SPEED, bench.binding.limits.get("speed", math.inf)))
        ttl = bench.binding.ttl
        await bench.until(lambda: bool(bench.latched), ttl + 2.0, "the guard to end it")
        ended = bench.now - last
        _see(ended <= ttl + LATE, f"it ended only after {ended:.2f} s")
        reason = bench.latched
        words = await rested(bench)
        if bench.binding.safe_state == "hold" or _kind(bench) == "rover":
            await _stops(bench)
        else:
            _see(bool(words), "it came down from the air and never said so")
            await bench.until(lambda: not bench.query("armed"), LATE, "its motors to be off, as it said")
        way = f", then {words[0]}" if words else ""
        return f"after {ended:.2f} s because {reason}{way}; then it was in {bench.query('mode')}"


@MOTION.check("a host that hangs while it is under way", moves=True)
async def hang(bench: Bench) -> str:
    """The guard notices, and the vehicle is made safe."""
    async with _under_way(bench):
        await bench.fall_silent(3 * bench.silence)
        reason = await held(bench, 1.0)
        return f"in {bench.query('mode')} because {reason}"


@MOTION.check("it stands at the end", moves=True)
async def ends(bench: Bench) -> str:
    """On the ground, motors off, free."""
    await bench.until(
        lambda: bench.query("landed") and not bench.query("armed"), 10.0, "it to stand, disarmed"
    )
    _see(not bench.latched, f"it is latched because {bench.latched}")
    return f"in {bench.query('mode')}, motors off"


@asynccontextmanager
async def _under_way(bench: Bench) -> AsyncIterator[None]:
    """Armed, a copter in the air; whatever happens, down and off again."""
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
    """Renew a velocity to the north until it is seen to move; the time of the last one."""
    pause = bench.binding.ttl / 4.0
    end = bench.now + 5.0
    while bench.now < end:
        last = bench.now
        await bench.call("setVelocity", speed, 0.0, 0.0)
        if math.hypot(*bench.query("velocity")[:2]) >= MOVES * speed:
            return last
        await asyncio.sleep(pause)
    raise CheckFailed(f"setVelocity({speed:g}, 0, 0) does not move it")


async def _fastest(bench: Bench, *goal: float) -> float:
    """The highest speed over ground on the way to a place."""
    going, most = asyncio.ensure_future(bench.call("goTo", *goal)), 0.0
    try:
        while not going.done():
            await asyncio.wait([going], timeout=0.05)
            most = max(most, math.hypot(*bench.query("velocity")[:2]))
        await going
    finally:
        going.cancel()
    return most


def _moves(bench: Bench) -> bool:
    return math.hypot(*bench.query("velocity")[:2]) > MOVES


async def _stops(bench: Bench) -> None:
    await bench.until(lambda: math.hypot(*bench.query("velocity")[:2]) < STANDS, 10.0, "it to stop")


async def _turn(bench: Bench) -> str:
    """A quarter to the right; what steers like a car may say that it cannot turn on the spot."""
    heading = bench.query("heading") + QUARTER
    try:
        await bench.call("yaw", heading)
    except DeviceError as error:
        if CANNOT_TURN in str(error):
            return "it turns only while it drives"
        raise
    off = abs(math.remainder(bench.query("heading") - heading, math.tau))
    _see(off <= 2.0 * HEADING_TOLERANCE, f"yaw() returned {off:.2f} rad from its heading")
    return f"turned, {off:.2f} rad off"


def _kind(bench: Bench) -> str:
    return str(bench.binding.option("kind"))


async def _tolerance(bench: Bench) -> float:
    """Metres; telemetry is a moment older than what the driver saw. ArduPilot stops a rover at WP_RADIUS."""
    stops = 0.0
    if _kind(bench) == "rover" and bench.identity.startswith("ArduPilot"):
        stops = await bench.call("parameter", "WP_RADIUS")
    return max(2.0 * float(bench.binding.option("tolerance")), stops + 0.5)


def _height(bench: Bench) -> float:
    return min(HEIGHT, bench.binding.limits.get("altitude", math.inf))


def _far(bench: Bench) -> float:
    return min(FAR, bench.binding.limits.get("radius", math.inf) / 2)


def _see(shown: bool, otherwise: str) -> None:
    if not shown:
        raise CheckFailed(otherwise)
