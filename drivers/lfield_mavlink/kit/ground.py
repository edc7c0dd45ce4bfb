"""Checks of a vehicle that stands: its link, commands, parameters, files, limits, payload."""

from __future__ import annotations

from lfield.driver import DeviceError
from lfield.driver.kit import Bench, CheckFailed, Kit, NotTried, refused
from lfield_mavlink.link.dialect import dialect, result_words

GROUND = Kit()

#: A user command that no autopilot has, and a parameter.
NO_COMMAND, NO_PARAMETER = 31009, "LFIELD_HAS_NONE"
#: The least share of packets that comes, and the longest way there and back, in seconds.
QUALITY, ROUND_TRIP = 0.5, 1.0
#: Seconds after which a parameter that does not exist is an error, with some room.
UNKNOWN_BY = 4.0
#: Seconds after which a vehicle that was just switched on can be armed.
READY_BY = 90.0
#: Payload that can be used without harm: instruction and arguments.
PAYLOAD: tuple[tuple[str, tuple[float, ...]], ...] = (
    ("closeGripper", ()),
    ("triggerCamera", ()),
    ("pointGimbal", (0.0, 0.0)),
)


@GROUND.check("it stands with its motors off", moves=False)
async def stands(bench: Bench) -> str:
    """Nothing of this kit is for a vehicle that is under way."""
    if bench.query("armed") or not bench.query("landed"):
        raise CheckFailed("it is armed or in the air: land it and switch its motors off before the kit")
    return f"in {bench.query('mode')}, battery {bench.query('battery') * 100.0:.0f} %"


@GROUND.check("where it is", moves=False)
async def place(bench: Bench) -> str:
    """Position about home or in the team's frame, and on the map, and how well it knows them."""
    await bench.until(lambda: bench.query("gpsFix") >= 3, 30.0, "a three-dimensional fix")
    north, east, down = bench.query("position")
    latitude, longitude, altitude = bench.query("globalPosition")
    of = "of home" if bench.binding.frame is None else "in the team's frame"
    return (
        f"({north:.1f}, {east:.1f}, {down:.1f}) m {of}, {latitude:.6f}, {longitude:.6f} "
        f"at {altitude:.0f} m, {bench.query('satellites')} satellites"
    )


@GROUND.check("the link is good", moves=False)
async def link(bench: Bench) -> str:
    """Few packets are lost, and the answers come soon."""
    await bench.until(lambda: bench.query("linkQuality") >= QUALITY, 15.0, f"a link quality of {QUALITY:g}")
    await bench.until(lambda: bench.query("roundTrip") <= ROUND_TRIP, 15.0, f"an answer in {ROUND_TRIP:g} s")
    return (
        f"{bench.query('linkQuality') * 100.0:.1f} % of its packets, {bench.query('packetsBroken')} broken, "
        f"there and back in {bench.query('roundTrip') * 1000.0:.1f} ms"
    )


@GROUND.check("an unknown command is told from a known one", moves=False)
async def commands(bench: Bench) -> str:
    """The results of two commands that move nothing: one there is, one there is not."""
    version = float(dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION)
    known = await bench.call("command", int(dialect.MAV_CMD_REQUEST_MESSAGE), [version])
    unknown = await bench.call("command", NO_COMMAND, [])
    told = f"known: {result_words(known)}, unknown: {result_words(unknown)}"
    if known != dialect.MAV_RESULT_ACCEPTED or unknown == dialect.MAV_RESULT_ACCEPTED:
        raise CheckFailed(told)
    return told


@GROUND.check("all parameters, and one of them again", moves=False)
async def parameters(bench: Bench) -> str:
    """The list is whole, and a parameter read by its name has the value of the list."""
    lines = (await bench.call("parameters")).splitlines()
    name, value = lines[0].split()
    again = await bench.call("parameter", name)
    if again != float(value):
        raise CheckFailed(f"{name} is {value} in the list and {again:.9g} when it is read by its name")
    return f"{len(lines)} parameters, {name} is {value}"


