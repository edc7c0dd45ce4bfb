"""Checks of a vehicle at rest: link, commands, parameters, files, limits, payload."""

from __future__ import annotations

from lfield.driver import DeviceError
from lfield.driver.kit import Bench, CheckFailed, Kit, NotTried, refused
from lfield_mavlink.link.dialect import dialect, result_text

GROUND = Kit()

#: A user command and a parameter that no autopilot has.
NO_COMMAND, NO_PARAMETER = 31009, "LFIELD_HAS_NONE"
#: Minimum share of received packets; longest round trip in seconds.
QUALITY, ROUND_TRIP = 0.5, 1.0
#: Seconds for the error of an unknown parameter, with margin.
UNKNOWN_BY = 4.0
#: Seconds after which a vehicle that was just switched on can be armed.
READY_BY = 90.0
#: Harmless payload instructions with arguments.
PAYLOAD: tuple[tuple[str, tuple[float, ...]], ...] = (
    ("closeGripper", ()),
    ("triggerCamera", ()),
    ("startPictures", (1.0, 1)),
    ("stopPictures", ()),
    ("startVideo", ()),
    ("stopVideo", ()),
    ("pointGimbal", (0.0, 0.0)),
    ("gimbalAttitude", ()),
    ("releaseGimbal", ()),
)


@GROUND.check("it is at rest with its motors off", moves=False)
async def at_rest(bench: Bench) -> str:
    """The kit must not start with a moving vehicle."""
    if bench.query("armed") or not bench.query("landed"):
        raise CheckFailed(
            "it is armed or in the air: land it and switch its motors off before running the kit"
        )
    return f"in {bench.query('mode')}, battery {bench.query('battery') * 100.0:.0f} %"


@GROUND.check("position", moves=False)
async def place(bench: Bench) -> str:
    """Local and global position, and their quality."""
    await bench.until(lambda: bench.query("gpsFix") >= 3, 30.0, "a three-dimensional fix")
    north, east, down = bench.query("position")
    latitude, longitude, altitude = bench.query("globalPosition")
    reference = "of home" if bench.binding.frame is None else "in the team's frame"
    return (
        f"({north:.1f}, {east:.1f}, {down:.1f}) m {reference}, {latitude:.6f}, {longitude:.6f} "
        f"at {altitude:.0f} m, {bench.query('satellites')} satellites"
    )


@GROUND.check("the link is good", moves=False)
async def link(bench: Bench) -> str:
    """Low packet loss and short round trips."""
    await bench.until(lambda: bench.query("linkQuality") >= QUALITY, 15.0, f"a link quality of {QUALITY:g}")
    await bench.until(lambda: bench.query("roundTrip") <= ROUND_TRIP, 15.0, f"an answer in {ROUND_TRIP:g} s")
    return (
        f"{bench.query('linkQuality') * 100.0:.1f} % of its packets, {bench.query('packetsBroken')} broken, "
        f"round trip {bench.query('roundTrip') * 1000.0:.1f} ms"
    )


@GROUND.check("an unknown command is distinguished from a known one", moves=False)
async def commands(bench: Bench) -> str:
    """The results of two commands without motion: a known and an unknown one."""
    version = float(dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION)
    known = await bench.call("command", int(dialect.MAV_CMD_REQUEST_MESSAGE), [version])
    unknown = await bench.call("command", NO_COMMAND, [])
    outcome = f"known: {result_text(known)}, unknown: {result_text(unknown)}"
    if known != dialect.MAV_RESULT_ACCEPTED or unknown == dialect.MAV_RESULT_ACCEPTED:
        raise CheckFailed(outcome)
    return outcome


@GROUND.check("all parameters, and one again by name", moves=False)
async def parameters(bench: Bench) -> str:
    """The list is complete, and a parameter read by name has the same value."""
    lines = (await bench.call("parameters")).splitlines()
    name, value = lines[0].split()
    repeated = await bench.call("parameter", name)
    if repeated != float(value):
        raise CheckFailed(f"{name} is {value} in the list but {repeated:.9g} when read by name")
    return f"{len(lines)} parameters, {name} is {value}"


