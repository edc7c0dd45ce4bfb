"""Events about the coordinators of a host: migrations, starts and ends. Sans-IO.

A hop only appends one tuple with the time to `hops` at each of its steps. The events are made from these
tuples before the next event of another kind, when a subscriber reads the log, and four times a second.
"""

from __future__ import annotations

from enum import IntEnum
from typing import Any

from msgspec import Struct

from lfield.host.events.event_rate_limit import MIGRATIONS, MIGRATIONS_UNOBSERVED
from lfield.host.events.event_recorder import EventRecorder
from lfield.mission.team import Team
from lfield.replication.transfer import effects as mobile
from lfield.vm.agent import Agent
from lfield.vm.machine import Machine
from lfield.wire import events
from lfield.wire.coordinator_messages import TERMINATED, CoordinatorState, Transfer
from lfield.wire.fields import MAX_LABEL, bounded_duration, truncate


class _InFlight(Struct):
    """A hop that was sent and is not confirmed: its name, its event (0: in an earlier incarnation), and the
    time of sending on the monotonic clock.

    `returned_at` is the time when the coordinator came back, which is equivalent to a confirmation.
    """

    to: str
    generation: int
    sequence: int
    event_number: int
    sent_at: float
    returned_at: float = 0.0


class HopStep(IntEnum):
    """The steps of a hop, with the fields after the time in the tuple of each.

    Sent: the host, the header, the resource, and the portal or its index. Arrived: the host and the header.
    Running: name, generation, sequence and a timestamp. Confirmed: the effect and a timestamp.
    """

    SENT = 0
    ARRIVED = 1
    RUNNING = 2
    CONFIRMED = 3


