"""Ticks of the loops of resources: schedule, overruns, suppression (decision 106).

A loop is a thread of its resource. Its method of kind "ticks" waits for ticks and calls the body. All loops
of a resource begin at the same time, so loops with equal periods have simultaneous ticks; then the loops with
the higher priority, whose threads are older, run first.
"""

from __future__ import annotations

from collections.abc import Callable

from lfield.text import log_messages
from lfield.text.log_messages import LogMessage
from lfield.vm.agent import Agent, ResourceLoops
from lfield.vm.cancellation import Cancellation
from lfield.vm.inspection import traceback
from lfield.vm.memory.threads import place_of
from lfield.vm.scheduler import Scheduler

#: The shortest and longest periods, in ns.
MIN_PERIOD, MAX_PERIOD = 1_000_000, 1_000_000_000_000
#: Seconds between two lines about the same loop.
REPORT_EVERY = 10.0


class LoopTicks:
    """The host calls of loops."""

    def __init__(self, scheduler: Scheduler, cancelling: Cancellation) -> None:
        self._scheduler, self._cancellation = scheduler, cancelling

    def handlers(self) -> dict[str, Callable[[Agent, int, int, list[int]], None]]:
        """The handlers by the name of the instruction."""
        return {
            "tick": self.tick,
            "suppress": self.suppress,
            "control": self.control,
            "tick_failed": self.tick_failed,
        }

    def tick(self, agent: Agent, thread: int, operand: int, words: list[int]) -> None:
        """End a tick, and wait for the next one; missed ticks are skipped."""
        scheduler, (due, period) = self._scheduler, words
        loops = _loops_of(agent)
        name = self._name(loops, thread)
        if not MIN_PERIOD <= period <= MAX_PERIOD:
            reason = f"the period of the loop {name} is {period / 1e9:g} s: it must be from 0.001 s to 1000 s"
            scheduler.throw_builtin(agent, thread, "ArithmeticException", reason, agent.id)
            return
        now = scheduler.clock_of(agent)
        if due > now + MAX_PERIOD:
            # Only a program that was not compiled by lfield has such a period.
            scheduler.throw_builtin(agent, thread, "ArithmeticException", f"no tick at {due} ns", agent.id)
            return
        loops.end_tick(thread)
        agent.pending_cancels.pop(thread, None)
        following = loops.started if due < 0 else due + period
        late = now - following
        if due >= 0 and late > 0:
            skipped = -(-late // period)
            following += skipped * period
            self._report(agent, log_messages.LOOP_OVERRUN, name, late=late / 1e9, skipped=skipped)
        scheduler.engine.complete(agent.block, place_of(agent.block, thread), following)
        scheduler.run_queue.sleep_until(agent, thread, (following - agent.offset) / 1e9, thread)

    def suppress(self, agent: Agent, thread: int, operand: int, words: list[int]) -> None:
        """Suppress the body of another loop."""
        loops = _loops_of(agent)
        by, other = self._name(loops, thread), loops.threads[operand]
        name = self._name(loops, other)
        if other not in loops.suppressed:
            self._cancellation.suppress(agent, other, f"the loop {by} has a higher priority than {name}")
            self._report(agent, log_messages.LOOP_SUPPRESSED, name, by=by)
        self._scheduler.complete_at_once(agent, thread)

    def control(self, agent: Agent, thread: int, operand: int, words: list[int]) -> None:
        """Let the devices obey only loops until the tick ends."""
        loops = _loops_of(agent)
        loops.controlling[thread] = self._name(loops, thread)
        self._scheduler.complete_at_once(agent, thread)

    def tick_failed(self, agent: Agent, thread: int, operand: int, words: list[int]) -> None:
        """Report the exception that has ended a tick."""
        kind, message, _ = traceback.describe(agent.block, self._scheduler.program, words[0])
        reason = f"{kind}: {message}" if message else kind
        self._report(agent, log_messages.LOOP_FAILED, self._name(_loops_of(agent), thread), reason=reason)
        self._scheduler.complete_at_once(agent, thread)

    def _name(self, loops: ResourceLoops, thread: int) -> str:
        method = next(method for method, known in loops.threads.items() if known == thread)
        return self._scheduler.program.core.methods[method].name

    def _report(self, agent: Agent, message: LogMessage, name: str, **values: object) -> None:
        """A line of the log, at most one of its kind per loop in REPORT_EVERY seconds."""
        reported, key = _loops_of(agent).reported, (message.code, name)
        now = self._scheduler.clock.monotonic()
        last, omitted = reported.get(key, (now - REPORT_EVERY, 0))
        if now - last < REPORT_EVERY:
            reported[key] = last, omitted + 1
            return
        reported[key] = now, 0
        self._scheduler.world.report(
            agent, message.line(agent=agent.id, loop=name, omitted=omitted, **values)
        )


def _loops_of(agent: Agent) -> ResourceLoops:
    assert agent.loops is not None, "only methods of loops have these instructions"
    return agent.loops
