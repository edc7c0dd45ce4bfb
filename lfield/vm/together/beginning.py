"""From a call that a `together` collects to one that runs (decision 46)."""

from __future__ import annotations

from lfield.vm import portals
from lfield.vm.agent import Agent
from lfield.vm.begun import Begun
from lfield.vm.contract import Trap
from lfield.vm.limits import TimeLimits
from lfield.vm.memory.block import Block
from lfield.vm.memory.copier import deep_copy
from lfield.vm.memory.layout import (
    BACK,
    BEGUN,
    CALLING,
    COLLECTED,
    FRAME,
    FRAME_SLOTS,
    TICKET,
    TICKET_CALL,
    TICKET_GENERATION,
    TICKET_STATE,
    TICKET_VALUE,
    TICKET_WORDS,
)
from lfield.vm.memory.tickets import collected, new_ticket
from lfield.vm.reserve.held import Held
from lfield.vm.scheduler import Scheduler
from lfield.vm.together.outcomes import Outcomes
from lfield.vm.together.visits import Ticket, Visits

#: The most calls of one `together`: each is looked at whenever one of them comes back.
MOST_CALLS = 256


def gather(agent: Agent) -> int:
    """A new sentinel; raises Full."""
    return agent.block.allocate(TICKET, 0, TICKET_WORDS)


def collect(scheduler: Scheduler, agent: Agent, method: int, words: list[int]) -> None:
    """One more call; `words` are sentinel, array (or null) and index of its target, proxy, arguments.

    What the arguments lead to is copied now: what the block changes later does not reach the portal. Raises
    Full before the call is in, and Trap when the target is no element, or there are too many.
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


def settle(agent: Agent, words: list[int]) -> None:
    """A ticket for what is there already, if somebody wants it; `words` are sentinel, array, index, value.

    Raises Full before it is in, and Trap when the target is no element, or there are too many.
    """
    sentinel, array, index, value = words
    if not array:
        return
    w = agent.block.w
    _check_target(agent.block, array, index)
    _check_number(agent.block, sentinel)
    ticket = new_ticket(agent.block, sentinel, 0, 0, 0, (array, index))
    w[ticket + TICKET_STATE], w[ticket + TICKET_VALUE] = BACK, value


def _check_number(block: Block, sentinel: int) -> None:
    if len(collected(block, sentinel)) == MOST_CALLS:
        raise Trap("LimitException", f"a together has at most {MOST_CALLS} calls")


def _check_target(block: Block, array: int, index: int) -> None:
    if array and not 0 <= index < (block.w[array] >> 32) - 1:
        length = (block.w[array] >> 32) - 1
        raise Trap("IndexException", f"index {index} of an array of length {length}")


class Beginnings:
    """Begins all calls for one host in one visit. A call that cannot begin is back, with its exception."""

    def __init__(
        self, scheduler: Scheduler, visits: Visits, held: Held, outcomes: Outcomes, limits: TimeLimits
    ) -> None:
        self._scheduler, self._visits, self._held = scheduler, visits, held
        self._outcomes, self._limits = outcomes, limits

    def begin_here(self, agent: Agent, thread: int) -> bool:
        """Begin what is collected for this host; false: its host does not let it yet, it is frozen."""
        if not self._served(agent, thread):
            return False
        mine = self._mine(agent, thread)
        if mine and not self._may_begin(agent, thread, mine):
            return False
        for number in [ticket.number for ticket in mine]:
            ticket = next(ticket for ticket in self._mine(agent, thread) if ticket.number == number)
            try:
                self._begin(agent, ticket)
            except Trap as trap:
                self._outcomes.throw(agent, thread, number, trap.kind, trap.message)
        return True

    def _mine(self, agent: Agent, thread: int) -> list[Ticket]:
        found = self._visits.tickets(agent, thread)
        return [ticket for ticket in found if ticket.state == COLLECTED and self._visits.is_here(ticket)]

    def _served(self, agent: Agent, thread: int) -> bool:
        """Whether no reservation keeps a call from beginning; one that it always will is back."""
        self._scheduler.set_state(agent, thread, CALLING)
        for number in [ticket.number for ticket in self._mine(agent, thread)]:
            ticket = next(ticket for ticket in self._mine(agent, thread) if ticket.number == number)
            member = self._visits.resource(ticket)
            resource = self._scheduler.agents.get(member.id)
            try:
                if resource is not None and not portals.serves(
                    self._scheduler, resource, agent, self._held.number(agent, member)
                ):
                    return False
            except Trap as trap:
                self._outcomes.throw(agent, thread, number, trap.kind, trap.message)
        return True

    def _may_begin(self, agent: Agent, thread: int, mine: list[Ticket]) -> bool:
        self._scheduler.set_state(agent, thread, CALLING)
        agent.frozen = True
        if not self._scheduler.world.begins(agent, [self._visits.beginning(ticket) for ticket in mine]):
            return False
        agent.frozen = False
        return True

    def _begin(self, agent: Agent, ticket: Ticket) -> None:
        scheduler = self._scheduler
        member, method, w = self._visits.resource(ticket), ticket.method, ticket.w
        resource = portals.called(scheduler, member, agent, ticket.proxy, method)
        first = w[ticket.place + TICKET_CALL] + FRAME_SLOTS + 1
        parameters = scheduler.program.core.methods[method].parameters
        words = [ticket.proxy, *w[first : first + parameters].tolist()]
        portal = self._visits.portal(ticket)
        begun = Begun(agent.id, agent.generation, ticket.number, member.id, portal, agent.fenced)
        served = portals.begin(scheduler, resource, agent, begun, method, words)
        begun.call, begun.method = scheduler.last_call, method
        scheduler.begun[begun.key] = begun
        w[ticket.place + TICKET_STATE] = BEGUN
        w[ticket.place + TICKET_GENERATION] = agent.generation
        w[ticket.place + TICKET_CALL] = 0
        self._limits.cancel_at_end(agent, resource, begun)
        if resource.open:
            portals.serve(scheduler, resource, served, method, scheduler.turns.last)
        else:
            resource.waiting.append((resource, served))
