"""The holders of reservations, judged from the grants that the machine receives and the calls that begin.

A number is durable on its host when it is granted, and is higher than all earlier numbers of that resource,
also across restarts. The holder has the resource exclusively until it leaves its block, its start ends, or it
was silent for a lease: the resource is not granted to another, no portal starts for another, and the holder
receives no loss. No portal starts with a number that is not the last.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

from lfield.journal.records import CoordinatorRecord, FenceRecord, Record, ReservationRecord
from lfield.simulate.host_fleet import HostRun
from lfield.vm.agent import Agent, TeamMember
from lfield.vm.memory.layout import THREAD_ID
from lfield.vm.memory.threads import threads
from lfield.wire.reservation_messages import RenewReservation
from simulation_testing.invariants.breaches import Breaches

#: The least share of a lease in true time, with any clocks of the hosts.
MIN_LEASE_SHARE = 0.97


@dataclass(slots=True)
class _Resource:
    """The last granted number of a resource, its holder, and the time until which the holder is exclusive."""

    number: int = 0
    holder: tuple[str, int] = ("", 0)
    since: float = 0.0
    until: float = 0.0
    #: The host of the resource.
    host: str = ""


class ReservationChecks:
    """The reservations of a team. `pages` gives the records on the disk of a host, `lease` is in seconds.

    `newest_at` gives the newest recovery of an agent that had continued before a time.
    """

    def __init__(
        self,
        breaches: Breaches,
        now: Callable[[], float],
        lease: Callable[[], float],
        newest_at: Callable[[str, float], int],
        pages: Callable[[str], Iterable[Record] | None],
    ) -> None:
        self._breaches, self._now, self._lease = breaches, now, lease
        self._newest_at, self._pages = newest_at, pages
        self._resources: defaultdict[str, _Resource] = defaultdict(_Resource)
        #: The numbers of calls inside and outside of blocks; the outcomes of rounds; the number of rounds of
        #: each agent since the end of the faults.
        self.started: Counter[str] = Counter()
        self.rounds: Counter[str] = Counter()
        self.closed: Counter[str] = Counter()
        self._started_for: set[tuple[str, int]] = set()
        #: The last start with a call in each round of a life, by the drawn number of the life.
        self._rounds_of: dict[tuple[float, float], tuple[str, int]] = {}

    def on_healed(self) -> None:
        """The faults are over."""
        self.closed.clear()

    def on_disk_lost(self, resources: Iterable[str]) -> None:
        """The host of these has a new disk, without records of its grants."""
        for name in resources:
            self._resources.pop(name, None)

    def has_any(self, agent: str, generation: int) -> bool:
        """Whether a start of an agent has begun any call."""
        return (agent, generation) in self._started_for

    def on_output(self, life: HostRun, agent: Agent, text: list[str]) -> bool:
        """Handle an output line of a program; whether it is about a reservation."""
        match text:
            case ["uses", who, number, how]:
                self._uses(life, agent, who, int(number), how)
            case ["quits", _, _, how]:
                self.rounds[how] += 1
                self.closed[agent.id] += 1
            case _:
                return False
        return True

    # --- observations of the machine ------------------------------------------------------------------

    def on_granted(self, life: HostRun, agent: Agent, resource: TeamMember, number: int) -> None:
        """A coordinator receives the number by which it holds a resource from now on."""
        known, start, host = self._resources[resource.id], (agent.id, agent.generation), (life.core.name,)
        if number <= known.number:
            found = (
                f"{resource.id} was given by number {number} to {start}, and {known.number} was told before"
            )
            self._breaches.add("number", host, found)
        pages = self._pages(life.core.name)
        record = ReservationRecord(resource.id, number, *start)
        if pages is not None and record not in pages:
            found = f"{agent.id} is told that it has {resource.id} by {number}, and that is on no disk"
            self._breaches.add("given", host, found)
        if self._is_alone(life, known, start):
            found = f"{resource.id} is given to {start}, and {known.holder} has it"
            self._breaches.add("reserved", host, found)
        others = _callers(life, life.core.machine.agents[resource.id]).keys() - {agent.id}
        if others:
            found = f"{resource.id} is given to {start} while it works for {', '.join(sorted(others))}"
            self._breaches.add("busy", host, found)
        known.number, known.holder, known.host = max(number, known.number), start, life.core.name
        known.since, known.until = self._now(), self._now() + MIN_LEASE_SHARE * self._lease()

    def on_dropped(self, agent: Agent, held: Sequence[tuple[TeamMember, int]]) -> None:
        """A coordinator has left a block."""
        for resource, number in held:
            known = self._resources[resource.id]
            if (known.holder, known.number) == ((agent.id, agent.generation), number):
                known.until = 0.0

    def on_reserved_call(
        self, life: HostRun, agent: Agent, resource: TeamMember, number: int, *, lost: bool
    ) -> None:
        """A coordinator with a reservation is served, or has lost it."""
        known, start = self._resources[resource.id], (agent.id, agent.generation)
        if (known.holder, known.number) != (start, number):
            return
        if lost and self._now() < known.until:
            found = f"{agent.id} is told that it has lost {resource.id}, and nobody could take it"
            self._breaches.add("robbed", (life.core.name,), found)
        elif not lost:
            known.until = max(known.until, self._now() + MIN_LEASE_SHARE * self._lease())

    def on_renewed(self, message: RenewReservation) -> None:
        """A host receives a renewal of the holder of one of its resources."""
        known = self._resources[message.resource]
        if (known.holder, known.number) != ((message.agent, message.generation), message.number):
            return
        if self._now() < known.until:
            known.until = self._now() + MIN_LEASE_SHARE * self._lease()

    # --- commands of devices --------------------------------------------------------------------------

    def caller_of(self, arguments: tuple[object, ...]) -> tuple[str, int]:
        """The agent and start for which a device was commanded, from the arguments; '' if unknown."""
        drawn, number = arguments[:2]
        assert isinstance(drawn, float)
        assert isinstance(number, float)
        return self._rounds_of.get((drawn, number), ("", 0))

    def commanded(self, resource: str, start: tuple[str, int], at: float) -> None:
        """The device of a resource was commanded for a start of a coordinator."""
        known = self._resources[resource]
        agent, generation = known.holder
        if agent in ("", start[0]) or not known.since < at < known.until:
            return
        # The host has stopped a start that is fenced or has ended, and may grant the resource to others.
        if any(_is_over(page, agent, generation) for page in self._pages(known.host) or ()):
            return
        if generation >= self._newest_at(agent, at):
            found = (
                f"the device of {resource} was commanded for {start} at {at:.3f} s, and {known.holder} has it"
            )
            self._breaches.add("reserved", (), found)

    # --- output of resources --------------------------------------------------------------------------

    def _uses(self, life: HostRun, resource: Agent, who: str, number: int, how: str) -> None:
        self.started[how] += 1
        name, _, drawn = who.partition(".")
        known, host = self._resources[resource.id], (life.core.name,)
        generation = max(_callers(life, resource).get(name, ()), default=0)
        if not generation:
            # The caller was detached before the first line of the portal.
            return
        start = name, generation
        self._started_for.add(start)
        self._rounds_of[float(drawn), float(number)] = start
        if self._is_alone(life, known, start):
            found = f"a portal of {resource.id} began for {start}, and {known.holder} has it"
            self._breaches.add("reserved", host, found)
        if how != "inside":
            return
        agent = life.core.machine.agents.get(name)
        held = (
            life.core.machine.held_reservations.of_coordinator(agent)
            if agent is not None and agent.generation == generation
            else ()
        )
        mark = next((mark for member, mark in held if member.id == resource.id), 0)
        if (known.holder, known.number) != (start, mark):
            found = f"a portal of {resource.id} began for {start} by {mark}, not {known.number}"
            self._breaches.add("stale", host, found)

    def _is_alone(self, life: HostRun, known: _Resource, other: tuple[str, int]) -> bool:
        """True if a resource of a host certainly has an exclusive holder."""
        (agent, generation), now = known.holder, self._now()
        if not agent or agent == other[0] or now >= known.until:
            return False
        if generation < self._newest_at(agent, now):
            return False
        pages = self._pages(life.core.name) or ()
        return not any(
            _is_over(page, agent, generation) for page in pages
        ) and not life.core.mobility.end_reason(agent, generation)


def _is_over(page: Record, agent: str, generation: int) -> bool:
    """True if a host has the end or fence of a start on its disk."""
    match page:
        case FenceRecord():
            return page.agent == agent and generation < page.generation
        case CoordinatorRecord():
            return (page.agent, page.generation, page.state) == (agent, generation, "EXITED")
    return False


def _callers(life: HostRun, resource: Agent) -> dict[str, set[int]]:
    """The agents that a resource serves now, each with its starts."""
    block, machine = resource.block, life.core.machine
    found: dict[str, set[int]] = {}
    for place in threads(block):
        if caller := machine.served_calls.caller(resource, block.w[place + THREAD_ID]):
            found.setdefault(caller.id, set()).add(caller.generation)
    return found
