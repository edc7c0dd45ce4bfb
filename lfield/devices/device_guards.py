"""All devices of one host: a guard process per bus, and simulated devices in simulated missions."""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from lfield import event_loop
from lfield.capability.directory.directory_delta import Unavailability
from lfield.clock import Clock
from lfield.devices.fake_processes import FakeProcess, bind_to_fakes
from lfield.devices.guard_process import GuardProcess
from lfield.devices.latched_devices import OnLatchEvent
from lfield.devices.pending_device_calls import OnDeviceAnswer
from lfield.devices.scheduling_jitter import JitterLimit, JitterMonitor
from lfield.driver.binding import DeviceBinding, by_bus
from lfield.driver.contract import RELEASE
from lfield.driver.driver_index import DriverLookup
from lfield.errors import DeviceError, DevicesError, OutputFileError
from lfield.guard.core import HOST_TIMEOUT
from lfield.guard.messages import NO_RECORDING, GuardRecording
from lfield.manifest import DeviceManifest, DeviceValue, Instruction, Observation
from lfield.recording.folders import guard_folder
from lfield.text.log_messages import LogLine
from lfield.text.secure_files import private_folder
from lfield.vm.engine_interface import Reading
from lfield.vm.host_interface import PENDING, Pending

#: Seconds for every device to confirm its safe state after an emergency stop.
STOP_TIMEOUT = 5.0


