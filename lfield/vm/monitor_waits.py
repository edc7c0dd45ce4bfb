"""`wait until`: threads of a resource that have left its monitor until a condition holds (decision 103).

    wait_leave   leaves the monitor; throws the end of the time, or a cancellation, while it holds the monitor
    wait_enter   parks the thread until another thread has run and the monitor is free, then enters again

The thread then evaluates its condition. If the condition is false, the thread waits again, which wakes no
other waiting thread, since no state has changed. So a waiting thread uses no time while its resource is idle.
A thread whose condition reads a clock or a device is woken every 5 ms.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial

from lfield.bytecode.opcodes import BY_NAME
from lfield.vm.agent import EVALUATES, POLLS, WAITS, Agent
from lfield.vm.engine_interface import EngineExit, HostCall
from lfield.vm.memory import layout
from lfield.vm.memory.layout import BLOCKED, COUNT_LIMIT, THREAD_STATE
from lfield.vm.memory.threads import place_of
from lfield.vm.memory.word_codec import real_from_bits
from lfield.vm.scheduler import Scheduler
from lfield.vm.turns.run_queue import RunQueue

TIME_LIMIT = "TimeLimitException"
#: Seconds between the checks of a condition that reads a clock or a device.
POLL_INTERVAL = 0.005
_LEAVE, _ENTER = BY_NAME["wait_leave"].code, BY_NAME["wait_enter"].code
Handler = Callable[[Agent, int, int, list[int]], None]


def wake(queue: RunQueue, agent: Agent, thread: int) -> None:
    """Let a waiting thread enter the monitor again and check its condition."""
    if agent.monitor_waits.get(thread, EVALUATES) == EVALUATES:
        return
    agent.monitor_waits[thread] = EVALUATES
    # A thread that has not reached `wait_enter` yet is in the queue.
    if agent.block.w[place_of(agent.block, thread) + THREAD_STATE] == BLOCKED:
        queue.push_back(agent, thread)


def after_turn(queue: RunQueue, agent: Agent, thread: int, leave: EngineExit) -> None:
    """A thread of an agent with waiting threads had a turn: the conditions of the waiting threads may hold
    now.
    """
    if isinstance(leave, HostCall) and leave.op in (_LEAVE, _ENTER):
        return
    if agent.monitor_waits.get(thread) == EVALUATES:
        del agent.monitor_waits[thread]
    if not agent.block.w[layout.W_OWNER]:
        for waiting in list(agent.monitor_waits):
            wake(queue, agent, waiting)


class MonitorWaits:
    """The instruction handlers of `wait until`, for the resources of one host."""

    def __init__(self, scheduler: Scheduler) -> None:
        self._scheduler, self._queue = scheduler, scheduler.run_queue
        #: The ends of waits, by agent and thread, for which an alarm is set.
        self._alarms: set[tuple[str, int, int]] = set()

    def handlers(self) -> dict[str, Handler]:
        """The handlers by name."""
        return {"wait_limit": self._on_limit, "wait_leave": self._on_leave, "wait_enter": self._on_enter}

    def _now(self) -> int:
        return round(self._scheduler.clock.monotonic() * 1e9)

    def _on_limit(self, agent: Agent, thread: int, operand: int, words: list[int]) -> None:
        seconds = real_from_bits(words[0])
        if math.isnan(seconds):
            message = "the time of a wait until is not a number"
            self._scheduler.throw_builtin(agent, thread, "ArithmeticException", message)
            return
        end = self._now() + int(max(0.0, min(seconds, 1e9)) * 1e9)
        self._scheduler.complete_at_once(agent, thread, min(max(1, end), COUNT_LIMIT - 1))

    def _on_leave(self, agent: Agent, thread: int, operand: int, words: list[int]) -> None:
        end, polls = words
        if end and self._now() >= end:
            agent.monitor_waits.pop(thread, None)
            message = "the time is over: the condition of a wait until does not hold"
            self._scheduler.throw_builtin(agent, thread, TIME_LIMIT, message, agent.id)
            return
        w = agent.block.w
        entries = w[layout.W_ENTRIES]
        w[layout.W_OWNER] = w[layout.W_ENTRIES] = 0
        is_first = thread not in agent.monitor_waits
        agent.start_monitor_wait(thread, POLLS if polls else WAITS)
        if is_first:
            # The thread may have changed the conditions of other threads.
            for waiting in [waiter for waiter in agent.monitor_waits if waiter != thread]:
                wake(self._queue, agent, waiting)
        self._scheduler.complete_at_once(agent, thread, entries)
        self._scheduler.unblock(agent)
        self._scheduler.open(agent)

    def _on_enter(self, agent: Agent, thread: int, operand: int, words: list[int]) -> None:
        entries, end = words
        w = agent.block.w
        if agent.monitor_waits.get(thread, EVALUATES) != EVALUATES:
            self._scheduler.set_state(agent, thread, BLOCKED)
            self._set_alarms(agent, thread, end)
        elif w[layout.W_OWNER]:
            self._scheduler.set_state(agent, thread, BLOCKED)
            agent.blocked.append(thread)
        else:
            w[layout.W_OWNER], w[layout.W_ENTRIES] = thread, entries
            self._scheduler.complete_at_once(agent, thread)

    def _set_alarms(self, agent: Agent, thread: int, end: int) -> None:
        if agent.monitor_waits[thread] == POLLS:
            self._queue.set_alarm(agent, POLL_INTERVAL, partial(self._wake, agent, thread))
        key = agent.id, thread, end
        if end and key not in self._alarms:
            self._alarms.add(key)
            self._queue.set_alarm(
                agent, max(0.0, (end - self._now()) / 1e9), partial(self._on_end, agent, key)
            )

    def _on_end(self, agent: Agent, key: tuple[str, int, int]) -> None:
        self._alarms.discard(key)
        self._wake(agent, key[1])

    def _wake(self, agent: Agent, thread: int) -> None:
        wake(self._queue, agent, thread)
