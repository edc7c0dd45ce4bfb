"""Checks of an axis: enabling, stopping, limits."""

from __future__ import annotations

import asyncio
import math

from lfield.driver.kit import SAFE, Bench, CheckFailed, Kit, NotTried, cancelled, held, refused, rested

AXIS = Kit()

#: Motion of a check in rad, its speed in rad/s, and the tolerance for no motion in rad.
TURN, SPEED, NEAR = 0.2, 0.4, 0.05
#: Homing methods of CiA 402 that use the present position without motion.
STAYING = (35, 37)
#: Seconds that a latch may be reported late by the guard.
LATE = 0.5
_TYPES = ("CanAxis",)


@AXIS.check("it responds without faults", moves=False, types=_TYPES)
async def healthy(bench: Bench) -> str:
    """No fault, and every frame is valid."""
    if not bench.query("online"):
        raise CheckFailed("it does not respond")
    if bench.query("fault"):
        # The cause of an older fault is polled once a second.
        await asyncio.sleep(1.5)
        raise CheckFailed(bench.query("fault"))
    return f"{bench.query('state')}, at {bench.query('position'):.3f} rad"


@AXIS.check("disabled, it refuses setpoints", moves=True, types=_TYPES)
async def disabled(bench: Bench) -> str:
    """The refusal of an instruction while the axis is disabled names the call that is needed."""
    await bench.call("disable")
    _see(not bench.query("enabled"), "disable() returned, but it is enabled")
    reason = await refused(bench, "setVelocity", 0.0)
    _see("enable()" in reason, f"it was refused for another reason: {reason}")
    return reason


@AXIS.check("clearing faults does not enable it", moves=True, types=_TYPES)
async def reset(bench: Bench) -> str:
    """resetFault() without a fault changes nothing."""
    await bench.call("resetFault")
    _see(not bench.query("enabled") and not bench.query("fault"), f"it is {bench.query('state')}")
    return str(bench.query("state"))


@AXIS.check("enabling does not move it", moves=True, types=_TYPES)
async def enabled(bench: Bench) -> str:
    """The axis switches its torque on without a jump."""
    before = bench.query("position")
    await bench.call("enable")
    _see(bench.query("enabled"), "enable() returned, but it is not enabled")
    await _stands(bench)
    moved = abs(bench.query("position") - before)
    _see(moved <= NEAR, f"it moved by {moved:.3f} rad")
    return f"{bench.query('state')}, moved by {moved:.4f} rad"


@AXIS.check("homing at its position", moves=True, types=_TYPES)
async def homing(bench: Bench) -> str:
    """The axis is homed only by a method without motion."""
    if bench.binding.option("protocol") != "cia402" or bench.binding.option("homing_method") not in STAYING:
        raise NotTried("homing may move; done here only by CiA 402 'homing_method' 35 or 37")
    await bench.call("enable")
    before = bench.query("position")
    await bench.call("home")
    _see(bench.query("referenced"), "home() returned, but it is not referenced")
    return f"{before:.3f} rad is now {bench.query('position'):.3f} rad"


@AXIS.check("turns there and back", moves=True, types=_TYPES)
async def turns(bench: Bench) -> str:
    """moveTo() returns when the axis is at rest at its goal."""
    if not bench.query("referenced") and not bench.binding.waives("no_homing"):
        raise NotTried("it has not been homed: home it, or add 'waivers: [no_homing]' to its binding")
    await bench.call("enable")
    start, way = bench.query("position"), _way(bench, TURN)
    off = []
    for goal in (start + way, start):
        await bench.call("moveTo", goal, _speed(bench))
        off.append(abs(bench.query("position") - goal))
        _see(off[-1] <= _tolerance(bench), f"moveTo() returned {off[-1]:.4f} rad from its goal")
    return f"{off[0]:.4f} rad off {abs(way):g} rad away, {off[1]:.4f} rad off back"


@AXIS.check("a cancelled motion halts", moves=True, types=_TYPES)
async def cancels(bench: Bench) -> str:
    """A cancelled axis stops on its way, enabled, and goes from there to the next goal."""
    if not bench.query("referenced") and not bench.binding.waives("no_homing"):
        raise NotTried("it has not been homed: home it, or add 'waivers: [no_homing]' to its binding")
    await bench.call("enable")
    start, way = bench.query("position"), _way(bench, 2.0 * TURN)
    speed = _speed(bench)
    outcome = await cancelled(bench, lambda: _turns(bench, speed), "moveTo", start + way, speed)
    _see(abs(bench.query("velocity")) <= _standstill(bench), f"{outcome}, but it turns")
    _see(bench.query("enabled"), f"{outcome}, but it is {bench.query('state')}")
    stood = bench.query("position")
    await asyncio.sleep(LATE)
    moved = abs(bench.query("position") - stood)
    _see(moved <= _tolerance(bench), f"{outcome}, but then it moved by {moved:.3f} rad")
    await bench.call("moveTo", start, speed)
    return f"{outcome}, {abs(start + way - stood):.2f} rad from its goal; then back"


