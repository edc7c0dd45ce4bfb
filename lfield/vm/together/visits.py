"""What a coordinator's `together` has to do, and where it must go for that. Looks only; changes nothing."""

from __future__ import annotations

from collections.abc import Sequence

from lfield.bytecode.opcodes import BY_CODE, BY_NAME
from lfield.vm.agent import Agent, Member
from lfield.vm.begun import Beginning
from lfield.vm.memory import layout
from lfield.vm.memory.layout import (
    BEGUN,
    COLLECTED,
    FRAME_SLOTS,
    PROXY_MEMBER,
    THREAD_FRAME,
    THREAD_ID,
    THREAD_PC,
    TICKET_GENERATION,
    TICKET_METHOD,
    TICKET_NUMBER,
    TICKET_PROXY,
    TICKET_STATE,
    TICKET_THROWN,
    TOLD,
)
from lfield.vm.memory.threads import only_thread, place_of
from lfield.vm.memory.tickets import collected
from lfield.vm.reserve.held import Held
from lfield.vm.scheduler import Scheduler

#: The heads that visit hosts, each with the states of the tickets that it travels for, in this order.
TRAVELS = {"start": (COLLECTED,), "fetch": (COLLECTED, BEGUN), "leave": (BEGUN, TOLD)}


_PUSH = BY_NAME["push"].code


class Ticket:
    """A ticket, as it is in the block now: whoever collects or packs that must look for it again."""

    __slots__ = ("place", "w")

    def __init__(self, w: memoryview[int], place: int) -> None:
        self.w, self.place = w, place

    @property
    def number(self) -> int:
        """Its number; they rise in the order of collection."""
        return self.w[self.place + TICKET_NUMBER]

    @property
    def state(self) -> int:
        """COLLECTED, BEGUN, TOLD or BACK."""
        return self.w[self.place + TICKET_STATE]

    @property
    def generation(self) -> int:
        """Which start of the coordinator has begun it."""
        return self.w[self.place + TICKET_GENERATION]

    @property
    def method(self) -> int:
        """The portal, by its index."""
        return self.w[self.place + TICKET_METHOD]

    @property
    def proxy(self) -> int:
        """The proxy that the portal is called on."""
        return self.w[self.place + TICKET_PROXY]

    @property
    def member(self) -> int:
        """The resource, by its number."""
        return self.w[self.proxy + PROXY_MEMBER]

    @property
    def thrown(self) -> int:
        """The exception that it has come back with, or 0."""
        return self.w[self.place + TICKET_THROWN]


