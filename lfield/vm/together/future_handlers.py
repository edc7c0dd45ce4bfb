"""`launch`, `next`, `ended`, `cancel`, `failure`: calls that are started now and fetched later (decision
102).

The ticket of a future is a sentinel with one call. Its result stays in the ticket and in the array of the
future, so it can be fetched again. Handlers run again from their start, as those of a `together`. A
coordinator that waits for the first of calls on several hosts stays on its host. The other hosts report calls
that have ended (`HostInterface.watch_calls`): a hint, after which the coordinator goes to that host and
fetches the result.
"""

from __future__ import annotations

from lfield.vm.agent import Agent
from lfield.vm.deadlines import Deadlines
from lfield.vm.memory import layout
from lfield.vm.memory.layout import (
    CALLING,
    TICKET_ARRAY,
    TICKET_CANCELLING,
    TICKET_INDEX,
    TICKET_RETURNED,
    TICKET_STARTED,
    TICKET_VALUE,
)
from lfield.vm.pending_call import PendingCall
from lfield.vm.scheduler import Scheduler
from lfield.vm.together.call_outcomes import CallOutcomes
from lfield.vm.together.call_progress import CallProgress, Handler
from lfield.vm.together.itinerary import Itinerary, Ticket

_OPEN = (TICKET_STARTED, TICKET_CANCELLING)


class FutureHandlers:
    """The instruction handlers of futures, for the coordinators of one host."""

    def __init__(
        self,
        scheduler: Scheduler,
        itinerary: Itinerary,
        limits: Deadlines,
        outcomes: CallOutcomes,
        progress: CallProgress,
    ) -> None:
        self._scheduler, self._itinerary, self._deadlines = scheduler, itinerary, limits
        self._outcomes, self._progress = outcomes, progress

    def handlers(self) -> dict[str, Handler]:
        """The handlers by name. They raise HeapFull, and run again after the collection."""
        return {
            "launch": self._progress.guarded(self._on_launch),
            "next": self._progress.guarded(self._on_next),
            "ended": self._progress.guarded(self._on_ended),
            "cancel": self._progress.guarded(self._on_cancel),
            "failure": self._progress.guarded(self._on_failure),
        }

    def _on_launch(self, agent: Agent, thread: int, operand: int, words: list[int]) -> None:
        if self._progress.are_all_started(agent, thread):
            self._scheduler.complete_at_once(agent, thread)

    def _on_next(self, agent: Agent, thread: int, operand: int, words: list[int]) -> None:
        running = self._fetch(agent, thread)
        index = self._first_returned(agent, thread)
        if agent.overdue and self._deadlines.expire(agent):
            return
        if index is not None:
            self._complete(agent, thread, index)
        else:
            self._await_any(agent, thread, running)

    def _on_ended(self, agent: Agent, thread: int, operand: int, words: list[int]) -> None:
        running = self._fetch(agent, thread)
        if running or not any(self._progress.departs_for(agent, thread, state) for state in _OPEN):
            self._complete(agent, thread, 0 if running else 1)

    def _on_cancel(self, agent: Agent, thread: int, operand: int, words: list[int]) -> None:
        if self._progress.are_all_cancelled(agent, thread):
            self._complete(agent, thread, 0)

    def _on_failure(self, agent: Agent, thread: int, operand: int, words: list[int]) -> None:
        has_failed = any(ticket.thrown for ticket in self._itinerary.tickets(agent, thread))
        thrown = self._outcomes.first_error(agent, thread) if has_failed else 0
        self._scheduler.complete_at_once(agent, thread, thrown)

    # --- results --------------------------------------------------------------------------------------

    def _fetch(self, agent: Agent, thread: int) -> list[PendingCall]:
        """Fetch the calls of this host that have ended; returns the calls that still run here."""
        for state in _OPEN:
            self._outcomes.mark_lost(agent, thread, state)
        return self._progress.running_calls(agent, thread, *_OPEN)

    def _first_returned(self, agent: Agent, thread: int) -> int | None:
        """The index of the first future whose result is here; -1 if there is no future, None if no result is
        here yet.
        """
        first = self._itinerary.call_arguments(agent, thread)[0]
        by_element = self._itinerary.tickets_by_element(agent, first)
        found = [i for i, ticket in by_element if ticket.state == TICKET_RETURNED]
        return found[0] if found else None if by_element else -1

    def _complete(self, agent: Agent, thread: int, word: int) -> None:
        """End an instruction that may have fetched results, which are stored in the arrays of their futures.

        The coordinator's stored image is now older than its next action.
        """
        for ticket in self._itinerary.tickets(agent, thread):
            self._store(ticket)
        agent.invalidate_image()
        self._scheduler.complete_at_once(agent, thread, word)

    def _store(self, ticket: Ticket) -> None:
        w, place = ticket.w, ticket.place
        array = w[place + TICKET_ARRAY]
        if ticket.state == TICKET_RETURNED and array and not ticket.thrown:
            first, end = layout.elements(w, array)
            if first + w[place + TICKET_INDEX] < end:
                w[first + w[place + TICKET_INDEX]] = w[place + TICKET_VALUE]

    # --- waiting for the first ------------------------------------------------------------------------

    def _await_any(self, agent: Agent, thread: int, running: list[PendingCall]) -> None:
        """Depart for a host where a call has ended, or for the only host; otherwise wait here."""
        found = self._itinerary.tickets(agent, thread)
        if self._progress.departs_to(agent, thread, self._itinerary.first_destination(agent, found)):
            return
        self._scheduler.set_state(agent, thread, CALLING)
        for pending in running:
            pending.waiter = agent, thread
        elsewhere = [t for t in found if t.state in _OPEN and not self._itinerary.is_here(t)]
        agent.wait_for_any()
        if elsewhere:
            calls = [(self._itinerary.resource(t), t.number) for t in elsewhere]
            self._scheduler.world.watch_calls(agent, calls)
