"""The conformance kit: what every driver promises, tried on whatever is at an endpoint, fake or real.

A driver adds its own checks in a module that its Plugin names (`kit="lfield_servo.kit:KIT"`):

```python
KIT = Kit()

@KIT.check("turns and says so", moves=True)
async def turns(bench: Bench) -> str:
    await bench.call("turn", 0.5)
    await bench.until(lambda: abs(bench.query("angle") - 0.5) < 0.02, 1.0, "the angle to be 0.5 rad")
    return f"0.5 rad asked, {bench.query('angle'):.3f} rad seen"
```

A check returns in words what it has seen; it fails by DeviceError or CheckFailed, and says by NotTried that
it does not apply. What can move something, or changes what a device keeps, says so: nothing of that kind
runs unless somebody has agreed to it.
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

#: The kind of the answer to a call that was cancelled.
CANCELLED = "CancelledException"
#: Seconds that one check may take beyond `rest_within`, and a safe state to be confirmed.
BOUND, SAFE = 60.0, 20.0


class CheckFailed(Exception):
    """Something that was promised was not seen; the sentence says what."""


class NotTried(Exception):
    """A check is not for a device that is bound like this; the sentence says why."""


class Bench(Protocol):
    """One device behind its guard, as a check sees it."""

    binding: DeviceBinding
    manifest: Manifest
    #: How long the host may be silent, in seconds, before the device goes safe.
    silence: float
    #: Seconds from the host's last sign of life until its bus is made quiet, at the latest.
    quiet_after: float
    #: What the guard has told since it was opened, one sentence each.
    notes: list[str]

    @property
    def now(self) -> float:
        """Seconds of the host's clock, for what a check measures: a kit may run on virtual time too."""

    @property
    def identity(self) -> str:
        """Who the device is, in its driver's words."""

    async def call(self, instruction: str, *arguments: object) -> Any:
        """Carry an instruction out and return its result. Raises DeviceError."""

    async def give_up(self, begun: Callable[[], bool], instruction: str, *arguments: object) -> Any:
        """Begin an instruction, cancel it as soon as `begun` holds, and wait for its end; its result.

        Raises DeviceError, of the kind CancelledException when it was cancelled, and CheckFailed when it is
        not begun within SAFE seconds.
        """

    @property
    def given_up(self) -> set[str]:
        """The names of the instructions that were."""

    def query(self, quantity: str) -> Any:
        """The present value of a telemetry quantity. Raises DeviceError when there is none."""

    async def until(self, condition: Callable[[], bool], bound: float, what: str) -> None:
        """Wait until the condition holds (a query that has no value counts as no). Raises CheckFailed."""

    async def make_safe(self) -> None:
        """Ask the guard for the safe state, and wait until it is confirmed. Raises CheckFailed."""

    async def fall_silent(self, seconds: float) -> None:
        """Be a host that hangs for so long."""

    async def kill_guard(self) -> None:
        """Kill the guard's process, and wait until the next one has opened the device."""

    @property
    def latched(self) -> str:
        """Why the device is held in its safe state, '' when it is free."""

    @property
    def confirmed(self) -> bool:
        """Whether it has been seen there."""

    @property
    def moving(self) -> str | None:
        """What it still does there, in its driver's words; '' at rest, None when nobody has said."""


CheckFunction = Callable[[Bench], Awaitable[str]]


@dataclass(frozen=True, slots=True)
class Check:
    """One check; `types` are the device types it is for, none means all."""

    name: str
    run: CheckFunction
    moves: bool
    types: tuple[str, ...] = ()

    def suits(self, device_type: str) -> bool:
        """Whether it is for devices of this type."""
        return not self.types or device_type in self.types


@dataclass(slots=True)
class Kit:
    """The checks of one driver, in the order in which they run."""

    checks: list[Check] = field(default_factory=list)

    def check(
        self, name: str, *, moves: bool, types: Sequence[str] = ()
    ) -> Callable[[CheckFunction], CheckFunction]:
        """Add a coroutine as a check."""

        def add(function: CheckFunction) -> CheckFunction:
            self.checks.append(Check(name, function, moves, tuple(types)))
            return function

        return add


async def refused(bench: Bench, instruction: str, *arguments: object) -> str:
    """The reason for which an instruction is refused. Raises CheckFailed when it is carried out."""
    try:
        await bench.call(instruction, *arguments)
    except DeviceError as error:
        return error.reason
    told = ", ".join(map(str, arguments))
    raise CheckFailed(f"{instruction}({told}) was carried out instead of being refused")


async def held(bench: Bench, bound: float) -> str:
    """Wait until the device is latched, at most `bound` seconds, and has been seen in its safe state; then
    release it. Why it was latched. Raises CheckFailed.
    """
    await bench.until(lambda: bool(bench.latched), bound, "the device to go safe")
    reason = bench.latched
    await bench.until(lambda: bench.confirmed, SAFE, f"'{bench.binding.safe_state}' to be confirmed")
    await bench.call("release")
    return reason


async def cancelled(bench: Bench, begun: Callable[[], bool], instruction: str, *arguments: object) -> str:
    """Cancel an instruction on its way, as soon as `begun` holds; its end, in words.

    What may `never` be cancelled goes on to its end. Anything else ends as its manifest says, within SAFE
    seconds, and leaves the device free; whether it then does what that says the caller looks at. Raises
    CheckFailed, and DeviceError for what fails.
    """
    declared = bench.manifest.device.instruction(instruction)
    assert declared is not None, "a kit knows the instructions of its device"
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
        took = bench.now - start
        if took > SAFE or bench.latched:
            why = f"it is latched because {bench.latched}" if bench.latched else f"that took {took:.1f} s"
            raise CheckFailed(f"{error.reason}; {why}") from None
        return f"{error.reason} after {took:.2f} s"
    if declared.may_be_cancelled:
        raise CheckFailed(f"{instruction}() was cancelled on its way and went on to its end")
    return f"{instruction}() goes on to its end"


async def rested(bench: Bench) -> list[str]:
    """Wait until the device is at rest in its safe state, at most `rest_within`; what was said on the way.

    Raises CheckFailed.
    """
    words, within = list[str](), bench.binding.rest_within

    def at_rest() -> bool:
        if bench.moving and bench.moving not in words:
            words.append(bench.moving)
        return bench.moving == ""

    try:
        await bench.until(at_rest, within, "it to come to rest")
    except CheckFailed:
        last = words[-1] if words else "nothing was said of it"
        raise CheckFailed(f"it was not at rest within {within:g} s: {last}") from None
    return words


@dataclass(frozen=True, slots=True)
class Finding:
    """What became of one check on one device: what was seen, or why it failed or did not run."""

    device: str
    check: str
    outcome: Literal["passed", "failed", "not run"]
    seen: str


async def run_kit(bench: Bench, checks: Iterable[Check], may_move: bool) -> AsyncIterator[Finding]:
    """Run the checks that suit the device one after the other; a failure does not end the run."""
    name = bench.binding.name
    for check in checks:
        if not check.suits(bench.binding.type):
            continue
        if check.moves and not may_move and not bench.binding.is_sensor:
            yield Finding(name, check.name, "not run", "it would move the device, and nobody agreed to that")
            continue
        finding = await _run(bench, check)
        if finding.outcome == "failed" and bench.confirmed:
            # The checks that follow are not to fail for the same reason.
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
    except Exception as error:  # a kit is foreign code, as a driver is
        return Finding(name, check.name, "failed", f"the check itself is broken: {error!r}")
