"""The checks that every driver must pass, whatever its devices do: made from its manifest alone."""

from __future__ import annotations

import math

from lfield.driver.contract import WATCHDOG
from lfield.driver.kit import SAFE, Bench, Check, CheckFailed, Kit, NotTried, held, refused, rested
from lfield.driver.plugin import Plugin
from lfield.driver.values import conform
from lfield.errors import DeviceError
from lfield.manifest import LEAVE, NEVER, Instruction, Quantity

KIT = Kit()
#: What is looked at when the driver's own checks have run.
LAST = Kit()

#: Texts that are an endpoint of no driver.
NO_ENDPOINTS = ("", "nothing", "nothing:")

#: Seconds for all telemetry to be there.
TELEMETRY = 10.0


def endpoint_check(plugin: Plugin) -> Check:
    """Before it is opened its driver takes its endpoint for one, and no text that is none.

    For a plugin that says which texts are endpoints.
    """

    async def check(bench: Bench) -> str:
        if why := plugin.why_no_endpoint(bench.binding.endpoint):
            raise CheckFailed(f"it is open, and told to be none: {why}")
        for text in NO_ENDPOINTS:
            if not plugin.why_no_endpoint(text):
                raise CheckFailed(f"it takes '{text}' for an endpoint")
        return "what is none is told before anything is opened"

    return Check("endpoint", check, moves=False)


@KIT.check("identity", moves=False)
async def identity(bench: Bench) -> str:
    """The device said who it is when it was opened."""
    return f"{bench.identity} at {bench.binding.endpoint}"


@KIT.check("telemetry", moves=False)
async def telemetry(bench: Bench) -> str:
    """Every quantity that the manifest gives a rate is reported with its type, and the device is heard."""
    regular = _regular(bench)
    missing = {quantity.name for quantity in regular}

    def complete() -> bool:
        for name in list(missing):
            if _known(bench, name):
                missing.discard(name)
        return not missing

    try:
        await bench.until(complete, TELEMETRY, "all telemetry")
    except CheckFailed:
        raise CheckFailed(f"it does not report {', '.join(sorted(missing))}") from None
    for quantity in regular:
        conform(bench.query(quantity.name), quantity.type)
    others = [q.name for q in bench.manifest.device.telemetry if q.rate == 0.0 and not _known(bench, q.name)]
    silent = f" (not {', '.join(others)})" if others else ""
    return f"{len(regular)} quantities{silent}, heard {bench.query('age') * 1000:.0f} ms ago"


@KIT.check("its own watchdog", moves=False)
async def watchdog(bench: Bench) -> str:
    """It stops by itself when this computer dies, or its binding says that it does not."""
    if bench.binding.is_sensor:
        return "a sensor needs none"
    if bench.binding.waives(WATCHDOG):
        return "waived by its binding: nothing, or nothing soon enough, stops it when this computer dies"
    return f"set to at most {2 * bench.binding.ttl:g} s and read back"


@KIT.check("what is no number is refused", moves=True)
async def nonsense(bench: Bench) -> str:
    """NaN and infinities are refused by every instruction that takes reals and acts."""
    tried = [i for i in bench.manifest.device.instructions if i.effect != "query" and _reals(i)]
    for instruction in tried:
        for value in (math.nan, math.inf):
            await _refused(bench, instruction, value)
    return f"{', '.join(i.name for i in tried) or 'no instruction takes numbers'}"


@KIT.check("the safe state is latched until release", moves=True)
async def latch(bench: Bench) -> str:
    """The safe state is confirmed; nothing moves before release(); then it is free again."""
    _has_safe_state(bench)
    await bench.make_safe()
    acting = next((i for i in bench.manifest.device.instructions if _acts(i)), None)
    if acting is not None:
        arguments = [_zero(parameter.type) for parameter in acting.parameters]
        reason = await refused(bench, acting.name, *arguments)
        if "release()" not in reason:
            raise CheckFailed(f"latched, it refused {acting.name}() for another reason: {reason}")
    await bench.call("release")
    await bench.until(lambda: not bench.latched, 2.0, "the latch to be off")
    return f"'{bench.binding.safe_state}' confirmed, released"


