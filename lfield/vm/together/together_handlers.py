"""`start`, `fetch` and `leave`: a coordinator visits the hosts of its `together` (decision 46).

Each handler does its work on this host, then departs for the next one, or completes. A handler runs again
from its start after each hop and each completed call: its progress is in the tickets. At most one visit to a
host starts its calls, and at most one fetches their results.
"""

from __future__ import annotations

from lfield.vm.agent import Agent
from lfield.vm.cancellation import Cancellation
from lfield.vm.deadlines import TIME_LIMIT, Deadlines
from lfield.vm.engine_interface import Trap
from lfield.vm.inspection import traceback
from lfield.vm.memory import layout
from lfield.vm.memory.layout import (
    TICKET_ARRAY,
    TICKET_CALL,
    TICKET_COLLECTED,
    TICKET_INDEX,
    TICKET_NEXT,
    TICKET_RETURNED,
    TICKET_STARTED,
    TICKET_STATE,
    TICKET_VALUE,
)
from lfield.vm.reservations.held_reservations import HeldReservations
from lfield.vm.scheduler import Scheduler
from lfield.vm.together.call_outcomes import RESTARTED, CallOutcomes
from lfield.vm.together.call_progress import CallProgress, Handler
from lfield.vm.together.call_start import CallStarter, add_settled, collect, new_sentinel
from lfield.vm.together.future_handlers import FutureHandlers
from lfield.vm.together.itinerary import Itinerary, Ticket

RESERVED = "ReservedException"


