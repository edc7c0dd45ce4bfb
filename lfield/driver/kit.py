"""The conformance kit: tests a driver's contract against a device, real or simulated.

A driver adds its own checks in a module that its Plugin names (`kit="lfield_servo.kit:KIT"`):

```python
KIT = Kit()

@KIT.check("turns and reports its angle", moves=True)
async def turns(bench: Bench) -> str:
    await bench.call("turn", 0.5)
    await bench.until(lambda: abs(bench.query("angle") - 0.5) < 0.02, 1.0, "the angle to be 0.5 rad")
    return f"0.5 rad commanded, {bench.query('angle'):.3f} rad measured"

```

A check returns a description of its observations. It raises DeviceError or CheckFailed when it fails, and
NotTried when it does not apply. A check that can move a device or change a setting declares `moves=True`; it
runs only with the user's consent.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any, Literal, Protocol

from lfield.driver.binding import DeviceBinding
from lfield.driver.contract import Manifest
from lfield.errors import DeviceError

#: The error kind of a call that was cancelled.
CANCELLED = "CancelledException"
#: Seconds for one check in addition to `rest_within`; seconds for a safe state to be confirmed.
BOUND, SAFE = 60.0, 20.0


class CheckFailed(Exception):
    """An expected behaviour, stated in the sentence, was not observed."""


class NotTried(Exception):
    """The check does not apply to this binding, for the reason in the sentence."""


class Bench(Protocol):
    """The interface of a check to one device behind its guard."""

    binding: DeviceBinding
    manifest: Manifest
    #: Longest time without a heartbeat of the host before the device is made safe, in seconds.
    silence: float
    #: Longest time from the host's last heartbeat until its bus is muted, in seconds.
    quiet_after: float
    #: Log lines of the guard since the device was opened.
    notes: list[str]

    @property
    def now(self) -> float:
        """Seconds on the host's clock; virtual time in tests."""

    @property
    def identity(self) -> str:
        """The identity of the device, as reported by its driver."""

    async def call(self, instruction: str, *arguments: object) -> Any:
        """Executes an instruction and returns its result. Raises DeviceError."""

    async def give_up(self, begun: Callable[[], bool], instruction: str, *arguments: object) -> Any:
        """Starts an instruction, cancels it as soon as `begun` holds, waits for its end and returns its
        result.

        Raises DeviceError (of kind CancelledException if it was cancelled), and CheckFailed if `begun` does
        not hold within SAFE seconds.
        """

    @property
    def given_up(self) -> set[str]:
        """The names of the cancelled instructions."""

    def query(self, quantity: str) -> Any:
        """The present value of a telemetry quantity. Raises DeviceError when there is none."""

    async def until(self, condition: Callable[[], bool], bound: float, what: str) -> None:
        """Waits for a condition; a query without a value counts as false. Raises CheckFailed."""

    async def make_safe(self) -> None:
        """Requests the safe state and waits until it is confirmed. Raises CheckFailed."""

    async def fall_silent(self, seconds: float) -> None:
        """Stops the host's heartbeats for `seconds` seconds."""

    async def kill_guard(self) -> None:
        """Kills the guard process and waits until its successor has opened the device."""

    @property
    def latched(self) -> str:
        """The reason why the device is latched in its safe state, '' when it is not."""

    @property
    def confirmed(self) -> bool:
        """Whether the safe state is confirmed."""

    @property
    def moving(self) -> str | None:
        """The remaining motion of the device in its safe state; '' at rest, None when unknown."""


CheckFunction = Callable[[Bench], Awaitable[str]]


@dataclass(frozen=True, slots=True)
class Check:
    """One check; `types` are the device types that it applies to, empty for all."""

    name: str
    run: CheckFunction
    moves: bool
    types: tuple[str, ...] = ()

    def suits(self, device_type: str) -> bool:
        """Whether the check applies to devices of this type."""
        return not self.types or device_type in self.types


@dataclass(slots=True)
class Kit:
    """The checks of one driver, in execution order."""

    checks: list[Check] = field(default_factory=list)

    def check(
        self, name: str, *, moves: bool, types: Sequence[str] = ()
    ) -> Callable[[CheckFunction], CheckFunction]:
        """Decorator that adds a coroutine as a check."""

        def add(function: CheckFunction) -> CheckFunction:
            self.checks.append(Check(name, function, moves, tuple(types)))
            return function

        return add


