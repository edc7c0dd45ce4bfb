"""Visits of a coordinator to the hosts of its calls: to start, fetch and cancel them (decision 46).

An instruction does its work on this host, then departs for the next one, or completes. An instruction runs
again from its start after each hop and each completed call: its progress is in the tickets.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from lfield.vm.agent import Agent
from lfield.vm.cancellation import Cancellation
from lfield.vm.deadlines import Deadlines
from lfield.vm.engine_interface import Trap
from lfield.vm.memory.layout import CALLING, TICKET_CANCELLING, TICKET_COLLECTED, TICKET_STARTED, TICKET_STATE
from lfield.vm.pending_call import PendingCall
from lfield.vm.scheduler import Scheduler
from lfield.vm.together.call_outcomes import UNREACHABLE, CallOutcomes
from lfield.vm.together.call_start import CallStarter
from lfield.vm.together.itinerary import Itinerary, Ticket

#: Message for a call whose host is unreachable when the time limit expires.
UNREACHED_MESSAGE = "its host is unreachable; it ends the call itself at the time limit"
Handler = Callable[[Agent, int, int, list[int]], None]


class CallProgress:
    """Common steps of the instructions of `together` and of futures, for the coordinators of one host."""

    def __init__(
        self,
        scheduler: Scheduler,
        itinerary: Itinerary,
        cancelling: Cancellation,
        limits: Deadlines,
        outcomes: CallOutcomes,
        starter: CallStarter,
    ) -> None:
        self._scheduler, self._itinerary, self._cancellation = scheduler, itinerary, cancelling
        self._deadlines, self._outcomes, self._starter = limits, outcomes, starter

    def guarded(self, head: Handler) -> Handler:
        """Convert a heap that cannot hold the results to an exception at the coordinator's position."""

        def run_handler(agent: Agent, thread: int, operand: int, words: list[int]) -> None:
            try:
                head(agent, thread, operand, words)
            except Trap as trap:
                self._scheduler.throw_builtin(agent, thread, trap.kind, trap.message)

        return run_handler

    def are_all_started(self, agent: Agent, thread: int) -> bool:
        """Whether all collected calls have started; otherwise the coordinator waits, or departs to start a
        call.
        """
        if not self._starter.start_local_calls(agent, thread):
            return False
        return not self.departs_for(agent, thread, TICKET_COLLECTED)

    def departs_for(self, agent: Agent, thread: int, state: int) -> bool:
        """Whether a coordinator departs for the next host that has tickets in a state."""
        elsewhere = self._itinerary.tickets_elsewhere(self._itinerary.tickets(agent, thread), state)
        return self.departs_to(agent, thread, elsewhere)

    def departs_to(self, agent: Agent, thread: int, elsewhere: Sequence[Ticket]) -> bool:
        """Whether a coordinator departs for the host of some tickets; False without tickets."""
        if not elsewhere:
            return False
        self._scheduler.freeze(agent, thread)
        self._deadlines.depart(agent, self._itinerary.resource(elsewhere[0]))
        return True

    def running_calls(self, agent: Agent, thread: int, *states: int) -> list[PendingCall]:
        """Fetch the completed calls here of the tickets in these states; returns the calls that still run."""
        found = self._itinerary.tickets(agent, thread)
        numbers = [t.number for t in found if t.state in states and self._itinerary.is_here(t)]
        pending = (self._outcomes.fetch(agent, thread, number) for number in numbers)
        return [call for call in pending if call is not None]

    def is_waiting_for(self, agent: Agent, thread: int, state: int) -> bool:
        """Fetch completed calls of the tickets in a state; returns whether a call here is still running."""
        found = self._itinerary.tickets(agent, thread)
        numbers = [t.number for t in found if t.state == state and self._itinerary.is_here(t)]
        for number in numbers:
            pending = self._outcomes.fetch(agent, thread, number)
            if pending is not None:
                self._scheduler.set_state(agent, thread, CALLING)
                pending.waiter = agent, thread
                return True
        return False

    def are_all_cancelled(self, agent: Agent, thread: int) -> bool:
        """Cancel all started calls, host by host, then wait for them; returns whether all of them have ended.

        Several other hosts get a message, so that the calls end while the coordinator is on its way. When a
        time limit around the block has expired, the coordinator does not wait for unreachable hosts, which
        know the limit and end the calls themselves.
        """
        for state in (TICKET_STARTED, TICKET_CANCELLING):
            self._outcomes.mark_lost(agent, thread, state)
        # Calls that have ended are fetched in this visit.
        self.running_calls(agent, thread, TICKET_STARTED)
        for ticket in self._itinerary.tickets(agent, thread):
            if ticket.state == TICKET_STARTED and self._itinerary.is_here(ticket):
                self._send_cancel(agent, ticket)
        self._request_cancels(agent, thread)
        if self._departs_in_time(agent, thread, TICKET_STARTED) or self.is_waiting_for(
            agent, thread, TICKET_CANCELLING
        ):
            return False
        return not self._departs_in_time(agent, thread, TICKET_CANCELLING)

    def _departs_in_time(self, agent: Agent, thread: int, state: int) -> bool:
        """As `departs_for`, but after the time limit only to hosts that are reachable at once.

        Heartbeats are requested from all hosts at the same time, so any number of silent hosts causes only
        one delay.
        """
        signs = self._scheduler.hooks.liveness
        if signs is None or not self._deadlines.is_block_expired(agent):
            return self.departs_to(agent, thread, self._next_cancelled(agent, thread, state))
        for ticket in self._itinerary.tickets(agent, thread):
            if ticket.state in (TICKET_STARTED, TICKET_CANCELLING) and not self._itinerary.is_here(ticket):
                signs.request_heartbeat(self._itinerary.resource(ticket), self._deadlines.over_for(agent))
        while elsewhere := self._next_cancelled(agent, thread, state):
            target = self._itinerary.resource(elsewhere[0])
            if not signs.is_silent(target):
                self.departs_to(agent, thread, elsewhere)
                if agent.frozen and signs.is_heartbeat_pending(target):
                    self._deadlines.recheck_soon(agent)
                    return True
                if not (agent.frozen and self._scheduler.world.abandon_wait(agent)):
                    return True
                agent.resume()
            for number in [ticket.number for ticket in elsewhere]:
                self._outcomes.throw(agent, thread, number, UNREACHABLE, UNREACHED_MESSAGE)
        return False

    def _next_cancelled(self, agent: Agent, thread: int, state: int) -> list[Ticket]:
        """The tickets on the next host, which is a reachable one if there is any."""
        found = self._itinerary.tickets(agent, thread)
        return self._itinerary.tickets_elsewhere(found, state, self._itinerary.cancel_rank)

    def _request_cancels(self, agent: Agent, thread: int) -> None:
        """Ask the other hosts to cancel, if there are several, because the coordinator goes to one host at a
        time.

        The requests are sent only when the block at this instruction is on disk, as after a hop: a
        coordinator that is restored from an earlier block has not cancelled any call.
        """
        if not agent.is_persisted:
            return
        found = self._itinerary.tickets(agent, thread)
        elsewhere = [t for t in found if t.state == TICKET_STARTED and not self._itinerary.is_here(t)]
        calls = [(self._itinerary.resource(ticket), ticket.number) for ticket in elsewhere]
        if len({resource.host for resource, _ in calls}) > 1:
            self._scheduler.world.request_cancels(agent, calls)

    def _send_cancel(self, agent: Agent, ticket: Ticket) -> None:
        """Cancel a call that runs here, if it is still running."""
        ticket.w[ticket.place + TICKET_STATE] = TICKET_CANCELLING
        pending = self._scheduler.pending_calls.get((agent.id, ticket.generation, ticket.number))
        resource = self._scheduler.agents.get(self._itinerary.resource(ticket).id)
        if pending is not None and pending.state == "running" and resource is not None:
            self._cancellation.cancel_call(resource, pending.call, pending.cancel_reason)
