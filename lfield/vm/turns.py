"""Whose turn it is: the queue of threads that can run, the timers of those that sleep, and alarms."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from heapq import heapify, heappop, heappush

from lfield.clock import Clock
from lfield.vm.agent import Agent
from lfield.vm.memory.layout import READY, SLEEPING, THREAD_STATE
from lfield.vm.memory.threads import place_of

#: Turns that may follow one another without the end of the queue being looked at.
STREAK = 50


class Turns:
    """Threads by agent and id. A thread stands in the queue, or in one timer, or in neither.

    An alarm is something else to be done for an agent at a time, unless that has ended by then.
    """

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        #: The threads that can run; the first one's turn is next.
        self.ready: deque[tuple[Agent, int]] = deque()
        self._timers: list[tuple[float, int, Agent, int]] = []
        self._alarms: list[tuple[float, int, Agent, Callable[[], None]]] = []
        #: The timer of each thread that sleeps, by its number: others of it do not count any more.
        self._asleep: dict[tuple[Agent, int], int] = {}
        self._timed = 0
        self._streak = 0

    @property
    def timed(self) -> bool:
        """Whether anybody sleeps, or an alarm is set: else there is nothing to `wake`."""
        return bool(self._timers or self._alarms)

    def last(self, agent: Agent, thread: int) -> None:
        """The thread is ready and waits its turn."""
        agent.block.w[place_of(agent.block, thread) + THREAD_STATE] = READY
        self.ready.append((agent, thread))

    def next(self, agent: Agent, thread: int) -> None:
        """The next turn is this thread's: it has only asked for a moment, or somebody waits for it.

        After STREAK such turns in a row everybody else comes first, so that nobody starves.
        """
        agent.block.w[place_of(agent.block, thread) + THREAD_STATE] = READY
        self.soon(agent, thread)

    def soon(self, agent: Agent, thread: int) -> None:
        """As `next`, of a thread whose state is READY already."""
        self._streak += 1
        if self._streak < STREAK:
            self.ready.appendleft((agent, thread))
        else:
            self._streak = 0
            self.ready.append((agent, thread))

    def sleep(self, agent: Agent, thread: int, seconds: float) -> None:
        """The thread is ready again after so many seconds."""
        agent.block.w[place_of(agent.block, thread) + THREAD_STATE] = SLEEPING
        self._timed += 1
        self._asleep[agent, thread] = self._timed
        heappush(self._timers, (self._clock.monotonic() + seconds, self._timed, agent, thread))

    def drop(self, agent: Agent, thread: int) -> None:
        """The thread waits neither for its turn nor for a time."""
        self._asleep.pop((agent, thread), None)
        if (agent, thread) in self.ready:
            self.ready.remove((agent, thread))

    def alarm(self, agent: Agent, seconds: float, ring: Callable[[], None]) -> None:
        """Have something done for an agent after so many seconds, by whoever calls `wake`."""
        self._timed += 1
        heappush(self._alarms, (self._clock.monotonic() + seconds, self._timed, agent, ring))

    def quiet(self, agent: Agent) -> None:
        """No alarm rings for the agent any more."""
        if self._alarms:
            self._alarms = [alarm for alarm in self._alarms if alarm[2] is not agent]
            heapify(self._alarms)

    def wake(self) -> Iterator[tuple[Agent, Callable[[], None]]]:
        """Put the threads whose time has come into the queue, and give the alarms, each once.

        In the order of their times, however late it is: a sleep that would have ended after an alarm has not.
        """
        now = self._clock.monotonic()
        while self._alarms and self._alarms[0][0] <= now:
            self._wake(self._alarms[0][0])
            _, _, agent, ring = heappop(self._alarms)
            if not agent.ended:
                yield agent, ring
        self._wake(now)

    def _wake(self, until: float) -> None:
        while self._timers and self._timers[0][0] <= until:
            _, number, agent, thread = heappop(self._timers)
            if self._asleep.get((agent, thread)) != number:
                continue
            del self._asleep[agent, thread]
            if not agent.ended:
                self.last(agent, thread)

    def pause(self) -> float | None:
        """Seconds until somebody can run or an alarm rings: 0 for at once, None for never of itself."""
        if self.ready:
            return 0.0
        if not self.timed:
            return None
        while self._alarms and self._alarms[0][2].ended:
            heappop(self._alarms)
        while self._timers and self._asleep.get(self._timers[0][2:]) != self._timers[0][1]:
            heappop(self._timers)
        due = [queue[0][0] for queue in (self._timers, self._alarms) if queue]
        return max(0.0, min(due) - self._clock.monotonic()) if due else None
