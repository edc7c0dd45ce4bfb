"""The conformance kit of Dynamixel servos: what is tried beside the checks that every driver must pass.

What moves turns by 0.2 rad at most, from where the servo stands and back; at the end the servo is limp.
"""

from __future__ import annotations

import asyncio
import math
from functools import partial

from lfield.driver import WATCHDOG
from lfield.driver.kit import Bench, CheckFailed, Kit, NotTried, cancelled, held, refused, rested

KIT = Kit()

#: rad that a check turns, and how exactly it must be back.
TURN, NEAR = 0.2, 0.05
#: rad/s and rad/s2 of what moves here.
PROFILE = (1.0, 5.0)
#: Seconds that the guard may be late with a latch, as the host hears of it.
LATE = 0.5


@KIT.check("supply and temperature are plausible", moves=False, types=("Dynamixel",))
async def plausible(bench: Bench) -> str:
    """What the servo measures about itself is within what any model can stand."""
    volts, degrees = bench.query("voltage"), bench.query("temperature")
    if not (3.0 <= volts <= 30.0 and -10.0 <= degrees <= 90.0):
        raise CheckFailed(f"it says that it has {volts:g} V and {degrees:g} degrees Celsius")
    return f"{volts:.1f} V, {degrees:.0f} degrees Celsius"


@KIT.check("nothing is wrong with the hardware", moves=False)
async def sound(bench: Bench) -> str:
    """No hardware error is set."""
    fault = bench.query("fault")
    if fault:
        raise CheckFailed(str(fault))
    return "no hardware error"


@KIT.check("every member answers", moves=False, types=("DynamixelGroup",))
async def whole(bench: Bench) -> str:
    """Nobody is missing, and every position is a number."""
    missing = bench.query("missing")
    if missing or any(math.isnan(angle) for angle in bench.query("positions")):
        raise CheckFailed(f"these do not answer: {missing}")
    return f"{len(bench.query('positions'))} members"


@KIT.check("a limp servo is not moved", moves=True)
async def limp(bench: Bench) -> str:
    """With the torque off, a goal is refused with a sentence that says what to call."""
    await bench.call("torque", False)
    reason = await refused(bench, "moveTo", _goal(bench, 0.0))
    if "torque" not in reason:
        raise CheckFailed(f"it was refused for another reason: {reason}")
    return reason


@KIT.check("torque on does not move it", moves=True)
async def stiff(bench: Bench) -> str:
    """It becomes stiff where it is."""
    before = _angles(bench)
    await bench.call("torque", True)
    await bench.until(lambda: bool(bench.query("torqueOn")), 3.0, "the torque to be on")
    moved = max(abs(now - then) for now, then in zip(_angles(bench), before, strict=True))
    if moved > NEAR:
        raise CheckFailed(f"it moved by {moved:.3f} rad")
    return f"it moved by {moved:.4f} rad"


@KIT.check("turns there and back", moves=True)
async def turns(bench: Bench) -> str:
    """moveTo returns when it is there, not before."""
    await _get_ready(bench)
    start = _angles(bench)
    seen = []
    for way in (_inwards(start), [0.0] * len(start)):
        goal = [angle + turn for angle, turn in zip(start, way, strict=True)]
        await bench.call("moveTo", goal if _is_group(bench) else goal[0])
        off = max(abs(now - wanted) for now, wanted in zip(_angles(bench), goal, strict=True))
        if off > NEAR:
            raise CheckFailed(f"moveTo() returned {off:.3f} rad short")
        seen.append(f"{off:.3f}")
    return f"within {' and '.join(seen)} rad"


@KIT.check("a travel that is cancelled stops", moves=True)
async def cancels(bench: Bench) -> str:
    """It stays on its way, stiff, and follows the next goal."""
    await _get_ready(bench)
    start = _angles(bench)
    goal = [angle + turn for angle, turn in zip(start, _inwards(start), strict=True)]
    begun = partial(_is_off, bench, start)
    told = await cancelled(bench, begun, "moveTo", goal if _is_group(bench) else goal[0])
    stood = _angles(bench)
    await asyncio.sleep(LATE)
    moved = max(abs(now - then) for now, then in zip(_angles(bench), stood, strict=True))
    if moved > NEAR or not bench.query("torqueOn"):
        raise CheckFailed(f"{told}, and then it moved by {moved:.3f} rad, or is limp")
    await bench.call("moveTo", start if _is_group(bench) else start[0])
    left = max(abs(wanted - then) for wanted, then in zip(goal, stood, strict=True))
    return f"{told}, {left:.2f} rad from its goal; then back"


