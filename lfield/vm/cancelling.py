"""Cancelling a portal call: its thread hears of it, may tidy up, and then is ended (decision 48)."""

from __future__ import annotations

from lfield.bytecode.opcodes import BY_NAME
from lfield.vm.agent import Agent
from lfield.vm.contract import Trap
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
from lfield.vm.memory.values import new_exception
from lfield.vm.scheduler import Scheduler

CANCELLED = "CancelledException"

_YIELD, _SLEEP, _DEVICE = (BY_NAME[name].code for name in ("yield", "sleep", "device"))


class Cancelling:
    """The calls of one host that are cancelled, in the threads that serve them (`Agent.cancels`)."""

    def __init__(self, scheduler: Scheduler) -> None:
        self._scheduler = scheduler

    def call(self, resource: Agent, number: int, reason: str) -> None:
        """Cancel a portal call by its number, if it is still served: at once where its thread waits.

        A thread that runs, or waits for what may not be cancelled, hears of it at its next waiting
        instruction. In `Limits.tidy` seconds it is ended wherever it is.
        """
        thread = serving(resource.block, number)
        if resource.ended or not thread or thread in resource.cancels:
            return
        resource.cancels[thread] = reason
        tidy = resource.limits.tidy
        self._scheduler.turns.alarm(resource, tidy, lambda: self._end(resource, thread))
        state = resource.block.w[place_of(resource.block, thread) + THREAD_STATE]
        if state == WAITING:
            self._scheduler.world.cancel(resource, thread)
        elif state != READY or self._is_queued(resource, thread):
            rouse(self._scheduler, resource, thread)
            self.strike(resource, thread)

    def _is_queued(self, resource: Agent, thread: int) -> bool:
        """Whether a thread that is ready has not begun: its resource's init, or another call, was busy."""
        w, place = resource.block.w, place_of(resource.block, thread)
        method = self._scheduler.program.core.methods[w[w[place + THREAD_FRAME]] >> 8 & 0xFFFFFF]
        enters = method.synchronized and w[place + THREAD_PC] == method.entry
        return enters or (resource, thread) in resource.waiting

    def waits(self, resource: Agent, thread: int, op: int, operand: int) -> bool:
        """Whether a thread has come to a head where it hears that it is cancelled; then it has heard."""
        if not resource.cancels.get(thread):
            return False
        if op == _DEVICE:
            call = self._scheduler.program.core.device_calls[operand]
            if call.effect == "query":
                return False
        elif op not in (_YIELD, _SLEEP):
            return False
        self.strike(resource, thread)
        return True

    def strike(self, resource: Agent, thread: int) -> None:
        """Throw it in a thread that has not heard of it, where it stands."""
        reason, resource.cancels[thread] = resource.cancels[thread], ""
        self._scheduler.refuse(resource, thread, CANCELLED, reason, resource.id)

    def _end(self, resource: Agent, thread: int) -> None:
        """The time to tidy up is over: the thread ends, unless it waits for what may not be cancelled."""
        scheduler = self._scheduler
        place = place_of(resource.block, thread)
        if not place:
            return
        tidy = resource.limits.tidy
        waits = resource.block.w[place + THREAD_STATE] == WAITING
        if waits and not scheduler.world.cancel(resource, thread):
            scheduler.turns.alarm(resource, tidy, lambda: self._end(resource, thread))
            return
        rouse(scheduler, resource, thread)
        message = f"it was cancelled, and ended since it took longer than {tidy:g} s to tidy up"
        try:
            thrown = scheduler.with_room(
                resource,
                lambda: new_exception(resource.block, scheduler.layouts, CANCELLED, message, resource.id),
            )
        except Trap as trap:
            scheduler.die(resource, f"{trap.kind}: {trap.message}", thread)
            return
        scheduler.uncaught(resource, thread, thrown)


def rouse(scheduler: Scheduler, agent: Agent, thread: int) -> None:
    """Take a thread out of whatever it waits in, but for a device.

    One that sleeps or yields stands behind its instruction already; it is put back into it, so that what is
    thrown now is thrown there.
    """
    w, place = agent.block.w, place_of(agent.block, thread)
    scheduler.turns.drop(agent, thread)
    agent.waiting = [entry for entry in agent.waiting if entry != (agent, thread)]
    if w[place + THREAD_STATE] in (SLEEPING, PARKED):
        agent.pollers.discard(thread)
        w[place + THREAD_PC] -= 1
    elif w[place + THREAD_STATE] == BLOCKED and thread in agent.blocked:
        agent.blocked.remove(thread)
    w[place + THREAD_STATE] = READY
