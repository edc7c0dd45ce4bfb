"""Checks the output of programs: no call starts twice, is skipped silently, or serves an old copy.

A coordinator keeps its *life* (a name and a drawn number) when it is recovered on another host. Then its
calls are counted again from that point: its later actions are lost.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass

from lfield.replication.transfer.generations import is_recovery
from lfield.simulate.host_fleet import HostRun
from lfield.vm.agent import Agent
from lfield.vm.memory.layout import THREAD_ID
from lfield.vm.memory.threads import threads
from simulation_testing.invariants.breaches import Breaches


@dataclass(slots=True, eq=False)
class _Call:
    """One call: the number of its starts, and the report of its caller."""

    starts: int = 0
    outcome: str = ""


class CallChecks:
    """The calls of all coordinators. `newest` gives the newest start of an agent that has continued."""

    def __init__(self, breaches: Breaches, newest: Callable[[str], int]) -> None:
        self._breaches, self._newest = breaches, newest
        #: The number of calls that began, and of walkers that were informed of a recovery or restart.
        self.started = self.restarts = 0
        #: The number of ended calls of each agent since the end of the faults.
        self.ended: defaultdict[str, int] = defaultdict(int)
        #: True after a time without faults in which every host must be reached.
        self.settled = False
        #: The agents that have finished.
        self.over: set[str] = set()
        #: The lives of each agent, and the start of each life.
        self._lives: defaultdict[str, set[str]] = defaultdict(set)
        self._at: defaultdict[str, int] = defaultdict(int)
        self._calls: dict[str, dict[int, _Call]] = defaultdict(dict)
        self._served: dict[tuple[str, str], tuple[int, int]] = {}
        #: The start for which a call began last, by the drawn number of its life and its number.
        self._started_for: dict[tuple[float, float], tuple[str, int]] = {}

    def on_output(self, life: HostRun, agent: Agent, text: str) -> None:
        """Handle the output of a program: a word, a life of a coordinator, the number of a call."""
        host = life.core.name
        for line in text.splitlines():
            word, caller, *more = line.split()
            if word == "begin":
                self._on_start(life, agent, caller, int(more[0]))
            elif word == "end" or self._is_old(agent, caller):
                continue
            elif word == "over":
                self.over.add(agent.id)
            elif word == "born":
                self._lives[agent.id].add(caller)
            elif word == "restarted":
                self._restarted(host, agent, caller, int(more[0]), " ".join(more))
            else:
                self._on_outcome(host, agent, caller, int(more[0]), word)

    def has_any(self, agent: str, generation: int) -> bool:
        """Whether a start of an agent has begun a call."""
        lives = (life for life in self._lives[agent] if self._at[life] == generation)
        return any(call.starts for life in lives for call in self._calls[life].values())

    def on_resumed_from_disk(self, agent: str) -> None:
        """A coordinator continues from a disk; the failures of calls that were reported to it may be lost."""
        for life in self._lives[agent]:
            for call in self._calls[life].values():
                if call.outcome == "failed":
                    call.outcome = "forgotten"

    def caller_of(self, arguments: tuple[object, ...]) -> tuple[str, int]:
        """The agent and start for which a device was commanded, from the arguments; '' if unknown."""
        drawn, number = arguments[:2]
        assert isinstance(drawn, float)
        assert isinstance(number, float)
        return self._started_for.get((drawn, number), ("", 0))

    # --- output of callers ----------------------------------------------------------------------------

    def _is_old(self, agent: Agent, who: str) -> bool:
        """True if this copy has a successor; its output between calls has no effect on other hosts."""
        return agent.generation < self._at[who]

    def _observe_start(self, who: str, generation: int, number: int) -> None:
        """Record that a start continues with this call. A recovery has no record of later calls.

        The recovery has no record of this call either if it continued before it: then the exception was about
        a call that only queries.
        """
        if generation > self._at[who]:
            if is_recovery(generation):
                self._calls[who] = {n: call for n, call in self._calls[who].items() if n < number}
            self._at[who] = generation

    def _on_outcome(self, host: str, agent: Agent, who: str, number: int, outcome: str) -> None:
        self._observe_start(who, agent.generation, number)
        call = self._calls[who].setdefault(number, _Call())
        self.ended[agent.id] += 1
        call.outcome = outcome
        if outcome == "done" and call.starts != 1:
            found = f"call {number} of {who} is done, and it began {call.starts} times"
            self._breaches.add("I4", (host,), found)
        if outcome == "failed" and self.settled:
            self._breaches.add("reach", (host,), f"call {number} of {who} could not be made, and all is well")
        if outcome == "failed" and call.starts:
            self._breaches.add("I4", (host,), f"call {number} of {who} could not be made, and it has begun")

    def _restarted(self, host: str, agent: Agent, who: str, number: int, text: str) -> None:
        """Record a call that may have started, or has not; later calls had not started, and are dropped."""
        self.restarts += 1
        self._observe_start(who, agent.generation, number)
        calls = self._calls[who]
        later = sorted(n for n in calls if n > number)
        for begun in (n for n in later if calls[n].starts):
            found = f"{who} went back to call {number}, and call {begun} had begun"
            self._breaches.add("I4", (host,), found)
        for n in later:
            del calls[n]
        self._on_outcome(host, agent, who, number, "failed" if "has not begun" in text else "threw")

    # --- output of resources --------------------------------------------------------------------------

    def _on_start(self, life: HostRun, resource: Agent, who: str, number: int) -> None:
        self.started += 1
        name = who.partition(".")[0]
        generation, host = _caller(life, resource, name), (life.core.name,)
        if generation < self._newest(name):
            found = f"call {number} of {who} began for start {generation}; {self._newest(name)} had gone on"
            self._breaches.add("I1", host, found)
            return
        self._observe_start(who, generation, number)
        call = self._calls[who].setdefault(number, _Call())
        call.starts += 1
        self._started_for[float(who.partition(".")[2]), float(number)] = name, generation
        if call.starts > 1:
            self._breaches.add("I4", host, f"call {number} of {who} began again, on {resource.id}")
        if call.outcome == "failed":
            self._breaches.add("I4", host, f"call {number} of {who} began after it could not be made")
        before = self._calls[who].get(number - 1)
        if number > 1 and (before is None or not before.outcome):
            found = f"call {number} of {who} began, and call {number - 1} has no end"
            self._breaches.add("I4", host, found)
        newest = self._served.get((resource.id, who), (0, 0))
        if (generation, number) < newest:
            found = f"{resource.id} served call {number} of {who} after call {newest[1]}"
            self._breaches.add("I3", host, found)
        self._served[resource.id, who] = max(newest, (generation, number))


def _caller(life: HostRun, resource: Agent, name: str) -> int:
    """The start of this agent whose call a resource serves: the latest one that has arrived there."""
    block = resource.block
    calls = life.core.machine.served_calls
    callers = (calls.caller(resource, block.w[place + THREAD_ID]) for place in threads(block))
    return next((caller.generation for caller in callers if caller and caller.id == name), 0)