class DeviceGuards:
    """The devices of some agents, by `drivers` that are known. `note` takes a log line.

    `silence` is the time in seconds without a heartbeat of this host after which its devices are made safe.
    Before each heartbeat `has_progressed` runs the host for one turn and returns whether this was possible; a
    blocked host sends no heartbeat. `on_event` receives changes of the safe states of devices, `on_lock_out`
    each device that its driver has locked out until it is inspected, with the reason.
    """

    def __init__(
        self,
        drivers: DriverLookup,
        clock: Clock,
        note: Callable[[LogLine], None],
        *,
        silence: float = HOST_TIMEOUT,
        has_progressed: Callable[[], bool] = lambda: True,
        on_event: OnLatchEvent = lambda event: None,
        on_lock_out: Callable[[str, str], None] = lambda device, reason: None,
    ) -> None:
        self._drivers, self.clock, self._note = drivers, clock, note
        #: Scheduling jitter of the heartbeats to the guards.
        self.lateness = JitterMonitor(JitterLimit(silence, event_loop.may_raise_timer_priority()))
        self._has_progressed = has_progressed
        self.on_event, self.on_lock_out = on_event, on_lock_out
        self._guards: list[GuardProcess] = []
        #: The reason why programs may not release devices, '' while they may; also for devices opened later.
        self._inhibit_reason = ""
        #: A future for each running emergency stop; several may run at the same time.
        self._stopping: list[asyncio.Event] = []
        self._fakes: list[FakeProcess] = []
        #: The problems of opening that `lfield setup` would solve.
        self._not_set_up: list[str] = []
        #: The result of `close`, also when not all devices could be opened.
        self._unsafe: dict[str, str] = {}
        self._by_device: dict[str, tuple[GuardProcess, DeviceManifest]] = {}

    async def open(self, devices: Sequence[DeviceBinding], recording: GuardRecording = NO_RECORDING) -> None:
        """Opens all devices concurrently. Raises DevicesError with all problems; then all are closed again.

        The folder of `recording` exists; the guards share its limit.
        """
        problems: list[str] = []
        try:
            await self._open(devices, problems, recording)
        except BaseException:
            await self.close()
            raise
        if problems:
            await self.close()
            raise DevicesError(problems, self._not_set_up)

    async def _open(
        self, devices: Sequence[DeviceBinding], problems: list[str], recording: GuardRecording
    ) -> None:
        problems += _shared_ports(devices)
        placed = await bind_to_fakes(devices, self._fakes, problems) if not problems else []
        if problems:
            return
        buses = by_bus(placed)
        limit = recording.limit // max(1, len(buses))
        for bus in buses.values():
            driver = self._drivers.by_driver[bus[0].driver]
            files = _recording_of(bus, recording, limit)
            guard = GuardProcess(
                driver, bus, self.clock, self._note, self.lateness, self._has_progressed, files
            )
            guard.latched_devices.inhibit(self._inhibit_reason)
            guard.latched_devices.set_event_handlers(self.on_event, self.on_lock_out, self._on_latch_change)
            self._guards.append(guard)
            self._by_device.update(
                {device.name: (guard, driver.manifests[device.type].device) for device in bus}
            )
        for answer in await asyncio.gather(*(g.open() for g in self._guards), return_exceptions=True):
            if isinstance(answer, DevicesError):
                problems.extend(answer.problems)
                self._not_set_up.extend(answer.not_set_up)
            elif isinstance(answer, BaseException):
                raise answer

    def query(self, agent: str, field: str, instruction: str) -> DeviceValue | Pending:
        """The value of a query, PENDING for a query that the device itself must answer (`call`).

        Raises DeviceError for an unknown device or instruction, or without a fresh value.
        """
        guard, declared = self._declared(agent, field, instruction)
        if declared.is_query:
            return guard.snapshots.query(f"{agent}.{field}", instruction)
        return PENDING

    def call(
        self,
        agent: str,
        field: str,
        instruction: str,
        arguments: Sequence[Any],
        answered: OnDeviceAnswer,
        until: float = math.inf,
        thread: int = 0,
    ) -> None:
        """Executes an instruction that is not a query; `answered` is called once, from the loop.

        An instruction that acts starts before `until` (seconds of the host's clock) and within the device's
        `ttl`, or not at all. `thread` of the agent waits for it and identifies it for `cancel`; a thread
        waits for one call at a time. Raises DeviceError if the instruction cannot be attempted.
        """
        guard, declared = self._declared(agent, field, instruction)
        guard.call(f"{agent}.{field}", declared, arguments, answered, until, thread)

    def cancel(self, agent: str, thread: int) -> bool:
        """Cancels the call that a thread of an agent waits for; returns whether it can be cancelled.

        True: the answer follows once, as for every call: a DeviceError of kind CancelledException when the
        device has executed the action that its manifest defines for a cancel, or could not execute it; the
        result, if it was already sent; or the error of a guard that died. False: no call is running, or the
        call may not be cancelled and runs to its end. Cancelling is idempotent.
        """
        return any(guard.cancel(agent, thread) for guard in self._guards)

    def may_be_cancelled(self, agent: str, field: str, instruction: str) -> bool:
        """Whether a call of this instruction can be cancelled; False for a device that is not open here."""
        found = self._by_device.get(f"{agent}.{field}")
        declared = found[1].instruction(instruction) if found else None
        return declared is not None and declared.may_be_cancelled

    def _declared(self, agent: str, field: str, instruction: str) -> tuple[GuardProcess, Instruction]:
        found = self._by_device.get(f"{agent}.{field}")
        if found is None:
            raise DeviceError(field, "is not open on this host")
        guard, manifest = found
        declared = manifest.instruction(instruction)
        if declared is None:
            raise DeviceError(field, f"has no instruction '{instruction}'")
        return guard, declared

    def reading(self, agent: str, field: str, quantity: str) -> Reading | None:
        """The reading of a telemetry quantity, None if it is not a plain quantity."""
        return self.guard_of(f"{agent}.{field}").snapshots.reading(f"{agent}.{field}", quantity)

    def last(self, device: str, quantity: str) -> Observation | None:
        """The last value of a telemetry quantity of any age; None before the first."""
        found = self._by_device.get(device)
        return found[0].snapshots.last(device, quantity) if found else None

    def unavailability(self, device: str) -> Unavailability | None:
        """The reason why a device cannot be called now, None when it can."""
        found = self._by_device.get(device)
        if found is None:
            return Unavailability(f"{device}: not open on this host")
        return found[0].unavailability(device)

    def make_safe(self, device: str, reason: str, state: str) -> None:
        """Brings a device into a safe state of its manifest, from which the program may release it.

        Without effect if the devices are closed.
        """
        if found := self._by_device.get(device):
            found[0].make_safe(device, reason, state)

    def guard_of(self, device: str) -> GuardProcess:
        """The guard of a device by its name."""
        return self._by_device[device][0]

    def inhibit(self, reason: str) -> None:
        """Brings every device into its safe state; no program may release it before `clear_emergency_stop`.

        Devices opened later are inhibited from the start.
        """
        self._inhibit_reason = reason
        for guard in self._guards:
            guard.inhibit(reason)

    async def emergency_stop(self, reason: str) -> dict[str, str]:
        """As `inhibit`; returns the result of `await_safe_states`."""
        self.inhibit(reason)
        return await self.await_safe_states()

    async def enter_safe_state(self, reason: str) -> dict[str, str]:
        """As `emergency_stop`, but programs may release the devices, and so does `release_held` with the same
        reason.
        """
        for guard in self._guards:
            for name in guard.actuated_devices:
                guard.make_safe(name, reason)
        return await self.await_safe_states()

    async def release_held(self, reason: str) -> dict[str, str]:
        """Releases the devices held for `reason`; returns for each actuator the reason why it stays held, or
        ''.
        """
        table: dict[str, str] = {}
        for guard in self._guards:
            for name in guard.actuated_devices:
                devices = guard.latched_devices
                held = devices.latched.get(name, "")
                blocked = devices.blocking_reason or devices.locked_out.get(name, "")
                table[name] = blocked or (held if held != reason else "")
                if held and not table[name]:
                    table[name] = await self._release(name)
        return table

    async def _release(self, name: str) -> str:
        """The reason why a device could not be released, '' when it is."""
        answered: asyncio.Future[DeviceValue | DeviceError] = asyncio.get_running_loop().create_future()
        agent, _, field = name.rpartition(".")

        def on_answer(value: DeviceValue | DeviceError) -> None:
            if not answered.done():
                answered.set_result(value)

        try:
            self.call(agent, field, RELEASE.name, (), on_answer)
            async with asyncio.timeout(STOP_TIMEOUT):
                value = await answered
        except (DeviceError, TimeoutError) as error:
            return str(error) or "it does not answer"
        return str(value) if isinstance(value, DeviceError) else ""

    async def await_safe_states(self) -> dict[str, str]:
        """For every device '' if it has confirmed its safe state within STOP_TIMEOUT, otherwise the
        reason.
        """
        changed = asyncio.Event()
        self._stopping.append(changed)
        try:
            async with asyncio.timeout(STOP_TIMEOUT):
                while not all(_is_confirmed(guard) for guard in self._guards):
                    changed.clear()
                    await changed.wait()
        except TimeoutError:
            pass
        finally:
            self._stopping.remove(changed)
        return {name: _unconfirmed(guard, name) for guard in self._guards for name in guard.actuated_devices}

    def _on_latch_change(self) -> None:
        for changed in self._stopping:
            changed.set()

    def clear_emergency_stop(self) -> dict[str, str]:
        """Permits programs to release their devices; returns the table of `await_safe_states`, all ''."""
        self._inhibit_reason = ""
        for guard in self._guards:
            guard.allow_release()
        return {name: "" for guard in self._guards for name in guard.actuated_devices}

    @property
    def latched(self) -> Mapping[str, str]:
        """The reason why devices are latched in their safe states, by device name."""
        return {
            name: reason for guard in self._guards for name, reason in guard.latched_devices.latched.items()
        }

    @property
    def moving(self) -> Mapping[str, str]:
        """The remaining motion of latched devices in their safe states, by device name; '' at rest."""
        return {
            name: motion for guard in self._guards for name, motion in guard.latched_devices.moving.items()
        }

    @property
    def last_contact(self) -> Mapping[str, float]:
        """The time of the last message of each device, on the monotonic clock; absent before it."""
        return {name: when for guard in self._guards for name, when in guard.snapshots.last_contact.items()}

    @property
    def telemetry(self) -> Mapping[str, Mapping[str, DeviceValue]]:
        """The last known values, by device and quantity."""
        return {name: values for guard in self._guards for name, values in guard.snapshots.telemetry.items()}

    async def close(self) -> dict[str, str]:
        """Makes every device safe, ends the guards when all are at rest, then the simulated devices.

        Returns the devices that were not confirmed at rest, with their last known condition, which can still
        be queried. The wait is bounded by their `rest_within`; `stop_waiting` shortens it.
        """
        ends = await asyncio.gather(*(self._close(guard) for guard in self._guards))
        await asyncio.gather(*(fake.stop() for fake in self._fakes))
        self._fakes, self._by_device = [], {}
        for end in ends:
            self._unsafe |= end
        return self._unsafe

    async def _close(self, guard: GuardProcess) -> dict[str, str]:
        unsafe = await guard.close()
        guard.latched_devices.moving.update(
            {name: "" for name in guard.actuated_devices if name not in unsafe}
        )
        return {name: f"{reason}; {guard.snapshots.describe(name)}" for name, reason in unsafe.items()}

    def stop_waiting(self) -> None:
        """Stops waiting for devices; `close` then ends and reports the devices that are not at rest."""
        for guard in self._guards:
            guard.stop_waiting()


