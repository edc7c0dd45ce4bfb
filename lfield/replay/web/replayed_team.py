"""The state of a recorded team at a time, by the read model that shows a running team.

The events up to that time are those that a subscriber would have received. They are followed by a batch of
each host with telemetry: activities of the agents from the replayed cores, and values of devices from the
guards.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator
from copy import deepcopy
from itertools import groupby

from lfield.host.status import telemetry_of
from lfield.host.subscriptions.telemetry_snapshot import agent_activity
from lfield.manifest import DeviceValue
from lfield.operator.team_model.team_contents import TeamContents
from lfield.operator.team_model.team_state import TeamState
from lfield.operator.team_model.team_view import TeamView
from lfield.replay.debugger.debugger import Debugger
from lfield.replay.debugger.device_readings import device_readings
from lfield.replay.debugger.moment import Moment
from lfield.replay.web.guard_index import GuardIndex
from lfield.replay.web.recorded_events import EventIndex, IndexedEvent
from lfield.wire.events import DeviceTelemetry, Event, TelemetryEvent
from lfield.wire.fields import bounded_duration
from lfield.wire.subscription_messages import MAX_EVENTS, EventBatch

#: Events between two copies of the view.
COPY_INTERVAL = 4000

NOT_RECORDED = "it has no recording at this time"


class ReplayedTeam:
    """The read model of a recorded team; `started_at` is the start of the recording in seconds since 1970."""

    def __init__(
        self,
        debugger: Debugger,
        contents: TeamContents,
        events: EventIndex,
        guards: GuardIndex,
    ) -> None:
        self._debugger, self._contents, self._events, self._guards = debugger, contents, events, guards
        team = debugger.team
        first = team.hosts[team.start.recording].recording
        self.started_at = first.start.wall - first.start.at + first.started_at
        #: A number that grows whenever the log begins again.
        self.epoch = 0
        self._view = TeamView(contents)
        #: The number of events in the view, and the share of the recording that was indexed at that time.
        self._count, self._progress = 0, -1.0
        #: Copies of the view by their numbers of events, in this order, so that a move back is quick.
        self._copies: dict[int, TeamView] = {}

    def state(self) -> TeamState:
        """The state at the position of the debugger."""
        debugger = self._debugger
        now = debugger.seconds
        self._feed_events(self._events.count_before(now if debugger.place.step == 0 else now + 1e-7))
        running = set(debugger.running)
        names = {number: debugger.team.hosts[number].recording.host for number in running}
        for name in self._contents.hosts:
            if name not in names.values():
                self._view.on_unlinked(name, NOT_RECORDED)
        for number in sorted(running):
            self._view.on_linked(names[number])
            self._feed(number, self._telemetry(number, now), now)
        return self._view.snapshot(now)

    def _feed_events(self, count: int) -> None:
        if self._progress != self._events.progress:
            # Events that are indexed later may be older than those of the view.
            self._copies = {0: TeamView(self._contents)}
            self._restore(0)
            self._progress = self._events.progress
        elif count < self._count:
            self._restore(max(each for each in self._copies if each <= count))
        while self._count < count:
            self._feed_range(min(count, self._count + COPY_INTERVAL - self._count % COPY_INTERVAL))
            if self._count % COPY_INTERVAL == 0 and self._count not in self._copies:
                self._copies[self._count] = self._copy_of(self._view)

    def _restore(self, count: int) -> None:
        self.epoch += 1
        self._view, self._count = self._copy_of(self._copies[count]), count

    def _copy_of(self, view: TeamView) -> TeamView:
        return deepcopy(view, {id(self._contents): self._contents})

    def _feed_range(self, count: int) -> None:
        for number, group in groupby(self._events.events(self._count, count), lambda each: each.recording):
            events = list(group)
            for first in range(0, len(events), MAX_EVENTS):
                self._feed_group(number, events[first : first + MAX_EVENTS])
        self._count = count

    def _feed_group(self, number: int, events: list[IndexedEvent]) -> None:
        self._feed(number, [each.event for each in events], events[-1].time)

    def _feed(self, number: int, events: list[Event], now: float) -> None:
        team = self._debugger.team
        start = team.hosts[number].recording.start
        uptime, wall = self._uptime(number, now), self.started_at + now
        latest = max((each.number for each in events), default=0)
        batch = EventBatch(start.incarnation, 1, wall, uptime, 0, latest, events)
        self._view.feed(start.host, batch, now, wall)

    def _uptime(self, number: int, now: float) -> float:
        """The seconds since the start of a host at a time of the team."""
        host, times = self._debugger.team.hosts[number], self._debugger.team.times[number]
        turn = max(0, bisect_right(times, now) - 1)
        return max(0.0, host.ats[turn] - host.recording.start.at + now - times[turn])

    # --- telemetry ------------------------------------------------------------------------------------

    def _telemetry(self, number: int, now: float) -> list[Event]:
        moment = self._debugger.moment_of(number)
        found: list[TelemetryEvent] = [
            agent_activity(agent, moment.core) for agent in moment.agents.values() if not agent.ended
        ]
        found += self._device_values(number, moment, now)
        uptime, wall = self._uptime(number, now), self.started_at + now
        return [Event(0, wall, uptime, 0, event) for event in found]

    def _device_values(self, number: int, moment: Moment, now: float) -> Iterator[DeviceTelemetry]:
        recorded = self._guards.devices
        for device, recording in recorded.items():
            known = self._guards.values_at(device, now)
            is_here = self._debugger.team.hosts[recording].recording.host == moment.core.name
            if is_here and known is not None:
                yield DeviceTelemetry(device, telemetry_of(known[0]), bounded_duration(known[1]))
        # Without recordings of the guards: the readings of the program.
        values: dict[str, dict[str, DeviceValue]] = {}
        for reading in device_readings(moment):
            device = f"{reading.agent}.{reading.device}"
            if device not in recorded:
                values.setdefault(device, {})[reading.instruction] = _device_value(reading.value)
        for device, read in values.items():
            yield DeviceTelemetry(device, telemetry_of(read), 0.0)


def _device_value(value: object) -> DeviceValue:
    """A recorded answer of a device, None for one that has no such type."""
    if isinstance(value, list):
        return [each for each in value if isinstance(each, int | float)]
    return value if isinstance(value, bool | int | float | str) else None
