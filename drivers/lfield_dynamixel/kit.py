"""The conformance kit of Dynamixel servos: what is tried beside the checks that every driver must pass.

What moves turns by 0.2 rad at most, from where the servo stands and back; at the end the servo is limp.
"""

from __future__ import annotations

import math

from lfield.driver.kit import Bench, CheckFailed, Kit
from lfield.errors import DeviceError

KIT = Kit()

#: rad that a check turns, and how exactly it must be back.
TURN, NEAR = 0.2, 0.05
#: rad/s and rad/s2 of what moves here.
PROFILE = (1.0, 5.0)


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
    try:
        await bench.call("moveTo", _goal(bench, 0.0))
    except DeviceError as error:
        if "torque" not in error.reason:
            raise
        return error.reason
    raise CheckFailed("moveTo() was carried out with the torque off")


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
    await bench.call("setProfile", *PROFILE)
    start = _angles(bench)
    inwards = -TURN if start[0] > 0.0 else TURN
    seen = []
    for way in (inwards, 0.0):
        goal = [angle + way for angle in start]
        await bench.call("moveTo", goal if _is_group(bench) else goal[0])
        off = max(abs(now - wanted) for now, wanted in zip(_angles(bench), goal, strict=True))
        if off > NEAR:
            raise CheckFailed(f"moveTo() returned {off:.3f} rad short")
        seen.append(f"{off:.3f}")
    return f"within {' and '.join(seen)} rad"


@KIT.check("its watchdog stops it, and release() frees it", moves=True)
async def watchdog(bench: Bench) -> str:
    """A servo that hears nothing for twice the time-to-live stops by itself; then goals are refused."""
    if bench.binding.waives("device_watchdog"):
        return "not tried: waived by its binding"
    await bench.call("torque", True)
    told = len(bench.notes)
    await bench.fall_silent(2.0 * bench.binding.ttl + 1.0)
    stopped = "stopped by its own watchdog"
    await bench.until(lambda: any(stopped in note for note in bench.notes[told:]), 5.0, "that to be told")
    await bench.until(lambda: bench.confirmed or not bench.latched, 10.0, "its safe state to be confirmed")
    await bench.call("release")
    await bench.until(lambda: bool(_angles(bench)), 3.0, "it to be polled again")
    await bench.call("moveTo", _goal(bench, 0.0))
    return next(note for note in bench.notes[told:] if stopped in note)


@KIT.check("limp at the end", moves=True)
async def let_go(bench: Bench) -> str:
    """The torque is off, and seen to be off."""
    await bench.call("torque", False)
    await bench.until(lambda: not bench.query("torqueOn"), 3.0, "the torque to be off")
    return "torque off"


def _is_group(bench: Bench) -> bool:
    return bench.binding.type == "DynamixelGroup"


def _angles(bench: Bench) -> list[float]:
    return list(bench.query("positions")) if _is_group(bench) else [float(bench.query("position"))]


def _goal(bench: Bench, way: float) -> list[float] | float:
    goal = [angle + way for angle in _angles(bench)]
    return goal if _is_group(bench) else goal[0]