def _recording_of(bus: Sequence[DeviceBinding], recording: GuardRecording, limit: int) -> GuardRecording:
    """The recording of the guard of a bus, in a folder of its own, so that its driver cannot remove other
    files.
    """
    if not recording.folder:
        return recording
    folder = guard_folder(Path(recording.folder), bus[0].name)
    # The guard reports a folder that it cannot use.
    with contextlib.suppress(OutputFileError):
        private_folder(folder)
    return GuardRecording(str(folder), limit, recording.run)


def _is_confirmed(guard: GuardProcess) -> bool:
    """Whether all devices of a guard have confirmed their safe states."""
    return guard.latched_devices.confirmed.issuperset(guard.actuated_devices)


def _unconfirmed(guard: GuardProcess, name: str) -> str:
    """The reason why an emergency stop is not confirmed for a device; '' when it is."""
    if name not in guard.latched_devices.confirmed:
        return f"its safe state was not confirmed in {STOP_TIMEOUT:g} s"
    if guard.snapshots.silent_since(name) is not None:
        return f"it was in its safe state before, but no longer responds; {guard.snapshots.describe(name)}"
    return ""


def _shared_ports(devices: Sequence[DeviceBinding]) -> list[str]:
    """Problems of devices of different drivers on one port, which would receive each other's bytes."""
    first: dict[str, DeviceBinding] = {}
    return [
        f"{other.name} and {device.name} are both at {device.endpoint}, with the drivers '{other.driver}' "
        f"and '{device.driver}': a port can have only one driver"
        for device in devices
        if (other := first.setdefault(device.endpoint, device)).driver != device.driver
    ]
