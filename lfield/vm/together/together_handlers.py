"""`start`, `fetch` and `leave`: a coordinator visits the hosts of its `together` (decision 46).

Each handler does its work on this host, then departs for the next one, or completes. It runs again from its
start after each hop and each completed call: its progress is in the tickets. At most one visit to a host
starts its calls, and one fetches them.
"""

from __future__ import annotations

from collections.abc import Callable

from lfield.vm.agent import Agent
from lfield.vm.cancellation import Cancellation
from lfield.vm.deadlines import TIME_LIMIT, Deadlines
from lfield.vm.engine_interface import Trap
from lfield.vm.inspection import traceback
from lfield.vm.memory import layout
from lfield.vm.memory.layout import (
    CALLING,
    TICKET_ARRAY,
    TICKET_CALL,
    TICKET_CANCELLING,
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
from lfield.vm.together.call_outcomes import RESTARTED, UNREACHABLE, CallOutcomes
from lfield.vm.together.call_start import CallStarter, add_settled, collect, new_sentinel
from lfield.vm.together.itinerary import Itinerary, Ticket

RESERVED = "ReservedException"
#: Message for a call whose host is unreachable when the time limit expires.
UNREACHED_MESSAGE = "its host is unreachable; it ends the call itself at the time limit"
Handler = Callable[[Agent, int, int, list[int]], None]


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
        self._scheduler, self._itinerary, self._cancellation = scheduler, itinerary, cancelling
        self._deadlines = limits
        self._outcomes = CallOutcomes(scheduler, itinerary)
        self._starter = CallStarter(scheduler, itinerary, held, self._outcomes, limits)

    def handlers(self) -> dict[str, Handler]:
        """The handlers by name. They raise HeapFull, and run again after the collection."""
        return {
            "gather": self._on_gather,
            "begin": self._guarded(self._on_collect),
            "start": self._guarded(self._on_start),
            "fetch": self._guarded(self._on_fetch),
            "leave": self._guarded(self._on_leave),
            "settle": self._guarded(self._on_settle),
        }

    def _guarded(self, head: Handler) -> Handler:
        """Convert a heap that cannot hold the results to an exception at the coordinator's position."""

        def run_handler(agent: Agent, thread: int, operand: int, words: list[int]) -> None:
            try:
                head(agent, thread, operand, words)
            except Trap as trap:
                self._scheduler.throw_builtin(agent, thread, trap.kind, trap.message)

        return run_handler

    def on_failed(self, agent: Agent, thread: int, kind: str, message: str, source: str) -> None:
        """A suspended coordinator cannot reach what it waits for: its awaited calls return with an exception.

        Where a resource is reserved by another coordinator (`source`), only the calls of that resource do.
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
        if self._are_all_started(agent, thread):
            self._scheduler.complete_at_once(agent, thread)

    def _are_all_started(self, agent: Agent, thread: int) -> bool:
        """Whether all collected calls have started; else the coordinator waits, or departs to start one."""
        if not self._starter.start_local_calls(agent, thread):
            return False
        return not self._departs_for(agent, thread, TICKET_COLLECTED)

    def _departs_for(self, agent: Agent, thread: int, state: int) -> bool:
        """Whether a coordinator departs for the next host that has tickets in a state."""
        elsewhere = self._itinerary.tickets_elsewhere(self._itinerary.tickets(agent, thread), state)
        if not elsewhere:
            return False
        self._scheduler.freeze(agent, thread)
        self._deadlines.depart(agent, self._itinerary.resource(elsewhere[0]))
        return True

    def _on_fetch(self, agent: Agent, thread: int, operand: int, words: list[int]) -> None:
        if not self._are_all_started(agent, thread):
            return
        self._outcomes.mark_lost(agent, thread, TICKET_STARTED)
        if self._is_waiting_for(agent, thread, TICKET_STARTED):
            return
        if agent.overdue and self._deadlines.expire(agent):
            return
        if self._departs_for(agent, thread, TICKET_STARTED):
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
            # The array has become shorter since the call began.
            self._scheduler.throw_builtin(agent, thread, "IndexException", removed)

    def _is_waiting_for(self, agent: Agent, thread: int, state: int) -> bool:
        """Fetch completed calls of the tickets in a state; whether one here is still running."""
        found = self._itinerary.tickets(agent, thread)
        numbers = [t.number for t in found if t.state == state and self._itinerary.is_here(t)]
        for number in numbers:
            pending = self._outcomes.fetch(agent, thread, number)
            if pending is not None:
                self._scheduler.set_state(agent, thread, CALLING)
                pending.waiter = agent, thread
                return True
        return False

    def _throw(self, agent: Agent, thread: int) -> None:
        """Throw the exception of the first failed call in program order, with the others suppressed."""
        first = self._outcomes.first_error(agent, thread)
        agent.block.w[self._itinerary.call_arguments(agent, thread)[0] + TICKET_NEXT] = 0
        self._scheduler.throw(agent, thread, first)

    # --- leave ----------------------------------------------------------------------------------------

    def _on_leave(self, agent: Agent, thread: int, operand: int, words: list[int]) -> None:
        """Cancel all calls, host by host, then wait for them.

        When a time limit around the block has expired, unreachable hosts are not awaited: they know the
        limit, and end the calls themselves.
        """
        for state in (TICKET_STARTED, TICKET_CANCELLING):
            self._outcomes.mark_lost(agent, thread, state)
        for ticket in self._itinerary.tickets(agent, thread):
            if ticket.state == TICKET_COLLECTED:
                ticket.w[ticket.place + TICKET_STATE], ticket.w[ticket.place + TICKET_CALL] = (
                    TICKET_RETURNED,
                    0,
                )
            elif ticket.state == TICKET_STARTED and self._itinerary.is_here(ticket):
                self._send_cancel(agent, ticket)
        if self._departs_in_time(agent, thread, TICKET_STARTED) or self._is_waiting_for(
            agent, thread, TICKET_CANCELLING
        ):
            return
        if not self._departs_in_time(agent, thread, TICKET_CANCELLING):
            self._report(agent, thread)
            self._clear(agent, thread)

    def _departs_in_time(self, agent: Agent, thread: int, state: int) -> bool:
        """As `_departs_for`, but after the time limit only to hosts that are reachable at once.

        All hosts are asked for a heartbeat together, so silence delays once, however many hosts are silent.
        """
        signs = self._scheduler.hooks.liveness
        if signs is None or not self._deadlines.is_block_expired(agent):
            return self._departs_for(agent, thread, state)
        for ticket in self._itinerary.tickets(agent, thread):
            if ticket.state in (TICKET_STARTED, TICKET_CANCELLING) and not self._itinerary.is_here(ticket):
                signs.request_heartbeat(self._itinerary.resource(ticket), self._deadlines.over_for(agent))
        while elsewhere := self._itinerary.tickets_elsewhere(self._itinerary.tickets(agent, thread), state):
            target = self._itinerary.resource(elsewhere[0])
            if not signs.is_silent(target):
                self._departs_for(agent, thread, state)
                if agent.frozen and signs.is_heartbeat_pending(target):
                    self._deadlines.recheck_soon(agent)
                    return True
                if not (agent.frozen and self._scheduler.world.abandon_wait(agent)):
                    return True
                agent.resume()
            for number in [ticket.number for ticket in elsewhere]:
                self._outcomes.throw(agent, thread, number, UNREACHABLE, UNREACHED_MESSAGE)
        return False

    def _send_cancel(self, agent: Agent, ticket: Ticket) -> None:
        """Cancel a call that runs here, if it is still running."""
        ticket.w[ticket.place + TICKET_STATE] = TICKET_CANCELLING
        pending = self._scheduler.pending_calls.get((agent.id, ticket.generation, ticket.number))
        resource = self._scheduler.agents.get(self._itinerary.resource(ticket).id)
        if pending is not None and pending.state == "running" and resource is not None:
            reason = f"{agent.id} has left the together that called {self._itinerary.portal(ticket)}()"
            self._cancellation.cancel_call(resource, pending.call, reason)

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
