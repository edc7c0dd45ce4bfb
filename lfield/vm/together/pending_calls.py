"""Pending calls of a host: their results, and their delivery to waiting coordinators (decision 46)."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator

from lfield.vm.agent import CANCELLED, Agent
from lfield.vm.cancellation import Cancellation
from lfield.vm.memory.block_verifier import BlockVerifier
from lfield.vm.memory.call_tickets import pending_call_numbers
from lfield.vm.memory.threads import only_thread
from lfield.vm.pending_call import CallKey, PendingCall
from lfield.vm.scheduler import Scheduler


class PendingCalls:
    """Manages `scheduler.pending_calls`: from the start of a call until its coordinator has fetched it."""

    def __init__(self, scheduler: Scheduler, cancelling: Cancellation, soundness: BlockVerifier) -> None:
        self._scheduler, self._cancellation, self._verifier = scheduler, cancelling, soundness
        self._on_result: Callable[[PendingCall], None] | None = None

    def calls(self) -> list[PendingCall]:
        """The calls that were not fetched yet, in the order of their start."""
        return list(self._scheduler.pending_calls.values())

    def drain_fetched(self, agent: Agent) -> list[CallKey]:
        """The calls that the coordinator has fetched here since the last call of this method.

        The host may delete its records of these calls when the block with their results is on disk, here or
        on the next host.
        """
        return agent.drain_fetched()

    def on_persisted(self, key: CallKey) -> None:
        """A result (`HostInterface.on_call_completed`) is on disk: a coordinator that waits for it continues.

        May be called from within `on_call_completed`.
        """
        pending = self._scheduler.pending_calls.get(key)
        if pending is None or pending.is_persisted:
            return
        pending.is_persisted = True
        self._scheduler.wake_waiter(pending)
        if self._on_result is not None:
            self._on_result(pending)

    def restore(self, calls: Iterable[PendingCall]) -> None:
        """Restore the records of an earlier incarnation; before any coordinator is restored.

        Calls that were running, and unreadable results, are lost: fetching one throws a RestartException.
        """
        for pending in calls:
            pending.is_persisted = True
            if pending.state == "running" or not self._verifier.is_result(
                pending.result, pending.state == "thrown"
            ):
                pending.state = "lost"
            self._scheduler.pending_calls[pending.key] = pending

    def forget(self, keys: Iterable[CallKey]) -> None:
        """Drop calls that will not be fetched; portals that still run for these calls continue without a
        caller.
        """
        for key in keys:
            if pending := self._scheduler.pending_calls.pop(key, None):
                pending.dropped = True

    def cancel(self, agent: str, below: int | None, reason: str) -> list[CallKey]:
        """Cancel and drop the calls of a coordinator's starts before `below` (None: of all starts).

        Their portals get a CancelledException with this reason, and their results are dropped. Returns the
        keys of the calls.
        """
        found = [pending for pending in self._calls_of(agent) if below is None or pending.generation < below]
        self._cancel(found, reason)
        return [pending.key for pending in found]

    def _cancel(self, calls: list[PendingCall], reason: str) -> None:
        self._report_failures(calls)
        self.forget([pending.key for pending in calls])
        for pending in calls:
            resource = self._scheduler.agents.get(pending.resource)
            if pending.state == "running" and resource is not None:
                self._cancellation.cancel_call(resource, pending.call, reason)

    def cancel_unneeded(self, agent: Agent) -> None:
        """A coordinator has arrived: cancel and drop its calls here that it no longer waits for.

        Its block has ended while this host was unreachable.
        """
        if not self._scheduler.pending_calls:
            return
        pending = [call for call in self._calls_of(agent.id) if call.generation == agent.generation]
        waited = pending_call_numbers(agent.block) if pending else set()
        unneeded = [
            call
            for call in pending
            if call.number not in waited and not (call.is_future and call.state == "running")
        ]
        self._cancel(unneeded, f"the together of {agent.id} has ended without this call")
        agent.fetched.extend(call.key for call in unneeded)

    def fail_running(self, agent: str, kind: str, reason: str) -> None:
        """End the running calls of a coordinator at once with an exception, as `Machine.detach_caller`
        does.

        Their portals continue without a caller, may command no device, and their results are dropped.
        """
        for pending in list(self._calls_of(agent)):
            if pending.state == "running":
                self._scheduler.calls.pop(pending.call, None)
                message = f"{reason} ({pending.resource}.{pending.portal})"
                self._scheduler.fail_pending(pending, kind, message, pending.resource)

    def stop_waiting(self, agent: Agent) -> bool:
        """Stop the wait of a coordinator for its calls here; false when it did not wait."""
        waited = [b for b in self._calls_of(agent.id) if b.waiter is not None and b.waiter[0] is agent]
        for pending in waited:
            pending.waiter = None
        return agent.stop_waiting_for_any() or bool(waited)

    # --- futures --------------------------------------------------------------------------------------

    def watch_results(self, on_result: Callable[[PendingCall], None]) -> None:
        """Set the function that is called with each call whose result may be fetched."""
        self._on_result = on_result

    def on_ended_elsewhere(self, agent_id: str, generation: int, numbers: Collection[int]) -> None:
        """Calls that a coordinator waits for here have ended on their host, or this host is unreachable."""
        agent = self._scheduler.agents.get(agent_id)
        if agent is None or agent.generation != generation or not agent.waits_for_any or agent.frozen:
            return
        self.stop_waiting(agent)
        agent.stop_waiting_for_any(numbers)
        self._scheduler.run_queue.push_front(agent, only_thread(agent.block))

    def cancel_started(self, agent_id: str, generation: int, numbers: Collection[int]) -> None:
        """Cancel calls of a coordinator that is in transit to this host to fetch their outcomes."""
        for number in numbers:
            pending = self._scheduler.pending_calls.get((agent_id, generation, number))
            resource = self._scheduler.agents.get(pending.resource) if pending is not None else None
            if pending is not None and pending.state == "running" and resource is not None:
                self._cancellation.cancel_call(resource, pending.call, pending.cancel_reason)

    def _report_failures(self, calls: list[PendingCall]) -> None:
        """Log the failures of calls whose futures were dropped. A cancellation is no failure."""
        for pending in calls:
            resource = self._scheduler.agents.get(pending.resource)
            failed = pending.is_future and pending.failure and not pending.failure.startswith(CANCELLED)
            if failed and resource is not None:
                text = f"{pending.portal}() failed, and its future was not awaited: {pending.failure}"
                self._scheduler.world.log(resource, text)

    def _calls_of(self, agent: str) -> Iterator[PendingCall]:
        return (pending for pending in self._scheduler.pending_calls.values() if pending.agent == agent)