class Visits:
    """Looks at the tickets of the coordinators on one host (`here`, a number); `team` is everybody.

    Where a coordinator waits for something else, a portal or a reservation, it tells that too.
    """

    def __init__(self, scheduler: Scheduler, team: Sequence[Member], here: int, held: Held) -> None:
        self._scheduler, self._team, self._here, self._held = scheduler, team, here, held
        self._program = scheduler.program

    def head(self, agent: Agent) -> str:
        """The name of the head that a coordinator stands at; '' when it is none that travels for tickets."""
        name = self._standing(agent)
        return name if name in TRAVELS else ""

    def _standing(self, agent: Agent) -> str:
        """The name of the head that a coordinator stands at, '' for none."""
        pc = agent.block.w[agent.block.w[layout.W_THREADS] + THREAD_PC]
        group = self._scheduler.engine.groups.get(pc)
        return BY_CODE[group.head.op].name if group is not None else ""

    def words(self, agent: Agent, thread: int) -> list[int]:
        """The arguments of the group that a coordinator stands at, as they are in the block now."""
        w = agent.block.w
        place = place_of(agent.block, thread)
        slots = w[place + THREAD_FRAME] + FRAME_SLOTS
        quads, pc = self._program.quads, w[place + THREAD_PC]
        words = []
        while quads[pc].op == _PUSH:
            # The only constant among them is null.
            words.append(w[slots + quads[pc].a] if quads[pc].a >= 0 else 0)
            pc += 1
        return words

    def tickets(self, agent: Agent, thread: int) -> list[Ticket]:
        """Those of the `together` that a coordinator stands at, in the order of collection."""
        sentinel = self.words(agent, thread)[0]
        # A block that came from elsewhere may have none; the engine throws when it comes to that.
        found = collected(agent.block, sentinel) if sentinel else []
        return [Ticket(agent.block.w, place) for place in found]

    def of_thread(self, agent: Agent) -> list[Ticket]:
        """Those of a coordinator's only thread."""
        return self.tickets(agent, only_thread(agent.block))

    def is_here(self, ticket: Ticket) -> bool:
        """Whether its resource is on this host."""
        return self._team[ticket.member].host == self._here

    def resource(self, ticket: Ticket) -> Member:
        """Its resource."""
        return self._team[ticket.member]

    @property
    def ids(self) -> list[str]:
        """The ids of the team."""
        return [member.id for member in self._team]

    def name(self, ticket: Ticket) -> str:
        """The call in a word: `resource.portal()`."""
        return f"{self.resource(ticket).id}.{self.portal(ticket)}()"

    def portal(self, ticket: Ticket) -> str:
        """The portal's name."""
        return self._program.core.methods[ticket.method].name

    def beginning(self, ticket: Ticket) -> Beginning:
        """What the host is told of a call that shall begin."""
        acts = ticket.method in self._scheduler.acting
        return Beginning(ticket.number, self.resource(ticket).id, self.portal(ticket), acts)

    def away(self, tickets: list[Ticket], state: int) -> list[Ticket]:
        """The tickets in a state that are on one other host, the one that was collected first."""
        away = [ticket for ticket in tickets if ticket.state == state and not self.is_here(ticket)]
        host = self.resource(away[0]).host if away else self._here
        return [ticket for ticket in away if self.resource(ticket).host == host]

    def wanted(self, agent: Agent) -> list[Ticket]:
        """The tickets that a frozen coordinator waits for: to begin them here, or to get to their host."""
        head, found = self.head(agent), self.of_thread(agent)
        if head != "leave" and (mine := [t for t in found if t.state == COLLECTED and self.is_here(t)]):
            return mine
        return next((away for state in TRAVELS[head] if (away := self.away(found, state))), [])

    def calling(self, agent: Agent) -> tuple[Member, str] | None:
        """The resource and the portal that a frozen coordinator waits for, the first of several.

        The portal is '' where it wants to reserve the resource.
        """
        if self._standing(agent) == "take":
            entry = self._held.wanted(agent)
            return (entry.resource, "") if entry is not None else None
        if self.head(agent):
            wanted = self.wanted(agent)
            return (self.resource(wanted[0]), self.portal(wanted[0])) if wanted else None
        w = agent.block.w
        thread = w[layout.W_THREADS]
        words = self.words(agent, w[thread + THREAD_ID])
        if not words or not words[0]:
            return None
        portal = self._scheduler.engine.groups[w[thread + THREAD_PC]].head.a
        return self._team[w[words[0] + PROXY_MEMBER]], self._program.core.methods[portal].name

    def called(self, agent: Agent) -> str:
        """The same in a word, `resource.portal()`; '' for none."""
        resource, portal = self.calling(agent) or (None, "")
        return f"{resource.id}.{portal}()" if resource else ""

    def cut_short(self, agent: Agent) -> str:
        """What a frozen coordinator is kept from, as the end of a sentence; '' for nothing."""
        if self._standing(agent) == "take":
            entry = self._held.wanted(agent)
            return f" before {entry.resource.id} could be reserved" if entry is not None else ""
        called = self.called(agent)
        if not called:
            return ""
        begun = self.fetches(agent)
        return (
            f"; {called} has begun, and was not heard of again" if begun else f" before {called} could begin"
        )

    def is_asked(self, agent: Agent) -> bool:
        """Whether a sign of life of the host that a frozen coordinator wants to is still waited for."""
        signs, wanted = self._scheduler.attached.signs, self.wanted(agent)
        return signs is not None and bool(wanted) and signs.is_asked(self.resource(wanted[0]))

    def keeps_waiting(self, agent: Agent) -> str:
        """Why a frozen coordinator cannot go on at once: it may be elsewhere, or is being written."""
        called = self.calling(agent)
        if called is None or called[0].host == self._here:
            return "it was being written to the disk"
        host = self._scheduler.world.host_of(called[0])
        return f"it was sent to {host}, and may have arrived there"

    def fetches(self, agent: Agent) -> bool:
        """Whether what a frozen coordinator waits for is a call of a `together` that has begun."""
        wanted = self.wanted(agent) if self.head(agent) else []
        return bool(wanted) and wanted[0].state != COLLECTED

    def goes_on(self, agent: Agent) -> bool:
        """Whether nothing is unknown of what a restored coordinator did where it stands."""
        head = self._standing(agent)
        if head not in TRAVELS or head == "leave":
            return head in ("take", "leave")
        return not any(t.state == COLLECTED and self.is_here(t) for t in self.of_thread(agent))
