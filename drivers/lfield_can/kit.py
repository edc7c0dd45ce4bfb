"""The conformance kit of CAN devices: `lfield kit can --endpoint ...` (see lfield.driver.kit).

Motions are small and slow: a tenth of a radian, at a rad/s or the limit of the binding if that is less.
"""

from __future__ import annotations

import math

from lfield.driver.kit import Bench, CheckFailed, Kit
from lfield.errors import DeviceError

KIT = Kit()

AXIS, SIGNALS = ("CanAxis",), ("CanSignals",)
#: A small way in rad, and the seconds that it may take.
WAY, BOUND = 0.1, 10.0


@KIT.check("tells its state and motion", moves=False, types=AXIS)
async def tells(bench: Bench) -> str:
    """Telemetry that every axis has."""
    await bench.until(lambda: math.isfinite(bench.query("velocity")), BOUND, "its velocity")
    return (
        f"{bench.query('state')}, at {bench.query('position'):.3f} rad, {bench.query('velocity'):.3f} rad/s"
    )


@KIT.check("refuses motion while it is off", moves=True, types=AXIS)
async def refuses(bench: Bench) -> str:
    """Only enable() enables."""
    await bench.call("disable")
    await bench.until(lambda: bench.query("enabled") is False, BOUND, "it to be off")
    return await _refused(bench, "setVelocity", 0.0)


@KIT.check("refuses what is no number or above its limits", moves=False, types=AXIS)
async def limits(bench: Bench) -> str:
    """Before anything is sent."""
    seen = await _refused(bench, "setVelocity", math.nan)
    for limit, instruction in (("speed", "setVelocity"), ("torque", "setTorque")):
        if (bound := bench.binding.limits.get(limit)) is not None:
            seen = await _refused(bench, instruction, 1.1 * bound)
    return seen


@KIT.check("moves a little and comes back", moves=True, types=AXIS)
async def moves(bench: Bench) -> str:
    """A travel that its position shows."""
    if not bench.query("referenced") and not bench.binding.waives("no_homing"):
        return "not homed: it may not travel"
    speed = min(1.0, bench.binding.limits.get("speed", 1.0))
    await bench.call("enable")
    start = bench.query("position")
    lowest, highest = bench.binding.option("lowest"), bench.binding.option("highest")
    goal = start + WAY if start + WAY <= highest else start - WAY
    if not lowest <= goal <= highest or not lowest <= start <= highest:
        return f"at {start:.3f} rad it has no room to move in"
    there = await _travel(bench, goal, speed)
    back = await _travel(bench, start, speed)
    return f"{goal:.3f} rad asked, {there:.3f} rad seen, and back at {back:.3f} rad"


async def _travel(bench: Bench, goal: float, speed: float) -> float:
    """Where it is seen to be after moveTo; telemetry may come a moment later than the answer."""
    near = 2.0 * bench.binding.option("tolerance")
    await bench.call("moveTo", goal, speed)
    await bench.until(lambda: abs(bench.query("position") - goal) <= near, 1.0, f"it to be at {goal:.3f} rad")
    return float(bench.query("position"))


@KIT.check("stands after its quick stop", moves=True, types=AXIS)
async def stops(bench: Bench) -> str:
    """stop() from a slow turn."""
    await bench.call("enable")
    await bench.call("setVelocity", min(0.2, bench.binding.limits.get("speed", 0.2)))
    await bench.call("stop")
    slow = 2.0 * bench.binding.option("standstill")
    await bench.until(lambda: abs(bench.query("velocity")) <= slow, 1.0, "it to stand")
    return f"{bench.query('state')}, {bench.query('velocity'):.3f} rad/s"


@KIT.check("is heard", moves=False, types=SIGNALS)
async def heard(bench: Bench) -> str:
    """Some message of its file has come."""
    await bench.until(lambda: bench.query("online") is True, BOUND, "a message of it")
    return bench.identity


@KIT.check("sends nothing that its binding does not list", moves=False, types=SIGNALS)
async def sends_nothing_else(bench: Bench) -> str:
    """Nothing is a command by default."""
    return await _refused(bench, "send", "no such message", [0.0])


async def _refused(bench: Bench, instruction: str, *arguments: object) -> str:
    """The words of a refusal. Raises CheckFailed when there is none."""
    try:
        await bench.call(instruction, *arguments)
    except DeviceError as error:
        return error.reason
    raise CheckFailed(f"{instruction}{arguments} was not refused")
