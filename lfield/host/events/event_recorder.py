"""Event recorder: the only writer of a host's event log; assigns numbers and causes. Sans-IO.

The cause of an agent's event is the last event of that agent here; of a portal event the last event of the
call; of a device event the instruction, or the event that made the device safe. Frequent kinds have a budget
each. Portal and device calls are recorded only while the recorder is `detailed`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Literal

from msgspec import Struct

from lfield.clock import Clock
from lfield.host.events.event_log import EventLog
from lfield.host.events.event_rate_limit import (
    INSTRUCTIONS,
    PIECE,
    PORTALS,
    PRINTS,
    REFILL_EVERY,
    EventRateLimiter,
    RateLimit,
)
from lfield.hybrid_clock import HybridClock
from lfield.text import log_messages
from lfield.text.log_messages import LogLine
from lfield.wire import events
from lfield.wire.coordinator_messages import Outcome
from lfield.wire.events import StateEvent
from lfield.wire.fields import MAX_LABEL, bounded_duration, truncate

#: Minimum interval between two reports of a latched device's movement, in seconds.
MOVING_EVENT_EVERY = 1.0


class _Call(Struct):
    """A portal call under way: caller, resource and portal; its last event, and when it started."""

    agent: str
    resource: str
    portal: str
    last: int
    started_at: float


class _Instruction(Struct):
    """A device instruction under way."""

    call: int
    agent: str
    device: str
    instruction: str
    portal: int
    number: int
    started_at: float


class EventRecorder:
    """The event stream of one incarnation of a host, which starts now, and the causes of events.

    `log` writes the findings about clocks. Each event has the timestamp of the hybrid clock, taken when the
    event is emitted, or at the step of the hop that the event is made of.
    """

    def __init__(self, clock: Clock, log: Callable[[LogLine], None] = lambda line: None) -> None:
        self._clock, self.now, self._started_at = clock, clock.monotonic, clock.monotonic()
        self.event_log = EventLog()
        #: Gives the timestamps of events and messages.
        self.hybrid_clock = HybridClock(
            self._started_at,
            clock.time(),
            lambda host, seconds: log(log_messages.CLOCK_AHEAD.line(host=host, seconds=seconds)),
            lambda seconds: log(log_messages.CLOCK_SET.line(seconds=seconds)),
        )
        #: Whether portal and device calls are recorded.
        self.detailed = False
        #: Called after every state event.
        self._on_event: Callable[[], None] | None = None
        #: Called before each event that the core does not make: orders of an operator, and log lines.
        self._on_shell_event: Callable[[StateEvent], None] | None = None
        self._limiters: list[EventRateLimiter] = []
        self._sources: list[Callable[[], None]] = []
        #: The time when budgets are refilled next, on the monotonic clock.
        self.due = 0.0
        self._portals, self._commands = self.new_limiter(PORTALS), self.new_limiter(INSTRUCTIONS)
        self._prints = self.new_limiter(PRINTS)
        #: The last event of each agent, of each device, and of the link with each host.
        self._last_of_agent: dict[str, int] = {}
        self._last_of_device: dict[str, int] = {}
        self._last_of_host: dict[str, int] = {}
        #: The events that caused devices to go into their safe states, by reason.
        self._causes: dict[str, int] = {}
        self._calls: dict[int, _Call] = {}
        self._instructions: dict[tuple[str, int], _Instruction] = {}
        self._device_calls_made = 0
        self._motion_reports: dict[str, tuple[bool, float]] = {}
        self._refused: dict[str, bool] = {}

    def listen(self, on_event: Callable[[], None] | None) -> None:
        """Set the callback that is called after every event; None for none."""
        self._on_event = on_event

    def watch_shell(self, on_event: Callable[[StateEvent], None] | None) -> None:
        """Set the callback for events that the core does not make: a replay does not make these events
        either.
        """
        self._on_shell_event = on_event

    def _emit_of_shell(self, event: StateEvent) -> int:
        if self._on_shell_event is not None:
            self._on_shell_event(event)
        return self.emit(event)

    def restart(self) -> None:
        """Forget the events, and refill all budgets: a replay has jumped to another time."""
        self.event_log = EventLog()
        self.due = 0.0
        for budget in self._limiters:
            budget.restart()

    def add_source(self, drain: Callable[[], None]) -> None:
        """Add a part that records events later: `drain` emits its pending events in order."""
        self._sources.append(drain)

    def drain(self) -> None:
        """Emit all pending events."""
        for drain in self._sources:
            drain()

    @property
    def uptime(self) -> float:
        """Seconds since the start of the host, by its monotonic clock."""
        return self._clock.monotonic() - self._started_at

    def emit(self, event: StateEvent, cause: int = 0) -> int:
        """Record an event now; returns its number."""
        self.drain()
        return self.emit_at(event, self._clock.monotonic(), cause)

    def emit_at(self, event: StateEvent, at: float, cause: int = 0, stamp: int = 0) -> int:
        """Record an event at this time of the monotonic clock; returns its number."""
        clock = self.hybrid_clock
        if not stamp:
            clock.set_wall_time(at, self._clock.time())
            stamp = clock.tick(at)
        number = self.event_log.append(event, clock.wall_time(at), at - self._started_at, cause, stamp)
        if self._on_event is not None:
            self._on_event()
        return number

    def new_limiter(self, watched: RateLimit, unwatched: RateLimit | None = None) -> EventRateLimiter:
        """A new limiter, refilled together with all others."""
        self._limiters.append(EventRateLimiter(self.emit, watched, unwatched))
        return self._limiters[-1]

    def set_detailed(self, *, on: bool) -> None:
        """Set whether details are recorded, since there are subscribers."""
        self.drain()
        self.detailed = on
        for budget in self._limiters:
            budget.set_observed(on=on)

    def refill(self, now: float) -> None:
        """Refill the budgets for the elapsed time."""
        self.drain()
        self.hybrid_clock.set_wall_time(now, self._clock.time())
        self.due = now + REFILL_EVERY
        for budget in self._limiters:
            budget.refill(now)

    def report_dropped(self, *, at_once: bool = False) -> None:
        """Report dropped events, if due or `at_once`."""
        self.drain()
        now = self.uptime
        for budget in self._limiters:
            budget.report_dropped(now, at_once=at_once)

    def emit_for_agent(
        self, agent: str, event: StateEvent, cause: int | None = None, at: float | None = None, stamp: int = 0
    ) -> int:
        """Record an agent's event, caused by the last event of the agent or by `cause`; returns its number.
        `at` is its time.
        """
        if at is None:
            self.drain()
            at = self._clock.monotonic()
        cause = self._last_of_agent.get(agent, 0) if cause is None else cause
        number = self._last_of_agent[agent] = self.emit_at(event, at, cause, stamp)
        return number

    # --- agents ---------------------------------------------------------------------------------------

    def on_agent_started(self, agent: str, generation: int, *, is_restored: bool = False) -> None:
        """An agent runs here."""
        self.emit_for_agent(agent, events.AgentStarted(agent, generation, is_restored))

    def on_agent_finished(self, agent: str, generation: int, how: Outcome, detail: str) -> None:
        """An agent has ended."""
        self.emit_for_agent(agent, events.AgentFinished(agent, generation, how, truncate(detail)))

    def on_printed(self, agent: str, text: str) -> None:
        """A line of `print`."""
        self._emit_output(events.Printed(agent, truncate(text)))

    def on_written(self, agent: str, text: str) -> None:
        """Output of `write`."""
        self._emit_output(events.Printed(agent, truncate(text), "out"))

    def _emit_output(self, event: events.Printed) -> None:
        if self._prints.try_acquire("printed", max(1.0, len(event.text) / PIECE)):
            self.emit_for_agent(event.agent, event)

    # --- portals, and instructions to devices ---------------------------------------------------------

    def on_call_started(self, call: int, agent: str, resource: str, portal: str) -> None:
        """A portal call has started; `call` identifies it until it ends."""
        if not self._portals.try_acquire("began"):
            return
        uptime = self.uptime
        portal = truncate(portal, MAX_LABEL)
        number = self.emit_for_agent(agent, events.PortalCallStarted(call, agent, resource, portal))
        self._last_of_agent[resource] = number
        self._calls[call] = _Call(agent, resource, portal, number, uptime)

    def discard_calls(self) -> None:
        """Discard the calls under way: the ends of these calls will not be recorded."""
        self._calls.clear()

    def is_recorded(self, call: int) -> bool:
        """Whether the start of a portal call under way was recorded."""
        return call in self._calls

    def on_call_ended(self, call: int, how: Literal["done", "thrown", "lost"], detail: str = "") -> None:
        """A portal call has ended; the end is recorded only if the start was."""
        known = self._calls.pop(call, None)
        if known is None:
            return
        seconds, detail = bounded_duration(self.uptime - known.started_at), truncate(detail)
        event = events.PortalCallEnded(call, known.agent, known.resource, known.portal, seconds, how, detail)
        number = self.emit(event, known.last)
        self._last_of_agent[known.agent] = self._last_of_agent[known.resource] = number

    def on_resource_died(self, resource: str, reason: str) -> None:
        """A resource has died: all its portal calls end."""
        for call in [call for call, known in self._calls.items() if known.resource == resource]:
            self.on_call_ended(call, "lost", reason)

    def on_device_call(self, agent: str, thread: int, portal: int, device: str, instruction: str) -> None:
        """A thread of an agent gives a device an instruction, for the portal call of that number, 0 without
        one.
        """
        if not self._commands.try_acquire("asked"):
            return
        uptime = self.uptime
        self._device_calls_made += 1
        device, instruction = truncate(device, MAX_LABEL), truncate(instruction, MAX_LABEL)
        known = self._calls.get(portal)
        cause = known.last if known is not None else self._last_of_agent.get(agent, 0)
        number = self.emit(
            events.DeviceCallStarted(self._device_calls_made, agent, device, instruction), cause
        )
        call = _Instruction(self._device_calls_made, agent, device, instruction, portal, number, uptime)
        self._instructions[agent, thread] = call
        self._link_cause(call, number)

    def on_device_answer(self, agent: str, thread: int, error: str) -> None:
        """The device has answered."""
        call = self._instructions.pop((agent, thread), None)
        if call is None:
            return
        seconds = bounded_duration(self.uptime - call.started_at)
        event = events.DeviceCallEnded(
            call.call, agent, call.device, call.instruction, seconds, truncate(error)
        )
        self._link_cause(call, self.emit(event, call.number))

    def _link_cause(self, call: _Instruction, number: int) -> None:
        self._last_of_agent[call.agent] = self._last_of_device[call.device] = number
        if (known := self._calls.get(call.portal)) is not None:
            known.last = number

    # --- devices --------------------------------------------------------------------------------------

    def set_cause(self, reason: str, number: int) -> None:
        """Set the event that causes devices to go into their safe states for that reason."""
        self._causes = {**dict(list(self._causes.items())[-63:]), truncate(reason): number}

    def on_orphaned_devices(self, reason: str, users: tuple[str, ...]) -> None:
        """Devices go into their safe states because none of these coordinators is confirmed alive."""
        self.set_cause(reason, max((self._last_of_agent.get(user, 0) for user in users), default=0))

    def on_device_event(
        self,
        event: events.DeviceLatched | events.SafeStateConfirmed | events.DeviceMoving | events.DeviceReleased,
    ) -> None:
        """A device goes into its safe state, reaches it, comes to rest, or is in use again."""
        cause = self._last_of_device.get(event.device, 0)
        match event:
            case events.DeviceLatched():
                self._motion_reports.pop(event.device, None)
                cause = self._causes.get(event.reason, 0)
            case events.SafeStateConfirmed() if not cause:
                cause = self._causes.get(event.reason, 0)
            case events.DeviceMoving() if not self._is_new_motion(event):
                return
        self._last_of_device[event.device] = self.emit(event, cause)

    def _is_new_motion(self, event: events.DeviceMoving) -> bool:
        """Whether the movement of a device is reported again."""
        moving, now = bool(event.moving), self.uptime
        before, at = self._motion_reports.get(event.device, (None, 0.0))
        if moving is before and (not moving or now - at < MOVING_EVENT_EVERY):
            return False
        self._motion_reports[event.device] = moving, now
        return True

    # --- the team and operators -----------------------------------------------------------------------

    def on_linked(self, host: str, *, restarted: bool) -> None:
        """A link with a host opened."""
        self._last_of_host[host] = self.emit(events.LinkUp(host, restarted))

    def on_unlinked(self, host: str, *, lost: bool) -> None:
        """A link with a host closed."""
        self._last_of_host[host] = self.emit(events.LinkDown(host, lost))

    def on_offers(self, refusals: Mapping[str, str], hosts: Mapping[str, str]) -> None:
        """Record which agents have become callable or not: why each cannot be called ('' if it can), and its
        host."""
        for agent, refusal in refusals.items():
            before = self._refused.get(agent)
            self._refused[agent] = bool(refusal)
            if before is None or before is bool(refusal):
                continue
            cause = self._last_of_host.get(hosts.get(agent, ""), 0)
            event = (
                events.OfferWithdrawn(agent, truncate(refusal)) if refusal else events.OfferPublished(agent)
            )
            self.emit(event, cause or self._last_device_event(agent))

    def _last_device_event(self, agent: str) -> int:
        return max((n for d, n in self._last_of_device.items() if d.startswith(f"{agent}.")), default=0)

    def on_link_refused(self, host: str, reason: str) -> None:
        """No link with a host can be made, for that reason; '' when a link is possible again."""
        self.emit(events.LinkRefused(host, truncate(reason)))

    def on_start_delayed(self, agents: Sequence[str], hosts: Sequence[str], held: str) -> None:
        """Coordinators wait to be started; without any coordinators, the wait is over."""
        self.emit(
            events.StartDelayed(truncate(", ".join(agents)), truncate(", ".join(hosts)), truncate(held))
        )

    def on_readers_changed(self, agents: Sequence[str]) -> None:
        """The agents that wait for a line of the operator's input have changed."""
        self.emit(events.InputAwaited(truncate(", ".join(agents))))

    def on_emergency_stop(self, by: str, reason: str, *, lifted: bool) -> None:
        """An operator has sent or lifted an emergency stop."""
        number = self._emit_of_shell(events.EmergencyStopChanged(truncate(by), truncate(reason), lifted))
        if not lifted:
            self.set_cause(reason, number)

    def on_pause(self, by: str, reason: str, *, lifted: bool, is_vote: bool = False) -> None:
        """An operator or a vote has paused or resumed the mission; devices are held for that reason."""
        self.set_cause(reason, self._emit_of_shell(events.PauseChanged(truncate(by), lifted, is_vote)))

    def on_host_stopping(self, description: str, reason: str) -> None:
        """The host stops; devices go into their safe states for that reason."""
        self.set_cause(reason, self._emit_of_shell(events.HostStopping(truncate(description))))

    def on_log_line(self, line: LogLine) -> None:
        # msgspec encodes no subclass of str.
        self._emit_of_shell(events.LineLogged(truncate(str(line)), line.code, line.level))
