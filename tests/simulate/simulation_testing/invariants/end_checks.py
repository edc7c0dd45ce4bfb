"""Checks that no terminated coordinator is recovered, from disks, messages and recoveries.

A termination (`init` has returned, or thrown) is final once a majority of the members has it on disk. A later
recovery is a breach, and so is a host on which that start still runs. A recovery is also a breach if a member
promised it that had the termination in its records, or in a message received in the same life. An operator's
recovery is judged by the information of its host: received messages, and terminations that have been final
for the time of a lease, because a host without a fresh lease executes no recovery.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Collection, Iterable
from typing import Any

from lfield.journal.records import CoordinatorRecord
from lfield.simulate.host_fleet import Fleet, HostRun
from lfield.wire.coordinator_messages import TERMINATED, CoordinatorState, Terminated
from lfield.wire.messages import Control, Hello
from lfield.wire.observer_messages import RecoverRequest, RecoverResponse
from lfield.wire.quorum_messages import Promise, Propose
from simulation_testing.invariants.breaches import Breaches
from simulation_testing.invariants.host_taps import tap_calls


def latest_start(starts: Collection[tuple[str, int]], agent: str, below: int) -> int:
    """The last start of an agent before number `below`, 0 for none."""
    return max((start for name, start in starts if name == agent and start < below), default=0)


class EndChecks:
    """The terminations of a team. `latest` gives the last start of an agent before a generation."""

    def __init__(
        self, breaches: Breaches, fleet: Callable[[], Fleet], latest: Callable[[str, int], int]
    ) -> None:
        self._breaches, self._fleet, self._latest = breaches, fleet, latest
        #: The newest start of each agent whose termination is final, and the time.
        self._final: dict[str, tuple[int, float]] = {}
        #: The newest terminated start of each agent of which each life has received a message.
        self._received: defaultdict[int, dict[str, int]] = defaultdict(dict)
        #: For each recovery and member: the newest termination that it knew when it was first asked.
        self._knew: dict[tuple[str, int], dict[str, int]] = {}
        #: The members that have promised each recovery.
        self._promised: defaultdict[tuple[str, int], set[str]] = defaultdict(set)

    def check(self) -> None:
        """Check the disks; several times a second, and whenever a coordinator is recovered."""
        fleet = self._fleet()
        members = fleet.mission.recovery.members
        found: defaultdict[str, dict[str, int]] = defaultdict(dict)
        for name, disk in fleet.disks.items():
            if name not in members:
                continue
            for page in disk.records():
                if (
                    isinstance(page, CoordinatorRecord)
                    and page.state == "EXITED"
                    and page.outcome in TERMINATED
                ):
                    of = found[page.agent]
                    of[name] = max(of.get(name, 0), page.generation)
        for agent, generations in found.items():
            ranked = sorted(generations.values(), reverse=True)
            needed = len(members) // 2
            final = ranked[needed] if len(ranked) > needed else 0
            if final > self._final.get(agent, (0, 0.0))[0]:
                self._final[agent] = final, fleet.now
        self._check_not_running(fleet)

    def _check_not_running(self, fleet: Fleet) -> None:
        """Check that a start whose termination is final runs on no host, including its own."""
        for name, life in fleet.runs.items():
            for agent in life.core.machine.agents.values():
                final, since = self._final.get(agent.id, (0, fleet.now))
                runs = not agent.frozen and not agent.ended and agent.id in fleet.mission.fenced
                if runs and agent.generation == final and since < fleet.now:
                    found = f"{agent.id} runs as start {final}, which has terminated for good"
                    self._breaches.add("terminated", (name,), found)

    def on_host_start(self, life: HostRun) -> None:
        """Observe the messages and recoveries of a new process of a host."""
        core, team = life.core, life.core.coordinators
        ordered: list[RecoverRequest] = []

        def on_message(go: Callable[..., None], host: str, message: Control) -> None:
            self._on_message(life, host, message)
            go(host, message)

        def on_linked(go: Callable[[Hello], None], hello: Hello) -> None:
            self._on_records(life, hello.coordinators)
            go(hello)

        def recover(go: Callable[[str, int], bool], agent: str, generation: int) -> bool:
            if agent in core.mission.fenced and self._fleet().options.keeps:
                self._on_recovery(life, agent, generation, by_operator=bool(ordered))
            return go(agent, generation)

        def by_operator(
            go: Callable[[RecoverRequest], RecoverResponse], word: RecoverRequest
        ) -> RecoverResponse:
            ordered.append(word)
            try:
                return go(word)
            finally:
                ordered.pop()

        for place, wire in ((core, on_message), (core, on_linked), (team, recover)):
            tap_calls(place, wire)
        by_operator.__name__ = "recover"
        tap_calls(core, by_operator)

    def _on_message(self, life: HostRun, host: str, message: Control) -> None:
        match message:
            case Terminated():
                self._on_ended(life, message)
            case Propose():
                knew = self._knew.setdefault((message.agent, message.generation), {})
                knew.setdefault(life.core.name, self._newest_known(life, message.agent))
            case Promise() if message.ended is None and message.fence == message.generation:
                self._promised[message.agent, message.generation].add(host)
        for ended in _ends_of(message):
            self._on_ended(life, ended)

    def _on_ended(self, life: HostRun, ended: Terminated) -> None:
        if ended.outcome in TERMINATED:
            known = self._received[life.core.incarnation]
            known[ended.agent] = max(known.get(ended.agent, 0), ended.generation)

    def _on_records(self, life: HostRun, records: Iterable[CoordinatorState]) -> None:
        for row in records:
            if row.state == "EXITED" and row.outcome:
                self._on_ended(life, Terminated(row.agent, row.generation, row.outcome, "", row.where))

    def _newest_known(self, life: HostRun, agent: str) -> int:
        rows = life.core.mobility.known_states()
        ended = (row.generation for row in rows if row.agent == agent and row.outcome in TERMINATED)
        return max([self._received[life.core.incarnation].get(agent, 0), *ended])

    def _on_recovery(self, life: HostRun, agent: str, generation: int, *, by_operator: bool) -> None:
        self.check()
        latest, host = self._latest(agent, generation), (life.core.name,)
        final, since = self._final.get(agent, (0, 0.0))
        known = self._fleet().mission.recovery.lease if by_operator else 0.0
        if final >= latest > 0 and self._fleet().now - since >= known:
            found = f"{agent} is recovered as start {generation}, and start {final} has terminated for good"
            self._breaches.add("terminated", host, found)
        start = agent, generation
        knew = {name for name in self._promised[start] if self._knew.get(start, {}).get(name, 0) >= latest}
        if self._newest_known(life, agent) >= latest:
            knew.add(life.core.name)
        if knew and latest > 0:
            names = ", ".join(sorted(knew))
            found = f"{agent} is recovered as start {generation}, and {names} knew that it has terminated"
            self._breaches.add("promised", host, found)


def _ends_of(message: Any) -> list[Terminated]:
    """The terminations in an answer of the quorum."""
    ended = getattr(message, "ended", None)
    return [ended] if isinstance(ended, Terminated) else list(ended or ())