@AXIS.check("a velocity that is not renewed ends", moves=True, types=_TYPES)
async def velocity(bench: Bench) -> str:
    """The guard brings the axis into the safe state after the time-to-live of a velocity."""
    await bench.call("enable")
    last = await _drive(bench, math.copysign(_speed(bench), _way(bench, TURN)))
    ttl = bench.binding.ttl
    await bench.until(lambda: bool(bench.latched), ttl + 2.0, "the guard to end it")
    ended = bench.now - last
    _see(ended <= ttl + LATE, f"it ended only after {ended:.2f} s")
    reports = await rested(bench)
    measured = abs(bench.query("velocity"))
    _see(measured <= _standstill(bench), f"it reported to be at rest, but turns at {measured:.3f} rad/s")
    reason = await held(bench, 0.0)
    way = f", then {reports[0]}" if reports else ""
    return f"after {ended:.2f} s, {reason}{way}; then it was {bench.query('state')}"


@AXIS.check("a host that stops responding during a motion", moves=True, types=_TYPES)
async def hang(bench: Bench) -> str:
    """The guard stops the axis."""
    await bench.call("enable")
    await _drive(bench, math.copysign(_speed(bench), -_way(bench, TURN)))
    await bench.fall_silent(3 * bench.silence)
    reason = await held(bench, 1.0)
    await _stands(bench)
    return f"{bench.query('state')} because {reason}"


@AXIS.check("stop", moves=True, types=_TYPES)
async def stop(bench: Bench) -> str:
    """stop() returns when the axis is at rest; the setpoint ends, and nothing is latched."""
    await bench.call("enable")
    await _drive(bench, math.copysign(_speed(bench), _way(bench, TURN)))
    await bench.call("stop")
    measured = abs(bench.query("velocity"))
    _see(measured <= _standstill(bench), f"stop() returned, but it turns at {measured:.3f} rad/s")
    await asyncio.sleep(2.0 * bench.binding.ttl)
    _see(not bench.latched, f"it was latched: {bench.latched}")
    return f"{bench.query('state')}, {measured:.4f} rad/s"


@AXIS.check("the limits of its binding are enforced", moves=True, types=_TYPES)
async def limits(bench: Bench) -> str:
    """Commands beyond the limits are refused before any frame is sent."""
    given, option = bench.binding.limits, bench.binding.option
    await bench.call("disable")
    beyond: list[tuple[str, tuple[float, ...]]] = [
        ("moveTo", (option("lowest") - 1.0, _speed(bench))),
        ("moveTo", (option("highest") + 1.0, _speed(bench))),
    ]
    if "speed" in given:
        beyond.append(("setVelocity", (2.0 * given["speed"],)))
    if "torque" in given:
        beyond.append(("setTorque", (2.0 * given["torque"],)))
    for instruction, arguments in beyond:
        reason = await refused(bench, instruction, *arguments)
        _see("limit" in reason or "outside" in reason, f"it was refused for another reason: {reason}")
    return f"{len(beyond)} refused, the last: {reason}"


@AXIS.check("it is disabled at the end", moves=True, types=_TYPES)
async def ends_safely(bench: Bench) -> str:
    """The axis ends with its torque off, free."""
    await bench.call("disable")
    _see(not bench.query("enabled"), "disable() returned, but it is enabled")
    _see(not bench.latched, f"it is latched: {bench.latched}")
    return f"{bench.query('state')}, at {bench.query('position'):.3f} rad"


async def _drive(bench: Bench, speed: float) -> float:
    """Repeats a velocity until the axis turns; returns the time of the last setpoint."""
    end = bench.now + 3.0
    start = bench.query("position")
    while bench.now < end:
        last = bench.now
        await bench.call("setVelocity", speed)
        if abs(bench.query("velocity")) >= 0.3 * abs(speed) or abs(bench.query("position") - start) >= NEAR:
            return last
        await asyncio.sleep(bench.binding.ttl / 10.0)
    await bench.call("stop")
    raise CheckFailed(f"setVelocity({speed:g}) does not turn it")


def _turns(bench: Bench, speed: float) -> bool:
    return bool(abs(bench.query("velocity")) >= 0.3 * speed)


async def _stands(bench: Bench) -> None:
    await bench.until(lambda: abs(bench.query("velocity")) <= _standstill(bench), SAFE, "it to stand still")


def _way(bench: Bench, turn: float) -> float:
    """A distance towards the side with more room."""
    lowest, highest = bench.binding.option("lowest"), bench.binding.option("highest")
    here = bench.query("position")
    return turn if highest - here >= here - lowest else -turn


def _speed(bench: Bench) -> float:
    return min(SPEED, bench.binding.limits.get("speed", math.inf))


def _tolerance(bench: Bench) -> float:
    """rad; telemetry is slightly older than the driver's data."""
    return 2.0 * float(bench.binding.option("tolerance"))


def _standstill(bench: Bench) -> float:
    return float(bench.binding.option("standstill"))


def _see(shown: bool, otherwise: str) -> None:
    if not shown:
        raise CheckFailed(otherwise)
