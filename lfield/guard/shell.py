"""The shell of a guard: frames and a driver around GuardCore. It decides nothing.

When its pipe ends the devices are made safe, and `exit` says that the process may end, and how.
"""

from __future__ import annotations

import asyncio
import os
import signal
import sys
from collections.abc import Callable, Coroutine, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from lfield.clock import Clock
from lfield.driver.device import Driver
from lfield.driver.plugin import Plugin
from lfield.errors import DeviceError, WireError
from lfield.guard.core import GuardCore
from lfield.guard.effects import Effect, Execute, Exit, Interrupt, LeaveOff, Look, MakeSafe, Quiet, Tell
from lfield.guard.endpoint_lock import EndpointLock, Lock
from lfield.guard.messages import (
    Allow,
    Beat,
    Call,
    Cancel,
    Done,
    Failed,
    Latched,
    LockedOut,
    Message,
    MessageReader,
    Moving,
    Note,
    Open,
    Ready,
    Refused,
    Released,
    Safe,
    Stop,
    Stopped,
    encode,
    last_words,
)
from lfield.guard.opening import Opening
from lfield.guard.rest import UNFINISHED
from lfield.guard.telemetry import Telemetry

#: More than this many unread bytes, and no periodic telemetry is sent: the host has stopped reading.
BACKLOG = 1 << 18
#: Messages that a program acts on: the telemetry of their cause goes out before them.
OUTCOMES = (Done, Refused, Latched, LockedOut, Moving, Released)
#: Seconds between two answers to the host's beats.
ANSWER = 0.5
#: Seconds for the safe states to be commanded by a guard that has no memory left.
LAST_COMMANDS = 0.3


