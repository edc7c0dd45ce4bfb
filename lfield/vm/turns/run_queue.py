"""Run queue of threads (round robin), with timers of sleeping threads, and alarms."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from heapq import heapify, heappop, heappush

from lfield.clock import Clock
from lfield.vm.agent import Agent
from lfield.vm.memory.layout import READY, SLEEPING, THREAD_STATE
from lfield.vm.memory.threads import place_of

#: Maximum consecutive turns of threads at the front before the others run.
MAX_STREAK = 50


class RunQueue:
    """Threads by agent and id. A thread is in the queue, in one timer, or in neither.

    An alarm is another timed action for an agent, dropped if the agent has ended.
    """

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        #: Threads that can run; the first is next.
        self.ready: deque[tuple[Agent, int]] = deque()
        #: Timers of sleeping threads, and alarms: if the heap is empty, `pop_due` has no work.
        self.timers: list[tuple[float, int, int, Agent, int]] = []
        self.alarms: list[tuple[float, int, Agent, Callable[[], None]]] = []
        #: The valid timer of each sleeping thread, by number.
        self._sleeping: dict[tuple[Agent, int], int] = {}
        self._timed = 0
        self._streak = 0

    def push_back(self, agent: Agent, thread: int) -> None:
        """Queue a ready thread at the end."""
        agent.block.w[place_of(agent.block, thread) + THREAD_STATE] = READY
        self.ready.append((agent, thread))

    def push_front(self, agent: Agent, thread: int) -> None:
        """Queue a ready thread at the front: its wait was short, or another thread waits for it.

        After MAX_STREAK such consecutive turns all other threads run first, to prevent starvation.
        """
        agent.block.w[place_of(agent.block, thread) + THREAD_STATE] = READY
        self.push_ready_front(agent, thread)

    def push_ready_front(self, agent: Agent, thread: int) -> None:
        """As `push_front`, for a thread whose state is READY."""
        self._streak += 1
        if self._streak < MAX_STREAK:
            self.ready.appendleft((agent, thread))
        else:
            self._streak = 0
            self.ready.append((agent, thread))

    def sleep(self, agent: Agent, thread: int, seconds: float) -> None:
        """Make the thread ready after `seconds` seconds."""
        self.sleep_until(agent, thread, self._clock.monotonic() + seconds)

    def sleep_until(self, agent: Agent, thread: int, at: float, rank: int = 0) -> None:
        """Make the thread ready at the time `at`. Of threads with the same time, the thread with the lowest
        rank is first.
        """
        agent.block.w[place_of(agent.block, thread) + THREAD_STATE] = SLEEPING
        self._timed += 1
        self._sleeping[agent, thread] = self._timed
        heappush(self.timers, (at, rank, self._timed, agent, thread))

    def remove(self, agent: Agent, thread: int) -> None:
        """Remove a thread from queue and timers."""
        self._sleeping.pop((agent, thread), None)
        if (agent, thread) in self.ready:
            self.ready.remove((agent, thread))

    def set_alarm(self, agent: Agent, seconds: float, ring: Callable[[], None]) -> None:
        """Set an alarm for an agent after `seconds` seconds, which `pop_due` returns."""
        self._timed += 1
        heappush(self.alarms, (self._clock.monotonic() + seconds, self._timed, agent, ring))

    def cancel_alarms(self, agent: Agent) -> None:
        """Cancel the agent's alarms."""
        if self.alarms:
            self.alarms = [alarm for alarm in self.alarms if alarm[2] is not agent]
            heapify(self.alarms)

    def pop_due(self) -> Iterator[tuple[Agent, Callable[[], None]]]:
        """Queue the threads that are due, and return the expired alarms, each once.

        They are in the order of their times, even if late: a sleep that would have ended after an alarm has
        not ended.
        """
        now = self._clock.monotonic()
        while self.alarms and self.alarms[0][0] <= now:
            self._push_due(self.alarms[0][0])
            _, _, agent, ring = heappop(self.alarms)
            if not agent.ended:
                yield agent, ring
        self._push_due(now)

    def _push_due(self, until: float) -> None:
        while self.timers and self.timers[0][0] <= until:
            _, _, number, agent, thread = heappop(self.timers)
            if self._sleeping.get((agent, thread)) != number:
                continue
            del self._sleeping[agent, thread]
            if not agent.ended:
                self.push_back(agent, thread)

    def seconds_until_due(self) -> float | None:
        """Seconds until a thread can run or an alarm expires: 0 for at once, None for never."""
        if self.ready:
            return 0.0
        if not (self.timers or self.alarms):
            return None
        while self.alarms and self.alarms[0][2].ended:
            heappop(self.alarms)
        while self.timers and self._sleeping.get(self.timers[0][3:]) != self.timers[0][2]:
            heappop(self.timers)
        due = [queue[0][0] for queue in (self.timers, self.alarms) if queue]
        return max(0.0, min(due) - self._clock.monotonic()) if due else None