@KIT.check("angles that it may not go to are refused", moves=True)
async def limits(bench: Bench) -> str:
    """Beyond the bounds of the binding; for a group, also a goal for another number of members."""
    await _get_ready(bench)
    start = _angles(bench)
    for edge, beyond in (("lowest", -1.0), ("highest", 1.0)):
        goal = [bench.binding.option(edge) + beyond] * len(start)
        reason = await refused(bench, "moveTo", goal if _is_group(bench) else goal[0])
    if _is_group(bench):
        reason = await refused(bench, "moveTo", [*start, 0.0])
    return reason


@KIT.check("a faster profile than its limit is refused", moves=True)
async def speed(bench: Bench) -> str:
    """The speed of the binding holds for profiles."""
    limit = bench.binding.limits.get("speed")
    if limit is None:
        raise NotTried("its binding has no limit of speed")
    return await refused(bench, "setProfile", 2.0 * limit, 0.0)


@KIT.check("a setpoint that is not renewed ends", moves=True)
async def ends(bench: Bench) -> str:
    """Past its time-to-live the guard brings it into the safe state, where it stands still."""
    await _get_ready(bench)
    last = bench.now
    await bench.call("setPositions" if _is_group(bench) else "setPosition", _goal(bench, 0.0))
    ttl = bench.binding.ttl
    await bench.until(lambda: bool(bench.latched), ttl + 2.0, "the guard to end it")
    ended = bench.now - last
    if ended > ttl + LATE:
        raise CheckFailed(f"it ended only after {ended:.2f} s")
    await rested(bench)
    reason = await held(bench, 0.0)
    before = _angles(bench)
    await asyncio.sleep(0.2)
    moved = max(abs(now - then) for now, then in zip(_angles(bench), before, strict=True))
    if moved > NEAR:
        raise CheckFailed(f"it turned on by {moved:.3f} rad in its safe state")
    return f"after {ended:.2f} s because {reason}"


@KIT.check("its watchdog stops it, and release() frees it", moves=True)
async def watchdog(bench: Bench) -> str:
    """A servo that hears nothing for twice the time-to-live stops by itself; then goals are refused."""
    if bench.binding.waives(WATCHDOG):
        raise NotTried("waived by its binding")
    await bench.call("torque", True)
    told = len(bench.notes)
    # So long the guard may try to see the safe state before it makes the bus quiet.
    await bench.fall_silent(bench.quiet_after + 2.0 * bench.binding.ttl + LATE)
    if not bench.latched:
        raise CheckFailed("its guard did not notice, while the host was silent, that it was")
    await bench.until(lambda: bool(_stopped(bench, told)), 5.0, "it to stop by itself and to be told so")
    await held(bench, 0.0)
    await bench.call("torque", True)
    await bench.call("moveTo", _goal(bench, 0.0))
    return _stopped(bench, told)


@KIT.check("limp at the end", moves=True)
async def let_go(bench: Bench) -> str:
    """The torque is off, and seen to be off."""
    await bench.call("torque", False)
    await bench.until(lambda: not bench.query("torqueOn"), 3.0, "the torque to be off")
    return "torque off"


async def _get_ready(bench: Bench) -> None:
    """Stiff, and not fast."""
    await bench.call("setProfile", min(PROFILE[0], bench.binding.limits.get("speed", math.inf)), PROFILE[1])
    await bench.call("torque", True)


def _stopped(bench: Bench, told: int) -> str:
    """The first note after so many that says that a watchdog has fired."""
    return next((note for note in bench.notes[told:] if "stopped by its own watchdog" in note), "")


def _inwards(angles: list[float]) -> list[float]:
    """So far towards the middle, for each."""
    return [-TURN if angle > 0.0 else TURN for angle in angles]


def _is_off(bench: Bench, start: list[float]) -> bool:
    """Whether it has left this place."""
    return any(abs(now - then) > NEAR for now, then in zip(_angles(bench), start, strict=True))


def _is_group(bench: Bench) -> bool:
    return bench.binding.type == "DynamixelGroup"


def _angles(bench: Bench) -> list[float]:
    return list(bench.query("positions")) if _is_group(bench) else [float(bench.query("position"))]


def _goal(bench: Bench, way: float) -> list[float] | float:
    goal = [angle + way for angle in _angles(bench)]
    return goal if _is_group(bench) else goal[0]
