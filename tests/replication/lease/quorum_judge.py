"""The judge of all hosts in real time: no two copies act, and a healthy holder is not fenced."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from quorum_scenario import LEASE

if TYPE_CHECKING:
    from quorum_world import World

#: Seconds of a lease, with all hosts up, after which a start must not be fenced.
WELL = 4.0 * LEASE


class Breach(AssertionError):
    """A violated promise."""


@dataclass
class Action:
    """A portal call that moves a device until its end, or until its command expires."""

    host: str
    token: tuple[int, int]
    started: float
    end: float
    until: float

    def under_way(self, now: float) -> bool:
        """Whether the device still moves."""
        return now < min(self.end, self.until)


class Judge:
    """The actions of coordinators. All times are real."""

    def __init__(self, world: World) -> None:
        self.world = world
        #: When a host was last killed, stopped or started.
        self.disturbed = 0.0
        #: The last action of each coordinator on each host.
        self._actions: dict[str, dict[str, Action]] = {}
        #: When each coordinator last began an action.
        self.acted: dict[str, float] = {}
        self._minted: dict[str, int] = {}
        #: The newest start of each coordinator whose termination is durable on each host.
        self._ends: dict[str, dict[str, int]] = {}
        #: The newest start of each coordinator whose termination is durable on a majority of the members.
        self._final: dict[str, int] = {}
        self._recovered: dict[str, int] = {}
        #: For each promised recovery: the termination that each promising member knew.
        self._knew: dict[tuple[str, int], dict[str, int]] = {}
        self.counts = {"actions": 0, "hops": 0, "recoveries": 0, "bars": 0, "ends": 0}

    def breach(self, text: str) -> None:
        """Report a violated promise."""
        raise Breach(f"{self.world.now:.3f} s of scenario {self.world.scenario.seed}: {text}")

    def on_action_started(
        self, agent: str, host: str, token: tuple[int, int], end: float, until: float
    ) -> None:
        """Check a copy that begins to act."""
        now, actions = self.world.now, self._actions.setdefault(agent, {})
        if token[0] <= self._final.get(agent, 0):
            self.breach(f"{agent} {token} acts on {host} after its termination was final")
        for other in actions.values():
            if other.host != host and other.under_way(now):
                self.breach(f"{agent} {token} acts on {host} while {other.token} acts on {other.host}")
            if other.token > token or (other.token == token and other.host != host):
                self.breach(f"{agent} {token} acts on {host} after {other.token} has acted on {other.host}")
        actions[host] = Action(host, token, now, end, until)
        self.acted[agent] = now
        self.counts["actions"] += 1

    def action(self, agent: str, host: str) -> Action | None:
        """The present action of a coordinator on a host."""
        action = self._actions.get(agent, {}).get(host)
        return action if action and action.under_way(self.world.now) else None

    def stops(self, agent: str, host: str) -> None:
        """A copy stops acting."""
        if action := self.action(agent, host):
            action.end = self.world.now

    def barred(self, agent: str, generation: int, host: str) -> None:
        """Check a fence that is raised for the first time: there must be a reason."""
        if generation <= self._minted.get(agent, 0):
            return
        self._minted[agent] = generation
        self.counts["bars"] += 1
        for computer in self.world.hosts.values():
            life = computer.life
            since = life.healthy_since(agent, generation) if life and not computer.frozen else None
            if since is not None and self.world.now - max(since, self.disturbed) > WELL:
                self.breach(f"{host} bars {agent}, which is healthy on {computer.name}, from {generation}")

    # --- terminations ---------------------------------------------------------------------------------

    def terminated(self, agent: str, generation: int, host: str) -> None:
        """A termination of a start is durable on a host."""
        ends = self._ends.setdefault(agent, {})
        ends[host] = max(generation, ends.get(host, 0))
        self.counts["ends"] += 1
        members = self.world.scenario.members
        ranked = sorted((ends.get(member, 0) for member in members), reverse=True)
        self._final[agent] = max(ranked[len(members) // 2], self._final.get(agent, 0))

    def has_terminated(self, agent: str) -> bool:
        """Whether the newest start has terminated, according to any disk."""
        newest = max(self._ends.get(agent, {}).values(), default=0)
        return newest > 0 and newest >= self._recovered.get(agent, 0)

    def promises(self, agent: str, generation: int, host: str, knew: int) -> None:
        """A member promises a recovery; it knew then that start `knew` has terminated, 0 for none."""
        self._knew.setdefault((agent, generation), {}).setdefault(host, knew)

    def recovers(self, agent: str, source: int, generation: int, knew: dict[str, int]) -> None:
        """A host recovers a coordinator from a block of start `source`; it knew of these terminations."""
        self.counts["recoveries"] += 1
        self._recovered[agent] = max(generation, self._recovered.get(agent, 0))
        if source <= self._final.get(agent, 0):
            self.breach(f"{agent} is recovered as {generation} after its termination was final")
        for host, known in {**self._knew.get((agent, generation), {}), **knew}.items():
            if source <= known:
                self.breach(f"{agent} is recovered as {generation}, and {host} knew of its termination")
