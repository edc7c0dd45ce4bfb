"""Whose turn it is: the queue of threads that can run, and the timers of those that sleep."""

from __future__ import annotations

from collections import deque
from heapq import heappop, heappush

from lfield.clock import Clock
from lfield.vm.agent import Agent
from lfield.vm.memory.layout import READY, SLEEPING, THREAD_STATE
from lfield.vm.memory.threads import place_of

#: Turns that may follow one another without the end of the queue being looked at.
STREAK = 50


class Turns:
    """Threads by agent and id. A thread stands in the queue, or in one timer, or in neither."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._ready: deque[tuple[Agent, int]] = deque()
        self._timers: list[tuple[float, int, Agent, int]] = []
        self._timed = 0
        self._streak = 0

    def __bool__(self) -> bool:
        return bool(self._ready)

    def take(self) -> tuple[Agent, int]:
        """The thread whose turn it is; there must be one."""
        return self._ready.popleft()

    def last(self, agent: Agent, thread: int) -> None:
        """The thread is ready and waits its turn."""
        agent.block.w[place_of(agent.block, thread) + THREAD_STATE] = READY
        self._ready.append((agent, thread))

    def next(self, agent: Agent, thread: int) -> None:
        """The next turn is this thread's: it has only asked for a moment, or somebody waits for it.

        After STREAK such turns in a row everybody else comes first, so that nobody starves.
        """
        self._streak += 1
        if self._streak >= STREAK:
            self._streak = 0
            self.last(agent, thread)
            return
        agent.block.w[place_of(agent.block, thread) + THREAD_STATE] = READY
        self._ready.appendleft((agent, thread))

    def sleep(self, agent: Agent, thread: int, seconds: float) -> None:
        """The thread is ready again after so many seconds."""
        agent.block.w[place_of(agent.block, thread) + THREAD_STATE] = SLEEPING
        self._timed += 1
        heappush(self._timers, (self._clock.monotonic() + seconds, self._timed, agent, thread))

    def wake(self) -> None:
        """Put the threads whose time has come into the queue."""
        if not self._timers:
            return
        now = self._clock.monotonic()
        while self._timers and self._timers[0][0] <= now:
            _, _, agent, thread = heappop(self._timers)
            if not agent.ended:
                self.last(agent, thread)

    def pause(self) -> float | None:
        """Seconds until somebody can run: 0 for at once, None for never of itself."""
        if self._ready:
            return 0.0
        return max(0.0, self._timers[0][0] - self._clock.monotonic()) if self._timers else None
