"""Which devices of a guard are held in a safe state, why, and how far they are on their way to rest.

What the guard tells comes in; lines for the log go out. It also knows what the guard has to be asked for
again when it was started again.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

from lfield.clock import Clock
from lfield.devices.lateness import Pulse
from lfield.driver.binding import DeviceBinding
from lfield.errors import WireError
from lfield.guard.messages import Latched, LockedOut, Moving, Released, Safe
from lfield.guard.rest import UNSEEN
from lfield.wire import events
from lfield.wire.fields import MAX_LABEL, clip

#: Seconds between two words in the log about a device on its way to rest.
ON_THE_WAY = 2.0

Tell = Callable[[events.Latched | events.Confirmed | events.Moving | events.Released], None]


class Held:
    """The devices of one guard by name. `pulse` knows when a silence was this computer's own fault."""

    def __init__(
        self,
        devices: Mapping[str, DeviceBinding],
        clock: Clock,
        note: Callable[[str], None],
        pulse: Pulse,
    ) -> None:
        self._devices, self._clock, self._note, self._pulse = devices, clock, note, pulse
        self._told_way: dict[str, float] = {}
        self._states: dict[str, str] = {}
        self._asked: dict[str, Safe] = {}
        #: Why no device may be released, '' while all may.
        self.barred = ""
        #: Whether the host is stopping: an ordinary stop is told once, when it is done.
        self.stopping = False
        #: Why a device is held in its safe state, by name; absent while it answers to calls.
        self.latched: dict[str, str] = {}
        #: The latched devices that have been seen in their safe states.
        self.confirmed: set[str] = set()
        #: What a latched device still does in its safe state, in words, by name; '' once it is at rest.
        self.moving: dict[str, str] = {}
        #: Why a driver requires an inspection of its device, by name; absent for one that may move.
        self.locked_out: dict[str, str] = {}
        #: Called with each device that is locked out, and why.
        self.on_lock_out: Callable[[str, str], None] = lambda device, reason: None
        #: Called after every change of the three; and with what has changed, for whoever watches the host.
        self.on_change: Callable[[], None] = lambda: None
        self.tell: Tell = lambda event: None

    def state(self, device: str) -> str:
        """The safe state that a device is held in, or would be."""
        return self._states.get(device) or self._devices[device].safe_state

    def take(self, message: Latched | LockedOut | Moving | Released) -> None:
        """The guard tells. Raises WireError for a device that it does not guard."""
        if message.device not in self._devices:
            raise WireError(f"word of '{message.device}', which it does not guard")
        match message:
            case Latched():
                self._latched(message)
            case LockedOut(device, reason):
                self.locked_out[device] = reason
                self._note(
                    f"{device}: LOCKED OUT: {reason}; inspect it, then 'lfield estop --lift' ends that"
                )
                self.on_lock_out(device, reason)
            case Moving(device, moving):
                self.moving[device] = moving
                self.tell(events.Moving(clip(device, MAX_LABEL), clip(moving)))
                self._tell_way(device, moving)
            case Released(device):
                for known in (self.latched, self.moving, self._states, self._asked):
                    known.pop(device, None)
                self.confirmed.discard(device)
                self.tell(events.Released(clip(device, MAX_LABEL)))
                self._note(f"{device}: released")
        self.on_change()

    def _latched(self, message: Latched) -> None:
        device, confirmed = message.device, message.confirmed
        fault = self._pulse.explained(message.reason, self._clock.monotonic())
        self.latched[device] = reason = self.latched.get(device, message.reason) if confirmed else fault
        self._states[device], self.moving[device] = message.state, UNSEEN
        (self.confirmed.add if confirmed else self.confirmed.discard)(device)
        told = events.Confirmed if confirmed else events.Latched
        self.tell(told(clip(device, MAX_LABEL), clip(self.state(device), MAX_LABEL), clip(reason)))
        if confirmed or not self.stopping:
            into = "is in" if confirmed else "goes into"
            self._note(f"{device}: {into} its safe state '{self.state(device)}': {reason}")

    def _tell_way(self, device: str, moving: str) -> None:
        """Whoever waits for a stop wants to know what for."""
        now = self._clock.monotonic()
        if not moving and self._told_way.pop(device, None) is not None:
            self._note(f"{device}: is at rest")
        elif moving and self.stopping and now >= self._told_way.get(device, 0.0) + ON_THE_WAY:
            self._told_way[device] = now
            self._note(f"{device}: {moving}")

    def guard_died(self) -> None:
        """Nobody sees them any more."""
        self.confirmed.clear()
        self.moving = dict.fromkeys(self.latched, UNSEEN)

    def ask(self, device: str, reason: str, state: str) -> Safe:
        """What to say to the guard for a safe state; '' is that of the binding."""
        asked = Safe(device, reason, state="" if state == self._devices[device].safe_state else state)
        if asked.state:
            self._asked[device] = asked
        return asked

    def asked_again(self) -> list[Safe]:
        """What a guard that was started again has to hear: it brings its devices into their usual states."""
        bar = [Safe("", self.barred, barred=True)] if self.barred else []
        locks = [Safe(device, reason, barred=True) for device, reason in self.locked_out.items()]
        return [*self._asked.values(), *bar, *locks]
