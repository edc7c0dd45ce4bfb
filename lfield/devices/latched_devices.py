"""Latched devices of a guard: the reasons for their safe states, and their progress to rest.

Messages of the guard in, log lines out. This module also stores the requests that a restarted guard must get
again.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

from lfield.clock import Clock
from lfield.devices.scheduling_jitter import HeartbeatJitter
from lfield.driver.binding import DeviceBinding
from lfield.errors import WireError
from lfield.guard.messages import Latched, LockedOut, Moving, Released, RequestSafeState
from lfield.guard.standstill import UNCONFIRMED
from lfield.text import log_messages
from lfield.text.log_messages import LogLine
from lfield.wire import events
from lfield.wire.fields import MAX_LABEL, truncate

#: Seconds between two log lines about a device on its way to rest.
PROGRESS_LOG_INTERVAL = 2.0

OnLatchEvent = Callable[
    [events.DeviceLatched | events.SafeStateConfirmed | events.DeviceMoving | events.DeviceReleased], None
]


class LatchedDevices:
    """The latched devices of one guard by name. `heartbeats` shows whether this computer caused a silence."""

    def __init__(
        self,
        devices: Mapping[str, DeviceBinding],
        clock: Clock,
        note: Callable[[LogLine], None],
        heartbeats: HeartbeatJitter,
    ) -> None:
        self._devices, self._clock, self._note, self._heartbeats = devices, clock, note, heartbeats
        self._progress_logged_at: dict[str, float] = {}
        self._states: dict[str, str] = {}
        #: The actions of devices in their safe states, if they differ from the name of the state.
        self._actions: Mapping[str, Mapping[str, str]] = {}
        self._requests: dict[str, RequestSafeState] = {}
        #: The reason why no device may be released, '' while all may.
        self.blocking_reason = ""
        #: Whether the host is stopping: an ordinary stop is logged once, when it is done.
        self.stopping = False
        #: The reason why a device is held in its safe state, by name; absent while it accepts calls.
        self.latched: dict[str, str] = {}
        #: The latched devices whose safe states are confirmed.
        self.confirmed: set[str] = set()
        #: The remaining motion of a latched device in its safe state, by name; '' at rest.
        self.moving: dict[str, str] = {}
        #: The reason why a driver requires an inspection, by device; absent for a device that may move.
        self.locked_out: dict[str, str] = {}
        #: Called with each device that is locked out, and the reason.
        self.on_lock_out: Callable[[str, str], None] = lambda device, reason: None
        #: Called after every change of this data; and called with the change, for observers of the host.
        self.on_change: Callable[[], None] = lambda: None
        self.on_event: OnLatchEvent = lambda event: None

    def set_event_handlers(
        self,
        on_event: OnLatchEvent,
        on_lock_out: Callable[[str, str], None],
        on_change: Callable[[], None],
    ) -> None:
        """Sets the functions for every event, every device that is locked out, and the end of a change."""
        self.on_event, self.on_lock_out, self.on_change = on_event, on_lock_out, on_change

    def set_actions(self, actions: Mapping[str, Mapping[str, str]]) -> None:
        """Sets the actions of devices in their safe states, by device and state."""
        self._actions = actions

    def on_stop(self) -> None:
        """The host stops."""
        self.stopping = True

    def inhibit(self, reason: str) -> None:
        """Forbids the release of all devices for a reason; '' allows it."""
        self.blocking_reason = reason

    def state(self, device: str) -> str:
        """The safe state in which a device is held, or would be held."""
        return self._states.get(device) or self._devices[device].safe_state

    def on_message(self, message: Latched | LockedOut | Moving | Released) -> None:
        """A message of the guard. Raises WireError for a device that the guard does not have."""
        if message.device not in self._devices:
            raise WireError(f"message about '{message.device}', which it does not guard")
        match message:
            case Latched():
                self._on_latched(message)
            case LockedOut(device, reason):
                self.locked_out[device] = reason
                self._note(log_messages.DEVICE_LOCKED_OUT.line(device=device, reason=reason))
                self.on_lock_out(device, reason)
            case Moving(device, moving):
                self.moving[device] = moving
                self.on_event(events.DeviceMoving(truncate(device, MAX_LABEL), truncate(moving)))
                self._log_progress(device, moving)
            case Released(device):
                for known in (self.latched, self.moving, self._states, self._requests):
                    known.pop(device, None)
                self.confirmed.discard(device)
                self.on_event(events.DeviceReleased(truncate(device, MAX_LABEL)))
                self._note(log_messages.DEVICE_RELEASED.line(device=device))
        self.on_change()

    def _on_latched(self, message: Latched) -> None:
        device, confirmed = message.device, message.confirmed
        fault = self._heartbeats.explain(message.reason, self._clock.monotonic())
        self.latched[device] = reason = self.latched.get(device, message.reason) if confirmed else fault
        self._states[device], self.moving[device] = message.state, UNCONFIRMED
        (self.confirmed.add if confirmed else self.confirmed.discard)(device)
        event = events.SafeStateConfirmed if confirmed else events.DeviceLatched
        self.on_event(
            event(truncate(device, MAX_LABEL), truncate(self.state(device), MAX_LABEL), truncate(reason))
        )
        if confirmed or not self.stopping:
            kind = log_messages.DEVICE_SAFE if confirmed else log_messages.DEVICE_GOES_SAFE
            state = self.state(device)
            action = self._actions.get(device, {}).get(state, state)
            self._note(kind.line(device=device, state=action, reason=reason))

    def _log_progress(self, device: str, moving: str) -> None:
        """Logs the progress for which a stop waits."""
        now = self._clock.monotonic()
        if not moving and self._progress_logged_at.pop(device, None) is not None:
            self._note(log_messages.DEVICE_AT_REST.line(device=device))
        elif (
            moving
            and self.stopping
            and now >= self._progress_logged_at.get(device, 0.0) + PROGRESS_LOG_INTERVAL
        ):
            self._progress_logged_at[device] = now
            self._note(log_messages.DEVICE_MOVING.line(device=device, moving=moving))

    def on_guard_died(self) -> None:
        """The guard has died: the state of its devices is unknown."""
        self.confirmed.clear()
        self.moving = dict.fromkeys(self.latched, UNCONFIRMED)

    def request_safe(self, device: str, reason: str, state: str) -> RequestSafeState:
        """The request for a safe state; '' is the one of the binding."""
        request = RequestSafeState(
            device, reason, state="" if state == self._devices[device].safe_state else state
        )
        if request.state:
            self._requests[device] = request
        return request

    def pending_requests(self) -> list[RequestSafeState]:
        """The requests for a restarted guard, which brings its devices into their usual safe states."""
        inhibitions = [RequestSafeState("", self.blocking_reason, lock=True)] if self.blocking_reason else []
        locks = [RequestSafeState(device, reason, lock=True) for device, reason in self.locked_out.items()]
        return [*self._requests.values(), *inhibitions, *locks]
