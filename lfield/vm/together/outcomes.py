"""What has become of the calls of a `together`, put into its tickets (decision 46)."""

from __future__ import annotations

from lfield.bytecode.program import EXCEPTIONS, MESSAGE
from lfield.vm.agent import Agent
from lfield.vm.begun import Begun
from lfield.vm.cancelling import CANCELLED
from lfield.vm.contract import Trap
from lfield.vm.inspect import traceback
from lfield.vm.inspect.decode import fields_of
from lfield.vm.memory.layout import (
    ARRAY,
    BACK,
    TICKET_ARRAY,
    TICKET_CALL,
    TICKET_STATE,
    TICKET_THROWN,
    TICKET_VALUE,
)
from lfield.vm.memory.parcels import open_parcel
from lfield.vm.memory.values import new_exception
from lfield.vm.scheduler import Scheduler
from lfield.vm.together.visits import Ticket, Visits

#: So many exceptions beside the first have a line of the log each.
MOST_TOLD = 8
RESTARTED, UNREACHABLE = "RestartException", "UnreachableResourceException"


class Outcomes:
    """Fills tickets. Whatever it does may collect the block: places of before are wrong then.

    Raises Trap when the heap cannot hold what came back.
    """

    def __init__(self, scheduler: Scheduler, visits: Visits) -> None:
        self._scheduler, self._visits = scheduler, visits
        self._program = scheduler.program

    def take(self, agent: Agent, thread: int, number: int) -> Begun | None:
        """Fetch a call that was begun here; None when it is back now, else what is to be waited for."""
        ticket = self._ticket(agent, thread, number)
        key = agent.id, ticket.generation, number
        begun = self._scheduler.begun.get(key)
        if begun is None or begun.state == "lost":
            why = f"its host was started again while {self._visits.name(ticket)} ran; it may have been done"
            self.throw(agent, thread, number, RESTARTED, why)
        elif begun.state == "running" or not begun.kept:
            return begun
        else:
            self._unpack(agent, thread, number, begun)
        if begun is not None and begun.over:
            # So much time has passed for certain; on its way here the coordinator may have counted less.
            self._scheduler.set_clock(agent, max(self._scheduler.clock_of(agent), begun.end))
            agent.overdue = True
        self._scheduler.begun.pop(key, None)
        agent.fetched.append(key)
        return None

    def throw(self, agent: Agent, thread: int, number: int, kind: str, message: str) -> None:
        """A call has come back with a built-in exception."""
        scheduler = self._scheduler

        def work() -> None:
            ticket = self._ticket(agent, thread, number)
            source = self._visits.resource(ticket).id
            thrown = new_exception(agent.block, scheduler.layouts, kind, message, source)
            self._back(ticket, TICKET_THROWN, thrown)

        scheduler.with_room(agent, work)

    def expire(self, agent: Agent, thread: int, state: int) -> None:
        """Calls in a state that another start of the coordinator has begun are lost: its hosts fence them."""
        for ticket in self._visits.tickets(agent, thread):
            if ticket.state == state and ticket.generation != agent.generation:
                name = self._visits.name(ticket)
                why = f"{agent.id} was recovered since it called {name}; it may have been done"
                self.throw(agent, thread, ticket.number, RESTARTED, why)

    def _unpack(self, agent: Agent, thread: int, number: int, begun: Begun) -> None:
        def work() -> None:
            ticket = self._ticket(agent, thread, number)
            if begun.state == "thrown":
                word = open_parcel(begun.parcel, agent.block, self._scheduler.layouts)
                self._back(ticket, TICKET_THROWN, word)
            elif ticket.w[ticket.place + TICKET_ARRAY]:
                word = open_parcel(begun.parcel, agent.block, self._scheduler.layouts)
                self._back(ticket, TICKET_VALUE, word)
            else:
                self._back(ticket, TICKET_VALUE, 0)

        try:
            self._scheduler.with_room(agent, work)
        except Trap as trap:
            self.throw(agent, thread, number, trap.kind, trap.message)

    def _back(self, ticket: Ticket, field: int, word: int) -> None:
        w = ticket.w
        w[ticket.place + TICKET_STATE] = BACK
        w[ticket.place + TICKET_CALL] = 0
        w[ticket.place + field] = word

    def _ticket(self, agent: Agent, thread: int, number: int) -> Ticket:
        """Where a ticket is now."""
        return next(ticket for ticket in self._visits.tickets(agent, thread) if ticket.number == number)

    # --- several exceptions ---------------------------------------------------------------------------

    def first(self, agent: Agent, thread: int) -> int:
        """What the first call in program order has thrown, the others beside it."""
        self._tell(agent, self._thrown(agent, thread)[1:])
        self._scheduler.with_room(
            agent, lambda: self._join(agent, *(ticket.thrown for ticket in self._thrown(agent, thread)))
        )
        return self._thrown(agent, thread)[0].thrown

    def beside(self, agent: Agent, thread: int) -> None:
        """What calls have thrown when a `together` was left, beside what it was left by, if it was thrown."""

        def real() -> list[Ticket]:
            return [t for t in self._thrown(agent, thread) if self._said(agent, t.thrown)[0] != CANCELLED]

        self._tell(agent, real())
        self._scheduler.with_room(
            agent,
            lambda: self._join(agent, self._visits.words(agent, thread)[1], *(t.thrown for t in real())),
        )

    def explain(self, agent: Agent, thread: int, late: float) -> None:
        """A time limit that is over says what became of each call that it has begun, and by how many seconds
        its block ends late."""
        begun = [ticket for ticket in self._visits.tickets(agent, thread) if ticket.generation]
        what = "; ".join(f"{self._visits.name(ticket)} {self._became(agent, ticket)}" for ticket in begun)
        if late:
            block = f"the block ends {late:.1f} s late since it waited for its calls and their hosts"
            what = f"{what}; {block}" if what else block
        if not what:
            return

        def work() -> None:
            limit = self._visits.words(agent, thread)[1]
            text = agent.block.text(agent.block.w[limit + 1 + MESSAGE])
            agent.block.w[limit + 1 + MESSAGE] = agent.block.new_string(f"{text}; {what}")

        self._scheduler.with_room(agent, work)

    def _became(self, agent: Agent, ticket: Ticket) -> str:
        kind = self._said(agent, ticket.thrown)[0] if ticket.thrown else ""
        became = {"": "came to its end", CANCELLED: "was cancelled", UNREACHABLE: "was not reached"}
        return became.get(kind, f"ended with {kind}")

    def _thrown(self, agent: Agent, thread: int) -> list[Ticket]:
        return [ticket for ticket in self._visits.tickets(agent, thread) if ticket.thrown]

    def _said(self, agent: Agent, thrown: int) -> tuple[str, str]:
        """Class and message of an exception."""
        return traceback.describe(agent.block, self._program, thrown)[:2]

    def _tell(self, agent: Agent, others: list[Ticket]) -> None:
        """A line of the log for each of the first, and one for the rest: `others()` has them all."""
        for ticket in others[:MOST_TOLD]:
            name, message = self._said(agent, ticket.thrown)
            text = f"{name}: {message}" if message else name
            if agent.block.w[ticket.thrown] >> 8 & 0xFFFFFF >= self._program.builtins:
                text = f"{name} {fields_of(agent.block, self._program, ticket.thrown, self._visits.ids)}"
            self._scheduler.world.log(agent, f"{self._visits.name(ticket)} has thrown too: {text}")
        if more := len(others[MOST_TOLD:]):
            self._scheduler.world.log(agent, f"and so have {more} other calls")

    def _join(self, agent: Agent, first: int, *others: int) -> None:
        """Put exceptions beside another one, behind those that are there. Raises Full before it does."""
        block = agent.block
        field = self._program.others.get(block.w[first] >> 8 & 0xFFFFFF) if first else None
        if field is None or not others:
            return
        known = block.w[first + 1 + field]
        before = block.w[known + 1 : known + (block.w[known] >> 32)].tolist() if known else []
        array = block.allocate(ARRAY, EXCEPTIONS, 1 + len(before) + len(others))
        for i, place in enumerate((*before, *others), array + 1):
            block.w[i] = place
        block.w[first + 1 + field] = array
