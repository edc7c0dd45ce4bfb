"""Conformance kit of Dynamixel servos, in addition to the standard checks.

Motions are at most 0.2 rad from the present position, and back; at the end the torque is off.
"""

from __future__ import annotations

import asyncio
import math
from functools import partial

from lfield.driver import WATCHDOG
from lfield.driver.kit import Bench, CheckFailed, Kit, NotTried, cancelled, held, refused, rested
from lfield_dynamixel.joints.mounting import joints_of

KIT = Kit()

#: Motion of a check in rad, and the tolerance of its return.
TURN, NEAR = 0.2, 0.05
#: Speed and acceleration in rad/s and rad/s2.
PROFILE = (1.0, 5.0)
#: Seconds that a latch may be reported late by the guard.
LATE = 0.5


@KIT.check("supply and temperature are plausible", moves=False, types=("Dynamixel",))
async def plausible(bench: Bench) -> str:
    """Measured values are within what any model supports."""
    volts, degrees = bench.query("voltage"), bench.query("temperature")
    if not (3.0 <= volts <= 30.0 and -10.0 <= degrees <= 90.0):
        raise CheckFailed(f"it reports {volts:g} V and {degrees:g} degrees Celsius")
    return f"{volts:.1f} V, {degrees:.0f} degrees Celsius"


@KIT.check("the hardware has no fault", moves=False)
async def healthy(bench: Bench) -> str:
    """No hardware error is set."""
    fault = bench.query("fault")
    if fault:
        raise CheckFailed(str(fault))
    return "no hardware error"


@KIT.check("every member answers", moves=False, types=("DynamixelGroup",))
async def complete(bench: Bench) -> str:
    """No member is missing, and every position is finite."""
    missing = bench.query("missing")
    if missing or any(math.isnan(angle) for angle in bench.query("positions")):
        raise CheckFailed(f"these do not answer: {missing}")
    return f"{len(bench.query('positions'))} members"


@KIT.check("without torque a servo refuses goals", moves=True)
async def refused_without_torque(bench: Bench) -> str:
    """The refusal of a motion without torque names the call that is needed."""
    await bench.call("torque", False)
    reason = await refused(bench, "moveTo", _goal(bench, 0.0))
    if "torque" not in reason:
        raise CheckFailed(f"it was refused for another reason: {reason}")
    return reason


@KIT.check("torque on does not move it", moves=True)
async def torque_on(bench: Bench) -> str:
    """The servo holds its position when its torque is switched on."""
    start_angles = _angles(bench)
    await bench.call("torque", True)
    await bench.until(lambda: bool(bench.query("torqueOn")), 3.0, "the torque to be on")
    motion = max(abs(angle - start) for angle, start in zip(_angles(bench), start_angles, strict=True))
    if motion > NEAR:
        raise CheckFailed(f"it moved by {motion:.3f} rad")
    return f"it moved by {motion:.4f} rad"


@KIT.check("turns there and back", moves=True)
async def turns(bench: Bench) -> str:
    """moveTo returns on arrival."""
    await _get_ready(bench)
    start = _angles(bench)
    errors = []
    for motion in (_inwards(bench, start), [0.0] * len(start)):
        goal = [start_angle + turn for start_angle, turn in zip(start, motion, strict=True)]
        await bench.call("moveTo", goal if _is_group(bench) else goal[0])
        error = max(abs(angle - target) for angle, target in zip(_angles(bench), goal, strict=True))
        if error > NEAR:
            raise CheckFailed(f"moveTo() returned {error:.3f} rad short")
        errors.append(f"{error:.3f}")
    return f"within {' and '.join(errors)} rad"


@KIT.check("a cancelled motion stops", moves=True)
async def cancels(bench: Bench) -> str:
    """A cancelled servo holds its position on the way, and follows the next goal."""
    await _get_ready(bench)
    start = _angles(bench)
    goal = [angle + turn for angle, turn in zip(start, _inwards(bench, start), strict=True)]
    has_started = partial(_is_off, bench, start)
    outcome = await cancelled(bench, has_started, "moveTo", goal if _is_group(bench) else goal[0])
    stop_angles = _angles(bench)
    await asyncio.sleep(LATE)
    motion = max(
        abs(angle - stop_angle) for angle, stop_angle in zip(_angles(bench), stop_angles, strict=True)
    )
    if motion > NEAR or not bench.query("torqueOn"):
        raise CheckFailed(f"{outcome}, but then it moved by {motion:.3f} rad, or is limp")
    await bench.call("moveTo", start if _is_group(bench) else start[0])
    remaining = max(abs(target - stop_angle) for target, stop_angle in zip(goal, stop_angles, strict=True))
    return f"{outcome}, {remaining:.2f} rad from its goal; then back"


