"""The host's end of one guard process: starts it, beats, calls, keeps its telemetry, starts it again."""

from __future__ import annotations

import asyncio
import math
import sys
from collections.abc import Callable, Sequence
from typing import Any, cast

from lfield.capability.directory.news import Trouble
from lfield.clock import Clock
from lfield.devices.calls import Answered, Calls
from lfield.devices.held import Held
from lfield.devices.lateness import BEAT, Lateness, Pulse
from lfield.devices.snapshots import Snapshots
from lfield.driver.binding import DeviceBinding, longest_rest
from lfield.driver.device import NOT_SET_UP
from lfield.driver.known import KnownDriver
from lfield.errors import DeviceError, DevicesError, WireError
from lfield.guard.messages import (
    Allow,
    Beat,
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
    Snapshot,
    Stop,
    Stopped,
    encode,
)
from lfield.guard.rest import UNFINISHED, UNSEEN
from lfield.loop import kill, spawn, start_process, unexpected
from lfield.manifest import Instruction

#: So many beats without a word from the guard, and it hangs. Beats are counted, not seconds: a host that
#: was stopped itself must not blame its guards.
UNANSWERED = 60
#: Seconds for a guard to open its devices; and to end, beyond the time that its devices have for it.
OPEN_BOUND, STOP_BOUND = 60.0, 5.0
#: Seconds for a guard to end that shall not wait for its devices any longer.
AT_ONCE = 1.0
#: Seconds before a guard that died is started again: when it died soon after it was ready, and at most. One
#: that lived longer is started at once: an autopilot's failsafe waits for no more than 2 s.
AGAIN_FIRST, AGAIN_LAST = 0.2, 5.0

#: Why devices are made safe when the host ends in order.
STOPPING = "the host is stopping"


def pause_before(lived: float) -> float:
    """Seconds to wait before a guard is started again that died `lived` seconds after it was ready."""
    return 0.0 if lived > AGAIN_LAST else AGAIN_FIRST


