"""The checks that every driver must pass, derived from its manifest."""

from __future__ import annotations

import math

from lfield.driver.contract import WATCHDOG
from lfield.driver.kit import SAFE, Bench, Check, CheckFailed, Kit, NotTried, held, refused, rested
from lfield.driver.plugin import Plugin
from lfield.driver.value_types import conform
from lfield.errors import DeviceError
from lfield.manifest import LEAVE, NEVER, Instruction, Quantity

KIT = Kit()
#: Checks that run after the driver's own.
LAST = Kit()

#: Texts that are not an endpoint of any driver.
NO_ENDPOINTS = ("", "nothing", "nothing:")

#: Seconds until all telemetry must be available.
TELEMETRY = 10.0


def endpoint_check(plugin: Plugin) -> Check:
    """The driver's endpoint parser accepts its endpoint and refuses invalid texts.

    For a plugin that has an endpoint parser.
    """

    async def check(bench: Bench) -> str:
        if reason := plugin.why_no_endpoint(bench.binding.endpoint):
            raise CheckFailed(f"it is open, but its endpoint is refused: {reason}")
        for text in NO_ENDPOINTS:
            if not plugin.why_no_endpoint(text):
                raise CheckFailed(f"it accepts '{text}' as an endpoint")
        return "invalid endpoints are refused before anything is opened"

    return Check("endpoint", check, moves=False)


@KIT.check("identity", moves=False)
async def identity(bench: Bench) -> str:
    """The device reported its identity when it was opened."""
    return f"{bench.identity} at {bench.binding.endpoint}"


@KIT.check("telemetry", moves=False)
async def telemetry(bench: Bench) -> str:
    """Every quantity with a rate in the manifest is reported with its type."""
    regular = _periodic_quantities(bench)
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
    return f"{len(regular)} quantities{silent}, last message {bench.query('age') * 1000:.0f} ms ago"


@KIT.check("its own watchdog", moves=False)
async def watchdog(bench: Bench) -> str:
    """The device stops by itself when this computer fails, or its binding has the waiver."""
    if bench.binding.is_sensor:
        return "not needed for a sensor"
    if bench.binding.waives(WATCHDOG):
        return "waived by its binding: nothing stops it, or not soon enough, when this computer fails"
    return f"set to at most {2 * bench.binding.ttl:g} s and read back"


@KIT.check("non-finite numbers are refused", moves=True)
async def non_finite(bench: Bench) -> str:
    """NaN and infinities are refused by every instruction that takes reals and acts."""
    tried = [i for i in bench.manifest.device.instructions if i.effect != "query" and _reals(i)]
    for instruction in tried:
        for value in (math.nan, math.inf):
            await _refused(bench, instruction, value)
    return f"{', '.join(i.name for i in tried) or 'no instruction takes numbers'}"


@KIT.check("the safe state is latched until release", moves=True)
async def latch(bench: Bench) -> str:
    """The safe state is confirmed; the device does not move before release(); afterwards it is free."""
    _has_safe_state(bench)
    await bench.make_safe()
    acting = next((i for i in bench.manifest.device.instructions if _acts(i)), None)
    if acting is not None:
        arguments = [_zero(parameter.type) for parameter in acting.parameters]
        reason = await refused(bench, acting.name, *arguments)
        if "release()" not in reason:
            raise CheckFailed(f"while latched, it refused {acting.name}() for another reason: {reason}")
    await bench.call("release")
    await bench.until(lambda: not bench.latched, 2.0, "the latch to be released")
    return f"'{bench.binding.safe_state}' confirmed, released"


@KIT.check("it comes to rest in its safe state", moves=True)
async def rest(bench: Bench) -> str:
    """The driver reports rest within `rest_within` of its binding; a stop waits for it."""
    _has_safe_state(bench)
    await bench.make_safe()
    reports = await rested(bench)
    await bench.call("release")
    return f"at rest{f', before that: {reports[-1]}' if reports else ''}"


@KIT.check("the safe state follows the death of a guard", moves=True)
async def guard_death(bench: Bench) -> str:
    """After its guard process was killed, the next guard holds the device in its safe state.

    A sensor is available again, and free.
    """
    available = _available_telemetry(bench)
    await bench.kill_guard()
    if bench.binding.is_sensor:
        await _wait_for_telemetry(bench, available)
        return "its telemetry is available again"
    reason = await held(bench, SAFE)
    await _wait_for_telemetry(bench, available)
    return f"'{bench.binding.safe_state}' confirmed because {reason}"


@KIT.check("a host that stops responding", moves=True)
async def silence(bench: Bench) -> str:
    """The silence of the host latches devices that were moved, and no others."""
    available = _available_telemetry(bench)
    await bench.fall_silent(3 * bench.silence)
    await _wait_for_telemetry(bench, available)
    if bench.latched:
        return f"latched because {await held(bench, 0.0)}"
    return "nothing had been moved; no device was latched"


@LAST.check("cancellable instructions were cancelled", moves=True)
async def cancels(bench: Bench) -> str:
    """The driver's kit has cancelled running instructions that the manifest ends by another one."""
    ended = {i.name for i in bench.manifest.device.instructions if i.cancel not in ("", NEVER, LEAVE)}
    tried, untested = sorted(ended & bench.given_up), sorted(ended - bench.given_up)
    if not ended:
        return "no instruction is ended by another"
    if not tried:
        raise NotTried(f"no check of its kit cancels {' or '.join(untested)}")
    others = f"; not tried: {', '.join(untested)}" if untested else ""
    return f"{', '.join(tried)}{others}"


def _has_safe_state(bench: Bench) -> None:
    """Raises NotTried for a pure sensor."""
    if bench.binding.is_sensor:
        raise NotTried("a sensor has no safe state")


def _available_telemetry(bench: Bench) -> list[str]:
    """The periodic telemetry that has arrived; the wait for missing quantities occurs only once."""
    return [quantity.name for quantity in _periodic_quantities(bench) if _known(bench, quantity.name)]


async def _wait_for_telemetry(bench: Bench, available: list[str]) -> None:
    """Waits until telemetry is available again: the bus may have been muted."""
    await bench.until(
        lambda: all(_known(bench, name) for name in available), TELEMETRY, "its telemetry to be available"
    )


def _periodic_quantities(bench: Bench) -> list[Quantity]:
    """The telemetry with a rate in the manifest."""
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
    """Raises CheckFailed unless the instruction refuses the value for each of its real parameters."""
    for number, parameter in enumerate(instruction.parameters):
        if parameter.type in ("real", "real[]"):
            arguments = [_zero(p.type) for p in instruction.parameters]
            arguments[number] = value if parameter.type == "real" else [value]
            await refused(bench, instruction.name, *arguments)