@KIT.check("it comes to rest in its safe state", moves=True)
async def rest(bench: Bench) -> str:
    """Within `rest_within` of its binding the driver says that it is still; a stop waits for that."""
    _has_safe_state(bench)
    await bench.make_safe()
    words = await rested(bench)
    await bench.call("release")
    return f"at rest{f' after it was {words[-1]}' if words else ''}"


@KIT.check("a guard that dies comes back safe", moves=True)
async def death(bench: Bench) -> str:
    """After its guard's process was killed the device is held in its safe state by the next one.

    A sensor is there again, and free.
    """
    there = _there(bench)
    await bench.kill_guard()
    if bench.binding.is_sensor:
        await _back(bench, there)
        return "its telemetry is back"
    reason = await held(bench, SAFE)
    await _back(bench, there)
    return f"'{bench.binding.safe_state}' confirmed because {reason}"


@KIT.check("a host that hangs", moves=True)
async def silence(bench: Bench) -> str:
    """Silence over the bound latches what was moved, and disturbs nothing that was not."""
    there = _there(bench)
    await bench.fall_silent(3 * bench.silence)
    await _back(bench, there)
    if bench.latched:
        return f"latched because {await held(bench, 0.0)}"
    return "nothing had been moved, nothing was done"


@LAST.check("what can be cancelled was", moves=True)
async def cancels(bench: Bench) -> str:
    """The driver's kit has cancelled, on their way, instructions that its manifest has another one for."""
    ended = {i.name for i in bench.manifest.device.instructions if i.cancel not in ("", NEVER, LEAVE)}
    tried, left = sorted(ended & bench.given_up), sorted(ended - bench.given_up)
    if not ended:
        return "no instruction of it is ended by another"
    if not tried:
        raise NotTried(f"no check of its kit cancels {' or '.join(left)}")
    others = f"; not tried: {', '.join(left)}" if left else ""
    return f"{', '.join(tried)}{others}"


def _has_safe_state(bench: Bench) -> None:
    """Raise NotTried for a pure sensor."""
    if bench.binding.is_sensor:
        raise NotTried("a sensor has no safe state, and needs none")


def _there(bench: Bench) -> list[str]:
    """The telemetry that has a rate and has come: what a device never tells is not waited for twice."""
    return [quantity.name for quantity in _regular(bench) if _known(bench, quantity.name)]


async def _back(bench: Bench, there: list[str]) -> None:
    """Wait until telemetry is there again: the bus may have been made quiet."""
    await bench.until(
        lambda: all(_known(bench, name) for name in there), TELEMETRY, "its telemetry to be back"
    )


def _regular(bench: Bench) -> list[Quantity]:
    """The telemetry that comes by itself, as the manifest says."""
    return [quantity for quantity in bench.manifest.device.telemetry if quantity.rate > 0.0]


def _known(bench: Bench, quantity: str) -> bool:
    try:
        bench.query(quantity)
    except DeviceError:
        return False
    return True


def _reals(instruction: Instruction) -> bool:
    return any(parameter.type in ("real", "real[]") for parameter in instruction.parameters)


def _acts(instruction: Instruction) -> bool:
    return instruction.effect == "actuate"


def _zero(kind: str) -> object:
    zeros: dict[str, object] = {"boolean": False, "int": 0, "real": 0.0, "string": ""}
    return zeros.get(kind, [])


async def _refused(bench: Bench, instruction: Instruction, value: float) -> None:
    """Raise CheckFailed unless the instruction refuses the value for each of its real parameters."""
    for number, parameter in enumerate(instruction.parameters):
        if parameter.type in ("real", "real[]"):
            arguments = [_zero(p.type) for p in instruction.parameters]
            arguments[number] = value if parameter.type == "real" else [value]
            await refused(bench, instruction.name, *arguments)
