"""The host's side of one guard process: starts it, sends heartbeats and calls, receives telemetry, restarts
it.
"""

from __future__ import annotations

import asyncio
import math
import sys
from collections.abc import Callable, Sequence
from typing import Any, cast

from lfield.capability.directory.directory_delta import Unavailability
from lfield.clock import Clock
from lfield.devices.latched_devices import LatchedDevices
from lfield.devices.pending_device_calls import OnDeviceAnswer, PendingDeviceCalls
from lfield.devices.scheduling_jitter import HEARTBEAT_INTERVAL, HeartbeatJitter, JitterMonitor
from lfield.devices.telemetry_snapshots import Snapshots
from lfield.driver.binding import DeviceBinding, longest_rest
from lfield.driver.device import NOT_SET_UP
from lfield.driver.driver_index import DriverInfo
from lfield.errors import DeviceError, DevicesError, WireError
from lfield.event_loop import kill, report_exception, spawn, start_process
from lfield.guard.messages import (
    NO_RECORDING,
    Beat,
    CallDone,
    ClearStop,
    DevicesOpened,
    GuardMessage,
    GuardRecording,
    Latched,
    LockedOut,
    MessageReader,
    Moving,
    Note,
    OpenDevices,
    OpenFailed,
    Refused,
    Released,
    RequestSafeState,
    Stop,
    Stopped,
    TelemetrySnapshot,
    encode,
)
from lfield.guard.standstill import UNCONFIRMED, UNFINISHED
from lfield.manifest import Instruction
from lfield.text import log_messages
from lfield.text.log_messages import LogLine

#: Heartbeats without an answer after which the guard counts as hung. The limit counts heartbeats, so that a
#: host that was itself stopped does not regard its guards as hung.
MAX_UNANSWERED = 60
#: Seconds for a guard to open its devices; seconds to end, in addition to the time of its devices.
OPEN_TIMEOUT, STOP_TIMEOUT = 60.0, 5.0
#: Seconds for a guard to end without waiting for its devices.
AT_ONCE_TIMEOUT = 1.0
#: Seconds before a guard that died is restarted: after an early death, and the maximum. A guard that ran
#: longer is restarted at once: an autopilot's failsafe waits no more than 2 s.
FIRST_RESTART_DELAY, MAX_RESTART_DELAY = 0.2, 5.0

#: The reason why devices are made safe in an orderly stop of the host.
STOPPING = "the host is stopping"


def restart_delay(lived: float) -> float:
    """Seconds until the restart of a guard that died `lived` seconds after it was ready."""
    return 0.0 if lived > MAX_RESTART_DELAY else FIRST_RESTART_DELAY