class Guard(asyncio.SubprocessProtocol):
    """One bus. `note` takes a line for the log; after a silence of `lateness.limit` it goes safe.

    A beat is given only when `turned` says that the host has just had its turn. How late each one was is told
    to `lateness`.
    """

    def __init__(
        self,
        driver: KnownDriver,
        devices: Sequence[DeviceBinding],
        clock: Clock,
        note: Callable[[str], None],
        lateness: Lateness,
        turned: Callable[[], bool],
    ) -> None:
        self._driver = driver.only({device.type for device in devices})
        self._clock, self._note = clock, note
        self._silence, self._pulse = lateness.limit.silence, Pulse(lateness)
        self._turned = turned
        self._devices = {device.name: device for device in devices}
        self._who = ", ".join(self._devices)
        self.snapshots = Snapshots(driver, devices, clock)
        self._reader = MessageReader()
        self._transport: asyncio.SubprocessTransport | None = None
        self._pipe: asyncio.WriteTransport | None = None
        self._beating: asyncio.TimerHandle | None = None
        self._restarting: asyncio.Task[None] | None = None
        self._opening: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._exited = asyncio.Event()
        # Set when the devices are open or never will be, and when this guard has ended for good.
        self._settled, self._over = asyncio.Event(), asyncio.Event()
        self._ready = self._stopping = self._hurried = self._spoken = False
        self._unanswered, self._ready_at = 0, -math.inf
        self._calls = Calls()
        self._unsafe: dict[str, str] | None = None
        #: Which of its devices are held in a safe state, and why.
        self.held = Held(self._devices, clock, note, self._pulse)
        #: Who the devices are, in their driver's words, once they are open.
        self.identities: dict[str, str] = {}

    # -- life -----------------------------------------------------------------------------------------

    async def open(self, latched: str = "") -> None:
        """Start the process and open the devices. Raises DevicesError with all that is wrong."""
        self._opening = asyncio.get_running_loop().create_future()
        self._exited, self._reader = asyncio.Event(), MessageReader()
        guard = (sys.executable, "-P", "-m", "lfield.guard.process", self._driver.reference)
        try:
            await start_process(self, *guard)
        except OSError as error:
            raise DevicesError([f"the driver's process does not start: {error.strerror or error}"]) from None
        devices, taken = list(self._devices.values()), sorted(self.snapshots.taken)
        self._send(Open(devices, latched, self._silence, self._driver, taken))
        self._pulse.pause()
        self._beat()
        try:
            async with asyncio.timeout(OPEN_BOUND):
                await self._opening
        except (TimeoutError, DevicesError) as error:
            self.kill()
            await self._exited.wait()
            if isinstance(error, DevicesError):
                raise
            raise DevicesError([f"the driver did not open its devices within {OPEN_BOUND:g} s"]) from None
        for asked in self.held.asked_again():
            self._send(asked)
        for name, identity in self.identities.items():
            self._note(f"{name}: {identity} at {self._devices[name].endpoint}")

    async def close(self) -> dict[str, str]:
        """Make the devices safe, and end the process when they are at rest.

        Returns those that have not been seen there, each with what is known of it. A guard that dies
        meanwhile is started again for it. Bounded by `rest_within` of its devices; `hurry` makes it short.
        """
        self._stopping = self.held.stopping = True
        if self._transport is None and self._restarting is None:
            return {}
        self._send(Stop(STOPPING))
        try:
            async with asyncio.timeout(STOP_BOUND):
                await self._settled.wait()
            async with asyncio.timeout(longest_rest(self._devices.values()) + STOP_BOUND):
                await self._over.wait()
        except TimeoutError:
            self._give_up()
            await self._exited.wait()
        return self._found_unsafe()

    def hurry(self) -> None:
        """Wait for the devices no longer; who is not at rest will be named."""
        self._hurried = True
        self._send(Stop(STOPPING, at_once=True))
        asyncio.get_running_loop().call_later(AT_ONCE, self._give_up)

    def _give_up(self) -> None:
        self._hurried = True
        if self._restarting is not None:
            self._restarting.cancel()
        self.kill()
        if self._transport is None:
            self._exited.set()
            self._over.set()

    def _found_unsafe(self) -> dict[str, str]:
        if self._unsafe is not None:
            return self._unsafe
        if not self.identities:
            return dict.fromkeys(self.movable, UNFINISHED) if self._spoken else {}
        words = {name: self.held.moving.get(name, UNSEEN) for name in self.movable}
        return {name: f"{said}, and its guard has ended" for name, said in words.items() if said}

    def kill(self) -> None:
        """End the process by force; unless this end is wanted, the next one makes the devices safe."""
        if self._transport is not None:
            kill(self._transport)

    def _beat(self) -> None:
        if self._pipe is None or self._pipe.is_closing() or not self._turned():
            return
        self._unanswered += 1
        if self._ready and self._unanswered > UNANSWERED:
            self._note(f"the guard of {self._who} hangs")
            self.kill()
        now = self._clock.monotonic()
        if self._ready and (warning := self._pulse.beat(now)):
            self._note(warning)
        self._send(Beat(now))
        self._beating = asyncio.get_running_loop().call_later(BEAT, self._beat)

    async def _restart(self) -> None:
        """Start the process again until it works; its devices come back safe."""
        pause = pause_before(self._clock.monotonic() - self._ready_at)
        while True:
            await asyncio.sleep(pause)
            try:
                await self.open("its guard died and was started again")
                if self._stopping:
                    self._send(Stop(STOPPING, at_once=self._hurried))
                return
            except DevicesError as error:
                pause = min(max(2 * pause, AGAIN_FIRST), AGAIN_LAST)
                self._note(f"the guard cannot be started again yet: {error}")

    def make_safe(self, device: str, reason: str, state: str = "") -> None:
        """Bring a device into its safe state, or into another one, from which the program may release it.

        A guard that is being started again is told when it is there.
        """
        self._send(self.held.ask(device, reason, state))

    async def fall_silent(self, seconds: float) -> None:
        """Send no beat for so long, as a host that hangs."""
        if self._beating is not None:
            self._beating.cancel()
        self._pulse.pause()
        await asyncio.sleep(seconds)
        self._beat()

    def bar(self, reason: str) -> None:
        """Bring every device into its safe state and keep the program from releasing it.

        A guard that is being started again is told when it is there.
        """
        self.held.barred = reason
        self._send(Safe("", reason, barred=True))

    def allow(self) -> None:
        """The program may release the devices again."""
        self.held.barred = ""
        self.held.locked_out.clear()
        self._send(Allow())

    # -- calls and queries ----------------------------------------------------------------------------

    def call(
        self,
        device: str,
        instruction: Instruction,
        arguments: Sequence[Any],
        answered: Answered,
        until: float = math.inf,
        thread: int = 0,
    ) -> None:
        """Have an instruction carried out; `answered` is called once, from the loop.

        What acts begins before `until`, in seconds of the host's clock, and within the device's `ttl`.
        `thread` of the device's agent is who waits for it.
        """
        binding = self._devices[device]
        if not self._ready:
            raise DeviceError(binding.field, "its guard has died and is being started again")
        now = self._clock.monotonic()
        self._send(self._calls.begin(binding, instruction, arguments, answered, now, until, thread))

    def cancel(self, agent: str, thread: int) -> bool:
        """Give up what a thread of an agent waits for, as `Guards.cancel`."""
        cancel = self._calls.cancel(agent, thread, self._clock.monotonic())
        if cancel is not None:
            self._send(cancel)
        return cancel is not None

    @property
    def pid(self) -> int:
        """The id of its process, 0 while there is none."""
        return (self._transport.get_pid() if self._transport is not None else 0) or 0

    @property
    def ready(self) -> bool:
        """Whether the devices are open."""
        return self._ready

    def trouble(self, device: str) -> Trouble | None:
        """Why the device cannot be called now; None when it can."""
        binding = self._devices[device]
        if not self._ready:
            return Trouble(f"{binding.field}: its guard has died and is being started again")
        if why := self.held.latched.get(device):
            return Trouble(f"{binding.field}: in its safe state {self.held.state(device)}: {why}")
        lost = self.snapshots.lost_since(device)
        return None if lost is None else Trouble(f"{binding.field}: not heard", lost)

    @property
    def movable(self) -> tuple[str, ...]:
        """The devices of this bus that have a safe state: all but pure sensors."""
        return tuple(name for name, device in self._devices.items() if not device.is_sensor)

    # -- the process ----------------------------------------------------------------------------------

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """The process runs."""
        # Casts, since uvloop's transports have these methods but not these base classes.
        self._transport = cast("asyncio.SubprocessTransport", transport)
        self._pipe = cast("asyncio.WriteTransport", self._transport.get_pipe_transport(0))

    def pipe_data_received(self, fd: int, data: bytes) -> None:
        """Messages of the guard."""
        self._unanswered, self._spoken = 0, True
        try:
            for message in self._reader.feed(data):
                self._receive(message)
        except WireError as error:
            self._note(f"the guard sent bytes that make no sense: {error}")
            self.kill()
        except Exception as error:
            unexpected(error)

    def connection_lost(self, exc: Exception | None) -> None:
        """The guard has ended and all it said is read; unless it was asked to end, a new one is started."""
        assert self._transport is not None
        status = self._transport.get_returncode()
        self._transport.close()
        self._transport = self._pipe = None
        if self._beating is not None:
            self._beating.cancel()
        was_ready, self._ready = self._ready, False
        if was_ready and self._stopping and status == 0:
            self._unsafe = {}  # Its last words may be lost, when there is no memory for them.
        self._exited.set()
        if not self._opening.done():
            self._opening.set_exception(DevicesError([f"the driver's process ended with status {status}"]))
        self._calls.lost(status)
        if self._unsafe is not None or self._hurried or not self.identities:
            self._settled.set()
            self._over.set()
            return
        self.held.guard_died()
        if was_ready:
            self._note(f"the guard of {self._who} died with status {status}; starting it again")
            self._restarting = spawn(self._restart())

    def _send(self, message: Message) -> None:
        if self._pipe is not None and not self._pipe.is_closing():
            self._pipe.write(encode(message))

    def _receive(self, message: Message) -> None:
        match message:
            case Snapshot():
                self.snapshots.take(message)
            case Done(token, value):
                self._calls.done(token, value)
            case Refused(token, kind, reason):
                self._calls.refused(token, kind, reason)
            case Latched() | LockedOut() | Moving() | Released():
                self.held.take(message)
            case Note(device, text):
                self._note(f"{device}: {text}")
            case Ready(identities) if not identities.keys() <= self._devices.keys():
                raise WireError(f"devices that it does not guard: {', '.join(identities)}")
            case Ready(identities) if self._stopping or not self._opening.done():
                self.identities, self._ready, self._ready_at = identities, True, self._clock.monotonic()
                self._settled.set()
                if not self._opening.done():
                    self._opening.set_result(None)
            case Failed(problems):
                self._on_failed(problems)
            case Stopped(unsafe):
                self._unsafe = unsafe

    def _on_failed(self, problems: list[tuple[str, str, str]]) -> None:
        kinds = {f"{device or self._who}: {reason}": kind for device, kind, reason in problems}
        if self._opening.done():  # Nobody waits for it any more.
            self._unsafe = {}
            return
        unset = [told for told, kind in kinds.items() if kind == NOT_SET_UP]
        self._opening.set_exception(DevicesError(list(kinds), unset))
