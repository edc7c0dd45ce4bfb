"""What the machine of a host asks, and which part of the host answers: the machine's `World`. Pure."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from lfield.bytecode.program import DeviceCall
from lfield.host.effects import CHANGED, Died, Effect, Say, Write
from lfield.host.offers import Offers
from lfield.host.sight.teller import Teller
from lfield.host.team.absent import Absent
from lfield.host.team.begun import BegunPages
from lfield.host.team.commands import Commands
from lfield.host.team.coordinators import Coordinators
from lfield.host.team.leases import Leases
from lfield.host.team.reserving import Reserving
from lfield.manifest import DeviceValue
from lfield.mission.team import Team
from lfield.vm.agent import Agent, Member
from lfield.vm.begun import Beginning, Begun
from lfield.vm.contract import Reading
from lfield.vm.offers import Found
from lfield.vm.world import Pending
from lfield.wire.coordinators import Outcome


class HostWorld:
    """The answers of one host. `effects` takes what is to be done outside, `reach` a host to be linked with.

    The machine is made with it, and the parts of the host with the machine: they `join` last.
    """

    def __init__(
        self, team: Team, effects: Callable[[Effect], None], reach: Callable[[str], None], teller: Teller
    ) -> None:
        self._team, self._out, self._reach, self._teller = team, effects, reach, teller
        self._coordinators: Coordinators
        self._leases: Leases
        self._begun: BegunPages
        self._reserving: Reserving
        self._commands: Commands
        self._offers: Offers
        self._absent: Absent

    def join(
        self,
        coordinators: Coordinators,
        leases: Leases,
        begun: BegunPages,
        reserving: Reserving,
        commands: Commands,
        offers: Offers,
        absent: Absent,
    ) -> None:
        """The parts that answer."""
        self._coordinators, self._leases, self._begun = coordinators, leases, begun
        self._reserving, self._commands, self._offers, self._absent = reserving, commands, offers, absent

    def write(self, agent: Agent, text: str) -> None:
        """Program output."""
        self._teller.written(agent.id, text)
        self._out(Write(text))

    def log(self, agent: Agent, text: str) -> None:
        """A line of `print`."""
        self._teller.printed(agent.id, text)
        self._out(Say(f"{agent.id}: {text}", lines=True, told=True))

    def may_begin(self, agent: Agent, acts: bool) -> bool:
        """Whether a portal of this host may begin now.

        Where its caller stands is kept before one that acts, and some callers need a lease.
        """
        return self._leases.may_begin(agent) and (agent.kept or not acts or self._begun.save(agent))

    def take(self, agent: Agent, resource: Member, *, nested: bool) -> int:
        """The number of the reservation of a resource of this host, 0 while it has to be waited for."""
        return self._reserving.take(agent, resource, nested=nested)

    def drop(self, agent: Agent, held: Sequence[tuple[Member, int]]) -> None:
        """What a coordinator has reserved is given back, here and on other hosts."""
        self._reserving.drop(agent, held)

    def serves(self, agent: Agent, resource: Member, number: int) -> bool:
        """Whether a portal of this host may begin for who has its resource by this number, or by none."""
        return self._reserving.serves(agent, resource, number)

    def begins(self, agent: Agent, calls: Sequence[Beginning]) -> bool:
        """Whether the calls of a `together` may begin here now: each has a page first."""
        return self._begun.begins(agent, calls)

    def came_back(self, begun: Begun) -> None:
        """A call that was begun here has come to its end: that is kept before it is told."""
        self._begun.came_back(begun)

    def give_up(self, agent: Agent) -> bool:
        """Whether a frozen coordinator may go on at once, since nobody wants to wait for it any longer."""
        waited = self._leases.give_up(agent) or self._reserving.give_up(agent)
        return waited or self._coordinators.mobility.give_up(agent.id, agent.generation)

    def cancel(self, agent: Agent, thread: int) -> bool:
        """Whether what a thread waits for of a device is cancelled."""
        return self._commands.cancel(agent, thread)

    def superseded(self, agent: str, generation: int) -> bool:
        """Whether that start of a coordinator was stopped because an earlier one goes on."""
        return self._coordinators.mobility.superseded(agent, generation)

    def host_of(self, member: Member) -> str:
        """The name of the host where an agent of the team lives."""
        return self._team.hosts[member.host]

    def depart(self, agent: Agent, resource: Member) -> None:
        """A frozen coordinator wants to the host of a resource."""
        host = self._team.hosts[resource.host]
        linked = self._absent.is_linked(host)
        if not linked:
            self._reach(host)
        elif agent.alarm < math.inf or agent.overdue:
            self._absent.ask(host)
        self._coordinators.depart(agent, resource, None if linked else self._absent)
        self._begun.leaves(agent)

    def device(
        self, agent: Agent, thread: int, call: DeviceCall, values: list[DeviceValue]
    ) -> DeviceValue | Pending:
        """A device instruction: telemetry is known here, anything else is the guard's."""
        return self._commands.device(agent, thread, call, values)

    def reading(self, agent: Agent, call: DeviceCall) -> Reading | None:
        """What the engine may read by itself from now on."""
        return self._commands.reading(agent, call)

    def offers(self, agent: Agent, capability: str, constraint: str | None) -> list[Found]:
        """Who offers a capability now, best first."""
        return self._offers.offers(agent.id, capability, constraint)

    def teams(self, agent: Agent, capability: str, constraint: str | None, size: int) -> list[list[Found]]:
        """Teams of so many who offer it, best first."""
        return self._offers.teams(agent.id, capability, constraint, size)

    def explain(self, agent: Agent, capability: str, constraint: str | None) -> str:
        """Why everybody else does not."""
        return self._offers.explain(agent.id, capability, constraint)

    def ended(self, agent: Agent) -> None:
        """A coordinator is done, or an agent has died."""
        how: Outcome = "died" if agent.ended == "died" else "done"
        self._teller.finished(agent.id, agent.generation, how, agent.report)
        if agent.ended == "died":
            self._report_death(agent)
        if agent.member.kind == "coordinator":
            self._coordinators.ended(agent)
        self._out(CHANGED)

    def _report_death(self, agent: Agent) -> None:
        visited = " → ".join(self._team.hosts[n] for n in agent.block.trail() if n < len(self._team.hosts))
        where = f"\n    hosts visited: {visited}" if agent.member.kind == "coordinator" else ""
        self._out(Say(f"{agent.id} died of an uncaught {agent.report}{where}", lines=True))
        self._out(Died(agent))
