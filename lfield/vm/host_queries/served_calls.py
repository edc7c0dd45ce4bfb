"""The portal calls that threads of this host serve, and the coordinators that made them.

The host queries them before it permits a device action, when it grants a reservation, and to display the
state of an agent. A call is identified by its number, which is in the record of the thread that serves it.
"""

from __future__ import annotations

from lfield.vm.agent import Agent
from lfield.vm.memory.layout import THREAD_CALL
from lfield.vm.memory.threads import place_of, threads
from lfield.vm.pending_call import PendingCall
from lfield.vm.scheduler import Scheduler


class ServedCalls:
    """Read access to the calls of one host. The calls in progress are in the scheduler, by number: the
    coordinator that waits, or the record of a call of a `together`.

    A call that is missing there was detached from its caller, and its result is dropped.
    """

    def __init__(self, scheduler: Scheduler) -> None:
        self._scheduler = scheduler

    def of_thread(self, resource: Agent, thread: int) -> tuple[int, Agent | PendingCall | None]:
        """The number of the portal call that a thread serves, 0 for none, and the calling coordinator.

        The coordinator is None for a detached call, and for a query of the host itself. For a call of a
        `together` the record of the call takes the place of the coordinator, with the coordinator's data at
        its start.
        """
        number = resource.block.w[place_of(resource.block, thread) + THREAD_CALL]
        found = self._scheduler.calls.get(number)
        return number, (found if found is None or isinstance(found, PendingCall) else found[0])

    def caller(self, resource: Agent, thread: int) -> Agent | PendingCall | None:
        """The coordinator of `of_thread`.

        A pending call represents its coordinator, which may have gone to another host: its record has the
        coordinator's id, start and time limit.
        """
        return self.of_thread(resource, thread)[1]

    def has_others(self, resource: Agent, agent_id: str) -> bool:
        """Whether a call of another coordinator, or a detached one, is in progress in a resource here.

        A resource is reserved only when no other coordinator uses it. Queries of the host do not count.
        """
        scheduler = self._scheduler
        if resource.ended:
            return False
        for place in threads(resource.block):
            number = resource.block.w[place + THREAD_CALL]
            if not number or number in scheduler.resource_queries:
                continue
            waits = scheduler.calls.get(number)
            caller_or_none = waits if waits is None or isinstance(waits, PendingCall) else waits[0]
            if caller_or_none is None or caller_or_none.id != agent_id:
                return True
        return False
