"""The conformance kit of MAVLink vehicles: what any autopilot must do for this driver, fake or real.

What moves stays small: a copter climbs to 3 m, a rover drives 3 m, and both stop.
"""

from __future__ import annotations

import math

from lfield.driver.kit import Bench, CheckFailed, Kit
from lfield.errors import DeviceError
from lfield_mavlink.dialect import dialect, result_words

KIT = Kit()

#: Metres: how high a copter flies, and how far everything goes.
HEIGHT, FAR = 3.0, 3.0
#: Seconds until telemetry shows what a call has seen.
TOLD = 1.0
#: A user command that no autopilot has.
NO_COMMAND = 31009


@KIT.check("an unknown command is told from a known one", moves=False)
async def commands(bench: Bench) -> str:
    """The results of two commands that move nothing: one there is, one there is not."""
    version = float(dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION)
    known = await bench.call("command", int(dialect.MAV_CMD_REQUEST_MESSAGE), [version])
    unknown = await bench.call("command", NO_COMMAND, [])
    if known != dialect.MAV_RESULT_ACCEPTED or unknown == dialect.MAV_RESULT_ACCEPTED:
        raise CheckFailed(f"known: {result_words(known)}, unknown: {result_words(unknown)}")
    return f"known: {result_words(known)}, unknown: {result_words(unknown)}"


@KIT.check("raw commands do not move it", moves=False)
async def raw_commands(bench: Bench) -> str:
    """Commands that would go past the limits and the guard are refused."""
    moving = (dialect.MAV_CMD_COMPONENT_ARM_DISARM, dialect.MAV_CMD_NAV_TAKEOFF, dialect.MAV_CMD_DO_SET_MODE)
    for number in map(int, moving):
        await _refused(bench, "command", number, [])
    return f"{len(moving)} refused"


@KIT.check("where it is", moves=False)
async def place(bench: Bench) -> str:
    """Position about home and on the map, and how well it knows them."""
    await bench.until(lambda: bench.query("gpsFix") >= 3, 30.0, "a three-dimensional fix")
    north, east, down = bench.query("position")
    latitude, longitude, altitude = bench.query("globalPosition")
    return (
        f"({north:.1f}, {east:.1f}, {down:.1f}) m of home, {latitude:.6f}, {longitude:.6f} "
        f"at {altitude:.0f} m, {bench.query('satellites')} satellites"
    )


@KIT.check("a mode it does not have is refused", moves=False)
async def modes(bench: Bench) -> str:
    """The names of modes are looked up before anything is sent."""
    await _refused(bench, "setMode", "SOMERSAULT")
    return f"in {bench.query('mode')}"


@KIT.check("the limits of its binding are kept", moves=True)
async def limits(bench: Bench) -> str:
    """Goals outside are refused while it stands."""
    given = bench.binding.limits
    if "altitude" in given:
        await _refused(bench, "takeoff", given["altitude"] + 1.0)
    if "radius" in given:
        await _refused(bench, "goTo", given["radius"] + 1.0, 0.0, -1.0)
    if "speed" in given:
        await _refused(bench, "setVelocity", given["speed"] + 1.0, 0.0, 0.0)
    return ", ".join(f"{name} {value:g}" for name, value in given.items()) or "its binding has none"


@KIT.check("motors on and off", moves=True)
async def arming(bench: Bench) -> str:
    """The armed bit follows."""
    await bench.call("arm")
    await bench.until(lambda: bench.query("armed"), TOLD, "armed() to be true after arm()")
    await bench.call("disarm")
    await bench.until(lambda: not bench.query("armed"), TOLD, "armed() to be false after disarm()")
    return "armed, disarmed"


@KIT.check("a short trip", moves=True)
async def trip(bench: Bench) -> str:
    """Up, over, and down; or over and stop."""
    flies = bench.binding.option("kind") == "copter"
    await bench.call("arm")
    if flies:
        await bench.call("takeoff", HEIGHT)
    goal = (FAR, 0.0, -HEIGHT if flies else 0.0)
    await bench.call("goTo", *goal)
    near = bench.binding.option("tolerance") + 0.1

    def off() -> float:
        return math.dist(bench.query("position")[:2], goal[:2])

    await bench.until(lambda: off() <= near, TOLD, f"position() to be within {near:g} m of the goal")
    await bench.call("hold")
    seen = off()
    await _come_down(bench)
    return f"held {seen:.2f} m off its goal"


@KIT.check("a velocity that is not renewed ends", moves=True)
async def velocity(bench: Bench) -> str:
    """Past its time-to-live the guard brings it into the safe state, and it stands still."""
    await bench.call("arm")
    if bench.binding.option("kind") == "copter":
        await bench.call("takeoff", HEIGHT)
    await bench.call("setVelocity", 0.5, 0.0, 0.0)
    await bench.until(lambda: bool(bench.latched), 2.0 * bench.binding.ttl + 1.0, "the latch")
    await bench.until(lambda: bench.confirmed, 20.0, "the safe state to be confirmed")
    await bench.until(lambda: math.hypot(*bench.query("velocity")[:2]) < 0.2, 10.0, "it to stand still")
    reason = bench.latched
    await bench.call("release")
    await _come_down(bench)
    return f"stopped in {bench.query('mode')} because {reason}"


async def _come_down(bench: Bench) -> None:
    """Leave the vehicle on the ground with its motors off."""
    if bench.binding.option("kind") == "copter":
        await bench.call("land")
    await bench.call("disarm")


async def _refused(bench: Bench, instruction: str, *arguments: object) -> None:
    try:
        await bench.call(instruction, *arguments)
    except DeviceError:
        return
    raise CheckFailed(f"{instruction}{arguments} was carried out")
