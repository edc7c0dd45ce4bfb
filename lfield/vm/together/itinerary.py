"""The next hosts and pending work of a coordinator's `together`. Read-only."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from lfield.bytecode.opcodes import BY_CODE, BY_NAME, SEQUENCING
from lfield.vm.agent import Agent, TeamMember
from lfield.vm.memory import layout
from lfield.vm.memory.call_tickets import tickets_of
from lfield.vm.memory.layout import (
    FRAME_SLOTS,
    PROXY_MEMBER,
    THREAD_FRAME,
    THREAD_ID,
    THREAD_PC,
    TICKET_CANCELLING,
    TICKET_COLLECTED,
    TICKET_GENERATION,
    TICKET_METHOD,
    TICKET_NUMBER,
    TICKET_PROXY,
    TICKET_STARTED,
    TICKET_STATE,
    TICKET_THROWN,
)
from lfield.vm.memory.threads import only_thread, place_of
from lfield.vm.pending_call import CallRequest
from lfield.vm.reservations.held_reservations import HeldReservations
from lfield.vm.scheduler import Scheduler

#: The instructions that visit hosts, each with the states of the tickets that it visits them for, in order.
VISITED_STATES = {
    "start": (TICKET_COLLECTED,),
    "fetch": (TICKET_COLLECTED, TICKET_STARTED),
    "leave": (TICKET_STARTED, TICKET_CANCELLING),
    "launch": (TICKET_COLLECTED,),
    "next": (TICKET_STARTED, TICKET_CANCELLING),
    "ended": (TICKET_STARTED, TICKET_CANCELLING),
    "cancel": (TICKET_STARTED, TICKET_CANCELLING),
}
#: The instructions that cancel calls, which only their time limit interrupts.
CANCELLING_HEADS = ("leave", "cancel")


_PUSH = BY_NAME["push"].code


class Ticket:
    """View of a ticket in the block; invalid after a collection."""

    __slots__ = ("place", "w")

    def __init__(self, w: memoryview[int], place: int) -> None:
        self.w, self.place = w, place

    @property
    def number(self) -> int:
        """The number of the ticket; numbers increase in the order of collection."""
        return self.w[self.place + TICKET_NUMBER]

    @property
    def state(self) -> int:
        """The state: COLLECTED, STARTED, CANCELLING or RETURNED."""
        return self.w[self.place + TICKET_STATE]

    @property
    def generation(self) -> int:
        """The start of the coordinator that started the call."""
        return self.w[self.place + TICKET_GENERATION]

    @property
    def method(self) -> int:
        """The portal, by index."""
        return self.w[self.place + TICKET_METHOD]

    @property
    def proxy(self) -> int:
        """The proxy of the call."""
        return self.w[self.place + TICKET_PROXY]

    @property
    def member(self) -> int:
        """The resource, by number."""
        return self.w[self.proxy + PROXY_MEMBER]

    @property
    def thrown(self) -> int:
        """The exception of the call, or 0."""
        return self.w[self.place + TICKET_THROWN]


class Itinerary:
    """Reads the tickets of the coordinators on one host (`own_host`, a number); `team` has all agents.

    It also serves coordinators that wait for a portal or a reservation.
    """

    def __init__(
        self, scheduler: Scheduler, team: Sequence[TeamMember], own_host: int, held: HeldReservations
    ) -> None:
        self._scheduler, self._team, self._own_host, self._held_reservations = scheduler, team, own_host, held
        self._program = scheduler.program

    def head(self, agent: Agent) -> str:
        """The instruction at a coordinator's position if this instruction visits hosts for tickets;
        else ''.
        """
        name = self._current_head(agent)
        return name if name in VISITED_STATES else ""

    def _current_head(self, agent: Agent) -> str:
        """The instruction at a coordinator's position, '' for none."""
        pc = agent.block.w[agent.block.w[layout.W_THREADS] + THREAD_PC]
        group = self._scheduler.engine.groups.get(pc)
        return BY_CODE[group.head.op].name if group is not None else ""

    def call_arguments(self, agent: Agent, thread: int) -> list[int]:
        """The arguments of the group at a coordinator's position, as in the block now."""
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
        """The tickets of the `together` at a coordinator's position, in the order of collection, or the
        tickets of futures.
        """
        first, w = self.call_arguments(agent, thread)[0], agent.block.w
        if w[first] & 0xFF in layout.ARRAYS_ON_HEAP:
            places = dict.fromkeys(ticket.place for _, ticket in self.tickets_by_element(agent, first))
            return [Ticket(w, place) for place in places]
        # A block of another host may have none; the engine throws when it executes the instruction.
        found = tickets_of(agent.block, first) if first else []
        return [Ticket(w, place) for place in found]

    def tickets_by_element(self, agent: Agent, first: int) -> list[tuple[int, Ticket]]:
        """The tickets of a sentinel (index 0) or an array of futures, each with the index of its future."""
        block = agent.block
        w = block.w
        sentinels = [first]
        if w[first] & 0xFF in layout.ARRAYS_ON_HEAP:
            # The ticket is the first field of a future.
            sentinels = [w[w[i] + 1] if w[i] else 0 for i in range(*layout.elements(w, first))]
        return [
            (i, Ticket(w, place))
            for i, sentinel in enumerate(sentinels)
            if sentinel
            for place in tickets_of(block, sentinel)
        ]

    def first_destination(self, agent: Agent, tickets: Sequence[Ticket]) -> list[Ticket]:
        """The tickets on the next host of a coordinator that waits for any of these tickets; [] if it stays.

        It goes to a host where a call has ended, or to the only host.
        """
        open_tickets = [t for t in tickets if t.state in VISITED_STATES["next"]]
        elsewhere = [t for t in open_tickets if not self.is_here(t)]
        known = [t for t in elsewhere if t.number in agent.ended_elsewhere]
        hosts = {self.resource(t).host for t in open_tickets}
        if not elsewhere or (not known and len(hosts) > 1):
            return []
        host = self.resource((known or elsewhere)[0]).host
        return [t for t in elsewhere if self.resource(t).host == host]

    def own_tickets(self, agent: Agent) -> list[Ticket]:
        """The tickets of a coordinator's only thread."""
        return self.tickets(agent, only_thread(agent.block))

    def is_here(self, ticket: Ticket) -> bool:
        """Whether the resource of the ticket is on this host."""
        return self._team[ticket.member].host == self._own_host

    def resource(self, ticket: Ticket) -> TeamMember:
        return self._team[ticket.member]

    @property
    def ids(self) -> list[str]:
        """The ids of the team."""
        return [member.id for member in self._team]

    def name(self, ticket: Ticket) -> str:
        """The call as `resource.portal()`."""
        return f"{self.resource(ticket).id}.{self.portal(ticket)}()"

    def portal(self, ticket: Ticket) -> str:
        """The portal's name."""
        return self._program.core.methods[ticket.method].name

    def call_request(self, ticket: Ticket) -> CallRequest:
        """The request to the host for starting a call."""
        acts = ticket.method in self._scheduler.effectful_methods
        return CallRequest(ticket.number, self.resource(ticket).id, self.portal(ticket), acts)

    def tickets_elsewhere(
        self, tickets: list[Ticket], state: int, rank: Callable[[TeamMember], float] = lambda resource: 0
    ) -> list[Ticket]:
        """The tickets in a state on one other host: the first by rank, then in the order of collection."""
        elsewhere = [ticket for ticket in tickets if ticket.state == state and not self.is_here(ticket)]
        if not elsewhere:
            return []
        host = min(map(self.resource, elsewhere), key=rank).host
        return [ticket for ticket in elsewhere if self.resource(ticket).host == host]

    def cancel_rank(self, resource: TeamMember) -> float:
        """The rank of a resource in the order of cancellation: its host may be unreachable, so other hosts
        are first.
        """
        signs = self._scheduler.hooks.liveness
        return signs.contact_age(resource) if signs is not None else 0.0

    def awaited_tickets(self, agent: Agent) -> list[Ticket]:
        """The tickets that a suspended coordinator waits for: to start them here, or to reach their host."""
        head, found = self.head(agent), self.own_tickets(agent)
        if head == "next":
            return self.first_destination(agent, found)
        if head not in CANCELLING_HEADS and (
            collected := [t for t in found if t.state == TICKET_COLLECTED and self.is_here(t)]
        ):
            return collected
        by_state = (
            self.tickets_elsewhere(found, state, lambda resource: resource.id != agent.called_resource)
            for state in VISITED_STATES[head]
        )
        return next(filter(None, by_state), [])

    def current_target(self, agent: Agent) -> tuple[TeamMember, str] | None:
        """The resource and portal that a suspended coordinator waits for, the first of several.

        The portal is '' if the coordinator is reserving the resource.
        """
        if self._current_head(agent) == "take":
            entry = self._held_reservations.next_ungranted(agent)
            return (entry.resource, "") if entry is not None else None
        if (function := SEQUENCING.get(self._current_head(agent))) is not None:
            named = self._named_startable(agent)
            return (named, function) if named is not None else None
        if self.head(agent):
            awaited = self.awaited_tickets(agent)
            return (self.resource(awaited[0]), self.portal(awaited[0])) if awaited else None
        w = agent.block.w
        thread = w[layout.W_THREADS]
        words = self.call_arguments(agent, w[thread + THREAD_ID])
        if not words or not words[0]:
            return None
        portal = self._scheduler.engine.groups[w[thread + THREAD_PC]].head.a
        return self._team[w[words[0] + PROXY_MEMBER]], self._program.core.methods[portal].name

    def _named_startable(self, agent: Agent) -> TeamMember | None:
        """The coordinator that an instruction of the sequencing names."""
        words = self.call_arguments(agent, only_thread(agent.block))
        name = agent.block.string(words[0]) if words and words[0] else ""
        return next((member for member in self._team if member.id == name), None)

    def is_start_made(self, agent: Agent) -> bool:
        """Whether a coordinator is at a `start` that this host, the home of the other coordinator,
        has made.
        """
        if self._current_head(agent) != "seq_start":
            return False
        named, request = self._named_startable(agent), self.call_arguments(agent, only_thread(agent.block))[1]
        sequencer = self._scheduler.world.sequencer
        return named is not None and named.host == self._own_host and sequencer.has_started(named, request)

    def current_call(self, agent: Agent) -> str:
        """The target of `current_target` as `resource.portal()`; '' for none."""
        resource, portal = self.current_target(agent) or (None, "")
        return f"{resource.id}.{portal}()" if resource else ""

    def blocked_action(self, agent: Agent) -> str:
        """The action that a suspended coordinator is prevented from, as the end of a sentence; '' for
        none.
        """
        if self._current_head(agent) == "take":
            entry = self._held_reservations.next_ungranted(agent)
            return f" before {entry.resource.id} could be reserved" if entry is not None else ""
        called = self.current_call(agent)
        if not called:
            return ""
        if self._current_head(agent) == "seq_end" and (named := self._named_startable(agent)) is not None:
            return f"; {named.id} has not ended"
        is_started = self.is_fetching(agent)
        return (
            f"; {called} has begun, and its outcome is unknown"
            if is_started
            else f" before {called} could begin"
        )

    def is_heartbeat_pending(self, agent: Agent) -> bool:
        """Whether a heartbeat of the destination host of a suspended coordinator is still awaited."""
        signs, awaited = self._scheduler.hooks.liveness, self.awaited_tickets(agent)
        return signs is not None and bool(awaited) and signs.is_heartbeat_pending(self.resource(awaited[0]))

    def wait_reason(self, agent: Agent) -> str:
        """The reason why a suspended coordinator cannot continue at once: it has left or is being stored."""
        called = self.current_target(agent)
        if called is None or called[0].host == self._own_host:
            return "it was being written to disk"
        host = self._scheduler.world.host_of(called[0])
        return f"it was sent to {host} and may have arrived there"

    def is_fetching(self, agent: Agent) -> bool:
        """Whether a suspended coordinator waits for a started call of a `together`."""
        awaited = self.awaited_tickets(agent) if self.head(agent) else []
        return bool(awaited) and awaited[0].state != TICKET_COLLECTED

    def may_continue(self, agent: Agent) -> bool:
        """Whether all effects of a restored coordinator's instruction are known."""
        head = self._current_head(agent)
        if head not in VISITED_STATES or head in CANCELLING_HEADS:
            return head == "take" or head in CANCELLING_HEADS or head in SEQUENCING
        return not any(t.state == TICKET_COLLECTED and self.is_here(t) for t in self.own_tickets(agent))
