"""Time limits of coordinators: `within` (decision 46).

The end of a limit is in a slot of the frame, in ns of the coordinator's clock; a row of its method gives the
covered instructions. Each coordinator has one timer, for the earliest end of the limits around its position.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import Protocol

from lfield.bytecode.program import LANDING, LIMIT
from lfield.vm import portal_calls
from lfield.vm.agent import Agent, TeamMember
from lfield.vm.cancellation import Cancellation, wake_thread
from lfield.vm.memory import layout
from lfield.vm.memory.layout import (
    CALLING,
    COUNT_LIMIT,
    FRAME_SLOTS,
    THREAD_ID,
    THREAD_STATE,
)
from lfield.vm.memory.threads import only_thread, serving
from lfield.vm.pending_call import PendingCall
from lfield.vm.reference.unwinder import rows_of
from lfield.vm.scheduler import LATE_THRESHOLD, Scheduler

TIME_LIMIT = "TimeLimitException"
#: Seconds between checks whether a `finally` that a limit must not interrupt has ended.
RECHECK_DELAY = 0.05
#: Reason for a late check: no program was running here when the limit expired.
HOST_PAUSED = "its host was paused or suspended"
#: Reason for a late check: the limit expired before the coordinator arrived.
IN_TRANSIT, HOST_DOWN = "it was in transit between hosts", "its host was down"
#: A number of seconds that no mission reaches: the limit around an `init` that may be stopped has no timer.
_NEVER = 1e8
#: A limit of at least this number of seconds never expires.
_ENDLESS = 1e9
#: Tolerance in ns, since the clocks have different units.
_CLOCK_TOLERANCE = 1000


class CallView(Protocol):
    """The calls of a coordinator: `lfield.vm.together.itinerary.Itinerary`."""

    def current_call(self, agent: Agent) -> str:
        """The call that the coordinator waits for, as `resource.portal()`; '' for none."""

    def head(self, agent: Agent) -> str:
        """The instruction of a `together` at which the coordinator is; '' for none."""

    def wait_reason(self, agent: Agent) -> str:
        """The reason why a suspended coordinator cannot continue at once."""

    def is_heartbeat_pending(self, agent: Agent) -> bool:
        """Whether a heartbeat of the destination host of a suspended coordinator is awaited."""

    def is_start_made(self, agent: Agent) -> bool:
        """Whether the coordinator is at a `start` that its host, the home of the other coordinator, has
        already made.
        """

    def blocked_action(self, agent: Agent) -> str:
        """The action that a suspended coordinator is prevented from, as the end of a sentence; '' for
        none.
        """


class Deadlines:
    """Sets time limits, and throws when they expire.

    `calls` provides the calls of a coordinator. `stop_waiting(agent)` ends the wait of a coordinator for
    pending calls here; it returns false without a wait.
    """

    def __init__(
        self,
        scheduler: Scheduler,
        cancelling: Cancellation,
        calls: CallView,
        stop_waiting: Callable[[Agent], bool],
    ) -> None:
        self._scheduler, self._cancelling = scheduler, cancelling
        self._calls, self._stop_waiting = calls, stop_waiting

    def start_limit(self, agent: Agent, seconds: float) -> int:
        """The end of a limit that starts now, for its slot; the limits of the agent are then checked.

        A limit not above 0 expires at once; a limit longer than any mission never expires.
        """
        now = self._scheduler.clock_of(agent)
        if seconds <= 0:
            agent.mark_overdue()
        last = COUNT_LIMIT - 1
        # The values are not added: after a restart with another clock, the time for which a host was down may
        # be decades.
        end = last if seconds >= _ENDLESS else min(now + int(max(0.0, seconds) * 1e9), last)
        self._arm(agent, max(1, end))
        return max(1, end)

    def on_arrival(self, agent: Agent, reason: str) -> None:
        """A coordinator has arrived with its limits; `reason` explains a delay, if any."""
        if not self._scheduler.program.has_limits:
            return
        if ends := [agent.block.w[word] for word, _ in self._enclosing_limits(agent)]:
            if min(ends) <= self._scheduler.clock_of(agent):
                agent.explain_lateness(reason)
            self._arm(agent, min(ends))

    def seconds_left(self, agent: Agent) -> float | None:
        """Seconds until the first limit around a coordinator expires; None without one."""
        ends = [agent.block.w[word] for word, shielded in self._enclosing_limits(agent) if not shielded]
        return (min(ends) - self._scheduler.clock_of(agent)) / 1e9 if ends else None

    def depart(self, agent: Agent, resource: TeamMember, portal: int = -1) -> None:
        """Let a suspended coordinator depart for the host of a resource, for a `portal` (index) or none.

        A coordinator that would arrive after its limit stays, and waits for the limit to expire.
        """
        agent.depart_for(resource.id, portal)
        signs, has_limits = self._scheduler.hooks.liveness, self._scheduler.program.has_limits
        remaining = self.seconds_left(agent) if has_limits and signs is not None else None
        if remaining is None or signs is None or (transit := signs.transit_time(resource)) < remaining:
            self._scheduler.world.depart(agent, resource)
            return
        agent.refuse_departure(
            f": the transfer to {self._scheduler.world.host_of(resource)} takes {transit:.1f} s"
        )

    def expire(self, agent: Agent, reason: str = "") -> bool:
        """Throw in a running or resumed coordinator if its limit has expired; otherwise return false."""
        due = self._due(agent)
        if not due and any(self._is_expired(agent, word) for word, _ in self._enclosing_limits(agent)):
            agent.mark_overdue()
        else:
            agent.clear_overdue()
        if due:
            if reason:
                agent.explain_lateness()
            self._throw(agent, only_thread(agent.block), due, f": {reason}" if reason else "")
        return bool(due)

    def stop(self, agent: Agent, word: int, reason: str) -> None:
        """End the limit with the word `word` now, for a reason; without effect on an expired limit."""
        w = agent.block.w
        if w[word] <= 0:
            return
        w[word] = max(1, min(w[word], self._scheduler.clock_of(agent)))
        agent.mark_stopping(reason)
        if due := self._due(agent):
            self._on_expired(agent, due)
        else:
            agent.mark_overdue("a running finally is not interrupted")
            self.recheck_soon(agent)

    # --- alarms ---------------------------------------------------------------------------------------

    def _arm(self, agent: Agent, end: int) -> None:
        """Set the timer for this end, unless it is set earlier."""
        scheduler = self._scheduler
        seconds = max(0.0, (end - scheduler.clock_of(agent)) / 1e9)
        if seconds > _NEVER:
            return
        at = scheduler.clock.monotonic() + seconds
        if at < agent.alarm:
            agent.set_alarm(at)
            scheduler.run_queue.set_alarm(agent, seconds, partial(self._on_alarm, agent, at))

    def _on_alarm(self, agent: Agent, at: float) -> None:
        if agent.alarm != at or self._scheduler.agents.get(agent.id) is not agent:
            return
        agent.set_alarm()
        if self._scheduler.clock.monotonic() - at >= LATE_THRESHOLD:
            agent.explain_lateness(HOST_PAUSED)
        w = agent.block.w
        around = [word for word, _ in self._enclosing_limits(agent)]
        later = [w[word] for word in around if not self._is_expired(agent, word)]
        if later:
            self._arm(agent, min(later))
        if due := self._due(agent):
            self._on_expired(agent, due)
            return
        if len(later) < len(around):
            agent.mark_overdue("a running finally is not interrupted")
            self.recheck_soon(agent)
        self._skip_unreachable_leave(agent)
        self._finish_made_start(agent)

    def recheck_soon(self, agent: Agent) -> None:
        """Set the timer for soon: the obstacle to a throw may be gone."""
        self._arm(agent, self._scheduler.clock_of(agent) + int(RECHECK_DELAY * 1e9))

    # --- expiry ---------------------------------------------------------------------------------------

    def _enclosing_limits(self, agent: Agent) -> Iterator[tuple[int, bool]]:
        """The limits around the position of a coordinator, innermost first.

        For each the word of its slot, and whether a started `finally` is in between.
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

    def _skip_unreachable_leave(self, agent: Agent) -> None:
        """Continue a coordinator that leaves a `together` and waits for an unreachable host.

        This is not done while a heartbeat of that host is awaited.
        """
        cancels = self._calls.head(agent) in ("leave", "cancel")
        leaves = agent.frozen and cancels and self.is_block_expired(agent)
        if leaves and self._calls.is_heartbeat_pending(agent):
            self.recheck_soon(agent)
        elif leaves and self._scheduler.world.abandon_wait(agent):
            agent.resume()
            self._scheduler.run_queue.push_front(agent, only_thread(agent.block))

    def _finish_made_start(self, agent: Agent) -> None:
        """Continue a coordinator after a `start` that was made, and that a restart has delayed."""
        if agent.frozen and self._calls.is_start_made(agent) and self._scheduler.world.abandon_wait(agent):
            agent.resume()
            agent.invalidate_image()
            self._scheduler.complete_at_once(agent, only_thread(agent.block), 1)

    def is_block_expired(self, agent: Agent) -> bool:
        """Whether a limit has expired around the block that a coordinator is about to leave.

        The coordinator is in the code of a `finally`. Limits beyond the next `finally` are ignored: they
        interrupt neither.
        """
        return bool(self._expired_ends(agent))

    def _expired_ends(self, agent: Agent) -> list[int]:
        """The ends in ns of expired limits around the block that is left."""
        w, landings, found = agent.block.w, 0, []
        now = self._scheduler.clock_of(agent) + _CLOCK_TOLERANCE
        for frame, row in rows_of(agent.block, self._scheduler.program, w[layout.W_THREADS]):
            landings += row.kind == LANDING
            if landings > 1:
                break
            end = w[frame + FRAME_SLOTS + row.slot] if row.kind == LIMIT else 0
            if end < 0 or 0 < end <= now:
                found.append(abs(end))
        return found

    def lateness(self, agent: Agent) -> float:
        """Seconds by which the end of the block that a coordinator leaves is late; 0 if in time."""
        seconds = self.over_for(agent)
        return seconds if seconds >= LATE_THRESHOLD else 0.0

    def over_for(self, agent: Agent) -> float:
        """Seconds since the last limit around the block that is left expired; 0 for none."""
        ends = self._expired_ends(agent)
        return max(0.0, (self._scheduler.clock_of(agent) - max(ends)) / 1e9) if ends else 0.0

    def _seconds_since(self, agent: Agent, end: int) -> float:
        seconds = (self._scheduler.clock_of(agent) - end) / 1e9
        return seconds if seconds >= LATE_THRESHOLD else 0.0

    def _due(self, agent: Agent) -> list[int]:
        """The slots of expired limits that may throw; the limit of a `start` that was made may not throw."""
        around = list(self._enclosing_limits(agent))
        due = [word for word, shielded in around if not shielded and self._is_expired(agent, word)]
        is_innermost = bool(due) and due[0] == around[0][0]
        return due[1:] if is_innermost and self._calls.is_start_made(agent) else due

    def _is_expired(self, agent: Agent, word: int) -> bool:
        return agent.block.w[word] <= self._scheduler.clock_of(agent) + _CLOCK_TOLERANCE

    def _on_expired(self, agent: Agent, due: list[int]) -> None:
        """A limit has expired: abandon the coordinator's operation, or cancel the operation and wait for its
        end.
        """
        scheduler = self._scheduler
        w = agent.block.w
        record = w[layout.W_THREADS]
        thread, state = w[record + THREAD_ID], w[record + THREAD_STATE]
        if agent.frozen:
            reason = self._calls.blocked_action(agent) + agent.unreachable_reason
            if not agent.unreachable_reason and not scheduler.world.abandon_wait(agent):
                agent.mark_overdue(self._calls.wait_reason(agent))
                return
            agent.resume()
            self._throw(agent, thread, due, reason)
        elif state == CALLING and (number := portal_calls.call_number(scheduler, agent)):
            self._cancel(agent, number, due)
        elif state == CALLING:
            waited = not self._stop_waiting(agent) and portal_calls.leave_init_queue(scheduler, agent)
            self._throw(agent, thread, due, " before the call could begin" if waited else "")
        else:
            wake_thread(scheduler, agent, thread)
            self._throw(agent, thread, due, "")

    def _cancel(self, agent: Agent, number: int, due: list[int]) -> None:
        """Cancel the call that the coordinator waits for; the exception follows when it has ended."""
        called = self._calls.current_call(agent)
        agent.cancel_call(self._mark_expired(agent, due), f"the time is over; {called} was cancelled")
        for resource in list(self._scheduler.agents.values()):
            if resource.member.kind == "resource" and serving(resource.block, number):
                self._cancelling.cancel_call(resource, number, f"the time limit of {agent.id} is over")
                return

    def _throw(self, agent: Agent, thread: int, due: list[int], detail: str) -> None:
        late = self._seconds_since(agent, self._mark_expired(agent, due))
        text = f", {late:.1f} s late" if late else ""
        reason = agent.explain_lateness()
        text += f" since {reason}" if late and reason else ""
        head = agent.stop_reason or "the time is over"
        self._scheduler.throw_builtin(agent, thread, TIME_LIMIT, f"{head}{text}{detail}", agent.id)

    def _mark_expired(self, agent: Agent, due: list[int]) -> int:
        """Mark limits as expired: their ends become negative. Returns the last end, in ns."""
        w = agent.block.w
        ends = [w[word] for word in due]
        for word in due:
            w[word] = -w[word]
        return max(ends)

    def schedule_cancel(self, agent: Agent, resource: Agent, pending: PendingCall) -> None:
        """Cancel a pending call here when its caller's limit expires."""
        remaining = self.seconds_left(agent)
        if remaining is not None:
            reason = f"the time limit of {agent.id} is over"
            pending.deadline = self._scheduler.clock_of(agent) + int(remaining * 1e9)
            ring = partial(self._cancel_call, resource, pending, reason)
            self._scheduler.run_queue.set_alarm(resource, max(0.0, remaining), ring)

    def _cancel_call(self, resource: Agent, pending: PendingCall, reason: str) -> None:
        pending.is_expired = pending.state == "running"
        self._cancelling.cancel_call(resource, pending.call, reason)