@GROUND.check("an unknown parameter fails soon", moves=False)
async def unknown_parameter(bench: Bench) -> str:
    """Autopilots do not answer a request for an unknown parameter, which must time out."""
    start = bench.now
    reason = await refused(bench, "parameter", NO_PARAMETER)
    elapsed = bench.now - start
    if elapsed > UNKNOWN_BY:
        raise CheckFailed(f"after {elapsed:.1f} s: {reason}")
    return f"after {elapsed:.1f} s: {reason}"


@GROUND.check("a parameter is written", moves=True)
async def write_parameter(bench: Bench) -> str:
    """The present value can be written to the first writable parameter."""
    for line in (await bench.call("parameters")).splitlines():
        name, value = line.split()
        try:
            await bench.call("setParameter", name, float(value))
        except DeviceError:  # read-only, or reserved by the driver
            continue
        return f"{name} is {value} as before"
    raise CheckFailed("it accepts none of its parameters")


@GROUND.check("files", moves=False)
async def files(bench: Bench) -> str:
    """Lists the root folder; an unknown one fails."""
    entries = (await bench.call("listFiles", "/")).splitlines()
    reason = await refused(bench, "readFile", "/lfield/has/none")
    return f"{len(entries)} entries: {' '.join(entries[:5])}; unknown folder: {reason}"


@GROUND.check("it can be armed", moves=True)
async def ready(bench: Bench) -> str:
    """The pre-arm checks have passed and the position is known; takes 45 s after power-on."""
    start = bench.now
    await bench.call("waitReady", READY_BY)
    if not await bench.call("isReady") or await bench.call("whyNotReady"):
        raise CheckFailed(f"waitReady() returned, but it is not ready: {await bench.call('whyNotReady')}")
    return f"after {bench.now - start:.1f} s, in {bench.query('mode')}"


@GROUND.check("raw commands do not move it", moves=True)
async def raw_commands(bench: Bench) -> str:
    """Commands that would bypass limits and guard are refused."""
    moving = (dialect.MAV_CMD_COMPONENT_ARM_DISARM, dialect.MAV_CMD_NAV_TAKEOFF, dialect.MAV_CMD_DO_SET_MODE)
    for number in moving:
        await refused(bench, "command", int(number), [])
    return f"{len(moving)} refused"


@GROUND.check("an unknown mode is refused", moves=True)
async def modes(bench: Bench) -> str:
    """Mode names are checked before any command is sent."""
    return await refused(bench, "setMode", "SOMERSAULT")


@GROUND.check("the limits of its binding are enforced", moves=True)
async def limits(bench: Bench) -> str:
    """Goals beyond the limits are refused while the vehicle is at rest, before any command is sent."""
    bounds = bench.binding.limits
    north, east, down = bench.query("position")
    # Limits are relative to home, which it may be away from; positions may use another frame.
    home = down + bench.query("altitude")
    excessive = {
        "altitude": ("goTo", north, east, home - bounds.get("altitude", 0.0) - 1.0),
        "radius": ("goTo", north + 2.0 * bounds.get("radius", 0.0) + 1.0, east, home - 1.0),
        "speed": ("setVelocity", bounds.get("speed", 0.0) + 1.0, 0.0, 0.0),
    }
    if not bounds:
        raise NotTried("its binding has no 'limits'")
    for name in bounds:
        reason = await refused(bench, *excessive[name])
        if "limit" not in reason:
            raise CheckFailed(
                f"beyond the {name} of {bounds[name]:g} it was refused for another reason: {reason}"
            )
    return ", ".join(f"{name} {value:g}" for name, value in bounds.items())


@GROUND.check("payload answers", moves=True)
async def payload(bench: Bench) -> str:
    """Available payload accepts commands, missing payload refuses; PX4 does not answer for the latter."""
    outcomes = []
    for instruction, arguments in PAYLOAD:
        try:
            await bench.call(instruction, *arguments)
            outcomes.append(f"{instruction} done")
        except DeviceError as error:
            is_timeout = error.kind == "DeviceTimeoutException"
            if is_timeout and not bench.identity.startswith("PX4"):
                raise
            outcomes.append(f"{instruction} {'missing' if is_timeout else 'refused'}")
    # The vehicle itself still responds.
    bench.query("mode")
    return ", ".join(outcomes)
