"""How a host comes to go on with a coordinator that nobody is heard to hold any more. Pure.

Appendix I of the thesis, made safe: whoever holds a shadow and has heard of nobody that holds the coordinator
for its interval asks every host. When a majority of the members has answered, and nobody has heard of it or
has a newer shadow, it has a majority promise that all earlier starts are barred, waits until no lease is left
that was given before, and goes on. Most suspicions are of hosts that are slow, not gone: they end with the
question. So do those of a host that is itself cut off: a fence of its own would bar whoever is well as soon
as its links are back.
"""

from __future__ import annotations

import random
from collections.abc import Collection
from dataclasses import dataclass, field
from typing import Literal

from lfield.quorum.effects import Bar, Copies, Effect, Explain, Saved, TakeOver, Tell
from lfield.quorum.members import Fences, Members
from lfield.quorum.terminations import VALID, Terminations
from lfield.wire.coordinators import Ended
from lfield.wire.quorum import Place, Promise, Propose, Seek, Sought

#: An attempt that finds no majority of promises is given up after so many leases, and made again later.
PATIENCE = 2.0


@dataclass(slots=True)
class Attempt:
    """One try to go on with an agent from `place`; it has something to do at `due`, and ends at `until`.

    Hosts that have not answered by `enough` are not waited for. The new start begins before `valid` or not at
    all: until then members that have promised it write no termination of an earlier start down.
    """

    place: Place
    phase: Literal["asking", "proposing", "waiting"]
    due: float
    enough: float
    until: float
    generation: int = 0
    valid: float = 0.0
    answered: set[str] = field(default_factory=set)
    promised: set[str] = field(default_factory=set)


