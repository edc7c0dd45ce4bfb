"""Who saw everything, in real time: no two copies act, and who is well is left alone."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from quorum_scenario import LEASE

if TYPE_CHECKING:
    from quorum_world import World

#: Whoever has held a lease for so many seconds without a break, while all hosts were up, is not barred.
WELL = 4.0 * LEASE


class Breach(AssertionError):
    """A promise is broken."""


@dataclass
class Action:
    """A portal call that moves something. It ends by itself, or when the time of its command is over."""

    host: str
    token: tuple[int, int]
    started: float
    end: float
    until: float

    def under_way(self, now: float) -> bool:
        """Whether something still moves."""
        return now < min(self.end, self.until)


class Judge:
    """What coordinators did. All times are real."""

    def __init__(self, world: World) -> None:
        self.world = world
        #: When a host was last killed, stopped or begun.
        self.disturbed = 0.0
        #: The last action of each coordinator on each host.
        self._actions: dict[str, dict[str, Action]] = {}
        #: When each coordinator last began an action.
        self.acted: dict[str, float] = {}
        self._minted: dict[str, int] = {}
        #: The newest start of each coordinator whose termination each host has on disk.
        self._ends: dict[str, dict[str, int]] = {}
        #: The newest start of each coordinator whose termination a majority of the members has on disk.
        self._final: dict[str, int] = {}
        self._recovered: dict[str, int] = {}
        #: For each promised recovery: the termination that each promising member knew.
        self._knew: dict[tuple[str, int], dict[str, int]] = {}
        self.counts = {"actions": 0, "hops": 0, "recoveries": 0, "bars": 0, "ends": 0}

    def breach(self, text: str) -> None:
        """Somebody broke a promise."""
        raise Breach(f"{self.world.now:.3f} s of story {self.world.story.seed}: {text}")

    def on_action_started(
        self, agent: str, host: str, token: tuple[int, int], end: float, until: float
    ) -> None:
        """A copy begins to act."""
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
        """What a coordinator does on a host now."""
        action = self._actions.get(agent, {}).get(host)
        return action if action and action.under_way(self.world.now) else None

    def stops(self, agent: str, host: str) -> None:
        """A copy acts no more."""
        if action := self.action(agent, host):
            action.end = self.world.now

    def barred(self, agent: str, generation: int, host: str) -> None:
        """A fence was raised on a host: was there a reason, when it was raised first?"""
        if generation <= self._minted.get(agent, 0):
            return
        self._minted[agent] = generation
        self.counts["bars"] += 1
        for computer in self.world.hosts.values():
            life = computer.life
            since = life.well(agent, generation) if life and not computer.frozen else None
            if since is not None and self.world.now - max(since, self.disturbed) > WELL:
                self.breach(f"{host} bars {agent}, which is well on {computer.name}, from {generation}")

    # --- terminations ---------------------------------------------------------------------------------

    def terminated(self, agent: str, generation: int, host: str) -> None:
        """A host has the termination of a start on disk."""
        ends = self._ends.setdefault(agent, {})
        ends[host] = max(generation, ends.get(host, 0))
        self.counts["ends"] += 1
        members = self.world.story.members
        ranked = sorted((ends.get(member, 0) for member in members), reverse=True)
        self._final[agent] = max(ranked[len(members) // 2], self._final.get(agent, 0))

    def has_terminated(self, agent: str) -> bool:
        """Whether the newest start that was ever made of it has terminated, as some disk has."""
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
