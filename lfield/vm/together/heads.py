"""`start`, `fetch` and `leave`: a coordinator goes round the hosts of its `together` (decision 46).

Each head does what there is to do on this host and then leaves for the next one, or is complete. It is run
again from its beginning wherever the coordinator comes to, and whenever something has come back: all that it
has done is in the tickets. At most one visit a host begins what is there, and one fetches it.
"""

from __future__ import annotations

from collections.abc import Callable

from lfield.vm.agent import Agent
from lfield.vm.cancelling import Cancelling
from lfield.vm.contract import Trap
from lfield.vm.inspect import traceback
from lfield.vm.limits import TIME_LIMIT, TimeLimits
from lfield.vm.memory.layout import (
    BACK,
    BEGUN,
    CALLING,
    COLLECTED,
    TICKET_ARRAY,
    TICKET_CALL,
    TICKET_INDEX,
    TICKET_NEXT,
    TICKET_STATE,
    TICKET_VALUE,
    TOLD,
)
from lfield.vm.reserve.held import Held
from lfield.vm.scheduler import Scheduler
from lfield.vm.together.beginning import Beginnings, collect, gather, settle
from lfield.vm.together.outcomes import RESTARTED, UNREACHABLE, Outcomes
from lfield.vm.together.visits import Ticket, Visits

RESERVED = "ReservedException"
#: Of a call whose host cannot be reached when the time is over.
UNREACHED = "its host cannot be reached; that ends the call itself, since its time is over"
Handler = Callable[[Agent, int, int, list[int]], None]