async def refused(bench: Bench, instruction: str, *arguments: object) -> str:
    """The reason for which an instruction is refused. Raises CheckFailed if the instruction is executed."""
    try:
        await bench.call(instruction, *arguments)
    except DeviceError as error:
        return error.reason
    argument_text = ", ".join(map(str, arguments))
    raise CheckFailed(f"{instruction}({argument_text}) was executed instead of being refused")


async def held(bench: Bench, bound: float) -> str:
    """Waits until the device is latched, at most `bound` seconds, and in its confirmed safe state; then
    releases it. Returns the reason why it was latched. Raises CheckFailed.
    """
    await bench.until(lambda: bool(bench.latched), bound, "the device to go safe")
    reason = bench.latched
    await bench.until(lambda: bench.confirmed, SAFE, f"'{bench.binding.safe_state}' to be confirmed")
    await bench.call("release")
    return reason


async def cancelled(bench: Bench, begun: Callable[[], bool], instruction: str, *arguments: object) -> str:
    """Cancels an instruction as soon as `begun` holds; returns its outcome.

    An instruction with `cancel: never` runs to its end. Any other instruction must end within SAFE seconds,
    as its manifest prescribes, and leave the device free; the caller checks the resulting motion. Raises
    CheckFailed, and DeviceError.
    """
    declared = bench.manifest.device.instruction(instruction)
    assert declared is not None, "a kit contains instructions of its device only"
    start = bench.now

    def since() -> bool:
        nonlocal start
        start = bench.now
        return begun()

    try:
        await bench.give_up(since, instruction, *arguments)
    except DeviceError as error:
        if error.kind != CANCELLED or not declared.may_be_cancelled:
            raise
        duration = bench.now - start
        if duration > SAFE or bench.latched:
            why = f"it is latched because {bench.latched}" if bench.latched else f"that took {duration:.1f} s"
            raise CheckFailed(f"{error.reason}; {why}") from None
        return f"{error.reason} after {duration:.2f} s"
    if declared.may_be_cancelled:
        raise CheckFailed(f"{instruction}() was cancelled and ran to its end")
    return f"{instruction}() runs to its end"


async def rested(bench: Bench) -> list[str]:
    """Waits until the device is at rest in its safe state, at most `rest_within`; returns the reported
    motion.

    Raises CheckFailed.
    """
    reports, within = list[str](), bench.binding.rest_within

    def at_rest() -> bool:
        if bench.moving and bench.moving not in reports:
            reports.append(bench.moving)
        return bench.moving == ""

    try:
        await bench.until(at_rest, within, "it to come to rest")
    except CheckFailed:
        last = reports[-1] if reports else "no motion was reported"
        raise CheckFailed(f"it was not at rest within {within:g} s: {last}") from None
    return reports


@dataclass(frozen=True, slots=True)
class Finding:
    """The result of one check on one device: the observation, or the reason why the check failed or did not
    run.
    """

    device: str
    check: str
    outcome: Literal["passed", "failed", "not run"]
    seen: str


async def run_kit(bench: Bench, checks: Iterable[Check], may_move: bool) -> AsyncIterator[Finding]:
    """Runs the checks that apply to the device, one after the other; a failure does not end the run."""
    name = bench.binding.name
    for check in checks:
        if not check.suits(bench.binding.type):
            continue
        if check.moves and not may_move and not bench.binding.is_sensor:
            yield Finding(name, check.name, "not run", "it would move the device, which was not permitted")
            continue
        finding = await _run(bench, check)
        if finding.outcome == "failed" and bench.confirmed:
            # Release the device so that later checks do not fail for the same reason.
            with suppress(DeviceError):
                await bench.call("release")
        yield finding


async def _run(bench: Bench, check: Check) -> Finding:
    name, bound = bench.binding.name, BOUND + bench.binding.rest_within
    try:
        async with asyncio.timeout(bound):
            return Finding(name, check.name, "passed", await check.run(bench))
    except TimeoutError:
        return Finding(name, check.name, "failed", f"it was not done within {bound:g} s")
    except DeviceError as error:
        return Finding(name, check.name, "failed", error.reason)
    except CheckFailed as error:
        return Finding(name, check.name, "failed", str(error))
    except NotTried as error:
        return Finding(name, check.name, "not run", str(error))
    except Exception as error:  # a kit is third-party code, as a driver is
        return Finding(name, check.name, "failed", f"the check itself is broken: {error!r}")