@GROUND.check("an unknown parameter is an error soon", moves=False)
async def unknown_parameter(bench: Bench) -> str:
    """Autopilots answer with silence: that must end."""
    start = bench.now
    reason = await refused(bench, "parameter", NO_PARAMETER)
    took = bench.now - start
    if took > UNKNOWN_BY:
        raise CheckFailed(f"after {took:.1f} s: {reason}")
    return f"after {took:.1f} s: {reason}"


@GROUND.check("a parameter is written", moves=True)
async def write_parameter(bench: Bench) -> str:
    """The first that may be written gets the value that it has."""
    for line in (await bench.call("parameters")).splitlines():
        name, value = line.split()
        try:
            await bench.call("setParameter", name, float(value))
        except DeviceError:  # one that the autopilot only tells, or that the driver keeps to itself
            continue
        return f"{name} is {value} as before"
    raise CheckFailed("it takes none of its parameters")


@GROUND.check("files", moves=False)
async def files(bench: Bench) -> str:
    """The root folder can be listed, and what is not there is an error."""
    listed = (await bench.call("listFiles", "/")).splitlines()
    reason = await refused(bench, "readFile", "/lfield/has/none")
    return f"{len(listed)} entries: {' '.join(listed[:5])}; of another: {reason}"


@GROUND.check("it can be armed", moves=True)
async def ready(bench: Bench) -> str:
    """Its own checks have passed, and it knows where it is; from cold that takes 45 s."""
    start = bench.now
    await bench.call("waitReady", READY_BY)
    if not await bench.call("isReady") or await bench.call("whyNotReady"):
        raise CheckFailed(f"waitReady() returned, and it is not ready: {await bench.call('whyNotReady')}")
    return f"after {bench.now - start:.1f} s, in {bench.query('mode')}"


@GROUND.check("raw commands do not move it", moves=True)
async def raw_commands(bench: Bench) -> str:
    """Commands that would go past the limits and the guard are refused."""
    moving = (dialect.MAV_CMD_COMPONENT_ARM_DISARM, dialect.MAV_CMD_NAV_TAKEOFF, dialect.MAV_CMD_DO_SET_MODE)
    for number in moving:
        await refused(bench, "command", int(number), [])
    return f"{len(moving)} refused"


@GROUND.check("a mode it does not have is refused", moves=True)
async def modes(bench: Bench) -> str:
    """The names of modes are looked up before anything is sent."""
    return await refused(bench, "setMode", "SOMERSAULT")


@GROUND.check("the limits of its binding are kept", moves=True)
async def limits(bench: Bench) -> str:
    """Goals outside are refused while it stands, before anything is sent."""
    given = bench.binding.limits
    north, east, down = bench.query("position")
    # Limits are about home, from which it may stand as far as they allow; places need not be about it.
    home = down + bench.query("altitude")
    beyond = {
        "altitude": ("goTo", north, east, home - given.get("altitude", 0.0) - 1.0),
        "radius": ("goTo", north + 2.0 * given.get("radius", 0.0) + 1.0, east, home - 1.0),
        "speed": ("setVelocity", given.get("speed", 0.0) + 1.0, 0.0, 0.0),
    }
    if not given:
        raise NotTried("its binding has none: give it 'limits'")
    for name in given:
        reason = await refused(bench, *beyond[name])
        if "limit" not in reason:
            raise CheckFailed(
                f"beyond the {name} of {given[name]:g} it was refused for another reason: {reason}"
            )
    return ", ".join(f"{name} {value:g}" for name, value in given.items())


@GROUND.check("payload answers", moves=True)
async def payload(bench: Bench) -> str:
    """What it has is accepted, and what it has not is refused; PX4 leaves that without an answer."""
    told = []
    for instruction, arguments in PAYLOAD:
        try:
            await bench.call(instruction, *arguments)
            told.append(f"{instruction} done")
        except DeviceError as error:
            silent = error.kind == "DeviceTimeoutException"
            if silent and not bench.identity.startswith("PX4"):
                raise
            told.append(f"{instruction} {'not there' if silent else 'refused'}")
    # What did not answer is still there itself.
    bench.query("mode")
    return ", ".join(told)