class MigrationEvents:
    """Records events of the coordinators of a `team` on its host `own_host`."""

    def __init__(self, recorder: EventRecorder, machine: Machine, own_host: str, team: Team) -> None:
        self._recorder, self._machine, self._own_host, self._hosts = recorder, machine, own_host, team.hosts
        self._known = frozenset(member.id for member in team.coordinators)
        self._limiter = recorder.new_limiter(MIGRATIONS, MIGRATIONS_UNOBSERVED)
        #: The coordinators that have arrived and do not run yet: sender and header.
        self._arriving: dict[str, tuple[str, Transfer]] = {}
        self._in_flight: dict[str, _InFlight] = {}
        #: The steps of hops for which no events are made yet, with the time of each on the monotonic clock.
        self.hops: list[tuple[Any, ...]] = []
        self._steps = self._on_sent, self._on_arrived, self._on_running, self._on_confirmed
        recorder.add_source(self.drain)

    # --- a hop ----------------------------------------------------------------------------------------

    def drain(self) -> None:
        """Make the events of all recorded steps."""
        if not self.hops:
            return
        steps = self.hops.copy()
        self.hops.clear()
        for step, *details in steps:
            self._steps[step](*details)

    def target_of(self, name: str) -> tuple[str, str]:
        """The resource and the portal that a frozen coordinator calls."""
        agent = self._machine.agents.get(name)
        called = self._machine.itinerary.current_target(agent) if agent is not None and agent.frozen else None
        return (called[0].id, called[1]) if called is not None else ("", "")

    def _on_sent(self, at: float, target: str, header: Transfer, resource: str, portal: str | int) -> None:
        """A coordinator is sent; a repetition is not recorded."""
        if not self._limiter.try_acquire("left"):
            return
        name, hop = header.agent, self._in_flight.get(header.agent)
        if hop is not None and (hop.generation, hop.sequence) == (header.generation, header.sequence):
            return
        if isinstance(portal, int):
            portal = self._machine.program.core.methods[portal].name
        generation, sequence = header.generation, header.sequence
        portal = truncate(portal, MAX_LABEL)
        event = events.MigrationStarted(name, generation, sequence, target, resource, portal, header.size)
        number = self._recorder.emit_for_agent(name, event, at=at, stamp=header.stamp)
        self._in_flight[name] = _InFlight(target, generation, sequence, number, at)

    def _on_arrived(self, at: float, host: str, header: Transfer) -> None:
        """A coordinator arrived; whether the coordinator runs is decided later. Unknown coordinators are
        ignored.
        """
        if header.agent in self._known:
            self._arriving[header.agent] = host, header
            if (hop := self._in_flight.get(header.agent)) is not None:
                hop.returned_at = at

    def _on_running(self, at: float, name: str, generation: int, sequence: int | None, stamp: int) -> None:
        """An arrived coordinator runs here, or a stored one is resumed."""
        arrival = self._arriving.pop(name, None)
        if arrival is None:
            return
        is_reported, hop = self._limiter.try_acquire("came"), self._in_flight.get(name)
        if not is_reported and hop is None:
            return
        host, header = arrival
        # An earlier arrival that was refused does not belong to this one.
        if (header.generation, header.sequence) != (generation, sequence):
            return
        if hop is not None and hop.generation == generation and hop.sequence < header.sequence:
            # A coordinator that returns at once is its own confirmation: its host sends no other
            # confirmation.
            self._emit_confirmed(name, hop, hop.returned_at, at, stamp)
        if is_reported:
            event = events.MigrationArrived(name, generation, header.sequence, host, header.size)
            self._recorder.emit_for_agent(name, event, cause=0, at=at, stamp=stamp)

    def _on_confirmed(self, at: float, effect: mobile.MarkMigrated, stamp: int) -> None:
        """The sender has the confirmation: recorded only for hops whose departure was recorded."""
        hop = self._in_flight.get(effect.agent)
        if hop is not None and (hop.generation, hop.sequence) == (effect.generation, effect.sequence):
            self._emit_confirmed(effect.agent, hop, at - effect.held, at, stamp)

    def _emit_confirmed(
        self, name: str, in_flight: _InFlight, arrived: float, at: float, stamp: int = 0
    ) -> None:
        """A hop that arrived at the time `arrived` was confirmed at the time `at`."""
        del self._in_flight[name]
        seconds = bounded_duration(arrived - in_flight.sent_at) if in_flight.event_number else None
        event = events.MigrationConfirmed(
            name, in_flight.generation, in_flight.sequence, in_flight.to, seconds
        )
        self._recorder.emit_at(event, at, in_flight.event_number, stamp)

    def restore_in_flight(self, known: CoordinatorState) -> None:
        """A hop that was sent in an earlier incarnation of this host."""
        self.drain()
        self._in_flight[known.agent] = _InFlight(known.where, known.generation, known.sequence, 0, 0.0)

    # --- other events ---------------------------------------------------------------------------------

    def on_failed(self, agent: Agent, exception: str, reason: str, *, recovered: bool) -> None:
        """A frozen coordinator is about to resume here with an exception: its hop has failed, or it is
        `recovered` from a copy.
        """
        self.drain()
        self._in_flight.pop(agent.id, None)
        if recovered:
            self._recorder.emit_for_agent(agent.id, events.CoordinatorRecovered(agent.id, agent.generation))
        elif self._limiter.try_acquire("stayed"):
            target, _, _ = self._call_target(agent)
            name = agent.id, agent.generation, agent.sequence
            self._recorder.emit_for_agent(
                agent.id, events.MigrationFailed(*name, target, exception, truncate(reason))
            )

    def on_effect(self, effect: mobile.Effect) -> None:
        """A rare effect is about to be executed."""
        self.drain()
        match effect:
            case mobile.CoordinatorStarted():
                self._recorder.emit_for_agent(
                    effect.agent, events.AgentStarted(effect.agent, effect.generation)
                )
            case mobile.MarkInDoubt():
                reason = truncate(effect.reason)
                event = events.MigrationInDoubt(effect.agent, effect.generation, effect.host, reason)
                self._recorder.emit_for_agent(effect.agent, event)
            case mobile.TerminateCopy():
                agent = self._machine.agents.get(effect.agent)
                if agent is not None and agent.generation == effect.generation:
                    reason = truncate(effect.reason)
                    self._recorder.emit_for_agent(
                        effect.agent, events.CoordinatorSuperseded(effect.agent, effect.generation, reason)
                    )
            case mobile.DropTerminated():
                self._on_terminated(effect)

    def _on_terminated(self, effect: mobile.DropTerminated) -> None:
        """A coordinator has ended on another host: unless the coordinator was lost, the hops that this host
        has sent have arrived there.
        """
        hop = self._in_flight.get(effect.agent)
        if hop is not None and hop.generation == effect.generation:
            if effect.outcome in TERMINATED:
                now = self._recorder.now()
                self._emit_confirmed(effect.agent, hop, now, now)
            else:
                del self._in_flight[effect.agent]
        if effect.host == self._own_host:
            # Each termination is recorded where it happened; a loss is recorded by the host that detects it.
            self._recorder.on_agent_finished(effect.agent, effect.generation, effect.outcome, effect.detail)

    def _call_target(self, agent: Agent) -> tuple[str, str, str]:
        """The host, the resource and the portal of a frozen coordinator's call."""
        called = self._machine.itinerary.current_target(agent) if agent.frozen else None
        return (self._hosts[called[0].host], called[0].id, called[1]) if called is not None else ("", "", "")
