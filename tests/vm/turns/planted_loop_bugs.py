"""The rules of loops, each broken."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import loop_world
import pytest

from lfield.lang import tree
from lfield.lang.checker.loops.loop_thread import _Ticks
from lfield.vm.agent import Agent, ResourceLoops
from lfield.vm.cancellation import Cancellation
from lfield.vm.turns.run_queue import RunQueue

Patch = pytest.MonkeyPatch
LoopBug = Callable[[Patch], None]


def missed_ticks_are_queued(patch: Patch) -> None:
    """A late loop repeats its body immediately until it has caught up with its ticks."""
    sleep = RunQueue.sleep_until

    def early(self: RunQueue, agent: Agent, thread: int, at: float, rank: int = 0) -> None:
        sleep(self, agent, thread, at - 0.1 if rank and at > 4.15 else at, rank)

    patch.setattr(RunQueue, "sleep_until", early)


def the_schedule_drifts(patch: Patch) -> None:
    """The period is counted from the end of the body."""
    sleep = RunQueue.sleep_until

    def late(self: RunQueue, agent: Agent, thread: int, at: float, rank: int = 0) -> None:
        sleep(self, agent, thread, self._clock.monotonic() + 0.1 if rank and at > 0.05 else at, rank)

    patch.setattr(RunQueue, "sleep_until", late)


def a_suppressed_body_commands_devices(patch: Patch) -> None:
    """A suppressed body gets its exception once, and may command devices in its clean-up."""
    patch.setattr(ResourceLoops, "refusal", lambda self, thread: ("", ""))


def the_running_command_is_not_cancelled(patch: Patch) -> None:
    """The device instruction of a suppressed body is not cancelled."""
    patch.setattr(Cancellation, "suppress", lambda self, agent, thread, reason: None)


def suppression_outlives_the_tick(patch: Patch) -> None:
    """A loop that was suppressed once can no longer command devices."""
    patch.setattr(ResourceLoops, "end_tick", lambda self, thread: None)


def lower_loops_go_first(patch: Patch) -> None:
    """At equal times the loop that waits longer is first."""
    sleep = RunQueue.sleep_until

    def unranked(self: RunQueue, agent: Agent, thread: int, at: float, rank: int = 0) -> None:
        sleep(self, agent, thread, at, -rank)

    patch.setattr(RunQueue, "sleep_until", unranked)


def an_unknown_condition_counts_as_false(patch: Patch) -> None:
    """A loop whose condition cannot be evaluated suppresses nothing."""
    _recompiled(patch)
    set_ = _Ticks._set

    def set_false(self: _Ticks, of: Any, to: Any) -> Any:
        is_unknown = of is self._loop.engaged and isinstance(to, tree.Literal_)
        return set_(self, of, self._literal(to.type, False) if is_unknown else to)

    patch.setattr(_Ticks, "_set", set_false)


def a_loop_above_portals_controls_nothing(patch: Patch) -> None:
    """Portals command devices while the body of a loop above them runs."""
    _recompiled(patch)
    patch.setattr(tree.ResourceLoop, "controls", property(lambda self: False))


def _recompiled(patch: Patch) -> None:
    """The programs of tests are compiled again."""
    patch.setattr(loop_world, "program", loop_world.program.__wrapped__)


LOOP_BUGS: tuple[LoopBug, ...] = (
    missed_ticks_are_queued,
    the_schedule_drifts,
    a_suppressed_body_commands_devices,
    the_running_command_is_not_cancelled,
    suppression_outlives_the_tick,
    lower_loops_go_first,
    an_unknown_condition_counts_as_false,
    a_loop_above_portals_controls_nothing,
)
