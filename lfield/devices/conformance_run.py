"""Runs a driver's conformance kit on devices, each behind a real guard process."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable, Sequence
from typing import Any

from lfield.clock import Clock
from lfield.devices.device_guards import DeviceGuards
from lfield.devices.guard_process import GuardProcess
from lfield.driver.binding import DeviceBinding
from lfield.driver.contract import Manifest
from lfield.driver.kit import SAFE, Check, CheckFailed, Finding, run_kit
from lfield.driver.plugins import InstalledPlugin, Plugins
from lfield.driver.standard_checks import KIT, LAST, endpoint_check
from lfield.errors import DeviceError
from lfield.guard.core import HOST_TIMEOUT, MUTE_AFTER
from lfield.guard.standstill import UNCONFIRMED
from lfield.manifest import DeviceValue
from lfield.vm.host_interface import Pending

#: Seconds between two checks of a condition: telemetry arrives at most 20 times a second.
POLL_INTERVAL = 0.02
#: Seconds for a guard to restart.
RESTART_TIMEOUT = 60.0
#: Name of the finding of a device that was not left in its safe state and at rest.
END_CHECK = "left safe and at rest"


class LiveBench:
    """A Bench (lfield.driver.kit) over the guards of this process."""

    def __init__(
        self,
        guards: DeviceGuards,
        binding: DeviceBinding,
        manifest: Manifest,
        notes: list[str],
        *,
        silence: float = HOST_TIMEOUT,
    ) -> None:
        self._guards, self.binding, self.manifest, self.notes = guards, binding, manifest, notes
        self.silence, self.quiet_after = silence, silence + MUTE_AFTER
        self.given_up = set[str]()
        # Thread ids, like those of an agent: each thread waits for one call.
        self._threads = 0

    @property
    def _guard(self) -> GuardProcess:
        return self._guards.guard_of(self.binding.name)

    @property
    def now(self) -> float:
        """Seconds of the host's clock."""
        return self._guards.clock.monotonic()

    @property
    def identity(self) -> str:
        """The identity of the device, as reported by its driver."""
        return self._guard.identities[self.binding.name]

    @property
    def guard_pid(self) -> int:
        """The process id of the guard, 0 without one."""
        return self._guard.pid

    @property
    def latched(self) -> str:
        """The reason why the device is latched in its safe state, '' when it is not."""
        return self._guard.latched_devices.latched.get(self.binding.name, "")

    @property
    def confirmed(self) -> bool:
        """Whether the safe state is confirmed."""
        return self.binding.name in self._guard.latched_devices.confirmed

    @property
    def moving(self) -> str | None:
        """The remaining motion of the device in its safe state; '' at rest, None when unknown."""
        motion = self._guard.latched_devices.moving.get(self.binding.name)
        return motion if motion != UNCONFIRMED else None

    async def call(self, instruction: str, *arguments: object) -> Any:
        """Executes an instruction and returns its result. Raises DeviceError."""
        value = self._guards.query(self.binding.agent, self.binding.field, instruction)
        if not isinstance(value, Pending):
            return value
        return await self._start(instruction, arguments)

    async def give_up(self, begun: Callable[[], bool], instruction: str, *arguments: object) -> Any:
        """Starts an instruction, cancels it as soon as `begun` holds, and waits for its end; returns its
        result.
        """
        answer = self._start(instruction, arguments)
        thread = self._threads
        await self.until(lambda: answer.done() or begun(), SAFE, f"{instruction}() to be running")
        if answer.done():
            await answer
            raise CheckFailed(f"{instruction}() was done before it could be cancelled")
        self._guards.cancel(self.binding.agent, thread)
        self.given_up.add(instruction)
        return await answer

    def _start(self, instruction: str, arguments: Sequence[object]) -> asyncio.Future[DeviceValue]:
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
        """Waits until the condition holds. Raises CheckFailed."""
        end = self.now + bound
        while not _holds(condition):
            if self.now >= end:
                raise CheckFailed(f"waited {bound:g} s for {what}")
            await asyncio.sleep(POLL_INTERVAL)

    async def make_safe(self) -> None:
        """Requests the safe state and waits until it is confirmed. Raises CheckFailed."""
        self._guard.make_safe(self.binding.name, "the conformance kit requested it")
        await self.until(lambda: self.confirmed, SAFE, f"'{self.binding.safe_state}' to be confirmed")

    async def fall_silent(self, seconds: float) -> None:
        """Stops the host's heartbeats for `seconds` seconds."""
        await self._guard.stop_heartbeats(seconds)

    async def kill_guard(self) -> None:
        """Kills the guard process and waits until its successor has opened the device."""
        self._guard.kill()
        await self.until(lambda: not self._guard.ready, 5.0, "the guard to end")
        await self.until(lambda: self._guard.ready, RESTART_TIMEOUT, "the guard to be available again")


def _holds(condition: Callable[[], bool]) -> bool:
    try:
        return condition()
    except DeviceError:
        return False


def conformance_checks(installed: InstalledPlugin) -> list[Check]:
    """The checks of every driver, the driver's own, and a final check. Raises PluginError."""
    own: Any = installed.plugin.load_kit() if installed.plugin.kit else None
    endpoint = [endpoint_check(installed.plugin)] if installed.plugin.endpoint else []
    return [*endpoint, *KIT.checks, *(own.checks if own is not None else ()), *LAST.checks]


async def run_conformance(
    plugins: Plugins,
    devices: Sequence[DeviceBinding],
    checks: Iterable[Check],
    may_move: bool,
    show: Callable[[Finding], None],
    *,
    clock: Clock,
    silence: float = HOST_TIMEOUT,
) -> list[Finding]:
    """Runs the checks on one device after the other, and shows each finding as it is made.

    The last finding is END_CHECK: each device that was not at rest in its safe state at the end. `clock` is
    the clock of this host, `silence` its time-out in seconds. Raises DevicesError when a device cannot be
    opened.
    """
    checks, notes, findings = list(checks), list[str](), list[Finding]()
    guards = DeviceGuards(plugins, clock, notes.append, silence=silence)
    await guards.open(devices)
    try:
        for device in devices:
            manifest = plugins.by_driver[device.driver].manifests[device.type]
            bench = LiveBench(guards, device, manifest, notes, silence=silence)
            async for finding in run_kit(bench, checks, may_move):
                findings.append(finding)
                show(finding)
    finally:
        for name, reason in (await guards.close()).items():
            findings.append(Finding(name, END_CHECK, "failed", reason))
            show(findings[-1])
    return findings