@KIT.check("angles outside its bounds are refused", moves=True)
async def limits(bench: Bench) -> str:
    """Goals beyond the bounds of the binding are refused; for a group, also a goal for another number of
    members.
    """
    await _get_ready(bench)
    start = _angles(bench)
    joints = joints_of(bench.binding).values()
    for goal in ([joint.lowest - 1.0 for joint in joints], [joint.highest + 1.0 for joint in joints]):
        reason = await refused(bench, "moveTo", goal if _is_group(bench) else goal[0])
    if _is_group(bench):
        reason = await refused(bench, "moveTo", [*start, 0.0])
    return reason


@KIT.check("a profile above its speed limit is refused", moves=True)
async def speed(bench: Bench) -> str:
    """The speed limit of the binding applies to profiles."""
    limit = bench.binding.limits.get("speed")
    if limit is None:
        raise NotTried("its binding has no speed limit")
    return await refused(bench, "setProfile", 2.0 * limit, 0.0)


@KIT.check("a setpoint that is not renewed ends", moves=True)
async def ends_safely(bench: Bench) -> str:
    """The guard brings the servo into the safe state after the time-to-live; the servo is then at rest."""
    await _get_ready(bench)
    sent_at = bench.now
    await bench.call("setPositions" if _is_group(bench) else "setPosition", _goal(bench, 0.0))
    ttl = bench.binding.ttl
    await bench.until(lambda: bool(bench.latched), ttl + 2.0, "the guard to end it")
    elapsed = bench.now - sent_at
    if elapsed > ttl + LATE:
        raise CheckFailed(f"it ended only after {elapsed:.2f} s")
    await rested(bench)
    reason = await held(bench, 0.0)
    safe_angles = _angles(bench)
    await asyncio.sleep(0.2)
    motion = max(
        abs(angle - safe_angle) for angle, safe_angle in zip(_angles(bench), safe_angles, strict=True)
    )
    if motion > NEAR:
        raise CheckFailed(f"it moved by {motion:.3f} rad in its safe state")
    return f"after {elapsed:.2f} s because {reason}"


@KIT.check("its watchdog stops it, and release() frees it", moves=True)
async def watchdog(bench: Bench) -> str:
    """A servo without packets for twice the time-to-live stops by itself; then goals are refused."""
    if bench.binding.waives(WATCHDOG):
        raise NotTried("waived by its binding")
    await bench.call("torque", True)
    note_count = len(bench.notes)
    # The guard may try to confirm the safe state for so long before it mutes the bus.
    await bench.fall_silent(bench.quiet_after + 2.0 * bench.binding.ttl + LATE)
    if not bench.latched:
        raise CheckFailed("its guard did not notice it while the host was silent")
    await bench.until(lambda: bool(_stopped(bench, note_count)), 5.0, "it to stop by itself and to report it")
    await held(bench, 0.0)
    await bench.call("torque", True)
    await bench.call("moveTo", _goal(bench, 0.0))
    return _stopped(bench, note_count)


@KIT.check("torque off at the end", moves=True)
async def torque_off(bench: Bench) -> str:
    """The torque is off, as read back."""
    await bench.call("torque", False)
    await bench.until(lambda: not bench.query("torqueOn"), 3.0, "the torque to be off")
    return "torque off"


async def _get_ready(bench: Bench) -> None:
    """Switches the torque on and sets a slow profile."""
    await bench.call("setProfile", min(PROFILE[0], bench.binding.limits.get("speed", math.inf)), PROFILE[1])
    await bench.call("torque", True)


def _stopped(bench: Bench, known_notes: int) -> str:
    """The first later log line about an expired watchdog."""
    return next((note for note in bench.notes[known_notes:] if "stopped by its own watchdog" in note), "")


def _inwards(bench: Bench, angles: list[float]) -> list[float]:
    """The motion of each servo towards the middle of its bounds."""
    middles = [
        joint.offset if joint.calibration else (joint.lowest + joint.highest) / 2.0
        for joint in joints_of(bench.binding).values()
    ]
    return [-TURN if angle > middle else TURN for angle, middle in zip(angles, middles, strict=True)]


def _is_off(bench: Bench, start: list[float]) -> bool:
    """Whether a servo has left its position."""
    return any(
        abs(angle - start_angle) > NEAR for angle, start_angle in zip(_angles(bench), start, strict=True)
    )


def _is_group(bench: Bench) -> bool:
    return bench.binding.type == "DynamixelGroup"


def _angles(bench: Bench) -> list[float]:
    return list(bench.query("positions")) if _is_group(bench) else [float(bench.query("position"))]


def _goal(bench: Bench, motion: float) -> list[float] | float:
    goal = [angle + motion for angle in _angles(bench)]
    return goal if _is_group(bench) else goal[0]
