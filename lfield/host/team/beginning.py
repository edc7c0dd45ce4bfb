"""The coordinators of one host's own: when they are started, and which of them are not. Pure.

What goes on from the journal never waits here: only a start that is new does (`Readiness`).
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Sequence

from lfield.clock import Clock
from lfield.host.effects import Effect, Nearby, Say
from lfield.host.sight.teller import Teller
from lfield.host.team.coordinators import Coordinators
from lfield.host.team.leases import Leases
from lfield.host.team.readiness import Readiness
from lfield.mission.mission import ON_GROUND, Mission
from lfield.mobility.effects import Send
from lfield.mobility.hearsay import Hearsay
from lfield.mobility.starts import Starts
from lfield.text.suggest import did_you_mean, listed
from lfield.wire.coordinators import Known
from lfield.wire.observing import StartResponse, StartStatus, Status, StatusRequest

#: Why an emergency stop during the wait holds a start back.
STOPPED = "an emergency stop holds ('lfield estop --lift' ends it)"
PAUSED = "the mission is paused; 'lfield resume' lets it go on"
#: Seconds between two looks at what a start waits for, at least.
LOOK = 0.25


class Beginning:
    """The starts that a host of a mission makes; `kept`: it has a journal.

    What is to be done outside is added to `effects`.
    """

    def __init__(
        self,
        mission: Mission,
        host: str,
        team: Coordinators,
        leases: Leases,
        clock: Clock,
        effects: Callable[[Effect], None],
        nearby: Nearby,
        hearsay: Hearsay,
        teller: Teller,
        *,
        kept: bool,
    ) -> None:
        self._mission, self._here, self._hosts = mission, host, mission.team.hosts
        self._team, self._leases, self._clock, self._kept = team, leases, clock, kept
        self._out, self._nearby, self._teller = effects, nearby, teller
        here, others = mission.team.number(host), [other for other in self._hosts if other != host]
        self.own = [member.id for member in mission.team.on(here) if member.kind == "coordinator"]
        needed = [other for other in others if mission.has_resources(other)]
        vehicles = [other for other in self._hosts if mission.vehicles_of(other)]
        self.readiness = Readiness(needed, mission.bindings.start.without, vehicles, hearsay.is_linked)
        self._told = self._told_pause = False
        self._looked_at = 0.0
        #: What watchers were last told of the wait: coordinators, hosts, and why it is held.
        self._shown: tuple[list[str], list[str], str] = [], [], ""
        self._starts = Starts(self.own, others)
        self._starts.leave_out(self.readiness.without)
        #: The batch that has the number of a start, and that number, until it is on the disk.
        self._counting: tuple[int, int] | None = None

    @property
    def settled(self) -> bool:
        """Whether the coordinators of this host are started, as far as they are."""
        return self._starts.begun and self._counting is None

    @property
    def wanted(self) -> Collection[str]:
        """The hosts that have to be heard."""
        return self._starts.wanted

    def begin(self, *, first: bool) -> None:
        """The others had time to answer; `first`: somebody says that there was no earlier start."""
        self._starts.begin(self._team.recovery.starts, first=first)
        self.look()

    def heard(self, host: str, known: Iterable[Known] = ()) -> None:
        """A host has greeted, or has ended for good."""
        self._starts.heard(host, known)
        self.readiness.on_linked(host)

    def unlinked(self, host: str) -> None:
        """A host cannot be talked to any more."""
        self._starts.unlinked(host)
        self.readiness.on_unlinked(host, self._clock.monotonic())

    def on_refused(self, host: str, reason: str, bundle: bytes) -> None:
        """No link with a host can be made, for that reason; '' when that is over."""
        self.readiness.on_refused(host, reason, bundle)
        self.look()

    def on_status(self, host: str, status: Status) -> None:
        """A host that was asked says how its devices are."""
        told = {device.name: device.telemetry.get(ON_GROUND) for device in status.devices}
        self.readiness.on_vehicles(
            host, {name: _truth(told.get(name)) for name in self._mission.vehicles_of(host)}
        )
        self.look()

    def kept(self, number: int) -> None:
        """All pages up to those of that batch are on the disk."""
        if self._counting and number >= self._counting[0]:
            _, counted = self._counting
            self._counting = None
            self._begin(counted)

    def look(self) -> None:
        """Something has changed: start what may be started now, and tell what is waited for."""
        self._looked_at = self._clock.monotonic()
        self._start_if_ready()
        status = self.status
        waits = status is not None and (status.hosts or status.held)
        shown = (status.agents, status.hosts, status.held) if status and waits else ([], [], "")
        if shown != self._shown:
            self._shown = shown
            self._teller.waits(*shown)

    def _start_if_ready(self) -> None:
        if why := self._starts.why():
            self._say(why)
        if self._team.halted or self._waits() or (self._starts.is_waiting and self._is_held_back()):
            return
        if self._starts.due:
            if (hosts := self._starts.unproven) and (agents := self._new()):
                self._say(
                    f"starting {listed(agents)} without a record of earlier starts on this host and without "
                    f"an answer of {listed(hosts)}, which are left out: an earlier start that is alive there "
                    "would run as well"
                )
            self._begin(0)

    @property
    def due(self) -> float | None:
        """When `look` has something to do by itself, in seconds of the host's clock; None for never.

        It may wait for other things too (a lease, say), so `LOOK` passes before it is looked at again.
        """
        due = self.readiness.due if self._starts.is_waiting and not self._team.halted else None
        return None if due is None else max(due, self._looked_at + LOOK)

    def _new(self) -> list[str]:
        """The coordinators whose start would be a new one."""
        known = self._team.mobility.knowledge()
        return [agent for agent in self.own if not self._why_not(agent, known)]

    def _is_held_back(self) -> bool:
        """Whether a new start has to wait: for hosts, for vehicles of an earlier start, or for a person."""
        agents = self._new()
        if not agents:
            return False
        readiness, now = self.readiness, self._clock.monotonic()
        if self._team.stopped:
            readiness.hold(STOPPED)
        if not (readiness.held or readiness.missing or self._starts.missing or self._is_paused(agents)):
            for host in readiness.to_ask(now):
                if host == self._here:
                    readiness.on_vehicles(host, self._own_vehicles())
                else:
                    self._out(Send(host, StatusRequest()))
        if line := readiness.line(agents, now):
            self._say(line)
        return self._team.paused or not readiness.is_ready

    def _own_vehicles(self) -> dict[str, bool | None]:
        """Whether each vehicle of this host is on the ground, None where that is not known."""
        told = {name: self._nearby.last(name, ON_GROUND) for name in self._mission.vehicles_of(self._here)}
        return {name: None if landed is None else _truth(landed.value) for name, landed in told.items()}

    def _is_paused(self, agents: Sequence[str]) -> bool:
        if self._team.paused and not self._told_pause:
            self._say(f"{' and '.join(agents)} not started: {PAUSED}")
        self._told_pause = self._team.paused
        return self._team.paused

    # --- operators ------------------------------------------------------------------------------------

    @property
    def status(self) -> StartStatus | None:
        """What the coordinators of this host wait for that are not started yet; None where none waits."""
        if not self._starts.is_waiting or self._team.halted or not (agents := self._new()):
            return None
        found = self.readiness.status(agents)
        unheard = [host for host in self._starts.missing if host not in found.hosts]
        held = found.held or (PAUSED if self._team.paused else "")
        return StartStatus(found.agents, [*found.hosts, *unheard], found.without, held)

    @property
    def is_settling(self) -> bool:
        """Whether a start needs nothing but a moment."""
        status = self.status
        return status is not None and not (status.hosts or status.held)

    def start(self, without: Collection[str]) -> StartResponse:
        """An operator wants the start, and does not want it to wait for some hosts."""
        unknown = [host for host in without if host not in self._hosts]
        if unknown:
            hint = did_you_mean(unknown[0], self._hosts)
            said = f"the deployment has no host '{unknown[0]}'{f': {hint}' if hint else ''}"
            return StartResponse([], self.status, said)
        waiting = self._new() if self._starts.is_waiting else []
        if not self._starts.begun:
            self.readiness.on_start_command(without)
            self._starts.leave_out(without)
            if without:
                self._say(f"starts of coordinators no longer wait for {' and '.join(sorted(without))}")
            self.look()
        return StartResponse(waiting, self.status)

    def unstartable(self, gone: Collection[str]) -> dict[str, str]:
        """The coordinators that wait for a host which has ended for certain, each with the reason."""
        lacking = [host for host in self.readiness.missing if host in gone]
        if not (self._starts.is_waiting and lacking):
            return {}
        ended = f"{listed(lacking)} {'has' if len(lacking) == 1 else 'have'} ended"
        why = f"it was not started, since {ended}"
        return dict.fromkeys(self._new(), why)

    def _waits(self) -> bool:
        """Whether a lease is waited for: who could give one may know of a later start."""
        if not self._leases.waits:
            return False
        known = self._team.mobility.knowledge()
        waiting = [a for a in self.own if a in self._leases.fenced and not self._why_not(a, known)]
        if waiting and not self._told:
            names = f"{' and '.join(waiting)} {'is' if len(waiting) == 1 else 'are'}"
            self._say(f"{names} not started before a majority of the team can be heard")
        self._told = bool(waiting)
        if waiting:
            self._leases.want()
        return self._told

    def _begin(self, counted: int) -> None:
        """Start the coordinators, once the number of that start is kept, and no later one was heard of."""
        known = self._team.mobility.knowledge()
        self._starts.learn(known)
        self._starts.beyond(max((self._leases.quorum.fences.of(agent) for agent in self.own), default=0))
        against = {agent: self._why_not(agent, known) for agent in self.own}
        if self._kept and counted < self._starts.next and not all(against.values()):
            self._counting = self._team.count(self._starts.next), self._starts.next
            return
        for agent, why in against.items():
            if why:
                self._say(f"{agent} {why}: not started again")
            else:
                self._team.carry_out(self._team.mobility.start(agent, self._starts.next))

    def _why_not(self, agent: str, known: list[Known]) -> str:
        """Why a coordinator of this host is not started now, '' if nothing is against it."""
        alive = "is alive on another host" if self._starts.alive(agent, known) else ""
        parked = self._starts.parked(agent, known)
        elsewhere = (
            f"is parked on {parked} for the program and deployment that it belongs to" if parked else ""
        )
        return self._team.recovery.why_not(agent, known) or elsewhere or alive or self._left(agent, known)

    def _left(self, agent: str, known: list[Known]) -> str:
        """The team goes on with what runs under leases from a shadow: beginning anew would forget that."""
        host = self._starts.shadowed(agent, known) if agent in self._leases.fenced else ""
        return f"has left {host}, where a copy of it is kept" if host else ""

    def _say(self, text: str) -> None:
        self._out(Say(text))


def _truth(value: object) -> bool | None:
    return value if isinstance(value, bool) else None
