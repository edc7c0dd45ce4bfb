"""What makes calls that are begun together durable, each left out: the judge must find what comes of it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from planted_bugs import Bug, Patch

from lfield.host.team.begun import BegunPages
from lfield.simulate.stories.story import crew
from lfield.vm.agent import Agent
from lfield.vm.begun import Begun
from lfield.vm.limits import TimeLimits
from lfield.vm.machine import Machine


def a_result_is_told_before_it_is_kept(patch: Patch) -> None:
    came_back = BegunPages.came_back

    def boldly(self: BegunPages, begun: Begun) -> None:
        came_back(self, begun)
        self._machine.kept_result(begun.key)

    patch.setattr(BegunPages, "came_back", boldly)


def what_is_begun_is_not_on_disk(patch: Patch) -> None:
    def begins(self: BegunPages, agent: Agent, calls: Sequence[Any]) -> bool:
        return self._leases.may_begin(agent)

    patch.setattr(BegunPages, "begins", begins)


def a_fence_cancels_nothing(patch: Patch) -> None:
    patch.setattr(BegunPages, "_over", lambda self, start: "")


def a_result_goes_before_its_coordinators_page(patch: Patch) -> None:
    def look(self: BegunPages) -> None:
        for agent in self._machine.agents.values():
            self._forget(agent.fetched)

    patch.setattr(BegunPages, "look", look)


def who_may_have_begun_begins_again(patch: Patch) -> None:
    patch.setattr(Machine, "goes_on", lambda self, agent: True)


def a_begun_call_knows_no_time_limit(patch: Patch) -> None:
    patch.setattr(TimeLimits, "cancel_at_end", lambda self, agent, resource, begun: None)


def _bug(plant: Any, why: str, found: str, seed: int) -> Bug:
    return Bug(plant, why, frozenset(found.split()), seed, crew)


TOGETHER_BUGS = [
    _bug(
        a_result_is_told_before_it_is_kept,
        "a coordinator goes on with what its host forgets when it dies a moment later",
        "told",
        0,
    ),
    _bug(
        what_is_begun_is_not_on_disk,
        "a host that was started again knows nothing of what it has begun",
        "begun told I5",
        0,
    ),
    _bug(
        a_fence_cancels_nothing,
        "what a start has begun that is barred works on beside its successor",
        "outlives",
        4,
    ),
    _bug(
        a_result_goes_before_its_coordinators_page,
        "a coordinator that goes back to its fetch finds nothing there",
        "result",
        6,
    ),
    _bug(
        who_may_have_begun_begins_again,
        "what was begun before its host died is begun once more",
        "I4",
        12,
    ),
    _bug(
        a_begun_call_knows_no_time_limit,
        "a call on a host that cannot be reached works on when its block was left long ago",
        "outlives",
        83,
    ),
]
