"""Cancellation of portal calls: exception in the serving thread, grace period, forced end (decision 46)."""

from __future__ import annotations

from functools import partial
from typing import Protocol

from lfield.bytecode.opcodes import BY_NAME
from lfield.vm.agent import CANCELLED, Agent
from lfield.vm.engine_interface import Trap
from lfield.vm.memory.layout import (
    BLOCKED,
    PARKED,
    READY,
    SLEEPING,
    THREAD_FRAME,
    THREAD_PC,
    THREAD_STATE,
    WAITING,
)
from lfield.vm.memory.threads import place_of, serving
from lfield.vm.memory.word_codec import new_exception
from lfield.vm.monitor_waits import wake
from lfield.vm.scheduler import Scheduler

_DEVICE = BY_NAME["device"].code
#: The other instructions at which a cancellation is thrown.
_PAUSES = frozenset(BY_NAME[name].code for name in ("yield", "sleep", "read_line", "wait_leave"))


class InputReaders(Protocol):
    """The threads that wait for a line of input: `lfield.vm.waits.operator_input.OperatorInput`."""

    def cancel(self, agent: Agent, thread: int) -> bool:
        """End the wait of a thread; False if the thread waits for no line."""


class Cancellation:
    """The cancelled calls of one host, per serving thread (`Agent.pending_cancels`)."""

    def __init__(self, scheduler: Scheduler, input_readers: InputReaders) -> None:
        self._scheduler, self._input = scheduler, input_readers

    def cancel_call(self, resource: Agent, number: int, reason: str) -> None:
        """Cancel a portal call by its number, if a thread still serves it; at once if this thread waits.

        A thread that runs, or whose wait cannot be cancelled, gets the exception at its next waiting
        instruction. After `AgentLimits.tidy` seconds the thread is ended.
        """
        thread = serving(resource.block, number)
        if resource.ended or not thread or thread in resource.pending_cancels:
            return
        tidy = resource.limits.tidy
        self._scheduler.run_queue.set_alarm(resource, tidy, partial(self._end_grace_period, resource, thread))
        self._interrupt(resource, thread, reason)

    def suppress(self, resource: Agent, thread: int, reason: str) -> None:
        """Suppress the body of a loop that runs: an exception as in `cancel_call`, but no end by force."""
        if resource.loops is None or thread in resource.loops.suppressed:
            return
        resource.loops.suppressed[thread] = reason
        self._interrupt(resource, thread, reason)

    def _interrupt(self, resource: Agent, thread: int, reason: str) -> None:
        resource.pending_cancels[thread] = reason
        state = resource.block.w[place_of(resource.block, thread) + THREAD_STATE]
        if thread in resource.monitor_waits:
            # The exception is thrown when the thread would wait again, while it holds the monitor.
            wake(self._scheduler.run_queue, resource, thread)
        elif state == WAITING and not self._input.cancel(resource, thread):
            self._scheduler.world.cancel(resource, thread)
        elif state != READY or self._is_queued(resource, thread):
            wake_thread(self._scheduler, resource, thread)
            self.deliver(resource, thread)

    def _is_queued(self, resource: Agent, thread: int) -> bool:
        """Whether a ready thread has not started, because the resource's init or another call is running."""
        w, place = resource.block.w, place_of(resource.block, thread)
        method = self._scheduler.program.core.methods[w[w[place + THREAD_FRAME]] >> 8 & 0xFFFFFF]
        enters = method.synchronized and w[place + THREAD_PC] == method.entry
        return enters or (resource, thread) in resource.waiting

    def deliver_at_head(self, resource: Agent, thread: int, op: int, operand: int) -> bool:
        """Throw the cancellation at a host call, if pending. Returns whether it was thrown."""
        if not resource.pending_cancels.get(thread):
            return False
        if op == _DEVICE:
            call = self._scheduler.program.core.device_calls[operand]
            if call.effect == "query":
                return False
        elif op not in _PAUSES:
            return False
        self.deliver(resource, thread)
        return True

    def deliver(self, resource: Agent, thread: int) -> None:
        """Throw the cancellation at the thread's position, if it was not thrown yet."""
        reason, resource.pending_cancels[thread] = resource.pending_cancels[thread], ""
        self._scheduler.throw_builtin(resource, thread, CANCELLED, reason, resource.id)

    def _end_grace_period(self, resource: Agent, thread: int) -> None:
        """The grace period is over: end the thread, unless its wait cannot be cancelled."""
        scheduler = self._scheduler
        place = place_of(resource.block, thread)
        if not place:
            return
        tidy = resource.limits.tidy
        waits = resource.block.w[place + THREAD_STATE] == WAITING and not self._input.cancel(resource, thread)
        if waits and not scheduler.world.cancel(resource, thread):
            scheduler.run_queue.set_alarm(resource, tidy, partial(self._end_grace_period, resource, thread))
            return
        wake_thread(scheduler, resource, thread)
        message = f"it was cancelled, and ended because its clean-up took longer than {tidy:g} s"
        try:
            thrown = scheduler.run_with_collection(
                resource,
                lambda: new_exception(resource.block, scheduler.layouts, CANCELLED, message, resource.id),
            )
        except Trap as trap:
            scheduler.die(resource, f"{trap.kind}: {trap.message}", thread)
            return
        scheduler.uncaught(resource, thread, thrown)


def wake_thread(scheduler: Scheduler, agent: Agent, thread: int) -> None:
    """Remove a thread from any wait except the wait for a device.

    A sleeping or yielding thread is positioned after its instruction; it is moved back, so that the exception
    is thrown at this instruction.
    """
    w, place = agent.block.w, place_of(agent.block, thread)
    scheduler.run_queue.remove(agent, thread)
    agent.remove_waiting(agent, thread)
    if w[place + THREAD_STATE] in (SLEEPING, PARKED):
        agent.pollers.discard(thread)
        w[place + THREAD_PC] -= 1
    elif w[place + THREAD_STATE] == BLOCKED and thread in agent.blocked:
        agent.blocked.remove(thread)
    w[place + THREAD_STATE] = READY
