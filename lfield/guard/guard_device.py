"""The state of one device in a guard: latched or free, running calls and deadlines."""

from __future__ import annotations

from msgspec import Struct, field

from lfield.guard.messages import GuardCall
from lfield.guard.running_call import RunningCall
from lfield.guard.standstill import StandstillState
from lfield.manifest import DeviceManifest, Instruction


class GuardDevice(Struct):
    """The state of one device. `latched` is the reason, '' when the device is free.

    `lock_reason` is the reason why the program may not release it: an emergency stop or a lock-out by its
    driver. `reported` is the last reason for a safe state that was logged for a sensor, which has none.
    `state` is the safe state in which the device is held; '' for the one of its binding. `making` means that
    the safe state is being commanded, `made_at` is the time when this command last ended. `rest_within` is
    the time to come to rest, in seconds. `active` is the running call of each channel, `setpoints` are the
    expiry times of setpoints in effect.
    """

    name: str
    manifest: DeviceManifest
    ttl: float
    rest_within: float
    latched: str = ""
    state: str = ""
    lock_reason: str = ""
    reported: str = ""
    confirmed: bool = False
    is_actuated: bool = False
    making: bool = False
    made_at: float = 0.0
    retry_at: float | None = None
    setpoints: dict[str, float] = field(default_factory=dict)
    active: dict[str, RunningCall] = field(default_factory=dict)
    queries: dict[int, RunningCall] = field(default_factory=dict)

    def instruction_of(self, call: GuardCall) -> Instruction:
        """The instruction of an accepted call."""
        instruction = self.manifest.instruction(call.instruction)
        assert instruction is not None, "unknown instructions are refused before"
        return instruction

    def start(self, channel: str, running: RunningCall) -> None:
        """An actuation starts on a channel."""
        self.active[channel] = running
        self.is_actuated = True

    def lock(self, reason: str) -> None:
        """Forbids the program to release the device, for a reason; '' has no effect, and the first reason
        remains.
        """
        self.lock_reason = self.lock_reason or reason

    def unlock(self) -> None:
        """Permits the program to release the device again."""
        self.lock_reason = ""

    def latch(self, reason: str, state: str) -> None:
        """Holds the device in a safe state, which is not confirmed yet."""
        self.latched, self.state, self.confirmed, self.retry_at = reason, state, False, None

    def release(self) -> None:
        """Ends the safe state: the device accepts calls again."""
        self.making = False
        self.latched, self.state, self.confirmed, self.is_actuated = "", "", False, False

    def confirm(self) -> None:
        """The safe state is confirmed."""
        self.confirmed = True

    def start_safe_state(self) -> None:
        """The command of the safe state starts."""
        self.making = True

    def end_safe_state(self, now: float) -> None:
        """The command of the safe state has ended, with or without success."""
        self.making, self.made_at = False, now

    def set_retry(self, at: float | None) -> None:
        """Sets the time when the safe state is commanded again; None for never."""
        self.retry_at = at

    def replace_reported(self, reason: str) -> str:
        """Sets the last reason logged for a sensor; returns the previous one."""
        before, self.reported = self.reported, reason
        return before

    def expiry(self) -> float | None:
        """The time when the first setpoint expires. A running actuation replaces it unless it fails."""
        if self.latched or not (self.setpoints or self.active):
            return None
        times = [until for channel, until in self.setpoints.items() if channel not in self.active]
        times += [
            running.call.sent + self.ttl for running in self.active.values() if running.kind == "setpoint"
        ]
        return min(times, default=None)

    def due(self) -> float | None:
        """The time when the next deadline of this device is due; None without any."""
        if not (self.setpoints or self.active):
            return self.retry_at
        times = (self.expiry(), self.retry_at, self.cancel_deadline())
        return min((time for time in times if time is not None), default=None)

    def running(self, token: int) -> RunningCall | None:
        """The running call of a token, None without one."""
        acting = (running for running in self.active.values() if running.call.token == token)
        return self.queries.get(token) or next(acting, None)

    def remove(self, running: RunningCall) -> None:
        """Removes a call that has ended."""
        self.queries.pop(running.call.token, None)
        self.active = {channel: other for channel, other in self.active.items() if other is not running}

    def cancel_deadline(self) -> float | None:
        """The time when the first cancelled call must have ended; None without any."""
        ends = (running.deadline for running in self.active.values() if running.cancelled is not None)
        return min(ends, default=None)

    def overdue_cancel(self, now: float) -> str:
        """A description of the cancelled call that has not ended in time; '' for none."""
        if not self.active:
            return ""
        late = (running.call for running in self.active.values() if now >= running.deadline)
        return next((f"{call.instruction}() is not done after {self.rest_within:g} s" for call in late), "")


class CoreState(Struct, frozen=True):
    """The data that a GuardCore stores between two events: `core.state`."""

    devices: list[GuardDevice]
    rest: StandstillState
    last_beat: float
    stopping: bool
    ended: bool
    muted: bool
