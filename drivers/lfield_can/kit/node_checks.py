"""Checks of functions of DroneCAN nodes. A servo moves less than 0.5 rad, and is where it was at the end."""

from __future__ import annotations

from lfield.driver.kit import Bench, CheckFailed, Kit, cancelled, held, refused

NODES = Kit()

#: Motion of a check in rad.
TURN = 0.2
_SENSORS, _SERVO = ("DroneCanBattery", "DroneCanEsc"), ("DroneCanServo",)


@NODES.check("its node is healthy", moves=False, types=(*_SENSORS, *_SERVO))
async def healthy(bench: Bench) -> str:
    """The node responds, operates and reports no error."""
    if not bench.query("online"):
        raise CheckFailed("it does not respond")
    if bench.query("health") not in ("ok", "warning"):
        raise CheckFailed(f"the health of its node is {bench.query('health')}")
    return f"{bench.query('health')}, {bench.identity}"


@NODES.check("its supply is plausible", moves=False, types=_SENSORS)
async def supply(bench: Bench) -> str:
    """The node reports a voltage above 1 V."""
    if bench.query("voltage") < 1.0:
        raise CheckFailed(f"its voltage is {bench.query('voltage'):.1f} V")
    return f"{bench.query('voltage'):.1f} V, {bench.query('current'):.1f} A"


@NODES.check("turns there and back", moves=True, types=_SERVO)
async def turns(bench: Bench) -> str:
    """moveTo() returns when the servo is at rest at its goal."""
    start = bench.query("position")
    errors = []
    for goal in (start + _distance(bench), start):
        await bench.call("moveTo", goal)
        errors.append(abs(bench.query("position") - goal))
        if errors[-1] > 2.0 * bench.binding.option("tolerance"):
            raise CheckFailed(f"moveTo() returned {errors[-1]:.3f} rad from its goal")
    return f"{errors[0]:.4f} rad off there, {errors[1]:.4f} rad off back"


@NODES.check("a cancelled motion holds", moves=True, types=_SERVO)
async def cancels(bench: Bench) -> str:
    """A cancelled servo stops on its way."""
    start = bench.query("position")

    def has_started() -> bool:
        return bool(abs(bench.query("position") - start) > 0.01)

    outcome = await cancelled(bench, has_started, "moveTo", start + 2.0 * _distance(bench))
    if abs(bench.query("speed")) > bench.binding.option("standstill"):
        raise CheckFailed(f"{outcome}, but it turns")
    await bench.call("moveTo", start)
    return outcome


@NODES.check("a setpoint that is not renewed ends", moves=True, types=_SERVO)
async def expires(bench: Bench) -> str:
    """The guard brings the servo into the safe state after the time-to-live of a setpoint."""
    await bench.call("setPosition", bench.query("position"))
    return await held(bench, bench.binding.ttl + 2.0)


@NODES.check("a host that stops responding", moves=True, types=_SERVO)
async def hang(bench: Bench) -> str:
    """The guard holds the servo."""
    await bench.call("setPosition", bench.query("position"))
    await bench.fall_silent(3 * bench.silence)
    return await held(bench, 1.0)


@NODES.check("positions beyond its bounds are refused", moves=True, types=_SERVO)
async def bounds(bench: Bench) -> str:
    """A position beyond the bounds is refused before any frame is sent."""
    for instruction in ("setPosition", "moveTo"):
        await refused(bench, instruction, bench.binding.option("lowest") - 0.1)
        reason = await refused(bench, instruction, bench.binding.option("highest") + 0.1)
    return f"4 refused, the last: {reason}"


def _distance(bench: Bench) -> float:
    """A distance towards the side with more free range."""
    position = bench.query("position")
    free_space = bench.binding.option("highest") - position, position - bench.binding.option("lowest")
    return TURN if free_space[0] >= free_space[1] else -TURN