class TogetherHandlers:
    """The instruction handlers of `together`, for the coordinators of one host."""

    def __init__(
        self,
        scheduler: Scheduler,
        itinerary: Itinerary,
        held: HeldReservations,
        cancelling: Cancellation,
        limits: Deadlines,
    ) -> None:
        self._scheduler, self._itinerary, self._deadlines = scheduler, itinerary, limits
        self._outcomes = CallOutcomes(scheduler, itinerary)
        starter = CallStarter(scheduler, itinerary, held, self._outcomes, limits)
        self._progress = CallProgress(scheduler, itinerary, cancelling, limits, self._outcomes, starter)
        self._futures = FutureHandlers(scheduler, itinerary, limits, self._outcomes, self._progress)

    def handlers(self) -> dict[str, Handler]:
        """The handlers by name. They raise HeapFull, and run again after the collection."""
        return {
            "gather": self._on_gather,
            "begin": self._progress.guarded(self._on_collect),
            "start": self._progress.guarded(self._on_start),
            "fetch": self._progress.guarded(self._on_fetch),
            "leave": self._progress.guarded(self._on_leave),
            "settle": self._progress.guarded(self._on_settle),
            **self._futures.handlers(),
        }

    def on_failed(self, agent: Agent, thread: int, kind: str, message: str, source: str) -> None:
        """A suspended coordinator cannot reach the awaited calls, which return with an exception.

        If another coordinator has reserved a resource (`source`), only the calls of that resource return.
        """
        tickets = [
            ticket
            for ticket in self._itinerary.awaited_tickets(agent)
            if kind != RESERVED or self._itinerary.resource(ticket).id == source
        ]
        failures = [(ticket.number, self._failure_text(kind, message, ticket)) for ticket in tickets]
        try:
            for number, text in failures:
                self._outcomes.throw(agent, thread, number, kind, text)
        except Trap as trap:
            self._scheduler.throw_builtin(agent, thread, trap.kind, trap.message)
            return
        self._scheduler.run_queue.push_front(agent, thread)

    def _failure_text(self, kind: str, message: str, ticket: Ticket) -> str:
        """The message for one call, which states whether it may have been executed."""
        if kind == RESTARTED:
            return message
        outcome = (
            "has not begun" if ticket.state == TICKET_COLLECTED else "has begun, and may have been executed"
        )
        return f"{message} ({self._itinerary.name(ticket)} {outcome})"

    def _on_gather(self, agent: Agent, thread: int, operand: int, words: list[int]) -> None:
        self._scheduler.complete_at_once(agent, thread, new_sentinel(agent))

    def _on_collect(self, agent: Agent, thread: int, operand: int, words: list[int]) -> None:
        collect(self._scheduler, agent, operand, words)
        self._scheduler.complete_at_once(agent, thread)

    def _on_settle(self, agent: Agent, thread: int, operand: int, words: list[int]) -> None:
        add_settled(agent, words)
        self._scheduler.complete_at_once(agent, thread)

    # --- start, fetch ---------------------------------------------------------------------------------

    def _on_start(self, agent: Agent, thread: int, operand: int, words: list[int]) -> None:
        if self._progress.are_all_started(agent, thread):
            self._scheduler.complete_at_once(agent, thread)

    def _on_fetch(self, agent: Agent, thread: int, operand: int, words: list[int]) -> None:
        if not self._progress.are_all_started(agent, thread):
            return
        self._outcomes.mark_lost(agent, thread, TICKET_STARTED)
        if self._progress.is_waiting_for(agent, thread, TICKET_STARTED):
            return
        if agent.overdue and self._deadlines.expire(agent):
            return
        if self._progress.departs_for(agent, thread, TICKET_STARTED):
            return
        found = self._itinerary.tickets(agent, thread)
        if any(ticket.thrown for ticket in found):
            self._throw(agent, thread)
            return
        w = agent.block.w
        removed = ""
        for ticket in found:
            if array := w[ticket.place + TICKET_ARRAY]:
                first, end = layout.elements(w, array)
                index = w[ticket.place + TICKET_INDEX]
                if first + index < end:
                    w[first + index] = w[ticket.place + TICKET_VALUE]
                else:
                    removed = removed or f"index {index} of an array of length {end - first}"
        self._clear(agent, thread)
        if removed:
            # The array has become shorter since the call started.
            self._scheduler.throw_builtin(agent, thread, "IndexException", removed)

    def _throw(self, agent: Agent, thread: int) -> None:
        """Throw the exception of the first failed call in program order, with the others suppressed."""
        first = self._outcomes.first_error(agent, thread)
        agent.block.w[self._itinerary.call_arguments(agent, thread)[0] + TICKET_NEXT] = 0
        self._scheduler.throw(agent, thread, first)

    # --- leave ----------------------------------------------------------------------------------------

    def _on_leave(self, agent: Agent, thread: int, operand: int, words: list[int]) -> None:
        """Cancel all calls, host by host, then wait for them."""
        for ticket in self._itinerary.tickets(agent, thread):
            if ticket.state == TICKET_COLLECTED:
                ticket.w[ticket.place + TICKET_STATE], ticket.w[ticket.place + TICKET_CALL] = (
                    TICKET_RETURNED,
                    0,
                )
        if self._progress.are_all_cancelled(agent, thread):
            self._report(agent, thread)
            self._clear(agent, thread)

    def _report(self, agent: Agent, thread: int) -> None:
        """Add the outcomes of the calls to the thrown exception, if there is one."""
        if not self._itinerary.tickets(agent, thread):
            return
        thrown = self._itinerary.call_arguments(agent, thread)[1]
        if thrown and traceback.describe(agent.block, self._scheduler.program, thrown)[0] == TIME_LIMIT:
            self._outcomes.explain(agent, thread, self._deadlines.lateness(agent))
        self._outcomes.attach_suppressed(agent, thread)

    def _clear(self, agent: Agent, thread: int) -> None:
        """All calls have ended: drop the sentinel.

        The coordinator's stored image is now older than its next action.
        """
        agent.invalidate_image()
        agent.block.w[self._itinerary.call_arguments(agent, thread)[0] + TICKET_NEXT] = 0
        self._scheduler.complete_at_once(agent, thread)
