"""The read model of one host: its snapshot and the events after it in, `HostState` out. Pure.

Every command that shows or uses the state of hosts reads this model: `ps`, `query`, `forget`, `recover`,
`up --fresh`, `pause` and `estop` after one snapshot; the live table of `up` and the page as long as events
come. Times are seconds of the monotonic clock of this computer, `wall` is its Unix time.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import TypeVar

from msgspec.structs import replace

from lfield.errors import LfieldError, WireError
from lfield.operator.team_model.device_tracker import DeviceEvent, DeviceTracker
from lfield.operator.team_model.log_buffer import LogEvent
from lfield.operator.team_model.team_state import HostState, LinkState, LocalPosition
from lfield.wire import events
from lfield.wire.fields import short_digest
from lfield.wire.observer_messages import EmergencyStopResult, LinkStatus, Status
from lfield.wire.subscription_messages import EventBatch

K = TypeVar("K")

#: Maximum drift between the clocks of two computers (s/s).
DRIFT = 2e-4


#: A link that has not been measured.
NO_LINK = LinkState()


class HostModel:
    """One host, at first with the devices that `has_safe_state` names.

    `known` is the state of the host except ages, dictionaries and devices. `first_after` is the number of the
    event before the first one that was received, `past` that of the newest event that a snapshot includes.
    `refusals` are the devices that have not confirmed an order, with the reasons.
    """

    def __init__(
        self,
        name: str,
        place: LocalPosition | None = None,
        has_safe_state: Mapping[str, bool | None] | None = None,
    ) -> None:
        self.devices, self._lost = DeviceTracker(has_safe_state or {}), Counter[str]()
        self.known = HostState(name, problem="no contact yet", position=place)
        self._start_life()

    def _start_life(self) -> None:
        self.incarnation = self.past = 0
        self.first_after: int | None = None
        self.stopped_by = ""
        self.stopped_at: float | None = None
        self.refusals: Mapping[str, str] = {}
        self.offers: dict[str, str] = {}
        #: The time of the last batch, the offset of our monotonic clock to that of the host (by the quickest
        #: batch so far), and the last time of that clock.
        self._last_update: float | None = None
        self._clock: float | None = None
        self._uptime = 0.0
        self._refused: dict[str, str] = {}
        self._links: dict[str, LinkState] = {}
        self._silent_since: dict[str, float] = {}

    # --- in -------------------------------------------------------------------------------------------

    def on_linked(self) -> None:
        self.known = replace(self.known, linked=True, problem="", error=None)

    def on_unlinked(self, reason: str, error: LfieldError | None = None) -> None:
        """Record that there is no link, or that the host has not answered, because of an `error`."""
        self.known = replace(self.known, linked=False, problem=reason, error=error)

    def on_restarted(self) -> None:
        """Start a new incarnation of the host: only the telemetry is kept, and its clock may be another
        one.
        """
        known = self.known
        self.devices.on_restarted()
        self.known = HostState(known.host, position=known.position, restarts=known.restarts + 1)
        self._start_life()

    def on_batch(self, batch: EventBatch, now: float, wall: float, took: float | None = None) -> None:
        """Handle a batch, except its events and its snapshot.

        `took` is the time from the request to a first batch, which is the uncertainty of the host's clock.
        """
        self.on_linked()
        self.incarnation = batch.incarnation
        self.first_after = batch.after if self.first_after is None else self.first_after
        self._last_update, self._uptime = now, batch.up
        behind = now - batch.up
        self._clock = behind if self._clock is None else min(behind, self._clock + DRIFT)
        if took is not None or self.known.clock_offset is None:
            self.known = replace(self.known, clock_offset=batch.now - wall, clock_uncertainty=took)
        self._lost.update(batch.lost)

    def on_snapshot(self, report: Status, latest: int, now: float) -> None:
        """Handle the state of the host as of its event number `latest`."""
        self.past, start, bundle = latest, report.start, report.bundle
        self.known = replace(
            self.known,
            report=report,
            paused=report.paused,
            held_by_vote=bool(report.ballot),
            stopped=report.stopped,
            jitter=report.late,
            bundle=short_digest(bundle.digest) if bundle is not None else "",
            waits_for=tuple(start.hosts) if start is not None else (),
            start_held=start.held if start is not None else "",
            awaiting_input=tuple(report.reads),
        )
        self._refused = {refused.host: refused.reason for refused in report.refused}
        self._links = {link.host: _measured(link) for link in report.links if link.away is None}
        self._silent_since = {link.host: now - link.away for link in report.links if link.away is not None}
        self.offers = {entry.agent: entry.refusal for entry in report.directory}
        self.devices.on_snapshot(report.devices, now)

    def on_past_event(self, event: object, when: float) -> None:
        """Handle an event before the snapshot: only its time and operator are used."""
        if isinstance(event, events.EmergencyStopChanged) and self.known.stopped and not event.lifted:
            self.stopped_by, self.stopped_at = event.by, when

    def on_event(self, event: object, when: float) -> None:
        """Handle an event after the snapshot. Portal calls and instructions leave no state."""
        if isinstance(event, DeviceEvent):
            self.devices.on_event(event, when)
        match event:
            case events.EmergencyStopChanged(by, reason, lifted):
                stopped = "" if lifted else reason or "the emergency stop was pressed"
                self.known = replace(self.known, stopped=stopped)
                self.stopped_by, self.stopped_at = ("", None) if lifted else (by, when)
                self.refusals = {}
            case events.PauseChanged(_, lifted, True):
                self.known = replace(self.known, held_by_vote=not lifted)
            case events.PauseChanged(_, lifted):
                self.known = replace(self.known, paused=not lifted)
            case events.HostStopping(reason):
                self.known = replace(self.known, end_reason=reason)
            case events.LinkRefused(peer, reason):
                self._refused.pop(peer, None)
                if reason:
                    self._refused[peer] = reason
            case events.StartDelayed(_, hosts, held):
                waits_for = tuple(filter(None, hosts.split(", ")))
                self.known = replace(self.known, waits_for=waits_for, start_held=held)
            case events.InputAwaited(agents):
                self.known = replace(self.known, awaiting_input=tuple(filter(None, agents.split(", "))))
            case events.LinkUp(peer):
                self._links[peer] = LinkState()
                self._silent_since.pop(peer, None)
            case events.LinkDown(peer, lost):
                self._links.pop(peer, None)
                if lost:
                    self._silent_since[peer] = when
            case events.LinkTelemetry(peer) if peer in self._links:
                self._links[peer] = _measured(event, self._links[peer])
            case events.OfferPublished(agent):
                self.offers[agent] = ""
            case events.OfferWithdrawn(agent, reason):
                self.offers[agent] = reason or "it cannot be called"
            case _:
                pass

    def on_log_event(self, event: LogEvent) -> None:
        """Handle an event of the log: events that the host itself has dropped are lost."""
        if isinstance(event, events.EventsDropped):
            self._lost[event.skipped] += event.count

    def on_answer(self, answer: EmergencyStopResult) -> None:
        """Handle the answer to an order, which names the devices that have a safe state."""
        self.devices.on_movable(answer.devices)
        self.refusals = {device: reason for device, reason in answer.devices.items() if reason}

    # --- out ------------------------------------------------------------------------------------------

    def when(self, uptime: float, now: float) -> float:
        """The time on our clock at which the clock of the host showed `uptime`; not later than now."""
        return now if self._clock is None else min(now, uptime + self._clock)

    def state(self, now: float) -> HostState:
        """The state of the host at that time."""
        since = None if self._last_update is None else max(0.0, now - self._last_update)
        return replace(
            self.known,
            age=since,
            uptime=None if since is None else self._uptime + (since if self.known.linked else 0.0),
            refused=dict(self._refused),
            links=dict(self._links),
            unreachable_for={peer: max(0.0, now - when) for peer, when in self._silent_since.items()},
            lost_events=dict(self._lost),
            devices=self.devices.states(self.known.host, now, fresh=self.known.linked),
        )


def host_states(answers: Mapping[K, EventBatch | LfieldError]) -> dict[K, HostState]:
    """The hosts after one snapshot each, at the moment of their answers.

    A host whose answer has no snapshot counts as one that has not answered.
    """
    states = {}
    for key, answer in answers.items():
        host = HostModel("")
        if isinstance(answer, EventBatch) and answer.snapshot is not None:
            host = HostModel(answer.snapshot.host)
            host.on_batch(answer, 0.0, 0.0)
            host.on_snapshot(answer.snapshot, answer.latest, 0.0)
        else:
            error = answer if isinstance(answer, LfieldError) else WireError("the answer has no snapshot")
            host.on_unlinked(str(error), error)
        states[key] = host.state(0.0)
    return states


def _measured(measurement: LinkStatus | events.LinkTelemetry, before: LinkState = NO_LINK) -> LinkState:
    status = measurement if isinstance(measurement, LinkStatus) else before
    return LinkState(
        measurement.round_trip,
        measurement.loss,
        measurement.sent,
        measurement.received,
        status.kinds,
        status.path,
        status.standby,
    )
