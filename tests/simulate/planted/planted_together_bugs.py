"""The rules that make concurrent calls durable, each removed: the judge must find the effect."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from planted_bugs import Bug, Patch

from lfield.host.location.call_watch import CallWatch
from lfield.host.team.pending_call_store import PendingCallStore
from lfield.vm.agent import Agent
from lfield.vm.deadlines import Deadlines
from lfield.vm.pending_call import PendingCall
from lfield.vm.together.future_handlers import FutureHandlers
from lfield.vm.together.itinerary import Itinerary
from simulation_testing.scenarios.scenario import crew, racer


def a_result_is_returned_before_it_is_on_disk(patch: Patch) -> None:
    complete = PendingCallStore.on_call_completed

    def complete_and_confirm(self: PendingCallStore, begun: PendingCall) -> None:
        complete(self, begun)
        self._machine.pending_calls.on_persisted(begun.key)

    patch.setattr(PendingCallStore, "on_call_completed", complete_and_confirm)


def the_start_of_a_call_is_not_on_disk(patch: Patch) -> None:
    def begins(self: PendingCallStore, agent: Agent, calls: Sequence[Any]) -> bool:
        return self._leases.may_start_call(agent)

    patch.setattr(PendingCallStore, "may_start_calls", begins)


def a_fence_does_not_cancel_calls(patch: Patch) -> None:
    patch.setattr(PendingCallStore, "_end_reason", lambda self, start: "")


def a_result_is_deleted_before_its_checkpoint_is_on_disk(patch: Patch) -> None:
    def look(self: PendingCallStore, now: float) -> None:
        for agent in self._machine.agents.values():
            self._delete(agent.fetched)

    patch.setattr(PendingCallStore, "on_tick", look)


def an_interrupted_call_is_started_again(patch: Patch) -> None:
    patch.setattr(Itinerary, "may_continue", lambda self, agent: True)


def a_started_call_has_no_time_limit(patch: Patch) -> None:
    patch.setattr(Deadlines, "schedule_cancel", lambda self, agent, resource, begun: None)


def an_end_is_not_reported(patch: Patch) -> None:
    patch.setattr(CallWatch, "_on_result", lambda self, pending: None)
    patch.setattr(CallWatch, "_update_due", lambda self: None)
    patch.setattr(CallWatch, "_on_link_opened", lambda self, event: None)


def a_result_does_not_reach_its_future(patch: Patch) -> None:
    patch.setattr(FutureHandlers, "_store", lambda self, ticket: None)


def _bug(plant: Any, broken: str, found: str, seed: int) -> Bug:
    return Bug(plant, broken, frozenset(found.split()), seed, crew)


TOGETHER_BUGS = [
    _bug(
        a_result_is_returned_before_it_is_on_disk,
        "a result is returned before its record is on disk",
        "told",
        0,
    ),
    _bug(
        the_start_of_a_call_is_not_on_disk,
        "the start of a call is not on disk: a restarted host does not know that it was running",
        "begun told I5",
        0,
    ),
    _bug(
        a_fence_does_not_cancel_calls,
        "a fence does not cancel the calls of the fenced start",
        "outlives",
        17,
    ),
    _bug(
        a_result_is_deleted_before_its_checkpoint_is_on_disk,
        "a result is deleted before the checkpoint of its coordinator is on disk",
        "result",
        2,
    ),
    _bug(
        an_interrupted_call_is_started_again,
        "a call that was running when its host failed is started again",
        "I4",
        2,
    ),
    _bug(
        a_started_call_has_no_time_limit,
        "a started call has no time limit: it continues on an unreachable host after its 'within' has ended",
        "outlives",
        91,
    ),
]

FUTURE_BUGS = [
    Bug(
        an_end_is_not_reported,
        "no host reports the end of a call: a coordinator waits for the first of several without end",
        frozenset({"stuck"}),
        5,
        racer,
    ),
    Bug(
        a_result_does_not_reach_its_future,
        "the result of a call stays in its ticket: a future gives the initial value of its type",
        frozenset({"I4"}),
        0,
        racer,
    ),
]
