"""Barrier before portal calls: a coordinator waits until the `init` of a resource reaches its first pause.

Sans-IO. A portal call cannot start before that. The wait is usually short; an `init` that homes an axis takes
a minute, and an `init` with an endless computation never reaches a pause.

`lfield ps` therefore shows the wait as the state of the coordinator, and the log has one line for each wait
that is longer than `REPORT_AFTER`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

from lfield.host.context import Part
from lfield.text import log_messages
from lfield.text.log_messages import LogLine
from lfield.vm.agent import Agent

#: A longer wait, in seconds, is logged.
REPORT_AFTER = 1.0


class InitBarrier(Part):
    """The coordinators that wait for an init on one host, while some `agents` have not reached their first
    pause.

    `log` receives one line for each wait. The host calls `on_tick` after each turn while there are such
    agents (`is_polled`).
    """

    def __init__(self, agents: Mapping[str, Agent], log: Callable[[LogLine], None]) -> None:
        self._agents, self._log = agents, log
        #: The time when each wait was first noticed, by coordinator and resource; the waits that were logged.
        self._since: dict[tuple[str, str], float] = {}
        self._reported: set[tuple[str, str]] = set()

    def wait_reason(self, coordinator: Agent) -> str:
        """A short text about the init that a coordinator waits for; '' if it waits for none."""
        found = (resource for caller, resource in self._waiting_pairs() if caller == coordinator.id)
        return next((f"waits for the init of {resource}" for resource in found), "")

    def on_tick(self, now: float) -> None:
        """Update the waits, and log long ones."""
        self._since = {wait: self._since.get(wait, now) for wait in self._waiting_pairs()}
        self._reported &= self._since.keys()
        for wait, since in self._since.items():
            if now - since >= REPORT_AFTER and wait not in self._reported:
                self._reported.add(wait)
                caller, resource = wait
                self._log(log_messages.INIT_WAIT.line(agent=caller, resource=resource))
        self.is_polled = bool(self._since)
        unreported = [since for wait, since in self._since.items() if wait not in self._reported]
        self.due = min(unreported) + REPORT_AFTER if unreported else None

    def _waiting_pairs(self) -> list[tuple[str, str]]:
        return [
            (caller.id, resource.id)
            for resource in self._agents.values()
            for caller, thread in resource.waiting
            if not (caller.ended or resource.is_own_loop(caller, thread))
        ]