class Recoveries:
    """The suspicions and attempts of one host. `hosts` are the others, `agents` those that this is about."""

    def __init__(
        self,
        members: Members,
        hosts: Collection[str],
        agents: Collection[str],
        copies: Copies,
        fences: Fences,
        dice: random.Random,
        terminations: Terminations,
    ) -> None:
        self._terminations = terminations
        self._members, self._hosts, self._copies, self._fences = members, hosts, copies, fences
        self._agents, self._dice = agents, dice
        self._attempts: dict[str, Attempt] = {}
        #: When it was last heard of, or known to be here.
        self._heard: dict[str, float] = {}
        #: Before that it is not suspected again: the last attempt has just failed.
        self._rest: dict[str, float] = {}
        #: When each agent is suspected that may be, unless it is heard of.
        self._suspected: dict[str, float] = {}
        #: What was said of each agent since it was last heard of, and when.
        self._said: dict[str, dict[str, float]] = {agent: {} for agent in agents}
        #: What is added to each interval.
        self._delays = {agent: self._delay() for agent in agents}

    def _delay(self) -> float:
        """Shadows with one interval must not all fire together."""
        return self._dice.uniform(0.0, self._members.beat / 2.0)

    @property
    def wanted(self) -> Collection[str]:
        """The hosts that are asked now."""
        return self._hosts if any(a.phase == "asking" for a in self._attempts.values()) else ()

    @property
    def due(self) -> float | None:
        """When `tick` has something to do next, as far as is known."""
        dues = [attempt.due for attempt in self._attempts.values()]
        suspected = [at for agent, at in self._suspected.items() if agent not in self._attempts]
        return min([*dues, *suspected], default=None)

    def claimed(self, agent: str) -> int:
        """The generation as which this host is about to go on with it; 0 when it is not."""
        attempt = self._attempts.get(agent)
        if attempt is None or attempt.generation != self._fences.of(agent):
            return 0
        return attempt.generation

    def heard(self, agent: str, generation: int, at: float) -> None:
        """Somebody was known then to hold a start of it that may run, or to be about to go on with it."""
        if agent in self._agents and not self._fences.bars(agent, generation):
            self._heard[agent] = max(at, self._heard.get(agent, at))
            self._rest.pop(agent, None)
            self._said[agent] = {text: when for text, when in self._said[agent].items() if when >= at}

    def doubt(self, now: float) -> None:
        """This host was itself stopped for a while: what it did not hear meanwhile means nothing."""
        for agent in self._agents:
            attempt = self._attempts.get(agent)
            if attempt is None or attempt.phase != "waiting":
                self._yield(agent, now)

    def tick(self, now: float) -> list[Effect]:
        """Time has passed."""
        return [effect for agent in self._agents for effect in self._look(agent, now)]

    def _is_alive(self, agent: str, saved: Saved) -> bool:
        return saved.alive and not self._fences.bars(agent, saved.place.generation)

    def _calm(self, agent: str, now: float) -> None:
        self._heard[agent] = now
        self._said[agent].clear()
        for known in (self._rest, self._suspected, self._attempts):
            known.pop(agent, None)

    def _look(self, agent: str, now: float) -> list[Effect]:
        saved = self._copies.saved(agent)
        if (
            saved is None
            or not saved.interval
            or self._is_alive(agent, saved)
            or self._terminations.covers(agent, saved.place.generation)
        ):
            self._calm(agent, now)
            return []
        at = self._suspected[agent] = self._suspect_at(agent, saved, now)
        attempt = self._attempts.get(agent)
        if attempt is None:
            return self._suspect(agent, saved, now) if now >= at else []
        if attempt.place != saved.place:
            return self._yield(agent, now)
        if now < at:
            return self._end(agent)
        return self._go_on(agent, attempt, now)

    def _suspect_at(self, agent: str, saved: Saved, now: float) -> float:
        # While whoever was heard of last may still have a lease, there is no reason.
        silence = max(saved.interval, self._members.wait)
        heard = self._heard.setdefault(agent, now)
        return max(heard + silence, self._rest.get(agent, heard)) + self._delays[agent]

    def _go_on(self, agent: str, attempt: Attempt, now: float) -> list[Effect]:
        match attempt.phase:
            case "asking" if self._has_heard_enough(attempt, now):
                return self._propose(agent, attempt, now)
            case "asking" | "proposing" if now >= attempt.until:
                return self._rest_from(agent, now)
            case "asking" if now >= attempt.due:
                return self._ask(agent, attempt, now)
            case "proposing" if now >= attempt.due:
                return self._repeat(agent, attempt, now)
            case "waiting" if now >= attempt.due:
                return self._take_over(agent, attempt, now)
        return []

    def _suspect(self, agent: str, saved: Saved, now: float) -> list[Effect]:
        attempt = Attempt(saved.place, "asking", now, now + self._members.beat, now + self._members.lease)
        self._attempts[agent] = attempt
        asked = self._ask(agent, attempt, now)
        text = f"nobody was heard to hold {agent} for {saved.interval:g} s: asking every host"
        return [*self._explain(agent, text, now), *asked]

    def _explain(self, agent: str, text: str, now: float) -> list[Effect]:
        """Once, until it is heard of."""
        if text in self._said[agent]:
            return []
        self._said[agent][text] = now
        return [Explain(text)]

    def _ask(self, agent: str, attempt: Attempt, now: float) -> list[Effect]:
        attempt.due = now + self._members.beat / 2.0
        return [Tell(host, Seek(agent)) for host in self._hosts if host not in attempt.answered]

    def _has_heard_enough(self, attempt: Attempt, now: float) -> bool:
        answered = {self._members.here, *attempt.answered}
        all_said = now >= attempt.enough or answered.issuperset(self._hosts)
        return all_said and self._members.is_majority(answered)

    # --- answers --------------------------------------------------------------------------------------

    def sought(self, host: str, answer: Sought, now: float) -> list[Effect]:
        """A host says what it knows of it."""
        if answer.holder:
            self.heard(answer.agent, answer.generation, now - answer.age)
        attempt = self._attempts.get(answer.agent)
        if attempt is None:
            return []
        if _newer(answer.place, attempt.place):
            text = f"{host} has a newer copy of {answer.agent}"
            return [*self._explain(answer.agent, text, now), *self._yield(answer.agent, now)]
        attempt.answered.add(host)
        return self._look(answer.agent, now)

    def terminated(self, ended: Ended, now: float) -> list[Effect]:
        """A host knows that the coordinator has terminated: no block from before that goes on."""
        attempt = self._attempts.get(ended.agent)
        if attempt is None or ended.generation < attempt.place.generation:
            return []
        return self._yield(ended.agent, now)

    def promised(self, host: str, answer: Promise, now: float) -> list[Effect]:
        """A member has promised, or tells of a later fence."""
        agent = answer.agent
        attempt = self._attempts.get(agent)
        if attempt is None or attempt.phase == "asking" or attempt.generation != answer.generation:
            return []
        if answer.fence > answer.generation or _newer(answer.place, attempt.place):
            return self._yield(agent, now)
        if attempt.phase == "proposing":
            attempt.promised.add(host)
            if self._members.is_majority(attempt.promised):
                attempt.phase, attempt.due = "waiting", now + self._members.wait
        return []

    # --- steps ----------------------------------------------------------------------------------------

    def _propose(self, agent: str, attempt: Attempt, now: float) -> list[Effect]:
        attempt.phase, attempt.until = "proposing", now + PATIENCE * self._members.lease
        attempt.valid = now + VALID * self._members.lease
        attempt.generation = self._copies.mint(agent, self._fences.of(agent))
        self._fences.raise_to(agent, attempt.generation)
        reason = f"{self._members.here} is about to go on with it"
        if self._members.counts_itself:
            # What is said to others waits until this fence is on disk: a promise as good as theirs.
            attempt.promised.add(self._members.here)
        if self._members.is_majority(attempt.promised):
            attempt.phase, attempt.due = "waiting", now + self._members.wait
        bar = Bar(agent, attempt.generation, reason)
        return [bar, *(self._repeat(agent, attempt, now) if attempt.phase == "proposing" else [])]

    def _repeat(self, agent: str, attempt: Attempt, now: float) -> list[Effect]:
        attempt.due = now + self._members.beat
        silent = (host for host in self._members.others if host not in attempt.promised)
        start = attempt.place.generation
        return [Tell(host, Propose(agent, attempt.generation, start)) for host in silent]

    def _take_over(self, agent: str, attempt: Attempt, now: float) -> list[Effect]:
        self._yield(agent, now)
        if self._fences.of(agent) != attempt.generation or now >= attempt.valid:
            return []
        told = f"no other host has gone on with {agent}, and {len(attempt.promised)} of the "
        told += f"{len(self._members.names)} members have barred every earlier start of it"
        return [TakeOver(agent, attempt.generation, told)]

    def _yield(self, agent: str, now: float) -> list[Effect]:
        """Somebody else is better off: look again after the interval."""
        self._heard[agent] = now
        self._rest.pop(agent, None)
        return self._end(agent)

    def _rest_from(self, agent: str, now: float) -> list[Effect]:
        """There is no majority: try again in a while."""
        told = self._explain(agent, f"{agent} waits: no majority of the members answers", now)
        self._rest[agent] = now + self._members.lease
        return [*told, *self._end(agent)]

    def _end(self, agent: str) -> list[Effect]:
        self._attempts.pop(agent, None)
        self._suspected.pop(agent, None)
        self._delays[agent] = self._delay()
        return []


def _newer(theirs: Place | None, own: Place) -> bool:
    return theirs is not None and theirs.order > own.order
