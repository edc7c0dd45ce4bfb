"""Who saw everything, in real time: no two copies act, and who is well is left alone."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from quorum_story import LEASE

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
    begun: float
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
        self.counts = {"actions": 0, "hops": 0, "recoveries": 0, "bars": 0}

    def breach(self, text: str) -> None:
        """Somebody broke a promise."""
        raise Breach(f"{self.world.now:.3f} s of story {self.world.story.seed}: {text}")

    def begins(self, agent: str, host: str, token: tuple[int, int], end: float, until: float) -> None:
        """A copy begins to act."""
        now, actions = self.world.now, self._actions.setdefault(agent, {})
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
