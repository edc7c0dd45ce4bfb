"""What the resources of this host tell of themselves by their portals, each asked at its rate.

A question that is not answered yet is not asked again. What a portal throws makes its value unknown, until it
gives one again; what it gave last grows old meanwhile, as any value does.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Protocol

from lfield.capability.model import Live
from lfield.clock import Clock
from lfield.manifest import DeviceValue, Observation
from lfield.vm.agent import Agent
from lfield.vm.asking.questions import Questions


class Machine(Protocol):
    """The agents here, and a way to ask them."""

    @property
    def agents(self) -> Mapping[str, Agent]:
        """By id."""

    @property
    def questions(self) -> Questions:
        """What asks them."""


@dataclass(slots=True)
class _Question:
    """A portal of an agent: when it was asked, whether it is being answered, and what it said last."""

    asked: float
    open: bool = True
    said: Observation | str | None = None


class Asking:
    """Asks, and knows what was answered."""

    def __init__(self, machine: Machine, clock: Clock) -> None:
        self._machine, self._clock = machine, clock
        self._questions: dict[tuple[str, str], _Question] = {}

    def last(self, agent: str, portal: str) -> Observation | str | None:
        """What the portal has given last, as old as its question; or why nothing; None for no answer yet."""
        question = self._questions.get((agent, portal))
        return None if question is None else question.said

    def look(self, agent: str, live: Iterable[Live]) -> None:
        """Ask an agent of this host what is due."""
        running = self._machine.agents.get(agent)
        if running is None or running.ended or not running.open:
            return
        for source in live:
            if source.portal and self._is_due(agent, source):
                self._ask(running, source.portal)

    def _is_due(self, agent: str, source: Live) -> bool:
        question = self._questions.get((agent, source.portal))
        if question is None:
            return True
        return not question.open and self._clock.monotonic() - question.asked >= source.every

    def _ask(self, agent: Agent, portal: str) -> None:
        before = self._questions.get((agent.id, portal))
        now = self._clock.monotonic()
        question = self._questions[agent.id, portal] = _Question(now, said=before.said if before else None)

        def told(value: DeviceValue, why: str) -> None:
            question.open, question.said = False, why or Observation(value, question.asked)

        self._machine.questions.ask(agent, portal, told)
