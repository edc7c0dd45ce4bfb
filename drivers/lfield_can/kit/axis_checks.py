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
    _require(not bench.query("enabled"), "disable() returned, but it is enabled")
    reason = await refused(bench, "setVelocity", 0.0)
    _require("enable()" in reason, f"it was refused for another reason: {reason}")
    return reason


@AXIS.check("clearing faults does not enable it", moves=True, types=_TYPES)
async def reset(bench: Bench) -> str:
    """resetFault() without a fault changes nothing."""
    await bench.call("resetFault")
    _require(not bench.query("enabled") and not bench.query("fault"), f"it is {bench.query('state')}")
    return str(bench.query("state"))


@AXIS.check("enabling does not move it", moves=True, types=_TYPES)
async def enabled(bench: Bench) -> str:
    """The axis switches its torque on without a jump."""
    start = bench.query("position")
    await bench.call("enable")
    _require(bench.query("enabled"), "enable() returned, but it is not enabled")
    await _await_standstill(bench)
    motion = abs(bench.query("position") - start)
    _require(motion <= NEAR, f"it moved by {motion:.3f} rad")
    return f"{bench.query('state')}, moved by {motion:.4f} rad"


@AXIS.check("homing at its position", moves=True, types=_TYPES)
async def homing(bench: Bench) -> str:
    """The axis is homed only by a method without motion."""
    if bench.binding.option("protocol") != "cia402" or bench.binding.option("homing_method") not in STAYING:
        raise NotTried("homing may move; done here only by CiA 402 'homing_method' 35 or 37")
    await bench.call("enable")
    start = bench.query("position")
    await bench.call("home")
    _require(bench.query("referenced"), "home() returned, but it is not referenced")
    return f"{start:.3f} rad is now {bench.query('position'):.3f} rad"


@AXIS.check("turns there and back", moves=True, types=_TYPES)
async def turns(bench: Bench) -> str:
    """moveTo() returns when the axis is at rest at its goal."""
    if not bench.query("referenced") and not bench.binding.waives("no_homing"):
        raise NotTried("it has not been homed: home it, or add 'waivers: [no_homing]' to its binding")
    await bench.call("enable")
    start, distance = bench.query("position"), _distance(bench, TURN)
    errors = []
    for goal in (start + distance, start):
        await bench.call("moveTo", goal, _speed(bench))
        errors.append(abs(bench.query("position") - goal))
        _require(errors[-1] <= _tolerance(bench), f"moveTo() returned {errors[-1]:.4f} rad from its goal")
    return f"{errors[0]:.4f} rad off {abs(distance):g} rad away, {errors[1]:.4f} rad off back"


@AXIS.check("a cancelled motion halts", moves=True, types=_TYPES)
async def cancels(bench: Bench) -> str:
    """A cancelled axis stops on its way, enabled, and goes from there to the next goal."""
    if not bench.query("referenced") and not bench.binding.waives("no_homing"):
        raise NotTried("it has not been homed: home it, or add 'waivers: [no_homing]' to its binding")
    await bench.call("enable")
    start, distance = bench.query("position"), _distance(bench, 2.0 * TURN)
    speed = _speed(bench)
    outcome = await cancelled(bench, lambda: _turns(bench, speed), "moveTo", start + distance, speed)
    _require(abs(bench.query("velocity")) <= _standstill(bench), f"{outcome}, but it turns")
    _require(bench.query("enabled"), f"{outcome}, but it is {bench.query('state')}")
    stop_position = bench.query("position")
    await asyncio.sleep(LATE)
    motion = abs(bench.query("position") - stop_position)
    _require(motion <= _tolerance(bench), f"{outcome}, but then it moved by {motion:.3f} rad")
    await bench.call("moveTo", start, speed)
    return f"{outcome}, {abs(start + distance - stop_position):.2f} rad from its goal; then back"


@AXIS.check("a velocity that is not renewed ends", moves=True, types=_TYPES)
async def velocity(bench: Bench) -> str:
    """The guard brings the axis into the safe state after the time-to-live of a velocity."""
    await bench.call("enable")
    sent_at = await _drive(bench, math.copysign(_speed(bench), _distance(bench, TURN)))
    ttl = bench.binding.ttl
    await bench.until(lambda: bool(bench.latched), ttl + 2.0, "the guard to end it")
    elapsed = bench.now - sent_at
    _require(elapsed <= ttl + LATE, f"it ended only after {elapsed:.2f} s")
    reports = await rested(bench)
    measured = abs(bench.query("velocity"))
    _require(measured <= _standstill(bench), f"it reported to be at rest, but turns at {measured:.3f} rad/s")
    reason = await held(bench, 0.0)
    report = f", then {reports[0]}" if reports else ""
    return f"after {elapsed:.2f} s, {reason}{report}; then it was {bench.query('state')}"


