"""The time limits of coordinators: `within` (decision 46).

The end of a limit is in a slot of the frame, in ns on the coordinator's own clock, and a row of its method
says which instructions it is about. Nothing is looked at until an alarm rings: one for each coordinator, for
the nearest end of all limits around the place where it stands.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from functools import partial
from typing import Protocol

from lfield.bytecode.program import LANDING, LIMIT
from lfield.vm import portals
from lfield.vm.agent import Agent, Member
from lfield.vm.begun import Begun
from lfield.vm.cancelling import Cancelling, rouse
from lfield.vm.memory import layout
from lfield.vm.memory.layout import (
    CALLING,
    COUNT_LIMIT,
    FRAME_SLOTS,
    THREAD_ID,
    THREAD_STATE,
)
from lfield.vm.memory.threads import only_thread, serving
from lfield.vm.reference.unwind import rows_of
from lfield.vm.scheduler import LATE, Scheduler

TIME_LIMIT = "TimeLimitException"
#: How soon it is looked again whether a `finally` that a limit must not cut has come to its end, in seconds.
SOON = 0.05
#: Why a limit is looked at late whose time was over while no program ran here.
STOOD_STILL = "its host was paused, or stood still"
#: The same where it was over before a coordinator came.
ON_ITS_WAY, DOWN = "it was on its way between hosts", "its host was down"
#: The clocks are read in different units: so many ns make no difference.
_SLACK = 1000


class Calling(Protocol):
    """What a coordinator calls: `lfield.vm.together.visits.Visits`."""

    def called(self, agent: Agent) -> str:
        """The call that it waits for, as `resource.portal()`; '' for none."""

    def head(self, agent: Agent) -> str:
        """The name of the head of a `together` at which it stands; '' for none."""

    def keeps_waiting(self, agent: Agent) -> str:
        """Why a frozen one cannot go on at once."""

    def is_asked(self, agent: Agent) -> bool:
        """Whether a sign of life of the host that a frozen one wants to is still waited for."""

    def cut_short(self, agent: Agent) -> str:
        """What a frozen one is kept from, as the end of a sentence; '' for nothing."""


class TimeLimits:
    """Sets them, and throws when they are over.

    `visits` tells what a coordinator calls. `stop_waiting(agent)` takes one that waits here for its begun
    calls out of that; false when it does not.
    """

    def __init__(
        self,
        scheduler: Scheduler,
        cancelling: Cancelling,
        visits: Calling,
        stop_waiting: Callable[[Agent], bool],
    ) -> None:
        self._scheduler, self._cancelling = scheduler, cancelling
        self._visits, self._stop_waiting = visits, stop_waiting

    def end(self, agent: Agent, seconds: float) -> int:
        """The end of a limit that begins now, for its slot; the agent is looked at then.

        What is not above 0 is over at once; what is beyond any mission is as good as none.
        """
        now = self._scheduler.clock_of(agent)
        agent.overdue = agent.overdue or seconds <= 0
        end = min(now + int(max(0.0, min(seconds, 1e9)) * 1e9), COUNT_LIMIT - 1)
        self._arm(agent, max(1, end))
        return max(1, end)

    def look(self, agent: Agent, why: str) -> None:
        """A coordinator has come, with the limits that it is under; `why` it comes late, if it does."""
        if not self._scheduler.program.has_limits:
            return
        if ends := [agent.block.w[word] for word, _ in self._around(agent)]:
            if min(ends) <= self._scheduler.clock_of(agent):
                agent.late_since = why
            self._arm(agent, min(ends))

    def nearest(self, agent: Agent) -> float | None:
        """In how many seconds the first limit around a coordinator is over; None without any."""
        ends = [agent.block.w[word] for word, shielded in self._around(agent) if not shielded]
        return (min(ends) - self._scheduler.clock_of(agent)) / 1e9 if ends else None

    def depart(self, agent: Agent, resource: Member) -> None:
        """Let a frozen coordinator leave for the host of a resource.

        One that would arrive there after its time is over stays, and waits for the end of its time.
        """
        signs, has_limits = self._scheduler.attached.signs, self._scheduler.program.has_limits
        left = self.nearest(agent) if has_limits and signs is not None else None
        if left is None or signs is None or (transit := signs.transit(resource)) < left:
            self._scheduler.world.depart(agent, resource)
            return
        agent.too_far = f": the way to {self._scheduler.world.host_of(resource)} takes {transit:.1f} s"

    def strike(self, agent: Agent, why: str = "") -> bool:
        """Throw in a coordinator that runs or was just resumed, if the time is over; false if it is not."""
        due = self._due(agent)
        agent.overdue = not due and any(self._is_over(agent, word) for word, _ in self._around(agent))
        if due:
            if why:
                agent.late_since = ""
            self._throw(agent, only_thread(agent.block), due, f": {why}" if why else "")
        return bool(due)

    # --- alarms ---------------------------------------------------------------------------------------

    def _arm(self, agent: Agent, end: int) -> None:
        """Let the alarm ring at this end, unless it rings earlier."""
        scheduler = self._scheduler
        seconds = max(0.0, (end - scheduler.clock_of(agent)) / 1e9)
        at = scheduler.clock.monotonic() + seconds
        if at < agent.alarm:
            agent.alarm = at
            scheduler.turns.alarm(agent, seconds, lambda: self._ring(agent, at))

    def _ring(self, agent: Agent, at: float) -> None:
        if agent.alarm != at or self._scheduler.agents.get(agent.id) is not agent:
            return
        agent.alarm = math.inf
        if self._scheduler.clock.monotonic() - at >= LATE:
            agent.late_since = STOOD_STILL
        w = agent.block.w
        around = [word for word, _ in self._around(agent)]
        later = [w[word] for word in around if not self._is_over(agent, word)]
        if later:
            self._arm(agent, min(later))
        if due := self._due(agent):
            self._over(agent, due)
            return
        if len(later) < len(around):
            agent.overdue = True
            agent.late_since = "a finally that has begun is not cut short"
            self.look_soon(agent)
        self._hurry_leave(agent)

    def look_soon(self, agent: Agent) -> None:
        """Let the alarm ring soon: what keeps a coordinator in a block that is over may have changed."""
        self._arm(agent, self._scheduler.clock_of(agent) + int(SOON * 1e9))

    # --- what is over ---------------------------------------------------------------------------------

    def _around(self, agent: Agent) -> Iterator[tuple[int, bool]]:
        """The limits around the place where a coordinator stands, innermost first.

        For each the word of its slot, and whether a `finally` that has begun stands between.
        """
        if not self._scheduler.program.has_limits:
            return
        w = agent.block.w
        shielded = False
        for within, row in rows_of(agent.block, self._scheduler.program, w[layout.W_THREADS]):
            shielded = shielded or row.kind == LANDING
            word = within + FRAME_SLOTS + row.slot
            if row.kind == LIMIT and w[word] > 0:
                yield word, shielded

    def _hurry_leave(self, agent: Agent) -> None:
        """A coordinator that leaves a `together`, and waits for a host that it cannot reach, goes on.

        It does not while that host still has time for a sign of life.
        """
        leaves = agent.frozen and self._visits.head(agent) == "leave" and self.is_block_over(agent)
        if leaves and self._visits.is_asked(agent):
            self.look_soon(agent)
        elif leaves and self._scheduler.world.give_up(agent):
            agent.frozen = False
            self._scheduler.turns.next(agent, only_thread(agent.block))

    def is_block_over(self, agent: Agent) -> bool:
        """Whether a limit is over around the block that a coordinator is about to leave.

        It stands in the code of a `finally`. Limits beyond the next one do not count: they cut neither.
        """
        return bool(self._ends_over(agent))

    def _ends_over(self, agent: Agent) -> list[int]:
        """The ends of the limits that are over around the block that is left, in ns."""
        w, landings, found = agent.block.w, 0, []
        now = self._scheduler.clock_of(agent) + _SLACK
        for frame, row in rows_of(agent.block, self._scheduler.program, w[layout.W_THREADS]):
            landings += row.kind == LANDING
            if landings > 1:
                break
            end = w[frame + FRAME_SLOTS + row.slot] if row.kind == LIMIT else 0
            if end < 0 or 0 < end <= now:
                found.append(abs(end))
        return found

    def lateness(self, agent: Agent) -> float:
        """By how many seconds the end of the block is late that a coordinator leaves; 0 for in time."""
        seconds = self.over_for(agent)
        return seconds if seconds >= LATE else 0.0

    def over_for(self, agent: Agent) -> float:
        """For how many seconds the last limit is over around the block that is left; 0 for none."""
        ends = self._ends_over(agent)
        return max(0.0, (self._scheduler.clock_of(agent) - max(ends)) / 1e9) if ends else 0.0

    def _seconds_since(self, agent: Agent, end: int) -> float:
        seconds = (self._scheduler.clock_of(agent) - end) / 1e9
        return seconds if seconds >= LATE else 0.0

    def _due(self, agent: Agent) -> list[int]:
        """The words of the limits that are over and may throw."""
        around = self._around(agent)
        return [word for word, shielded in around if not shielded and self._is_over(agent, word)]

    def _is_over(self, agent: Agent, word: int) -> bool:
        return agent.block.w[word] <= self._scheduler.clock_of(agent) + _SLACK

    def _over(self, agent: Agent, due: list[int]) -> None:
        """A limit is over: whatever the coordinator does is given up, or cancelled and waited for."""
        scheduler = self._scheduler
        w = agent.block.w
        record = w[layout.W_THREADS]
        thread, state = w[record + THREAD_ID], w[record + THREAD_STATE]
        if agent.frozen:
            what = self._visits.cut_short(agent) + agent.too_far
            if not agent.too_far and not scheduler.world.give_up(agent):
                agent.overdue = True
                agent.late_since = self._visits.keeps_waiting(agent)
                return
            agent.frozen, agent.too_far = False, ""
            self._throw(agent, thread, due, what)
        elif state == CALLING and (number := portals.call_of(scheduler, agent)):
            self._cancel(agent, number, due)
        elif state == CALLING:
            waited = not self._stop_waiting(agent) and portals.withdraw(scheduler, agent)
            self._throw(agent, thread, due, " before the call could begin" if waited else "")
        else:
            rouse(scheduler, agent, thread)
            self._throw(agent, thread, due, "")

    def _cancel(self, agent: Agent, number: int, due: list[int]) -> None:
        """The call that the coordinator waits for is cancelled; it throws when that has come to its end."""
        called = self._visits.called(agent)
        agent.over_at = self._end_all(agent, due)
        agent.over = f"the time is over; {called} was cancelled"
        for resource in list(self._scheduler.agents.values()):
            if resource.member.kind == "resource" and serving(resource.block, number):
                self._cancelling.call(resource, number, f"the time limit of {agent.id} is over")
                return

    def _throw(self, agent: Agent, thread: int, due: list[int], what: str) -> None:
        late = self._seconds_since(agent, self._end_all(agent, due))
        said = f", {late:.1f} s late" if late else ""
        said += f" since {agent.late_since}" if late and agent.late_since else ""
        agent.late_since = ""
        self._scheduler.refuse(agent, thread, TIME_LIMIT, f"the time is over{said}{what}", agent.id)

    def _end_all(self, agent: Agent, due: list[int]) -> int:
        """Mark limits as over: the end stays there, below zero. Returns the last of them, in ns."""
        w = agent.block.w
        ends = [w[word] for word in due]
        for word in due:
            w[word] = -w[word]
        return max(ends)

    def cancel_at_end(self, agent: Agent, resource: Agent, begun: Begun) -> None:
        """A call that was begun is cancelled here when the time of whoever began it is over."""
        left = self.nearest(agent)
        if left is not None:
            reason = f"the time limit of {agent.id} is over"
            begun.end = self._scheduler.clock_of(agent) + int(left * 1e9)
            ring = partial(self._end, resource, begun, reason)
            self._scheduler.turns.alarm(resource, max(0.0, left), ring)

    def _end(self, resource: Agent, begun: Begun, reason: str) -> None:
        begun.over = begun.state == "running"
        self._cancelling.call(resource, begun.call, reason)
