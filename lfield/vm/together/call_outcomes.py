"""Results of the calls of a `together`, stored into its tickets (decision 46)."""

from __future__ import annotations

from lfield.bytecode.program import EXCEPTIONS, MESSAGE
from lfield.vm.agent import CANCELLED, Agent
from lfield.vm.engine_interface import Trap
from lfield.vm.inspection import traceback
from lfield.vm.inspection.block_view import fields_of
from lfield.vm.memory.layout import (
    ARRAY,
    TICKET_ARRAY,
    TICKET_CALL,
    TICKET_RETURNED,
    TICKET_STATE,
    TICKET_THROWN,
    TICKET_VALUE,
)
from lfield.vm.memory.serialised_results import deserialise_result
from lfield.vm.memory.word_codec import new_exception
from lfield.vm.pending_call import PendingCall
from lfield.vm.scheduler import Scheduler
from lfield.vm.together.itinerary import Itinerary, Ticket

#: Number of suppressed exceptions with a log line each.
MAX_LOGGED = 8
RESTARTED, UNREACHABLE = "RestartException", "UnreachableResourceException"


class CallOutcomes:
    """Fills tickets. Every method may collect the block, which invalidates places.

    Raises Trap when the heap cannot hold the results.
    """

    def __init__(self, scheduler: Scheduler, itinerary: Itinerary) -> None:
        self._scheduler, self._itinerary = scheduler, itinerary
        self._program = scheduler.program

    def fetch(self, agent: Agent, thread: int, number: int) -> PendingCall | None:
        """Fetch a call that was started here; None if the call has returned, otherwise the call to
        wait for.
        """
        ticket = self._ticket(agent, thread, number)
        key = agent.id, ticket.generation, number
        started = self._scheduler.pending_calls.get(key)
        if started is None or started.state == "lost":
            reason = f"its host restarted while {self._itinerary.name(ticket)} ran; it may have been executed"
            self.throw(agent, thread, number, RESTARTED, reason)
        elif started.state == "running" or not started.is_persisted:
            return started
        else:
            self._unpack(agent, thread, number, started)
        if started is not None and started.is_expired:
            # Set the clock, because at least this time has passed; the coordinator may have counted less
            # during the transfer.
            self._scheduler.set_clock(agent, max(self._scheduler.clock_of(agent), started.deadline))
            agent.mark_overdue()
        self._scheduler.pending_calls.pop(key, None)
        agent.fetched.append(key)
        return None

    def throw(self, agent: Agent, thread: int, number: int, kind: str, message: str) -> None:
        """End a call with a built-in exception."""
        scheduler = self._scheduler

        def work() -> None:
            ticket = self._ticket(agent, thread, number)
            source = self._itinerary.resource(ticket).id
            thrown = new_exception(agent.block, scheduler.layouts, kind, message, source)
            self._mark_returned(ticket, TICKET_THROWN, thrown)

        scheduler.run_with_collection(agent, work)

    def mark_lost(self, agent: Agent, thread: int, state: int) -> None:
        """Mark the calls in a state as lost that another start of the coordinator started: their hosts fence
        them.
        """
        for ticket in self._itinerary.tickets(agent, thread):
            if ticket.state == state and ticket.generation != agent.generation:
                name = self._itinerary.name(ticket)
                reason = f"{agent.id} was recovered since it called {name}; the call may have been executed"
                self.throw(agent, thread, ticket.number, RESTARTED, reason)

    def _unpack(self, agent: Agent, thread: int, number: int, pending: PendingCall) -> None:
        def work() -> None:
            ticket = self._ticket(agent, thread, number)
            if pending.state == "thrown":
                word = deserialise_result(pending.result, agent.block, self._scheduler.layouts)
                self._mark_returned(ticket, TICKET_THROWN, word)
            elif ticket.w[ticket.place + TICKET_ARRAY]:
                word = deserialise_result(pending.result, agent.block, self._scheduler.layouts)
                self._mark_returned(ticket, TICKET_VALUE, word)
            else:
                self._mark_returned(ticket, TICKET_VALUE, 0)

        try:
            self._scheduler.run_with_collection(agent, work)
        except Trap as trap:
            self.throw(agent, thread, number, trap.kind, trap.message)

    def _mark_returned(self, ticket: Ticket, field: int, word: int) -> None:
        w = ticket.w
        w[ticket.place + TICKET_STATE] = TICKET_RETURNED
        w[ticket.place + TICKET_CALL] = 0
        w[ticket.place + field] = word

    def _ticket(self, agent: Agent, thread: int, number: int) -> Ticket:
        """The present view of a ticket."""
        return next(ticket for ticket in self._itinerary.tickets(agent, thread) if ticket.number == number)

    # --- several exceptions ---------------------------------------------------------------------------

    def first_error(self, agent: Agent, thread: int) -> int:
        """The exception of the first failed call in program order, with the others suppressed."""
        self._log_errors(agent, self._thrown(agent, thread)[1:])
        self._scheduler.run_with_collection(
            agent,
            lambda: self._add_suppressed(agent, *(ticket.thrown for ticket in self._thrown(agent, thread))),
        )
        return self._thrown(agent, thread)[0].thrown

    def attach_suppressed(self, agent: Agent, thread: int) -> None:
        """Attach exceptions of calls to the exception by which a `together` was left, if any."""

        def real() -> list[Ticket]:
            return [
                t
                for t in self._thrown(agent, thread)
                if self._class_and_message(agent, t.thrown)[0] != CANCELLED
            ]

        self._log_errors(agent, real())
        self._scheduler.run_with_collection(
            agent,
            lambda: self._add_suppressed(
                agent, self._itinerary.call_arguments(agent, thread)[1], *(t.thrown for t in real())
            ),
        )

    def explain(self, agent: Agent, thread: int, late: float) -> None:
        """Add the outcome of each started call to the exception of a time limit, and the delay in seconds of
        the end of the block.
        """
        started = [ticket for ticket in self._itinerary.tickets(agent, thread) if ticket.generation]
        reasons = "; ".join(
            f"{self._itinerary.name(ticket)} {self._outcome_text(agent, ticket)}" for ticket in started
        )
        if late:
            block = f"the block ends {late:.1f} s late: it waited for its calls and their hosts"
            reasons = f"{reasons}; {block}" if reasons else block
        if not reasons:
            return

        def work() -> None:
            limit = self._itinerary.call_arguments(agent, thread)[1]
            text = agent.block.text(agent.block.w[limit + 1 + MESSAGE])
            agent.block.w[limit + 1 + MESSAGE] = agent.block.new_string(f"{text}; {reasons}")

        self._scheduler.run_with_collection(agent, work)

    def _outcome_text(self, agent: Agent, ticket: Ticket) -> str:
        kind = self._class_and_message(agent, ticket.thrown)[0] if ticket.thrown else ""
        outcomes = {"": "has completed", CANCELLED: "was cancelled", UNREACHABLE: "was not reached"}
        return outcomes.get(kind, f"ended with {kind}")

    def _thrown(self, agent: Agent, thread: int) -> list[Ticket]:
        return [ticket for ticket in self._itinerary.tickets(agent, thread) if ticket.thrown]

    def _class_and_message(self, agent: Agent, thrown: int) -> tuple[str, str]:
        """Class and message of an exception."""
        return traceback.describe(agent.block, self._program, thrown)[:2]

    def _log_errors(self, agent: Agent, others: list[Ticket]) -> None:
        """Log the first exceptions with a line each, and the number of the other ones; `others()` returns
        all.
        """
        for ticket in others[:MAX_LOGGED]:
            name, message = self._class_and_message(agent, ticket.thrown)
            text = f"{name}: {message}" if message else name
            if agent.block.w[ticket.thrown] >> 8 & 0xFFFFFF >= self._program.builtins:
                text = f"{name} {fields_of(agent.block, self._program, ticket.thrown, self._itinerary.ids)}"
            self._scheduler.world.log(agent, f"{self._itinerary.name(ticket)} also failed: {text}")
        if more := len(others[MAX_LOGGED:]):
            self._scheduler.world.log(agent, f"{more} other calls also failed")

    def _add_suppressed(self, agent: Agent, first: int, *others: int) -> None:
        """Append suppressed exceptions to an exception. Raises HeapFull before any change."""
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