@AXIS.check("a host that stops responding during a motion", moves=True, types=_TYPES)
async def hang(bench: Bench) -> str:
    """The guard stops the axis."""
    await bench.call("enable")
    await _drive(bench, math.copysign(_speed(bench), -_distance(bench, TURN)))
    await bench.fall_silent(3 * bench.silence)
    reason = await held(bench, 1.0)
    await _await_standstill(bench)
    return f"{bench.query('state')} because {reason}"


@AXIS.check("stop", moves=True, types=_TYPES)
async def stop(bench: Bench) -> str:
    """stop() returns when the axis is at rest; the setpoint ends, and nothing is latched."""
    await bench.call("enable")
    await _drive(bench, math.copysign(_speed(bench), _distance(bench, TURN)))
    await bench.call("stop")
    measured = abs(bench.query("velocity"))
    _require(measured <= _standstill(bench), f"stop() returned, but it turns at {measured:.3f} rad/s")
    await asyncio.sleep(2.0 * bench.binding.ttl)
    _require(not bench.latched, f"it was latched: {bench.latched}")
    return f"{bench.query('state')}, {measured:.4f} rad/s"


@AXIS.check("the limits of its binding are enforced", moves=True, types=_TYPES)
async def limits(bench: Bench) -> str:
    """Commands beyond the limits are refused before any frame is sent."""
    bounds, option = bench.binding.limits, bench.binding.option
    await bench.call("disable")
    excessive: list[tuple[str, tuple[float, ...]]] = [
        ("moveTo", (option("lowest") - 1.0, _speed(bench))),
        ("moveTo", (option("highest") + 1.0, _speed(bench))),
    ]
    if "speed" in bounds:
        excessive.append(("setVelocity", (2.0 * bounds["speed"],)))
    if "torque" in bounds:
        excessive.append(("setTorque", (2.0 * bounds["torque"],)))
    for instruction, arguments in excessive:
        reason = await refused(bench, instruction, *arguments)
        _require("limit" in reason or "outside" in reason, f"it was refused for another reason: {reason}")
    return f"{len(excessive)} refused, the last: {reason}"


@AXIS.check("it is disabled at the end", moves=True, types=_TYPES)
async def ends_safely(bench: Bench) -> str:
    """The axis ends with its torque off, free."""
    await bench.call("disable")
    _require(not bench.query("enabled"), "disable() returned, but it is enabled")
    _require(not bench.latched, f"it is latched: {bench.latched}")
    return f"{bench.query('state')}, at {bench.query('position'):.3f} rad"


async def _drive(bench: Bench, speed: float) -> float:
    """Repeats a velocity until the axis turns; returns the time of the last setpoint."""
    end = bench.now + 3.0
    start = bench.query("position")
    while bench.now < end:
        sent_at = bench.now
        await bench.call("setVelocity", speed)
        if abs(bench.query("velocity")) >= 0.3 * abs(speed) or abs(bench.query("position") - start) >= NEAR:
            return sent_at
        await asyncio.sleep(bench.binding.ttl / 10.0)
    await bench.call("stop")
    raise CheckFailed(f"setVelocity({speed:g}) does not turn it")


def _turns(bench: Bench, speed: float) -> bool:
    return bool(abs(bench.query("velocity")) >= 0.3 * speed)


async def _await_standstill(bench: Bench) -> None:
    await bench.until(lambda: abs(bench.query("velocity")) <= _standstill(bench), SAFE, "it to stand still")


def _distance(bench: Bench, turn: float) -> float:
    """A distance towards the side with more free range."""
    lowest, highest = bench.binding.option("lowest"), bench.binding.option("highest")
    position = bench.query("position")
    return turn if highest - position >= position - lowest else -turn


def _speed(bench: Bench) -> float:
    return min(SPEED, bench.binding.limits.get("speed", math.inf))


def _tolerance(bench: Bench) -> float:
    """rad; telemetry is slightly older than the driver's data."""
    return 2.0 * float(bench.binding.option("tolerance"))


def _standstill(bench: Bench) -> float:
    return float(bench.binding.option("standstill"))


def _require(condition: bool, failure: str) -> None:
    if not condition:
        raise CheckFailed(failure)