class Together:
    """The heads of `together`, for the coordinators of one host."""

    def __init__(
        self, scheduler: Scheduler, visits: Visits, held: Held, cancelling: Cancelling, limits: TimeLimits
    ) -> None:
        self._scheduler, self._visits, self._cancelling = scheduler, visits, cancelling
        self._limits = limits
        self._outcomes = Outcomes(scheduler, visits)
        self._beginnings = Beginnings(scheduler, visits, held, self._outcomes, limits)

    def heads(self) -> dict[str, Handler]:
        """By name, what carries them out. Raise Full: they are run again then."""
        return {
            "gather": self._gather,
            "begin": self._guarded(self._begin),
            "start": self._guarded(self._start),
            "fetch": self._guarded(self._fetch),
            "leave": self._guarded(self._leave),
            "settle": self._guarded(self._settle),
        }

    def _guarded(self, head: Handler) -> Handler:
        """A heap that cannot hold what came back is an exception where the coordinator stands."""

        def carry_out(agent: Agent, thread: int, operand: int, words: list[int]) -> None:
            try:
                head(agent, thread, operand, words)
            except Trap as trap:
                self._scheduler.refuse(agent, thread, trap.kind, trap.message)

        return carry_out

    def failed(self, agent: Agent, thread: int, kind: str, message: str, source: str) -> None:
        """What a frozen coordinator waited for cannot be: its calls there are back with an exception.

        Where a resource is reserved by somebody else (`source`), only the calls of that one are.
        """
        tickets = [
            ticket
            for ticket in self._visits.wanted(agent)
            if kind != RESERVED or self._visits.resource(ticket).id == source
        ]
        wanted = [(ticket.number, self._told(kind, message, ticket)) for ticket in tickets]
        try:
            for number, told in wanted:
                self._outcomes.throw(agent, thread, number, kind, told)
        except Trap as trap:
            self._scheduler.refuse(agent, thread, trap.kind, trap.message)
            return
        self._scheduler.turns.next(agent, thread)

    def _told(self, kind: str, message: str, ticket: Ticket) -> str:
        """What is said of one call: whether it may have been done is never left open."""
        if kind == RESTARTED:
            return message
        became = "has not begun" if ticket.state == COLLECTED else "has begun, and may have been done"
        return f"{message} ({self._visits.name(ticket)} {became})"

    def _gather(self, agent: Agent, thread: int, operand: int, words: list[int]) -> None:
        self._scheduler.go_on(agent, thread, gather(agent))

    def _begin(self, agent: Agent, thread: int, operand: int, words: list[int]) -> None:
        collect(self._scheduler, agent, operand, words)
        self._scheduler.go_on(agent, thread)

    def _settle(self, agent: Agent, thread: int, operand: int, words: list[int]) -> None:
        settle(agent, words)
        self._scheduler.go_on(agent, thread)

    # --- begin, fetch ---------------------------------------------------------------------------------

    def _start(self, agent: Agent, thread: int, operand: int, words: list[int]) -> None:
        if self._all_begun(agent, thread):
            self._scheduler.go_on(agent, thread)

    def _all_begun(self, agent: Agent, thread: int) -> bool:
        """Whether no call is only collected any more; else the coordinator waits, or leaves to begin one."""
        if not self._beginnings.begin_here(agent, thread):
            return False
        return not self._departs(agent, thread, COLLECTED)

    def _departs(self, agent: Agent, thread: int, state: int) -> bool:
        """Whether a coordinator leaves for the next host that has tickets in a state."""
        away = self._visits.away(self._visits.tickets(agent, thread), state)
        if not away:
            return False
        self._scheduler.freeze(agent, thread)
        self._limits.depart(agent, self._visits.resource(away[0]))
        return True

    def _fetch(self, agent: Agent, thread: int, operand: int, words: list[int]) -> None:
        if not self._all_begun(agent, thread):
            return
        self._outcomes.expire(agent, thread, BEGUN)
        if self._waits(agent, thread, BEGUN):
            return
        if agent.overdue and self._limits.strike(agent):
            return
        if self._departs(agent, thread, BEGUN):
            return
        found = self._visits.tickets(agent, thread)
        if any(ticket.thrown for ticket in found):
            self._throw(agent, thread)
            return
        w = agent.block.w
        for ticket in found:
            if array := w[ticket.place + TICKET_ARRAY]:
                w[array + 1 + w[ticket.place + TICKET_INDEX]] = w[ticket.place + TICKET_VALUE]
        self._clear(agent, thread)

    def _waits(self, agent: Agent, thread: int, state: int) -> bool:
        """Take what has come back of the tickets in a state; whether something here has not yet."""
        found = self._visits.tickets(agent, thread)
        numbers = [t.number for t in found if t.state == state and self._visits.is_here(t)]
        for number in numbers:
            begun = self._outcomes.take(agent, thread, number)
            if begun is not None:
                self._scheduler.set_state(agent, thread, CALLING)
                begun.waiter = agent, thread
                return True
        return False

    def _throw(self, agent: Agent, thread: int) -> None:
        """Throw what the first call in program order has thrown; the others are beside it."""
        first = self._outcomes.first(agent, thread)
        agent.block.w[self._visits.words(agent, thread)[0] + TICKET_NEXT] = 0
        self._scheduler.throw(agent, thread, first)

    # --- leave ----------------------------------------------------------------------------------------

    def _leave(self, agent: Agent, thread: int, operand: int, words: list[int]) -> None:
        """First all are told, host by host, then they are waited for.

        When a time limit around the block is over, hosts that cannot be reached are not waited for: they know
        of the limit, and end the calls themselves.
        """
        for state in (BEGUN, TOLD):
            self._outcomes.expire(agent, thread, state)
        for ticket in self._visits.tickets(agent, thread):
            if ticket.state == COLLECTED:
                ticket.w[ticket.place + TICKET_STATE], ticket.w[ticket.place + TICKET_CALL] = BACK, 0
            elif ticket.state == BEGUN and self._visits.is_here(ticket):
                self._tell(agent, ticket)
        if self._departs_in_time(agent, thread, BEGUN) or self._waits(agent, thread, TOLD):
            return
        if not self._departs_in_time(agent, thread, TOLD):
            self._report(agent, thread)
            self._clear(agent, thread)

    def _departs_in_time(self, agent: Agent, thread: int, state: int) -> bool:
        """As `_departs`; but who is over its time limit goes to no host that it cannot reach at once.

        All are asked for a sign of life together, so silence delays it once, however many hosts are silent.
        """
        signs = self._scheduler.attached.signs
        if signs is None or not self._limits.is_block_over(agent):
            return self._departs(agent, thread, state)
        for ticket in self._visits.tickets(agent, thread):
            if ticket.state in (BEGUN, TOLD) and not self._visits.is_here(ticket):
                signs.ask(self._visits.resource(ticket), self._limits.over_for(agent))
        while away := self._visits.away(self._visits.tickets(agent, thread), state):
            target = self._visits.resource(away[0])
            if not signs.is_silent(target):
                self._departs(agent, thread, state)
                if agent.frozen and signs.is_asked(target):
                    self._limits.look_soon(agent)
                    return True
                if not (agent.frozen and self._scheduler.world.give_up(agent)):
                    return True
                agent.frozen = False
            for number in [ticket.number for ticket in away]:
                self._outcomes.throw(agent, thread, number, UNREACHABLE, UNREACHED)
        return False

    def _tell(self, agent: Agent, ticket: Ticket) -> None:
        """Cancel a call that runs here, if it still does."""
        ticket.w[ticket.place + TICKET_STATE] = TOLD
        begun = self._scheduler.begun.get((agent.id, ticket.generation, ticket.number))
        resource = self._scheduler.agents.get(self._visits.resource(ticket).id)
        if begun is not None and begun.state == "running" and resource is not None:
            reason = f"{agent.id} has left the together that called {self._visits.portal(ticket)}()"
            self._cancelling.call(resource, begun.call, reason)

    def _report(self, agent: Agent, thread: int) -> None:
        """What was thrown, if anything was, says what became of the calls."""
        if not self._visits.tickets(agent, thread):
            return
        thrown = self._visits.words(agent, thread)[1]
        if thrown and traceback.describe(agent.block, self._scheduler.program, thrown)[0] == TIME_LIMIT:
            self._outcomes.explain(agent, thread, self._limits.lateness(agent))
        self._outcomes.beside(agent, thread)

    def _clear(self, agent: Agent, thread: int) -> None:
        """All calls are back, and nothing is asked of them any more.

        What is on the disk of the coordinator stands before what it does from here on.
        """
        agent.kept = False
        agent.block.w[self._visits.words(agent, thread)[0] + TICKET_NEXT] = 0
        self._scheduler.go_on(agent, thread)
