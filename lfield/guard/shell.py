"""The I/O shell of a guard: connects the pipe and the driver to GuardCore, which makes all decisions."""

from __future__ import annotations

import asyncio
import os
import signal
from collections.abc import Callable, Coroutine, Sequence
from typing import Any

from lfield.clock import Clock
from lfield.driver.device import Driver
from lfield.driver.plugin import Plugin
from lfield.errors import DeviceError, WireError
from lfield.guard.core import GuardCore
from lfield.guard.device_opener import DeviceOpener
from lfield.guard.effects import Abandon, CheckRest, Effect, Execute, Exit, Interrupt, MakeSafe, Mute, Notify
from lfield.guard.endpoint_lock import EndpointGuard, EndpointLock
from lfield.guard.messages import (
    Beat,
    CallDone,
    DevicesOpened,
    GuardCall,
    GuardMessage,
    Latched,
    LockedOut,
    MessageReader,
    Moving,
    Note,
    OpenDevices,
    OpenFailed,
    OrphanLog,
    Refused,
    Released,
    Stop,
    Stopped,
    TelemetrySnapshot,
    encode,
)
from lfield.guard.recording import guard_inputs
from lfield.guard.recording.guard_recorder import GuardRecorder
from lfield.guard.recording.guard_rings import open_recorder
from lfield.guard.recording.recorded_core import RecordedCore
from lfield.guard.standstill import UNFINISHED
from lfield.guard.telemetry import Telemetry
from lfield.recording.turn_clocks import TurnClock
from lfield.text import log_messages
from lfield.text.log_messages import report_fields

#: Unread bytes in the pipe above which no periodic telemetry is sent, because the host does not read.
BACKLOG = 1 << 18
#: Messages to which a program reacts: telemetry is flushed before them.
OUTCOMES = (CallDone, Refused, Latched, LockedOut, Moving, Released)
#: Seconds between two answers to heartbeats.
ANSWER_EVERY = 0.5
#: Seconds to command the safe states when the guard is out of memory.
SAFE_COMMAND_TIME = 0.3


