"""The host interface of the machine (`HostInterface`): passes each query to the responsible part. Sans-IO."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Protocol

from lfield.bytecode.program import DeviceCallRecord
from lfield.host.context import HostContext
from lfield.host.effects import WAKE_WAITERS, DumpAgent, WriteLog, WriteOutput
from lfield.host.offer_queries import CapabilityQueries
from lfield.host.team.coordinators import Coordinators
from lfield.host.team.device_commands import DeviceCommands
from lfield.host.team.leases import TeamLeases
from lfield.host.team.part_interfaces import CallEnds, CallWatcher, SequencingDecisions
from lfield.host.team.pending_call_store import PendingCallStore
from lfield.host.team.reachability import Reachability
from lfield.host.team.reservation_service import ReservationService
from lfield.manifest import DeviceValue
from lfield.replication.membership.membership import Membership
from lfield.text import log_messages
from lfield.text.log_messages import LogLine
from lfield.vm.agent import Agent, TeamMember
from lfield.vm.engine_interface import Reading
from lfield.vm.host_interface import Pending
from lfield.vm.offer_objects import FoundOffer
from lfield.vm.pending_call import CallRequest, PendingCall
from lfield.wire.coordinator_messages import Outcome


class HostParts(Protocol):
    """The parts of a host that serve its machine; looked up at each query."""

    coordinators: Coordinators
    leases: TeamLeases
    pending_calls: PendingCallStore
    person_calls: CallEnds
    reservations: ReservationService
    sequencing: SequencingDecisions
    commands: DeviceCommands
    offers: CapabilityQueries
    reachability: Reachability
    membership: Membership
    call_watch: CallWatcher

    def require_link(self, host: str) -> None:
        """Request a link to this host, if there is none."""


class HostServices:
    """The host's side of the machine (`HostInterface`), and the liveness of other hosts (`HostLiveness`).

    The parts are created after the machine, so they are looked up in `parts` at each query.
    """

    def __init__(self, context: HostContext, parts: HostParts) -> None:
        self._parts, self._hosts, self._recorder = parts, context.team.hosts, context.recorder
        self._out = context.effects.append

    def write(self, agent: Agent, text: str) -> None:
        """Program output."""
        self._recorder.on_written(agent.id, text)
        self._out(WriteOutput(agent.id, text))

    def log(self, agent: Agent, text: str) -> None:
        """A line of `print`."""
        self._recorder.on_printed(agent.id, text)
        line = log_messages.PROGRAM_OUTPUT.line(agent=agent.id, text=text)
        self._out(WriteLog(line, lines=True, is_recorded=True))

    def on_input_awaited(self, agent: Agent, seconds: float) -> None:
        """A thread of an agent waits for a line of the operator's input."""
        host = self.host_of(agent.member)
        self._log_line(log_messages.INPUT_AWAITED.line(agent=agent.id, seconds=seconds, host=host))

    def on_line_read(self, agent: Agent, text: str) -> None:
        """An agent reads a line of the operator's input."""
        self._log_line(log_messages.INPUT_READ.line(agent=agent.id, text=text))

    def on_readers_changed(self, agents: Sequence[str]) -> None:
        """The agents that wait for a line have changed."""
        self._recorder.on_readers_changed(agents)

    def report(self, agent: Agent, line: LogLine) -> None:
        """A line of the log about an agent."""
        self._log_line(line)

    def _log_line(self, line: LogLine) -> None:
        self._out(WriteLog(line))

    def may_start_call(self, agent: Agent, acts: bool) -> bool:
        """Whether a portal call on this host may start now.

        A call with side effects waits until its caller's state is written, and some callers need a lease.
        """
        return self._parts.leases.may_start_call(agent) and (
            agent.is_persisted or not acts or self._parts.pending_calls.on_save(agent)
        )

    @property
    def sequencer(self) -> SequencingDecisions:
        """Starts and stops the startable coordinators of this host."""
        return self._parts.sequencing

    def acquire_reservation(self, agent: Agent, resource: TeamMember, *, nested: bool) -> int:
        """The number of the reservation of a resource of this host, 0 while the caller has to wait."""
        return self._parts.reservations.acquire(agent, resource, nested=nested)

    def release_reservations(self, agent: Agent, held: Sequence[tuple[TeamMember, int]]) -> None:
        """Release the reservations of a coordinator, here and on other hosts."""
        self._parts.reservations.release_all(agent, held)

    def may_serve(self, agent: Agent, resource: TeamMember, number: int) -> bool:
        """Whether a portal call may start for the coordinator with this reservation, or with none."""
        return self._parts.reservations.may_serve(agent, resource, number)

    def may_start_calls(self, agent: Agent, calls: Sequence[CallRequest]) -> bool:
        """Whether the calls of a `together` may start here now: each is recorded first."""
        return self._parts.pending_calls.may_start_calls(agent, calls)

    def on_call_completed(self, pending: PendingCall) -> None:
        """A pending call has ended: its result is recorded before it is reported."""
        if pending.is_of_person:
            self._parts.person_calls.on_completed(pending)
        else:
            self._parts.pending_calls.on_call_completed(pending)

    def watch_calls(self, agent: Agent, calls: Sequence[tuple[TeamMember, int]]) -> None:
        """Report the first of these calls on other hosts that ends."""
        self._parts.call_watch.watch(agent, calls)

    def request_cancels(self, agent: Agent, calls: Sequence[tuple[TeamMember, int]]) -> None:
        """Ask other hosts to cancel these calls."""
        self._parts.call_watch.request_cancels(agent, calls)

    def abandon_wait(self, agent: Agent) -> bool:
        """Whether a frozen coordinator may continue at once, since its wait was cancelled."""
        waited = self._parts.leases.abandon_wait(agent) or self._parts.reservations.abandon_wait(agent)
        waited = waited or self._parts.sequencing.abandon_wait(agent)
        return waited or self._parts.coordinators.mobility.cancel_departure(agent.id, agent.generation)

    def cancel(self, agent: Agent, thread: int) -> bool:
        """Whether the device call of a thread was cancelled."""
        return self._parts.commands.cancel_device_call(agent, thread)

    def is_superseded(self, agent: str, generation: int) -> bool:
        """Whether that start of a coordinator was stopped because an earlier one continues."""
        return self._parts.coordinators.mobility.is_superseded(agent, generation)

    def host_of(self, member: TeamMember) -> str:
        """The name of the host of an agent."""
        return self._hosts[member.host]

    def depart(self, agent: Agent, resource: TeamMember) -> None:
        """Send a frozen coordinator to the host of a resource."""
        host, parts = self._hosts[resource.host], self._parts
        lost_reason, down_for = "", 0.0
        if host not in parts.membership.linked:
            parts.require_link(host)
            lost_reason, down_for = parts.reachability.lost_reason(host), parts.reachability.down_for(host)
        elif agent.alarm < math.inf or agent.overdue or parts.reachability.is_stale(host):
            parts.reachability.request_heartbeat(host)
        parts.coordinators.depart(agent, resource, lost_reason, down_for)
        if agent.fetched:
            parts.pending_calls.on_departing(agent)

    def contact_age(self, member: TeamMember) -> float:
        """Seconds since the last message from the host of an agent; infinite without a link."""
        return self._parts.reachability.contact_age(self._hosts[member.host])

    def is_silent(self, member: TeamMember) -> bool:
        """Whether no message arrives from the host of an agent, although there is a link."""
        return self._parts.reachability.is_silent(self._hosts[member.host])

    def request_heartbeat(self, member: TeamMember, within: float) -> None:
        """Request a heartbeat from the host of an agent, unless a message arrived in the last `within`
        seconds.
        """
        self._parts.reachability.request_heartbeat(self._hosts[member.host], within)

    def is_heartbeat_pending(self, member: TeamMember) -> bool:
        """Whether that heartbeat is still awaited."""
        return self._parts.reachability.is_heartbeat_pending(self._hosts[member.host])

    def transit_time(self, member: TeamMember) -> float:
        """The expected transit time to the host of an agent, in seconds."""
        return self._parts.reachability.arrival_time(self._hosts[member.host])

    def call_device(
        self, agent: Agent, thread: int, call: DeviceCallRecord, values: list[DeviceValue]
    ) -> DeviceValue | Pending:
        """A device instruction: telemetry is answered here, other instructions by the guard."""
        return self._parts.commands.call_device(agent, thread, call, values)

    def telemetry_reading(self, agent: Agent, call: DeviceCallRecord) -> Reading | None:
        """The reading that the engine may read directly from now on."""
        return self._parts.commands.telemetry_reading(agent, call)

    def offers(self, agent: Agent, capability: str, constraint: str | None) -> list[FoundOffer]:
        """The present offers of a capability, best first."""
        return self._parts.offers.find_offers(agent.id, capability, constraint)

    def teams(
        self, agent: Agent, capability: str, constraint: str | None, size: int
    ) -> list[list[FoundOffer]]:
        """Teams of this size that offer it, best first."""
        return self._parts.offers.find_teams(agent.id, capability, constraint, size)

    def explain(self, agent: Agent, capability: str, constraint: str | None) -> str:
        """The reasons why the other agents do not match."""
        return self._parts.offers.explain_others(agent.id, capability, constraint)

    def ended(self, agent: Agent) -> None:
        """A coordinator has finished, or an agent has died."""
        how: Outcome = "died" if agent.ended == "died" else "done"
        self._recorder.on_agent_finished(agent.id, agent.generation, how, agent.report)
        if agent.ended == "died":
            self._report_death(agent)
        if agent.member.kind == "coordinator":
            self._parts.coordinators.on_agent_ended(agent)
        self._out(WAKE_WAITERS)

    def _report_death(self, agent: Agent) -> None:
        visited = " → ".join(self._hosts[n] for n in agent.block.trail() if n < len(self._hosts))
        where = f"\n    hosts visited: {visited}" if agent.member.kind == "coordinator" else ""
        line = log_messages.AGENT_DIED.line(agent=agent.id, report=f"{agent.report}{where}")
        self._out(WriteLog(line, lines=True))
        self._out(DumpAgent(agent))
        if agent.loops is not None:
            # Without these loops a device would not react any more.
            reason = f"{agent.id}, whose loops control it, has died"
            self._parts.commands.make_safe(agent.id, reason)
