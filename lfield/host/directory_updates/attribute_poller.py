"""Polls the attribute portals of this host's resources, each at its rate.

A portal that has not answered yet is not called again. An exception makes its value unknown until the next
result; the last result keeps its age, as any value does.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import partial
from typing import Protocol

from msgspec import Struct

from lfield.capability.model import LiveAttribute
from lfield.clock import Clock
from lfield.manifest import DeviceValue, Observation
from lfield.vm.agent import Agent
from lfield.vm.host_queries.resource_queries import ResourceQueries


class PolledMachine(Protocol):
    """The agents here, and access to their portals."""

    @property
    def agents(self) -> Mapping[str, Agent]:
        """The agents by id."""

    @property
    def resource_queries(self) -> ResourceQueries:
        """Calls their portals."""


class _Poll(Struct):
    """A polled portal of an agent: the time of the last call, whether this call is under way, and the last
    result.
    """

    asked_at: float
    is_open: bool = True
    result: Observation | str | None = None


class AttributePoller:
    """Calls the portals that are due, and stores the results."""

    def __init__(self, machine: PolledMachine, clock: Clock) -> None:
        self._machine, self._clock = machine, clock
        self._polls: dict[tuple[str, str], _Poll] = {}

    def last(self, agent: str, portal: str) -> Observation | str | None:
        """The last result of the portal, with the age of its call; or the reason for a failure; None before
        the first.
        """
        question = self._polls.get((agent, portal))
        return None if question is None else question.result

    def poll(self, agent: str, live: Iterable[LiveAttribute]) -> None:
        """Call the portals of an agent that are due."""
        running = self._machine.agents.get(agent)
        if running is None or running.ended or not running.open:
            return
        for source in live:
            if source.portal and self._is_due(agent, source):
                self._poll_portal(running, source.portal)

    def _is_due(self, agent: str, source: LiveAttribute) -> bool:
        question = self._polls.get((agent, source.portal))
        if question is None:
            return True
        return not question.is_open and self._clock.monotonic() - question.asked_at >= source.every

    def _poll_portal(self, agent: Agent, portal: str) -> None:
        before = self._polls.get((agent.id, portal))
        now = self._clock.monotonic()
        question = self._polls[agent.id, portal] = _Poll(now, result=before.result if before else None)
        self._machine.resource_queries.call_portal(agent, portal, partial(self._on_result, question))

    def _on_result(self, question: _Poll, value: DeviceValue, reason: str) -> None:
        question.is_open, question.result = False, reason or Observation(value, question.asked_at)