class Shell(asyncio.Protocol):
    """Passes events to the core and its effects to the driver and the host.

    `on_loaded` is called when the driver is imported, before it opens a device; `lock` reserves the endpoint.
    """

    def __init__(
        self,
        plugin: Plugin,
        output: asyncio.WriteTransport,
        clock: Clock,
        on_loaded: Callable[[], None] = lambda: None,
        lock: EndpointGuard | None = None,
    ) -> None:
        self._output, self._clock, self._orphan_log = output, clock, OrphanLog(clock)
        self._loop = asyncio.get_running_loop()
        # An exception in a callback of a driver (socket, timer) has no task that would report it.
        self._loop.set_exception_handler(self._callback_raised)
        self._reader = MessageReader()
        self._core: RecordedCore | None = None
        self._recorder: GuardRecorder | None = None
        self._opening = DeviceOpener(plugin, clock, self, on_loaded, lock or EndpointLock())
        # The end of the core, if it was requested while the devices were opened.
        self._leave: guard_inputs.GuardInput | None = None
        self._telemetry = Telemetry(
            clock, self._send_snapshot, self._is_foreign, lambda: output.get_write_buffer_size() >= BACKLOG
        )
        # Driver reports that are passed directly to telemetry.
        self.publish, self.heard = self._telemetry.publish, self._telemetry.on_contact
        self._foreign: list[str] = []
        self._calls: dict[int, asyncio.Task[None]] = {}
        self._making: dict[str, asyncio.Task[None]] = {}
        self._tasks: set[asyncio.Task[Any]] = set()
        self._timer: asyncio.Handle | None = None
        self._timer_at = self._answered = 0.0
        self._is_open_requested = self._no_memory = False
        # The messages of the effects that are being carried out; None between effects.
        self._buffered: list[bytes] | None = None
        self.exit: asyncio.Future[int] = self._loop.create_future()

    # -- the pipe -------------------------------------------------------------------------------------

    def data_received(self, data: bytes) -> None:
        """Messages of the host."""
        try:
            for message in self._reader.feed(data):
                self._receive(message)
        except WireError as error:
            self.on_host_gone(f"the host sent invalid bytes: {error}")

    def connection_lost(self, exc: Exception | None) -> None:
        """The pipe has closed: the host has ended or was killed."""
        self.on_host_gone("the host is gone")

    def on_host_gone(self, reason: str) -> None:
        """The host has ended."""
        self._end(guard_inputs.HostGone(reason))

    def _receive(self, message: GuardMessage) -> None:
        if isinstance(message, OpenDevices) and not self._is_open_requested:
            self._is_open_requested = True
            self._orphan_log.on_opening(message.devices)
            self._opening.on_request(message)
            self._recorder = open_recorder(message, self._clock, self.note)
            self._spawn(self._open(message))
        elif isinstance(message, Stop):
            self._end(guard_inputs.StopRequested(message.reason, message.at_once), at_once=message.at_once)
        elif self._core is not None and (event := guard_inputs.input_of(message)) is not None:
            self._handle(event)
            if isinstance(message, Beat):
                self._answer_beat()

    def _answer_beat(self) -> None:
        """A rate-limited heartbeat, which distinguishes an idle guard from one that hangs."""
        now = self._clock.monotonic()
        if now - self._answered >= ANSWER_EVERY:
            self._answered = now
            self._send(Beat(now))

    def _send(self, message: GuardMessage) -> None:
        if self._buffered is not None:
            self._buffered.append(encode(message))
        elif not self._output.is_closing():
            self._output.write(encode(message))
        else:
            self._orphan_log.write(message)

    def _send_snapshot(self, snapshot: TelemetrySnapshot) -> None:
        self._send(snapshot)
        if self._recorder is not None:
            self._recorder.on_snapshot(snapshot)

    def on_signal(self, number: int) -> None:
        """Handles a signal that was intended for the host."""
        line = log_messages.GUARD_SIGNAL_IGNORED.line(signal=signal.Signals(number).name)
        self.note("the guard", line)

    def _is_foreign(self, device: str) -> bool:
        """Whether the device is under foreign control; while it is opened, as the previous guard reported."""
        if self._core is None:
            return device in self._foreign
        try:
            return self._driver.devices[device].taken_over()
        except Exception:  # third-party code; assume control by the program
            return False

    # -- reports of a driver (lfield.driver.contract.Reports) -------------------------------------------

    def note(self, device: str, text: str) -> None:
        """Writes a line into the log of the host."""
        note = Note(device, *report_fields(text))
        self._send(note)
        if self._recorder is not None:
            self._recorder.on_note(note)

    def breach(self, device: str, reason: str) -> None:
        """The device exceeds a limit: it is made safe, independently of its calls."""
        self._handle(guard_inputs.SafeStateRequested(device, reason))

    def lock_out(self, device: str, reason: str) -> None:
        """The device must be inspected: it is made safe, and only an operator clears the lock-out."""
        if self._core is not None:
            effects = self._core.handle(guard_inputs.SafeStateRequested(device, reason, lock=True))
            self._run([*effects, Notify(LockedOut(device, reason))])

    def _callback_raised(self, loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        error = context.get("exception") or context.get("message", "")
        if "future" in context or "task" in context:
            # No task waited for the failed call any more: this is no reason to stop a vehicle.
            self._check_memory(error)
            self.note("the driver", log_messages.DRIVER_TASK_FAILED.line(reason=_error_text(error)))
        else:
            self.crashed(error)

    def crashed(self, reason: str | BaseException) -> None:
        """The driver itself has failed."""
        self._check_memory(reason)
        if not self._no_memory:  # else the safe states are commanded already
            self._on_broken_driver(f"the driver failed: {_error_text(reason)}")

    def _on_broken_driver(self, reason: str) -> None:
        if self._core is not None:
            self._handle(guard_inputs.SafeStateRequested("", reason))
        elif not self.exit.done():
            self._send(OpenFailed([("", "DeviceException", reason)]))
            self._finish(1)

    def _check_memory(self, error: str | BaseException) -> None:
        """If memory is exhausted: commands the safe states and ends, since the host starts another guard.

        If the host has ended, no process would start another guard, so this one continues.
        """
        if self._no_memory or not isinstance(error, MemoryError):
            return
        self._no_memory = True
        try:
            self._loop.call_later(SAFE_COMMAND_TIME, self._free_memory)
            self._on_broken_driver("its guard is out of memory")
        except MemoryError:
            self._free_memory()

    def _free_memory(self) -> None:
        if not self._output.is_closing():
            os.kill(os.getpid(), signal.SIGKILL)

    async def _open(self, message: OpenDevices) -> None:
        self._foreign = message.foreign_controlled
        # This heartbeat announces that no device is opened yet.
        self._send(Beat(self._clock.monotonic()))
        identities, problems = await self._opening.run(message)
        if problems:
            self._send(OpenFailed(problems))
            self._finish(1)
            return
        devices, clock = [self._driver.devices[name] for name in identities], TurnClock(self._clock)
        rows = [(d.binding.name, d.manifest.device, d.binding.ttl, d.binding.rest_within) for d in devices]
        self._core = RecordedCore(GuardCore(rows, clock, silence=message.silence), clock, self._recorder)
        # Flush telemetry first: a query right after opening must find it.
        self._telemetry.flush()
        self._send(DevicesOpened(identities, self._opening.safe_actions))
        self._handle(guard_inputs.BusOpened(message.latched))
        if self._leave is not None:
            self._handle(self._leave)

    def _end(self, leave: guard_inputs.GuardInput, *, at_once: bool = False) -> None:
        """The host stops or has ended; half-open devices are completed first, unless `at_once`."""
        if self._core is not None:
            self._handle(leave)
            return
        seconds, first = self._opening.abandon(), self._leave is None
        self._leave = leave
        if at_once or seconds == 0.0:
            self._abandon()
        elif first and seconds is not None:
            self._loop.call_later(seconds, self._abandon)

    def _abandon(self) -> None:
        """Ends the guard without waiting any longer for devices that are not open."""
        if self._core is None and not self.exit.done():
            self._send(Stopped(unsafe := dict.fromkeys(self._opening.commanded, UNFINISHED)))
            self._finish(1 if unsafe else 0)

    @property
    def _driver(self) -> Driver:
        """The driver; it exists as soon as the core exists."""
        assert self._opening.driver is not None
        return self._opening.driver

    # -- effects --------------------------------------------------------------------------------------

    def _handle(self, event: guard_inputs.GuardInput) -> None:
        if self._core is not None:
            self._run(self._core.handle(event))

    def _run(self, effects: Sequence[Effect]) -> None:
        """Carries out effects, and sends their messages in one write: the host wakes up once."""
        if self._buffered is not None or self._output.is_closing():
            self._carry_out(effects)
            return
        messages = self._buffered = list[bytes]()
        try:
            self._carry_out(effects)
        finally:
            self._buffered = None
            if messages:
                self._output.write(b"".join(messages))

    def _carry_out(self, effects: Sequence[Effect]) -> None:
        for effect in effects:
            match effect:
                case Execute(call):
                    self._calls[call.token] = self._spawn(self._execute(call))
                case Interrupt(token):
                    # Removed here: a task that is cancelled before its first step runs no `finally`.
                    if (task := self._calls.pop(token, None)) is not None:
                        task.cancel()
                case MakeSafe(device, state):
                    self._making[device] = self._spawn(self._make_safe(device, state))
                case Abandon(device):
                    self._making[device].cancel()
                case CheckRest(device):
                    self._check_rest(device)
                case Mute(on):
                    self._mute(on)
                case Notify(message):
                    if isinstance(message, OUTCOMES):
                        self._telemetry.flush_changes()
                    self._send(message)
                case Exit(status):
                    self._finish(status)
        self._set_timer()

    def _mute(self, on: bool) -> None:
        try:
            if on:
                self._driver.quiet()
            else:
                self._driver.resume()
        except Exception as error:  # third-party code
            self.crashed(error)

    def _check_rest(self, name: str) -> None:
        try:
            moving = self._driver.devices[name].moving()
        except Exception as error:  # third-party code; an unknown state counts as moving
            self._check_memory(error)
            moving = f"unknown, the driver failed: {error!r}"
        self._handle(guard_inputs.MotionReported(name, moving))

    async def _execute(self, call: GuardCall) -> None:
        core = self._core
        assert core is not None
        try:
            device = self._driver.devices[call.device]
            if refusal := core.start_call(call):
                raise device.error(refusal)
            value = await device.execute(call.instruction, call.arguments)
            self._handle(guard_inputs.CallFinished(call.token, value))
        except DeviceError as error:
            self._handle(guard_inputs.CallRefused(call.token, error.kind, error.reason))
        except ValueError as error:
            reason = f"{call.instruction}(): {error}"
            self._handle(guard_inputs.CallRefused(call.token, "DeviceException", reason))
        except Exception as error:  # third-party code; the device is made safe
            self._check_memory(error)
            problem = f"the driver failed in {call.instruction}(): {error!r}"
            self._handle(guard_inputs.CallCrashed(call.token, problem))
        finally:
            self._calls.pop(call.token, None)

    async def _make_safe(self, name: str, state: str) -> None:
        outcome: guard_inputs.GuardInput
        try:
            await self._driver.devices[name].make_safe(state)
            outcome = guard_inputs.SafeStateReached(name)
        except DeviceError as error:
            outcome = guard_inputs.SafeStateFailed(name, error.reason)
        except Exception as error:  # third-party code; the core retries
            self._check_memory(error)
            outcome = guard_inputs.SafeStateFailed(name, f"the driver failed: {error!r}")
        # A driver may end an abandoned command with a result although the command was cancelled.
        task = asyncio.current_task()
        if task is not None and not task.cancelling():
            self._handle(outcome)

    def _set_timer(self) -> None:
        """Schedules the core's next deadline; an existing timer that is early enough is kept."""
        due = self._core.due() if self._core is not None else None
        if due is None or (self._timer is not None and self._timer_at <= due):
            return
        if self._timer is not None:
            self._timer.cancel()
        # Stored here: uvloop cannot tell when a timer is due that expires in less than half a millisecond.
        self._timer, self._timer_at = self._loop.call_at(due, self._on_timer), due

    def _on_timer(self) -> None:
        self._timer = None
        self._handle(guard_inputs.TimerExpired())

    def _spawn(self, work: Coroutine[Any, Any, None]) -> asyncio.Task[None]:
        task = self._loop.create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        return task

    def _finish(self, status: int) -> None:
        if not self.exit.done():
            self.exit.set_result(status)

    async def close(self) -> None:
        """Closes the bus; messages already written are still sent."""
        for task in list(self._tasks):
            task.cancel()
        await self._opening.close()
        if self._recorder is not None:
            self._recorder.close()


def _error_text(error: str | BaseException) -> str:
    return error if isinstance(error, str) else repr(error)
