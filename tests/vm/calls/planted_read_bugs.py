"""The rules of `read`, each broken."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from lfield.vm.agent import Agent
from lfield.vm.scheduler import Scheduler
from lfield.vm.waits import operator_input
from lfield.vm.waits.operator_input import OperatorInput, _Reader

Patch = pytest.MonkeyPatch
ReadBug = Callable[[Patch], None]


def the_latest_reader_gets_the_line(patch: Patch) -> None:
    """A line goes to the thread that has waited for the shortest time."""
    enter = OperatorInput.enter

    def reversed_(self: OperatorInput, text: str, *, is_kept: bool, agent: str = "") -> str:
        self._readers.reverse()
        return enter(self, text, is_kept=is_kept, agent=agent)

    patch.setattr(OperatorInput, "enter", reversed_)


def a_line_from_the_page_is_kept(patch: Patch) -> None:
    """A line from the page answers a later question."""
    enter = OperatorInput.enter
    patch.setattr(OperatorInput, "enter", lambda self, text, **_: enter(self, text, is_kept=True))


def a_line_for_one_agent_is_given_to_another(patch: Patch) -> None:
    """A line from the page answers the question of another agent."""
    enter = OperatorInput.enter
    patch.setattr(
        OperatorInput, "enter", lambda self, text, *, is_kept, **_: enter(self, text, is_kept=is_kept)
    )


def lines_are_kept_without_limit(patch: Patch) -> None:
    """A pipe fills the memory of the host."""
    patch.setattr(operator_input, "MAX_KEPT", 1_000_000)


def a_long_line_is_not_shortened(patch: Patch) -> None:
    """A line is as long as the operator's input."""
    patch.setattr(operator_input, "MAX_LINE", 1_000_000)


def a_limit_ends_the_wait_of_the_first_thread(patch: Patch) -> None:
    """At the end of a limit the thread that has waited longest gets the exception."""

    def expire(self: OperatorInput, reader: _Reader) -> None:
        if self._readers:
            self._throw_expired(self._readers.pop(0))

    patch.setattr(OperatorInput, "_expire", expire)


def a_question_is_not_ended(patch: Patch) -> None:
    """Text that the thread has written before the prompt remains an unfinished line."""
    patch.setattr(Scheduler, "end_line", lambda self, agent, thread: None)


def read_in_init_is_no_pause(patch: Patch) -> None:
    """Portals wait while `init` reads."""
    read = OperatorInput._read

    def unopened(self: OperatorInput, agent: Agent, thread: int, operand: int, words: list[int]) -> None:
        opened, self._scheduler.open = self._scheduler.open, lambda agent: None  # type: ignore[method-assign]
        read(self, agent, thread, operand, words)
        self._scheduler.open = opened  # type: ignore[method-assign]

    patch.setattr(OperatorInput, "_read", unopened)


READ_BUGS: tuple[ReadBug, ...] = (
    the_latest_reader_gets_the_line,
    a_line_from_the_page_is_kept,
    a_line_for_one_agent_is_given_to_another,
    lines_are_kept_without_limit,
    a_long_line_is_not_shortened,
    a_limit_ends_the_wait_of_the_first_thread,
    a_question_is_not_ended,
    read_in_init_is_no_pause,
)
