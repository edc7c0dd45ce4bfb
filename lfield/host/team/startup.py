"""Start of one host's own coordinators: its time, and the coordinators that are not started. Sans-IO.

A coordinator that resumes from the journal never waits: only a new start does (`Readiness`).
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from functools import partial

from lfield.host.context import HostContext, LinkClosed, LinkOpened, Part
from lfield.host.team.part_interfaces import CoordinatorOperations, LeaseRules
from lfield.host.team.start_readiness import Readiness
from lfield.mission.mission import ON_GROUND
from lfield.replication.membership.membership import Membership
from lfield.replication.transfer.effects import Send
from lfield.replication.transfer.start_gate import StartGate
from lfield.text import log_messages
from lfield.text.suggestions import did_you_mean, listed
from lfield.wire.coordinator_messages import CoordinatorState
from lfield.wire.messages import GroundQuery, GroundReport
from lfield.wire.observer_messages import StartResponse, StartStatus

#: The reason why an emergency stop during the wait holds the start.
EMERGENCY_STOPPED = "an emergency stop holds ('lfield estop --lift' ends it)"
PAUSED = "the mission is paused; 'lfield resume' continues it"
#: The reason why the vote about an activation holds the start.
VOTE_OPEN = "the result of a vote about an activation is not known; 'lfield status' shows it"
#: Minimum seconds between two checks.
CHECK_EVERY = 0.25


class Startup(Part):
    """The starts of the coordinators of one host."""

    def __init__(
        self, context: HostContext, team: CoordinatorOperations, leases: LeaseRules, membership: Membership
    ) -> None:
        mission, host = context.mission, context.name
        self._mission, self._own_host, self._hosts = mission, host, mission.team.hosts
        self._team, self._leases, self._clock = team, leases, context.clock
        self._has_journal, self._environment = context.has_journal, context.environment
        self._out, self._log, self._recorder = context.effects.append, context.log, context.recorder
        self.own_agents = [
            member.id for member in mission.team.initial_coordinators if member.host == context.own_number
        ]
        #: A lease that was gained permits a start in the same turn.
        self.is_polled = bool(leases.leased_agents)
        self.handles = {
            GroundQuery: lambda host, _: self._out(Send(host, GroundReport(self._local_vehicles()))),
            GroundReport: self._on_ground_report,
        }
        self.observes = {
            LinkOpened: self._on_link_opened,
            LinkClosed: self._on_link_closed,
        }
        without, vehicles = mission.bindings.start.without, mission.hosts_with_vehicles
        self.readiness = Readiness(
            host, mission.team.hosts_with_resources, without, vehicles, membership.is_linked
        )
        self._lease_wait_logged = self._pause_logged = False
        self._checked_at = 0.0
        #: The last reported wait: coordinators, hosts, and the reason for the hold.
        self._reported_wait: tuple[list[str], list[str], str] = [], [], ""
        # Other hosts matter only to a host that starts coordinators.
        queried = self._hosts if self.own_agents else ()
        self._gate = StartGate(self.own_agents, [other for other in queried if other != host])
        self._gate.exclude(self.readiness.without)
        #: Whether the number of a start is not on disk yet.
        self._is_count_pending = False

    @property
    def is_settled(self) -> bool:
        """Whether the start of this host's coordinators is decided."""
        return self._gate.is_decided and not self._is_count_pending

    @property
    def needed_hosts(self) -> Collection[str]:
        """The hosts whose reports are needed."""
        return self._gate.needed_hosts

    def open(self, *, first: bool) -> None:
        """The other hosts had time to report; `first`: an operator asserts that there was no earlier
        start."""
        self._gate.open(self._team.recovery.last_start, first=first)
        self.check()

    def _on_link_opened(self, event: LinkOpened) -> None:
        self._gate.on_states(event.hello.host, event.hello.coordinators)
        self.readiness.on_linked(event.hello.host)
        self.check()

    def on_host_exited(self, host: str) -> None:
        """A host has ended permanently: it has no coordinator any more."""
        self._gate.on_states(host)
        self.readiness.on_linked(host)
        self.check()

    def _on_link_closed(self, event: LinkClosed) -> None:
        self._gate.on_unlinked(event.host)
        self.readiness.on_unlinked(event.host, self._clock.monotonic())
        self.check()

    def on_refused(self, host: str, reason: str, bundle: bytes) -> None:
        """No link with a host can be made, for that reason; '' when a link is possible again."""
        self.readiness.on_refused(host, reason, bundle)
        self.check()

    def _on_ground_report(self, host: str, report: GroundReport) -> None:
        vehicles = self._mission.vehicles_of(host)
        self.readiness.on_vehicles(host, {name: report.vehicles.get(name) for name in vehicles})
        self.check()

    def _on_count_durable(self, counted: int) -> None:
        self._is_count_pending = False
        self._start_coordinators(counted)

    def check(self) -> None:
        """After a change, start the coordinators if possible, and report the wait."""
        self._checked_at = self._clock.monotonic()
        self._start_if_ready()
        status = self.status
        waits = status is not None and (status.hosts or status.held)
        wait = (status.agents, status.hosts, status.held) if status and waits else ([], [], "")
        if wait != self._reported_wait:
            self._reported_wait = wait
            self._recorder.on_start_delayed(*wait)
        self._update_due()

    def on_tick(self, now: float) -> None:
        """A check is due, or a lease may have been gained."""
        if self._leases.poll_gained() or (self.due is not None and now >= self.due):
            self.check()

    def on_halted(self) -> None:
        """The host stops: no coordinator starts any more."""
        self.due = None

    def _update_due(self) -> None:
        """Set the time of the next check. It may wait for other conditions too, such as a lease, so
        `CHECK_EVERY` seconds pass between two checks.
        """
        waits = self._gate.is_waiting and not self._team.is_halted
        due = self.readiness.due if waits else None
        self.due = None if due is None else max(due, self._checked_at + CHECK_EVERY)

    def _start_if_ready(self) -> None:
        if waiting := self._gate.wait_line():
            self._log(waiting)
        if (
            self._team.is_halted
            or self._request_lease()
            or (self._gate.is_waiting and self._poll_readiness())
        ):
            return
        if self._gate.poll_due:
            if (hosts := self._gate.unproven) and (agents := self._new_starts()):
                line = log_messages.START_WITHOUT_PROOF.line(agents=listed(agents), hosts=listed(hosts))
                self._log(line)
            self._start_coordinators(0)

    def _new_starts(self) -> list[str]:
        """The coordinators whose start would be a new one."""
        known = self._team.mobility.known_states()
        return [agent for agent in self.own_agents if not self._blocking_reason(agent, known)]

    def _poll_readiness(self) -> bool:
        """Query the hosts that are due. True if a new start has to wait: for hosts, for vehicles of an
        earlier start, or for an operator.
        """
        agents = self._new_starts()
        if not agents:
            return False
        readiness, now = self.readiness, self._clock.monotonic()
        if self._team.stopped:
            readiness.hold(EMERGENCY_STOPPED)
        if not (readiness.held or readiness.missing or self._gate.missing or self._log_pause(agents)):
            for host in readiness.hosts_to_query(now):
                if host == self._own_host:
                    readiness.on_vehicles(host, self._local_vehicles())
                else:
                    self._out(Send(host, GroundQuery()))
        if line := readiness.line(agents, now):
            self._log(line)
        return self._team.paused or not readiness.is_ready

    def _local_vehicles(self) -> dict[str, bool | None]:
        """Whether each vehicle of this host is on the ground, None if unknown."""
        reported = {
            name: self._environment.last(name, ON_GROUND)
            for name in self._mission.vehicles_of(self._own_host)
        }
        return {name: None if landed is None else _truth(landed.value) for name, landed in reported.items()}

    def _log_pause(self, agents: Sequence[str]) -> bool:
        """Log the begin of a pause once. True during a pause."""
        if self._team.paused and not self._pause_logged:
            self._log(log_messages.START_PAUSED.line(agents=" and ".join(agents), reason=self._pause_reason))
        self._pause_logged = self._team.paused
        return self._team.paused

    @property
    def _pause_reason(self) -> str:
        """The reason for a pause of the mission, '' without a pause."""
        return VOTE_OPEN if self._team.ballot else PAUSED if self._team.paused else ""

    # --- operators ------------------------------------------------------------------------------------

    @property
    def status(self) -> StartStatus | None:
        """The conditions for the start of the waiting coordinators of this host; None if none waits."""
        if not self._gate.is_waiting or self._team.is_halted or not (agents := self._new_starts()):
            return None
        found = self.readiness.status(agents)
        unreachable = [host for host in self._gate.missing if host not in found.hosts]
        held = found.held or self._pause_reason
        return StartStatus(found.agents, [*found.hosts, *unreachable], found.without, held)

    @property
    def is_settling(self) -> bool:
        """Whether a start is imminent."""
        status = self.status
        return status is not None and not (status.hosts or status.held)

    def start(self, without: Collection[str]) -> StartResponse:
        """An operator orders the start, and excludes some hosts."""
        unknown = [host for host in without if host not in self._hosts]
        if unknown:
            hint = did_you_mean(unknown[0], self._hosts)
            problem = f"the deployment has no host '{unknown[0]}'{f': {hint}' if hint else ''}"
            return StartResponse([], self.status, problem)
        waiting = self._new_starts() if self._gate.is_waiting else []
        if not self._gate.is_decided:
            self.readiness.on_start_command(without)
            self._gate.exclude(without)
            if without:
                self._log(log_messages.START_WITHOUT_HOSTS.line(hosts=" and ".join(sorted(without))))
            self.check()
        return StartResponse(waiting, self.status)

    def unstartable(self, ended_hosts: Collection[str]) -> dict[str, str]:
        """The coordinators that wait for a host that has certainly ended, each with the reason."""
        lacking = [host for host in self.readiness.missing if host in ended_hosts]
        if not (self._gate.is_waiting and lacking):
            return {}
        ended = f"{listed(lacking)} {'has' if len(lacking) == 1 else 'have'} ended"
        reason = f"it was not started, since {ended}"
        return dict.fromkeys(self._new_starts(), reason)

    def _request_lease(self) -> bool:
        """Request the lease of new starts. True until it is granted: members may know of a later start."""
        if not self._leases.has_to_wait:
            return False
        known = self._team.mobility.known_states()
        waiting = [
            a
            for a in self.own_agents
            if a in self._leases.leased_agents and not self._blocking_reason(a, known)
        ]
        if waiting and not self._lease_wait_logged:
            self._log(log_messages.START_NEEDS_MAJORITY.line(agents=" and ".join(waiting)))
        self._lease_wait_logged = bool(waiting)
        if waiting:
            self._leases.request()
        return self._lease_wait_logged

    def _start_coordinators(self, counted: int) -> None:
        """Start the coordinators, once the number of the start is on disk, and no later start is known."""
        known = self._team.mobility.known_states()
        self._gate.on_generations(known)
        self._gate.require_above(
            max((self._leases.quorum.fences.token_of(agent) for agent in self.own_agents), default=0)
        )
        blocking_reasons = {agent: self._blocking_reason(agent, known) for agent in self.own_agents}
        if self._has_journal and counted < self._gate.next_generation and not all(blocking_reasons.values()):
            counted = self._gate.next_generation
            self._is_count_pending, batch = True, self._team.record_start(counted)
            self._team.write_ahead.when_durable(batch, partial(self._on_count_durable, counted))
            return
        for agent, reason in blocking_reasons.items():
            if reason:
                self._log(log_messages.START_REFUSED.line(agent=agent, reason=reason))
                # Other hosts have to know that no start follows an end in their journals.
                self._team.apply_effects(self._team.mobility.announce_end(agent))
            else:
                self._team.apply_effects(self._team.mobility.start(agent, self._gate.next_generation))

    def _blocking_reason(self, agent: str, states: list[CoordinatorState]) -> str:
        """The reason why a coordinator of this host is not started now, '' if it may be."""
        alive = "is alive on another host" if self._gate.is_alive(agent, states) else ""
        parked = self._gate.parked_on(agent, states)
        elsewhere = (
            f"is parked on {parked} for the program and deployment that it belongs to" if parked else ""
        )
        return (
            self._team.recovery.restart_blocker(agent, states)
            or elsewhere
            or alive
            or self._shadow_elsewhere(agent, states)
        )

    def _shadow_elsewhere(self, agent: str, known: list[CoordinatorState]) -> str:
        """The host with a shadow of a coordinator under leases: the team resumes it from there."""
        host = self._gate.shadow_on(agent, known) if agent in self._leases.leased_agents else ""
        return f"has left {host}, where a copy of it is kept" if host else ""


def _truth(value: object) -> bool | None:
    return value if isinstance(value, bool) else None