class Shell(asyncio.Protocol):
    """Carries events to the core and its effects out to the driver and the host.

    `on_loaded` is called when the driver's code is there, before it opens anything; `lock` keeps others away
    from the endpoint.
    """

    def __init__(
        self,
        plugin: Plugin,
        output: asyncio.WriteTransport,
        clock: Clock,
        on_loaded: Callable[[], None] = lambda: None,
        lock: Lock | None = None,
    ) -> None:
        self._output, self._clock = output, clock
        self._loop = asyncio.get_running_loop()
        # A driver's callback that raises (of a socket, a timer) has no task to tell of it.
        self._loop.set_exception_handler(self._callback_raised)
        self._reader = MessageReader()
        self._core: GuardCore | None = None
        self._opening = Opening(plugin, clock, self, on_loaded, lock or EndpointLock())
        # How the core ends that comes of an opening during which somebody wanted the end.
        self._leave: Callable[[GuardCore], list[Effect]] | None = None
        self._telemetry = Telemetry(
            clock, self._tell, self._is_taken, lambda: output.get_write_buffer_size() >= BACKLOG
        )
        # Of what a driver can tell, new values and signs of life.
        self.publish, self.heard = self._telemetry.publish, self._telemetry.heard
        self._taken_before: list[str] = []
        self._calls: dict[int, asyncio.Task[None]] = {}
        self._making: dict[str, asyncio.Task[None]] = {}
        self._tasks: set[asyncio.Task[Any]] = set()
        self._timer: asyncio.Handle | None = None
        self._timer_at = self._answered = 0.0
        self._asked = self._starved = False
        # Messages that go out in one write, while there are any to wait for.
        self._held: list[bytes] | None = None
        self.exit: asyncio.Future[int] = self._loop.create_future()

    # -- the pipe -------------------------------------------------------------------------------------

    def data_received(self, data: bytes) -> None:
        """Messages of the host."""
        try:
            for message in self._reader.feed(data):
                self._receive(message)
        except WireError as error:
            self.gone(f"the host sent bytes that make no sense: {error}")

    def connection_lost(self, exc: Exception | None) -> None:
        """The pipe has closed: the host has ended or was killed."""
        self.gone("the host is gone")

    def gone(self, reason: str) -> None:
        """There is nobody left to work for."""
        self._end(lambda core: core.gone(reason))

    def _receive(self, message: Message) -> None:
        if isinstance(message, Open) and not self._asked:
            self._asked = True
            self._spawn(self._open(message))
        elif isinstance(message, Stop):
            self._end(
                lambda core: core.stop(message.reason, at_once=message.at_once), at_once=message.at_once
            )
        elif self._core is None:
            pass
        elif isinstance(message, Beat):
            self._run(self._core.beat(message.sent))
            self._answer_beat()
        elif isinstance(message, Call):
            self._run(self._core.call(message))
        elif isinstance(message, Cancel):
            self._run(self._core.cancel(message.token, message.sent))
        elif isinstance(message, Safe):
            self._run(
                self._core.safe(message.device, message.reason, barred=message.barred, state=message.state)
            )
        elif isinstance(message, Allow):
            self._run(self._core.allow())

    def _answer_beat(self) -> None:
        """Now and then, so that the host can tell a guard that hangs from one with nothing to say."""
        now = self._clock.monotonic()
        if now - self._answered >= ANSWER:
            self._answered = now
            self._tell(Beat(now))

    def _tell(self, message: Message) -> None:
        if self._held is not None:
            self._held.append(encode(message))
        elif not self._output.is_closing():
            self._output.write(encode(message))
        elif line := last_words(message):
            print(line, file=sys.stderr, flush=True)

    @contextmanager
    def _in_one_write(self) -> Iterator[None]:
        """Messages of the meantime go out together: the host wakes up once for them."""
        if self._held is not None or self._output.is_closing():
            yield
            return
        held: list[bytes] = []
        self._held = held
        try:
            yield
        finally:
            self._held = None
            if held:
                self._output.write(b"".join(held))

    def signalled(self, number: int) -> None:
        """Somebody who means the host has sent its guard a signal too."""
        name = signal.Signals(number).name
        self.note("the guard", f"{name} does not end it: it ends with its host, its devices safe")

    def _is_taken(self, device: str) -> bool:
        """Whether somebody else has it; while it is opened, as the guard before this one knew."""
        if self._core is None:
            return device in self._taken_before
        try:
            return self._driver.devices[device].taken_over()
        except Exception:  # foreign code again; what is not known is the program's
            return False

    # -- what a driver can tell (lfield.driver.device.Reports) ------------------------------------------

    def note(self, device: str, text: str) -> None:
        """A sentence for the log."""
        self._tell(Note(device, text))

    def breach(self, device: str, reason: str) -> None:
        """It is beyond a limit and could not be brought back: it goes safe, whatever its calls do."""
        if self._core is not None:
            self._run(self._core.safe(device, reason))

    def lock_out(self, device: str, reason: str) -> None:
        """It must be inspected before it moves again: it goes safe, and only an operator ends that."""
        if self._core is not None:
            self._run([*self._core.safe(device, reason, barred=True), Tell(LockedOut(device, reason))])

    def _callback_raised(self, loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        reason = context.get("exception") or context.get("message", "")
        if "future" in context or "task" in context:
            # Somebody has stopped waiting for what then failed: no reason to stop a vehicle.
            self.note("the driver", f"nobody was told of {self._words(reason)}")
        else:
            self.crashed(reason)

    def crashed(self, reason: str | BaseException) -> None:
        """The driver is broken as a whole."""
        self._broken(f"the driver failed: {self._words(reason)}")

    def _broken(self, told: str) -> None:
        if self._core is not None:
            self._run(self._core.safe("", told))
        elif not self.exit.done():
            self._tell(Failed([("", "DeviceException", told)]))
            self._finish(1)

    def _words(self, error: str | BaseException) -> str:
        """What a driver has raised; when it is for want of memory, this guard ends."""
        if isinstance(error, MemoryError):
            self._out_of_memory()
        return error if isinstance(error, str) else repr(error)

    def _out_of_memory(self) -> None:
        """Command the safe states and end: a guard that hears only half is worse than the next one.

        For a host that is gone nobody would start another: then this one goes on trying.
        """
        if self._starved:
            return
        self._starved = True
        try:
            self._loop.call_later(LAST_COMMANDS, self._make_room)
            self._broken("there is no memory left for its guard")
        except MemoryError:
            self._make_room()

    def _make_room(self) -> None:
        if not self._output.is_closing():
            os.kill(os.getpid(), signal.SIGKILL)

    # -- opening --------------------------------------------------------------------------------------

    async def _open(self, message: Open) -> None:
        self._taken_before = message.taken
        # A guard that has not said a word has opened nothing.
        self._tell(Beat(self._clock.monotonic()))
        identities, problems = await self._opening.run(message)
        if problems:
            self._tell(Failed(problems))
            self._finish(1)
            return
        devices = [self._driver.devices[name] for name in identities]
        self._core = GuardCore(
            [(d.binding.name, d.manifest.device, d.binding.ttl, d.binding.rest_within) for d in devices],
            self._clock,
            silence=message.silence,
        )
        # Telemetry first: a query right after the opening must find it.
        self._telemetry.flush()
        self._tell(Ready(identities))
        self._run(self._core.opened(message.latched))
        if self._leave is not None:
            self._run(self._leave(self._core))

    def _end(self, leave: Callable[[GuardCore], list[Effect]], *, at_once: bool = False) -> None:
        """The host wants to end, or is gone; what is half open is finished first, but not `at_once`."""
        if self._core is not None:
            self._run(leave(self._core))
            return
        seconds, first = self._opening.leave(), self._leave is None
        self._leave = leave
        if at_once or seconds == 0.0:
            self._give_up()
        elif first and seconds is not None:
            self._loop.call_later(seconds, self._give_up)

    def _give_up(self) -> None:
        """The devices are not open, and are waited for no longer."""
        if self._core is None and not self.exit.done():
            self._tell(Stopped(unsafe := dict.fromkeys(self._opening.touched, UNFINISHED)))
            self._finish(1 if unsafe else 0)

    @property
    def _driver(self) -> Driver:
        """The driver, which is there as soon as the core is."""
        assert self._opening.driver is not None
        return self._opening.driver

    # -- effects --------------------------------------------------------------------------------------

    def _run(self, effects: Sequence[Effect]) -> None:
        with self._in_one_write():
            self._carry_out(effects)
        self._set_timer()

    def _carry_out(self, effects: Sequence[Effect]) -> None:
        for effect in effects:
            match effect:
                case Execute(call):
                    self._calls[call.token] = self._spawn(self._execute(call))
                case Interrupt(token):
                    if token in self._calls:
                        self._calls[token].cancel()
                case MakeSafe(device, state):
                    self._making[device] = self._spawn(self._make_safe(device, state))
                case LeaveOff(device):
                    self._making[device].cancel()
                case Look(device):
                    self._look(device)
                case Quiet(on):
                    self._be_quiet(on)
                case Tell(message):
                    if isinstance(message, OUTCOMES):
                        self._telemetry.flush_changes()
                    self._tell(message)
                case Exit(status):
                    self._finish(status)

    def _be_quiet(self, on: bool) -> None:
        try:
            if on:
                self._driver.quiet()
            else:
                self._driver.resume()
        except Exception as error:  # foreign code again
            self.crashed(error)

    def _look(self, name: str) -> None:
        assert self._core is not None
        try:
            moving = self._driver.devices[name].moving()
        except Exception as error:  # foreign code again; what is not known is not rest
            moving = f"nobody knows, since the driver failed: {self._words(error)}"
        self._run(self._core.looked(name, moving))

    async def _execute(self, call: Call) -> None:
        core, driver = self._core, self._driver
        assert core is not None
        try:
            device = driver.devices[call.device]
            if refusal := core.begins(call):
                raise device.error(refusal)
            value = await device.execute(call.instruction, call.arguments)
            self._run(core.finished(call.token, value))
        except DeviceError as error:
            self._run(core.refused(call.token, error.kind, error.reason))
        except ValueError as error:
            self._run(core.refused(call.token, "DeviceException", f"{call.instruction}(): {error}"))
        except Exception as error:  # foreign code again; the device goes safe
            told = f"the driver failed in {call.instruction}(): {self._words(error)}"
            self._run(core.crashed(call.token, told))
        finally:
            self._calls.pop(call.token, None)

    async def _make_safe(self, name: str, state: str) -> None:
        core, driver = self._core, self._driver
        assert core is not None
        try:
            await driver.devices[name].make_safe(state)
        except DeviceError as error:
            self._run(core.not_safe(name, error.reason))
        except Exception as error:  # foreign code again; the core tries again
            self._run(core.not_safe(name, f"the driver failed: {self._words(error)}"))
        else:
            self._run(core.made_safe(name))

    def _set_timer(self) -> None:
        """Be awake when the core next needs it; a timer that is early enough is left alone."""
        due = self._core.due() if self._core is not None else None
        if due is None or (self._timer is not None and self._timer_at <= due):
            return
        if self._timer is not None:
            self._timer.cancel()
        # Kept here: uvloop's handle of a timer that is due within half a millisecond cannot say when.
        self._timer, self._timer_at = self._loop.call_at(due, self._on_timer), due

    def _on_timer(self) -> None:
        self._timer = None
        if self._core is not None:
            self._run(self._core.tick())

    def _spawn(self, work: Coroutine[Any, Any, None]) -> asyncio.Task[None]:
        task = self._loop.create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        return task

    def _finish(self, status: int) -> None:
        if not self.exit.done():
            self.exit.set_result(status)

    async def close(self) -> None:
        """Give the bus back; the messages written so far still go out."""
        for task in list(self._tasks):
            task.cancel()
        await self._opening.close()
