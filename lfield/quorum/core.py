"""One host's part in leases, fences and recovery: events in, effects out. Pure.

Why of one coordinator never two copies act: a majority that gave a lease and a majority that gave a promise
have a member in common. If it acknowledged a heartbeat after it promised, that answer carried the fence; if
before, the heartbeat was sent before the promise, and that part of the lease is over a lease after it. Who
goes on waits longer than that. durability section 4; decision 45 has what differs from it.
"""

from __future__ import annotations

import random
from collections.abc import Collection, Mapping

from lfield.quorum.effects import Bar, Copies, Effect, Tell, Terminate
from lfield.quorum.lease import Lease
from lfield.quorum.members import Fences, Members
from lfield.quorum.recovery import Recoveries
from lfield.quorum.terminations import Terminations
from lfield.wire.coordinators import TERMINAL, Ended
from lfield.wire.fields import age
from lfield.wire.quorum import (
    MOST,
    Ack,
    Heartbeat,
    Held,
    Place,
    Promise,
    Propose,
    QuorumMessage,
    Seek,
    Sought,
)


class Quorum:
    """The leases and fences of one host; `life` is its incarnation.

    `hosts` are the others of the team, `agents` the coordinators that run under leases, `fences` what the
    journal has kept. With a `new` journal it may have promised what it does not remember. Times are in
    seconds on the host's own clock.
    """

    def __init__(
        self,
        members: Members,
        hosts: Collection[str],
        agents: Collection[str],
        life: int,
        copies: Copies,
        fences: Mapping[str, int],
        dice: random.Random,
        *,
        new: bool = False,
    ) -> None:
        self.members, self._agents, self._life, self._copies = members, frozenset(agents), life, copies
        self.fences = Fences({agent: fence for agent, fence in fences.items() if agent in self._agents})
        self.lease = Lease(members)
        self.terminations = Terminations(members, self._agents, copies, self.fences)
        self._recoveries = Recoveries(
            members, sorted(hosts), sorted(agents), copies, self.fences, dice, self.terminations
        )
        #: Who was last heard to hold each agent, or was promised it: the host, the generation, and when.
        self._holders: dict[str, tuple[str, int, float]] = {}
        self._next: float | None = None
        #: The members that must tell of their fences before this one gives a lease or a promise.
        self._unheard = set(members.others) if new else set()
        self._needed = False
        self._recall()

    # --- time -----------------------------------------------------------------------------------------

    def begin(self, now: float, *, first: bool = False) -> None:
        """This host takes part from now on; until then it has only answered.

        `first`: somebody says that it has never promised anything.
        """
        self._next = now
        if first:
            self._unheard.clear()
            self._recall()

    @property
    def remembers(self) -> bool:
        """Whether this host knows all that it may ever have promised."""
        return self.members.remembers

    @property
    def unheard(self) -> list[str]:
        """The members that must tell of their fences before this host counts."""
        return sorted(self._unheard)

    def _recall(self) -> None:
        """With the fences of all other members it knows what it has promised."""
        self.members.remembers = not self._unheard

    @property
    def due(self) -> float | None:
        """When `tick` has something to do next; None before `begin`."""
        if self._next is None:
            return None
        other = self._recoveries.due
        return self._next if other is None else min(self._next, other)

    @property
    def wanted(self) -> set[str]:
        """The hosts that links are needed with now."""
        return {*self.members.others, *self._recoveries.wanted}

    def tick(self, now: float) -> list[Effect]:
        """Time has passed."""
        if self._next is None:
            return []
        self._notice(now)
        effects = [*self.terminations.tick(now), *self._beat(now)] if now >= self._next else []
        return effects + self._recoveries.tick(now)

    def hurry(self, now: float) -> None:
        """A coordinator waits for the lease: ask for it now, unless that was done a moment ago.

        It may not have begun yet, at a home that is no member: that is asked for until the lease is there.
        """
        self._needed = not self.lease.holds(now)
        asked = self.lease.holds(now) or self.lease.is_asked(now - self.members.beat)
        if self._next is not None and not asked:
            self._next = min(self._next, now)

    def _notice(self, now: float) -> None:
        """A slow host, or one that was stopped, doubts itself before it doubts others."""
        if self._next is not None and now > self._next + self.members.beat:
            self._recoveries.doubt(now)

    def _beat(self, now: float) -> list[Effect]:
        self._next = now + self.members.beat
        held = self._held()
        self._needed = self._needed and not self.lease.holds(now)
        if not (held or self._needed or self._is_member):
            return []
        # Who holds no lease cannot act, however well it is heard: others may have to go on.
        told = held if self.lease.holds(now) else []
        beat = Heartbeat(self._life, self.lease.beat(now), self.terminations.digest, told)
        return [Tell(host, beat) for host in self.members.others]

    @property
    def _is_member(self) -> bool:
        return self.members.here in self.members.names

    def _held(self) -> list[Held]:
        found = ((agent, self._alive(agent)) for agent in sorted(self._agents))
        held = [Held(agent, place.generation, place.sequence) for agent, place in found if place is not None]
        return held[:MOST]

    def _alive(self, agent: str) -> Place | None:
        """How far an agent has come that is here and not barred.

        One that has terminated here counts until that is final: nobody may recover it meanwhile.
        """
        saved = self._copies.saved(agent)
        if saved is None or self.barred(agent, saved.place.generation):
            return None
        return saved.place if saved.alive or not saved.final else None

    # --- what coordinators may do ---------------------------------------------------------------------

    def barred(self, agent: str, generation: int) -> bool:
        """Whether this start may not run any more, wherever it is."""
        return self.fences.bars(agent, generation)

    def may_act(self, agent: str, generation: int, now: float) -> bool:
        """Whether a coordinator that is here may begin a portal call now."""
        return self.lease.holds(now) and not self.barred(agent, generation)

    # --- messages -------------------------------------------------------------------------------------

    def receive(self, host: str, message: QuorumMessage, now: float) -> list[Effect]:
        """A host asks, answers or tells that it lives."""
        self._notice(now)
        match message:
            case Heartbeat():
                return self._on_heartbeat(host, message, now)
            case Ack():
                return self._on_ack(host, message, now)
            case Seek():
                return [Tell(host, self._sought(message.agent, now))]
            case Sought():
                ends = self._on_termination(host, message.agent, message.ended, now)
                return [*ends, *self._recoveries.sought(host, message, now)]
            case Propose():
                return self._on_propose(host, message, now)
            case Promise():
                return self._on_promise(host, message, now)

    def _on_heartbeat(self, host: str, message: Heartbeat, now: float) -> list[Effect]:
        for held in message.held:
            self._heard(host, held.agent, held.generation, now)
        known = message.fences == self.terminations.digest
        fences, ended = ([], []) if known else (self.fences.all, self.terminations.all)
        # Number 0 is of no heartbeat: it tells the fences, and gives no lease.
        number = message.number if self.remembers else 0
        # A part of them would be no better than none: no lease is given then.
        whole = len(fences) <= MOST and len(ended) <= MOST
        return [Tell(host, Ack(message.life, number, fences, ended))] if whole else []

    def _heard(self, host: str, agent: str, generation: int, now: float) -> None:
        """A host holds an agent, or is about to."""
        if agent in self._agents and not self.barred(agent, generation):
            self._holders[agent] = host, generation, now
            self._recoveries.heard(agent, generation, now)

    def _on_ack(self, host: str, message: Ack, now: float) -> list[Effect]:
        """The lease counts it only with the fences that came along."""
        if message.life != self._life:
            return []
        effects: list[Effect] = []
        for ended in message.ended:
            effects += self._on_termination(host, ended.agent, ended, now)
        for fence in message.fences:
            effects += self._rise(fence.agent, fence.generation, f"{host} told of it")
        self._unheard.discard(host)
        self._recall()
        self.lease.acknowledged(host, message.number)
        return effects

    def _on_propose(self, host: str, message: Propose, now: float) -> list[Effect]:
        agent, generation = message.agent, message.generation
        if agent not in self._agents or not self.remembers:
            return []
        if self._alive(agent) and self.lease.holds(now):
            # It asked before the coordinator came here.
            return [Tell(host, self._sought(agent, now))]
        if ended := self.terminations.covers(agent, message.start):
            return [Tell(host, self.terminations.refusal(ended, generation))]
        risen = self._rise(agent, generation, f"{host} is about to go on with it")
        if generation == self.fences.of(agent):
            self.terminations.promise(agent, generation, host, now)
        self._heard(host, agent, generation, now)
        saved = self._copies.saved(agent)
        place = saved.place if saved is not None and saved.ended is None else None
        return [*risen, Tell(host, Promise(agent, generation, self.fences.of(agent), place))]

    def _on_promise(self, host: str, message: Promise, now: float) -> list[Effect]:
        risen = self._rise(message.agent, message.fence, f"{host} has promised it")
        ends = self._on_termination(host, message.agent, message.ended, now)
        if message.ended is not None:
            # It waits with what it has promised here until it knows that nothing begins by it.
            known = self.terminations.covers(message.agent, message.ended.generation)
            ended = known or message.ended
            claimed = self._recoveries.claimed(message.agent)
            answer = [] if claimed else [Tell(host, Sought(message.agent, None, ended=ended))]
            return [*risen, *ends, *answer]
        return [*risen, *self._recoveries.promised(host, message, now)]

    def _on_termination(self, host: str, agent: str, ended: Ended | None, now: float) -> list[Effect]:
        """A host knows that a coordinator has terminated."""
        if ended is None or ended.agent != agent or agent not in self._agents:
            return []
        if ended.outcome not in TERMINAL:
            return []
        effects = self.terminations.conceded(host, ended)
        if self.terminations.covers(agent, ended.generation):
            return effects
        effects += self._recoveries.terminated(ended, now)
        if self._is_member and self.terminations.is_delayed(ended, now):
            return [*effects, *self.terminations.tick(now)]
        saved = self._copies.saved(agent)
        if saved is None or saved.place.generation <= ended.generation:
            effects.append(Terminate(ended))
        return effects

    def is_delayed(self, ended: Ended, now: float) -> bool:
        """Whether a termination elsewhere must not come to the disk yet, nor be confirmed."""
        if not self._is_member or not self.terminations.is_delayed(ended, now):
            return False
        self._next = None if self._next is None else min(self._next, now)
        return True

    def _rise(self, agent: str, generation: int, reason: str) -> list[Effect]:
        if agent not in self._agents or not self.fences.raise_to(agent, generation):
            return []
        return [Bar(agent, generation, reason)]

    def _sought(self, agent: str, now: float) -> Sought:
        """What this host knows of an agent."""
        if agent not in self._agents:
            return Sought(agent, None)
        saved, ended = self._copies.saved(agent), self.terminations.of(agent)
        place = saved.place if saved is not None and saved.ended is None else None
        if alive := self._alive(agent):
            return Sought(agent, place, self.members.here, alive.generation, ended=ended)
        if claimed := self._recoveries.claimed(agent):
            return Sought(agent, place, self.members.here, claimed, ended=ended)
        host, generation, heard = self._holders.get(agent, ("", 0, now))
        return Sought(agent, place, host, generation, age(now - heard), ended)