class GuardProcess(asyncio.SubprocessProtocol):
    """The guard of one bus. `note` takes a log line; the guard's host time-out is `lateness.limit`.

    A heartbeat is sent only when `has_progressed` returns that the host has run a turn. Its jitter is
    reported to `lateness`.
    """

    def __init__(
        self,
        driver: DriverInfo,
        devices: Sequence[DeviceBinding],
        clock: Clock,
        note: Callable[[LogLine], None],
        lateness: JitterMonitor,
        has_progressed: Callable[[], bool],
        recording: GuardRecording = NO_RECORDING,
    ) -> None:
        self._driver = driver.for_types({device.type for device in devices})
        self._clock, self._note = clock, note
        self._silence, self._heartbeats = lateness.limit.silence, HeartbeatJitter(lateness)
        self._has_progressed, self._recording = has_progressed, recording
        self._devices = {device.name: device for device in devices}
        self._label = ", ".join(self._devices)
        self.snapshots = Snapshots(driver, devices, clock)
        self._reader = MessageReader()
        self._transport: asyncio.SubprocessTransport | None = None
        self._pipe: asyncio.WriteTransport | None = None
        self._heartbeat_timer: asyncio.TimerHandle | None = None
        self._restarting: asyncio.Task[None] | None = None
        self._opening: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._exited = asyncio.Event()
        # Set when the devices are open or will never be open; and set when this guard has ended.
        self._settled, self._over = asyncio.Event(), asyncio.Event()
        self._ready = self._stopping = self._is_at_once = self._has_sent_data = False
        self._unanswered, self._ready_at, self._open_reason = 0, -math.inf, ""
        self._calls = PendingDeviceCalls()
        self._unsafe: dict[str, str] | None = None
        #: The devices that are latched in a safe state, and the reasons.
        self.latched_devices = LatchedDevices(self._devices, clock, note, self._heartbeats)
        #: Identities of the devices as reported by their drivers, once they are open.
        self.identities: dict[str, str] = {}

    # -- life cycle -----------------------------------------------------------------------------------

    async def open(self, latched: str = "") -> None:
        """Starts the process and opens the devices. Raises DevicesError with all problems."""
        self._opening = asyncio.get_running_loop().create_future()
        self._exited, self._reader, self._open_reason = asyncio.Event(), MessageReader(), latched
        guard = (sys.executable, "-P", "-m", "lfield.guard.process", self._driver.reference)
        try:
            await start_process(self, *guard)
        except OSError as error:
            raise DevicesError([f"the driver's process does not start: {error.strerror or error}"]) from None
        except asyncio.CancelledError:
            self._opening.cancel()  # otherwise the end of the process is an exception that nothing handles
            raise
        self._heartbeats.pause()
        self._send_heartbeat()
        try:
            async with asyncio.timeout(OPEN_TIMEOUT):
                await self._opening
        except (TimeoutError, DevicesError) as error:
            self.kill()
            await self._exited.wait()
            if isinstance(error, DevicesError):
                raise
            raise DevicesError([f"the driver did not open its devices within {OPEN_TIMEOUT:g} s"]) from None
        for request in self.latched_devices.pending_requests():
            self._send(request)
        for name, identity in self.identities.items():
            endpoint = self._devices[name].endpoint
            self._note(log_messages.DEVICE_OPENED.line(device=name, identity=identity, endpoint=endpoint))

    async def close(self) -> dict[str, str]:
        """Makes the devices safe, and ends the process when they are at rest.

        Returns the devices not confirmed at rest, with their last known condition. A guard that dies during
        this time is restarted. Bounded by `rest_within` of its devices; `stop_waiting` shortens it.
        """
        self._stopping = True
        self.latched_devices.on_stop()
        if self._transport is None and self._restarting is None:
            return {}
        self._send(Stop(STOPPING))
        try:
            async with asyncio.timeout(STOP_TIMEOUT):
                await self._settled.wait()
            async with asyncio.timeout(longest_rest(self._devices.values()) + STOP_TIMEOUT):
                await self._over.wait()
        except TimeoutError:
            self._abandon()
            await self._exited.wait()
        return self._unsafe_devices()

    def stop_waiting(self) -> None:
        """Stops waiting for the devices; the devices not at rest are reported."""
        self._is_at_once = True
        self._send(Stop(STOPPING, at_once=True))
        asyncio.get_running_loop().call_later(AT_ONCE_TIMEOUT, self._abandon)

    def _abandon(self) -> None:
        self._is_at_once = True
        if self._restarting is not None:
            self._restarting.cancel()
        self.kill()
        if self._transport is None:
            self._exited.set()
            self._over.set()

    def _unsafe_devices(self) -> dict[str, str]:
        if self._unsafe is not None:
            return self._unsafe
        if not self.identities:
            return dict.fromkeys(self.actuated_devices, UNFINISHED) if self._has_sent_data else {}
        motions = {name: self.latched_devices.moving.get(name, UNCONFIRMED) for name in self.actuated_devices}
        return {name: f"{motion}, and its guard has ended" for name, motion in motions.items() if motion}

    def kill(self) -> None:
        """Kills the process; the next process makes the devices safe, unless the guard is closing."""
        if self._transport is not None:
            kill(self._transport)

    def _send_heartbeat(self) -> None:
        if self._pipe is None or self._pipe.is_closing() or not self._has_progressed():
            return
        self._unanswered += 1
        if self._ready and self._unanswered > MAX_UNANSWERED:
            self._note(log_messages.GUARD_HANGS.line(bus=self._label))
            self.kill()
        now = self._clock.monotonic()
        if self._ready and (warning := self._heartbeats.on_heartbeat(now)):
            self._note(warning)
        self._send(Beat(now))
        self._heartbeat_timer = asyncio.get_running_loop().call_later(
            HEARTBEAT_INTERVAL, self._send_heartbeat
        )

    async def _restart(self) -> None:
        """Restarts the process until it works; its devices start in their safe states."""
        pause = restart_delay(self._clock.monotonic() - self._ready_at)
        while True:
            await asyncio.sleep(pause)
            try:
                await self.open("its guard died and was restarted")
                if self._stopping:
                    self._send(Stop(STOPPING, at_once=self._is_at_once))
                return
            except DevicesError as error:
                pause = min(max(2 * pause, FIRST_RESTART_DELAY), MAX_RESTART_DELAY)
                self._note(log_messages.GUARD_RESTART_FAILED.line(bus=self._label, reason=error))

    def make_safe(self, device: str, reason: str, state: str = "") -> None:
        """Brings a device into a safe state, from which the program may release it.

        A guard that is restarting receives the request when it is ready.
        """
        self._send(self.latched_devices.request_safe(device, reason, state))

    async def stop_heartbeats(self, seconds: float) -> None:
        """Sends no heartbeat for `seconds` seconds, like a host that hangs."""
        if self._heartbeat_timer is not None:
            self._heartbeat_timer.cancel()
        self._heartbeats.pause()
        await asyncio.sleep(seconds)
        self._send_heartbeat()

    def inhibit(self, reason: str) -> None:
        """Brings every device into its safe state and prevents the program from releasing it.

        A guard that is restarting receives the request when it is ready.
        """
        self.latched_devices.inhibit(reason)
        self._send(RequestSafeState("", reason, lock=True))

    def allow_release(self) -> None:
        """Permits the program to release the devices."""
        self.latched_devices.inhibit("")
        self.latched_devices.locked_out.clear()
        self._send(ClearStop())

    # -- calls and queries ----------------------------------------------------------------------------

    def call(
        self,
        device: str,
        instruction: Instruction,
        arguments: Sequence[Any],
        answered: OnDeviceAnswer,
        until: float = math.inf,
        thread: int = 0,
    ) -> None:
        """Executes an instruction; `answered` is called once, from the loop.

        An instruction that acts starts before `until` (seconds of the host's clock) and within the device's
        `ttl`. `thread` of the device's agent waits for it.
        """
        binding = self._devices[device]
        if not self._ready:
            raise DeviceError(binding.field, "its guard has died and is restarting")
        now = self._clock.monotonic()
        self._send(self._calls.start(binding, instruction, arguments, answered, now, until, thread))

    def cancel(self, agent: str, thread: int) -> bool:
        """Cancels the call that a thread of an agent waits for, as `DeviceGuards.cancel`."""
        cancel = self._calls.cancel(agent, thread, self._clock.monotonic())
        if cancel is not None:
            self._send(cancel)
        return cancel is not None

    @property
    def pid(self) -> int:
        """The process id, 0 without a process."""
        return (self._transport.get_pid() if self._transport is not None else 0) or 0

    @property
    def ready(self) -> bool:
        """Whether the devices are open."""
        return self._ready

    def unavailability(self, device: str) -> Unavailability | None:
        """The reason why the device cannot be called now; None when it can."""
        binding = self._devices[device]
        if not self._ready:
            return Unavailability(f"{binding.field}: its guard has died and is restarting")
        if reason := self.latched_devices.latched.get(device):
            return Unavailability(
                f"{binding.field}: in its safe state {self.latched_devices.state(device)}: {reason}"
            )
        lost = self.snapshots.silent_since(device)
        return None if lost is None else Unavailability(f"{binding.field}: no message", lost)

    @property
    def actuated_devices(self) -> tuple[str, ...]:
        """The devices of this bus with a safe state: all except pure sensors."""
        return tuple(name for name, device in self._devices.items() if not device.is_sensor)

    # -- the process ----------------------------------------------------------------------------------

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """The process has started."""
        # Casts, since uvloop's transports have these methods but not these base classes.
        self._transport = cast("asyncio.SubprocessTransport", transport)
        self._pipe = cast("asyncio.WriteTransport", self._transport.get_pipe_transport(0))
        # This is the first message, also when another task stops this guard while `open` waits for the
        # process: a guard that received `Stop` first would end without making its devices safe.
        devices, foreign_controlled = list(self._devices.values()), sorted(self.snapshots.foreign_controlled)
        opening = self._open_reason, self._silence, self._driver, foreign_controlled
        self._send(OpenDevices(devices, *opening, self._recording))

    def pipe_data_received(self, fd: int, data: bytes) -> None:
        """Messages of the guard."""
        self._unanswered, self._has_sent_data = 0, True
        try:
            for message in self._reader.feed(data):
                self._receive(message)
        except WireError as error:
            self._note(log_messages.GUARD_PROTOCOL.line(bus=self._label, reason=error))
            self.kill()
        except Exception as error:
            report_exception(error)

    def connection_lost(self, exc: Exception | None) -> None:
        """The guard has ended and all its output was read; it is restarted unless it was stopped."""
        assert self._transport is not None
        status = self._transport.get_returncode()
        self._transport.close()
        self._transport = self._pipe = None
        if self._heartbeat_timer is not None:
            self._heartbeat_timer.cancel()
        was_ready, self._ready = self._ready, False
        if was_ready and self._stopping and status == 0:
            self._unsafe = {}  # The last message of the guard may be lost when it is out of memory.
        self._exited.set()
        if not self._opening.done():
            self._opening.set_exception(DevicesError([f"the driver's process ended with status {status}"]))
        self._calls.on_guard_lost(status)
        if self._unsafe is not None or self._is_at_once or not self.identities:
            self._settled.set()
            self._over.set()
            return
        self.latched_devices.on_guard_died()
        if was_ready:
            self._note(log_messages.GUARD_DIED.line(bus=self._label, status=status))
            self._restarting = spawn(self._restart())

    def _send(self, message: GuardMessage) -> None:
        if self._pipe is not None and not self._pipe.is_closing():
            self._pipe.write(encode(message))

    def _receive(self, message: GuardMessage) -> None:
        match message:
            case TelemetrySnapshot():
                self.snapshots.on_snapshot(message)
            case CallDone(token, value):
                self._calls.on_done(token, value)
            case Refused(token, kind, reason):
                self._calls.on_refused(token, kind, reason)
            case Latched() | LockedOut() | Moving() | Released():
                self.latched_devices.on_message(message)
            case Note(device, text, code, level):
                self._note(log_messages.report_line(device, text, code, level))
            case DevicesOpened(identities) if not identities.keys() <= self._devices.keys():
                raise WireError(f"devices that it does not guard: {', '.join(identities)}")
            case DevicesOpened(identities, actions) if self._stopping or not self._opening.done():
                self.latched_devices.set_actions(actions)
                self.identities, self._ready, self._ready_at = identities, True, self._clock.monotonic()
                self._settled.set()
                if not self._opening.done():
                    self._opening.set_result(None)
            case OpenFailed(problems):
                self._on_failed(problems)
            case Stopped(unsafe):
                self._unsafe = unsafe

    def _on_failed(self, problems: list[tuple[str, str, str]]) -> None:
        kinds = {f"{device or self._label}: {reason}": kind for device, kind, reason in problems}
        if self._opening.done():  # No task waits for the opening any more.
            if not self.identities:  # A guard that could not be restarted leaves its devices as they are.
                self._unsafe = {}
            return
        unset = [problem for problem, kind in kinds.items() if kind == NOT_SET_UP]
        self._opening.set_exception(DevicesError(list(kinds), unset))
