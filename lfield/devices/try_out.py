"""Tries devices by their driver's conformance kit: each behind a real guard process, as a host has it."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable, Sequence
from typing import Any

from lfield.clock import Clock
from lfield.devices.guards import Guards
from lfield.devices.keeper import Guard
from lfield.driver.binding import DeviceBinding
from lfield.driver.contract import Manifest
from lfield.driver.kit import SAFE, Check, CheckFailed, Finding, run_kit
from lfield.driver.kit_checks import KIT, LAST, endpoint_check
from lfield.driver.plugins import Installed, Plugins
from lfield.errors import DeviceError
from lfield.guard.core import QUIET_BY, SILENCE
from lfield.guard.rest import UNSEEN
from lfield.manifest import DeviceValue
from lfield.vm.world import Pending

#: Seconds between two looks at a condition: telemetry comes 20 times a second at most.
LOOK = 0.02
#: Seconds for a guard to be there again.
BACK = 60.0
#: The name of the finding that a device was not left in its safe state and at rest.
LEFT = "left safe and at rest"


class LiveBench:
    """A Bench (lfield.driver.kit) over the guards of this process."""

    def __init__(
        self,
        guards: Guards,
        binding: DeviceBinding,
        manifest: Manifest,
        notes: list[str],
        *,
        silence: float = SILENCE,
    ) -> None:
        self._guards, self.binding, self.manifest, self.notes = guards, binding, manifest, notes
        self.silence, self.quiet_after = silence, silence + QUIET_BY
        self.given_up = set[str]()
        # As the threads of an agent: each waits for one call.
        self._threads = 0

    @property
    def _guard(self) -> Guard:
        return self._guards.guard_of(self.binding.name)

    @property
    def now(self) -> float:
        """Seconds of the host's clock."""
        return self._guards.clock.monotonic()

    @property
    def identity(self) -> str:
        """Who the device is, in its driver's words."""
        return self._guard.identities[self.binding.name]

    @property
    def guard_pid(self) -> int:
        """The id of its guard's process, 0 while there is none."""
        return self._guard.pid

    @property
    def latched(self) -> str:
        """Why the device is held in its safe state, '' when it is free."""
        return self._guard.held.latched.get(self.binding.name, "")

    @property
    def confirmed(self) -> bool:
        """Whether it has been seen there."""
        return self.binding.name in self._guard.held.confirmed

    @property
    def moving(self) -> str | None:
        """What it still does there; '' when it is at rest, None when nobody has said."""
        told = self._guard.held.moving.get(self.binding.name)
        return told if told != UNSEEN else None

    async def call(self, instruction: str, *arguments: object) -> Any:
        """Carry an instruction out and return its result. Raises DeviceError."""
        value = self._guards.query(self.binding.agent, self.binding.field, instruction)
        if not isinstance(value, Pending):
            return value
        return await self._begin(instruction, arguments)

    async def give_up(self, begun: Callable[[], bool], instruction: str, *arguments: object) -> Any:
        """Begin an instruction, cancel it as soon as `begun` holds, and wait for its end; its result."""
        answer = self._begin(instruction, arguments)
        thread = self._threads
        await self.until(lambda: answer.done() or begun(), SAFE, f"{instruction}() to be under way")
        if answer.done():
            await answer
            raise CheckFailed(f"{instruction}() was done before it could be cancelled")
        self._guards.cancel(self.binding.agent, thread)
        self.given_up.add(instruction)
        return await answer

    def _begin(self, instruction: str, arguments: Sequence[object]) -> asyncio.Future[DeviceValue]:
        answer: asyncio.Future[DeviceValue] = asyncio.get_running_loop().create_future()

        def answered(value: DeviceValue | DeviceError) -> None:
            if answer.done():
                return
            if isinstance(value, DeviceError):
                answer.set_exception(value)
            else:
                answer.set_result(value)

        self._threads += 1
        agent, field, thread = self.binding.agent, self.binding.field, self._threads
        self._guards.call(agent, field, instruction, list(arguments), answered, thread=thread)
        return answer

    def query(self, quantity: str) -> Any:
        """The present value of a telemetry quantity. Raises DeviceError when there is none."""
        return self._guard.snapshots.query(self.binding.name, quantity)

    async def until(self, condition: Callable[[], bool], bound: float, what: str) -> None:
        """Wait until the condition holds. Raises CheckFailed."""
        end = self.now + bound
        while not _holds(condition):
            if self.now >= end:
                raise CheckFailed(f"waited {bound:g} s for {what}")
            await asyncio.sleep(LOOK)

    async def make_safe(self) -> None:
        """Ask the guard for the safe state, and wait until it is confirmed. Raises CheckFailed."""
        self._guard.make_safe(self.binding.name, "the conformance kit asked for it")
        await self.until(lambda: self.confirmed, SAFE, f"'{self.binding.safe_state}' to be confirmed")

    async def fall_silent(self, seconds: float) -> None:
        """Be a host that hangs for so long."""
        await self._guard.fall_silent(seconds)

    async def kill_guard(self) -> None:
        """Kill the guard's process, and wait until the next one has opened the device."""
        self._guard.kill()
        await self.until(lambda: not self._guard.ready, 5.0, "the guard to be gone")
        await self.until(lambda: self._guard.ready, BACK, "the guard to be there again")


def _holds(condition: Callable[[], bool]) -> bool:
    try:
        return condition()
    except DeviceError:
        return False


def checks_of(installed: Installed) -> list[Check]:
    """What every driver must pass, the driver's own checks, and what those have left. Raises PluginError."""
    own: Any = installed.plugin.load_kit() if installed.plugin.kit else None
    endpoint = [endpoint_check(installed.plugin)] if installed.plugin.endpoint else []
    return [*endpoint, *KIT.checks, *(own.checks if own is not None else ()), *LAST.checks]


async def try_devices(
    plugins: Plugins,
    devices: Sequence[DeviceBinding],
    checks: Iterable[Check],
    may_move: bool,
    show: Callable[[Finding], None],
    *,
    clock: Clock,
    silence: float = SILENCE,
) -> list[Finding]:
    """Run the checks on one device after the other, and show each finding as it is made.

    The last is of LEFT: each device that was not seen at rest in its safe state in the end. `clock` is that
    of this host, and `silence` how long it may be silent, in seconds. Raises DevicesError when a device
    cannot be opened.
    """
    checks, notes, findings = list(checks), list[str](), list[Finding]()
    guards = Guards(plugins, clock, notes.append, silence=silence)
    await guards.open(devices)
    try:
        for device in devices:
            manifest = plugins.by_driver[device.driver].manifests[device.type]
            bench = LiveBench(guards, device, manifest, notes, silence=silence)
            async for finding in run_kit(bench, checks, may_move):
                findings.append(finding)
                show(finding)
    finally:
        for name, why in (await guards.close()).items():
            findings.append(Finding(name, LEFT, "failed", why))
            show(findings[-1])
    return findings
