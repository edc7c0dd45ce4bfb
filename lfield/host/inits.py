"""Coordinators that wait for a resource whose `init` has not come to its first pause (decision 6).

A portal begins after that. Mostly it is a moment; an `init` that homes an axis takes a minute, and one that
computes for ever never ends. Whoever looks at the team is told what is waited for.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

from lfield.vm.agent import Agent

#: After so many seconds the log tells it.
PATIENCE = 1.0


class Inits:
    """Who waits for the init of whom, on one host, as far as `agents` have not come to their first pauses.

    `say` is given a line of the log, once for each wait.
    """

    def __init__(self, agents: Mapping[str, Agent], say: Callable[[str], None]) -> None:
        self._agents, self._say = agents, say
        #: When each wait was seen first, by coordinator and resource, and which of them were told.
        self._since: dict[tuple[str, str], float] = {}
        self._told: set[tuple[str, str]] = set()

    @property
    def due(self) -> float | None:
        """When to look again at the latest; None while there is nothing to tell."""
        if not self._since:
            return None
        untold = [since for wait, since in self._since.items() if wait not in self._told]
        return min(untold) + PATIENCE if untold else None

    def waits(self, coordinator: Agent) -> str:
        """What a coordinator waits for, in a few words; '' when it is for no init."""
        found = (resource for caller, resource in self._waits() if caller == coordinator.id)
        return next((f"waits for the init of {resource}" for resource in found), "")

    def look(self, now: float) -> None:
        """Note who waits; tell those that have waited for long. To be called after every turn."""
        if not self._agents and not self._since:
            return
        self._since = {wait: self._since.get(wait, now) for wait in self._waits()}
        self._told &= self._since.keys()
        for wait, since in self._since.items():
            if now - since >= PATIENCE and wait not in self._told:
                self._told.add(wait)
                caller, resource = wait
                self._say(f"{caller} waits for {resource}, whose init has not come to its first pause")

    def _waits(self) -> list[tuple[str, str]]:
        return [
            (caller.id, resource.id)
            for resource in self._agents.values()
            for caller, _ in resource.waiting
            if not caller.ended
        ]
