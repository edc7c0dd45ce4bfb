"""Starting the calls that a `together` has collected (decision 46)."""

from __future__ import annotations

from lfield.vm import portal_calls
from lfield.vm.agent import Agent
from lfield.vm.deadlines import Deadlines
from lfield.vm.engine_interface import Trap
from lfield.vm.memory import layout
from lfield.vm.memory.block import Block
from lfield.vm.memory.call_tickets import new_ticket, tickets_of
from lfield.vm.memory.copier import deep_copy
from lfield.vm.memory.layout import (
    CALLING,
    FRAME,
    FRAME_SLOTS,
    THREAD_CALL,
    TICKET,
    TICKET_CALL,
    TICKET_COLLECTED,
    TICKET_GENERATION,
    TICKET_RETURNED,
    TICKET_STARTED,
    TICKET_STATE,
    TICKET_VALUE,
    TICKET_WORDS,
)
from lfield.vm.memory.threads import place_of
from lfield.vm.pending_call import PendingCall
from lfield.vm.reservations.held_reservations import HeldReservations
from lfield.vm.scheduler import Scheduler
from lfield.vm.together.call_outcomes import CallOutcomes
from lfield.vm.together.itinerary import Itinerary, Ticket

#: The maximum number of calls of one `together`: all calls are checked whenever a call returns.
MAX_CALLS = 256


def new_sentinel(agent: Agent) -> int:
    """A new sentinel; raises HeapFull."""
    return agent.block.allocate(TICKET, 0, TICKET_WORDS)


def collect(scheduler: Scheduler, agent: Agent, method: int, words: list[int]) -> None:
    """Collect a call; `words` are sentinel, array (or null) and index of its target, proxy, arguments.

    Arguments are copied now, so later changes in the block do not reach the portal. Raises HeapFull before
    any change, and Trap when the target is not an element, or there are too many calls.
    """
    sentinel, array, index, proxy, *arguments = words
    block = agent.block
    _check_target(block, array, index)
    _check_number(block, sentinel)
    call = block.allocate(FRAME, method, scheduler.layouts.frame_words[method])
    references = scheduler.reference_arguments[method]
    roots = [arguments[i - 1] for i in references]
    copies = deep_copy(block, roots, block, scheduler.layouts) if references else []
    w = block.w
    for i, word in enumerate(arguments, call + FRAME_SLOTS + 1):
        w[i] = word
    for i, place in zip(references, copies, strict=True):
        w[call + FRAME_SLOTS + i] = place
    new_ticket(block, sentinel, method, proxy, call, (array, index if array else 0))


def add_settled(agent: Agent, words: list[int]) -> None:
    """Add a ticket for an existing result, if it has a target; `words` are sentinel, array, index, value.

    Raises HeapFull before any change, and Trap when the target is not an element, or there are too many
    calls.
    """
    sentinel, array, index, value = words
    if not array:
        return
    w = agent.block.w
    _check_target(agent.block, array, index)
    _check_number(agent.block, sentinel)
    ticket = new_ticket(agent.block, sentinel, 0, 0, 0, (array, index))
    w[ticket + TICKET_STATE], w[ticket + TICKET_VALUE] = TICKET_RETURNED, value


def _check_number(block: Block, sentinel: int) -> None:
    if len(tickets_of(block, sentinel)) == MAX_CALLS:
        raise Trap("LimitException", f"a together has at most {MAX_CALLS} calls")


def _check_target(block: Block, array: int, index: int) -> None:
    if array and not 0 <= index < (length := layout.length(block.w, array)):
        raise Trap("IndexException", f"index {index} of an array of length {length}")


class CallStarter:
    """Starts all calls for one host in one visit. A call that cannot start returns with an exception."""

    def __init__(
        self,
        scheduler: Scheduler,
        itinerary: Itinerary,
        held: HeldReservations,
        outcomes: CallOutcomes,
        limits: Deadlines,
    ) -> None:
        self._scheduler, self._itinerary, self._held_reservations = scheduler, itinerary, held
        self._outcomes, self._deadlines = outcomes, limits

    def start_local_calls(self, agent: Agent, thread: int) -> bool:
        """Start the calls collected for this host; false: the host does not permit it yet, and the
        coordinator is suspended.
        """
        if not self._is_served(agent, thread):
            return False
        local_tickets = self._local_tickets(agent, thread)
        if local_tickets and not self._may_start(agent, thread, local_tickets):
            return False
        for number in [ticket.number for ticket in local_tickets]:
            ticket = next(ticket for ticket in self._local_tickets(agent, thread) if ticket.number == number)
            try:
                self._start(agent, ticket)
            except Trap as trap:
                self._outcomes.throw(agent, thread, number, trap.kind, trap.message)
        return True

    def _local_tickets(self, agent: Agent, thread: int) -> list[Ticket]:
        found = self._itinerary.tickets(agent, thread)
        return [
            ticket for ticket in found if ticket.state == TICKET_COLLECTED and self._itinerary.is_here(ticket)
        ]

    def _is_served(self, agent: Agent, thread: int) -> bool:
        """Whether reservations permit the start of all calls; a call that they will never permit returns."""
        self._scheduler.set_state(agent, thread, CALLING)
        for number in [ticket.number for ticket in self._local_tickets(agent, thread)]:
            ticket = next(ticket for ticket in self._local_tickets(agent, thread) if ticket.number == number)
            member = self._itinerary.resource(ticket)
            resource = self._scheduler.agents.get(member.id)
            try:
                if resource is not None and not portal_calls.is_served(
                    self._scheduler,
                    resource,
                    agent,
                    self._held_reservations.reservation_number(agent, member),
                ):
                    return False
            except Trap as trap:
                self._outcomes.throw(agent, thread, number, trap.kind, trap.message)
        return True

    def _may_start(self, agent: Agent, thread: int, local_tickets: list[Ticket]) -> bool:
        self._scheduler.set_state(agent, thread, CALLING)
        agent.freeze()
        if not self._scheduler.world.may_start_calls(
            agent, [self._itinerary.call_request(ticket) for ticket in local_tickets]
        ):
            return False
        agent.resume()
        return True

    def _start(self, agent: Agent, ticket: Ticket) -> None:
        scheduler = self._scheduler
        member, method, w = self._itinerary.resource(ticket), ticket.method, ticket.w
        resource = portal_calls.target_resource(scheduler, member, agent, ticket.proxy, method)
        first = w[ticket.place + TICKET_CALL] + FRAME_SLOTS + 1
        parameters = scheduler.program.core.methods[method].parameters
        words = [ticket.proxy, *w[first : first + parameters].tolist()]
        portal = self._itinerary.portal(ticket)
        pending = PendingCall(agent.id, agent.generation, ticket.number, member.id, portal, agent.fenced)
        pending.is_future = self._itinerary.head(agent) == "launch"
        served = portal_calls.start_call(scheduler, resource, agent, pending, method, words)
        number = resource.block.w[place_of(resource.block, served) + THREAD_CALL]
        pending.call, pending.method = number, method
        scheduler.pending_calls[pending.key] = pending
        w[ticket.place + TICKET_STATE] = TICKET_STARTED
        w[ticket.place + TICKET_GENERATION] = agent.generation
        w[ticket.place + TICKET_CALL] = 0
        self._deadlines.schedule_cancel(agent, resource, pending)
        if resource.open:
            portal_calls.serve(scheduler, resource, served, method, scheduler.run_queue.push_back)
        else:
            resource.waiting.append((resource, served))
