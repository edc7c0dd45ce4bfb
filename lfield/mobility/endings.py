"""How coordinators end, how every host comes to know, and which of two starts goes on.

A host of which a coordinator came may restart while the coordinator is away, and start it again. Then
there are two starts. The earlier one has done work and goes on; the later one is superseded wherever a
host learns of both. A recovery is the exception: whoever knows of it, however it went on since, runs no
earlier start any more.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from lfield.mobility.copies import LIVE, Copies, Copy
from lfield.mobility.effects import Effect, Finished, Send, Supersede
from lfield.mobility.generations import is_recovery, outranks, stops, why_stopped
from lfield.wire.coordinators import Ended, EndedAck, Known, Outcome
from lfield.wire.fields import clip
from lfield.wire.messages import Hello

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Mapping


class Endings:
    """The endings of one host's copies. `links` are the greetings of the hosts that can be reached."""

    def __init__(self, host: str, peers: frozenset[str], copies: Copies, links: Mapping[str, Hello]) -> None:
        self._host, self._peers, self._copies, self._links = host, peers, copies, links
        self._untold: dict[tuple[str, int], tuple[Ended, set[str]]] = {}
        #: The losses that another host, which goes, has told of, and when it did so first: then it was news.
        self._losses: dict[tuple[str, int], float] = {}
        #: Whether an ending that another host tells of must not come to the disk yet, nor be confirmed.
        self.is_delayed: Callable[[Ended], bool] = lambda ended: False

    def end(self, copy: Copy, outcome: Outcome, detail: str) -> list[Effect]:
        """End a copy here and tell every host, each until it confirms."""
        detail = clip(detail)
        copy.end(outcome, detail, self._host)
        message = Ended(copy.agent, copy.generation, outcome, detail, self._host)
        self._untold[copy.agent, copy.generation] = message, set(self._peers)
        told: list[Effect] = [Send(host, message) for host in sorted(self._peers & self._links.keys())]
        return self._copies.keep(copy) + told

    def restored(self, copy: Copy) -> None:
        """An ending that was known before this host was restarted: who has confirmed it is not."""
        if copy.outcome and copy.ended_on == self._host:
            message = Ended(copy.agent, copy.generation, copy.outcome, copy.detail, copy.ended_on)
            self._untold[copy.agent, copy.generation] = message, set(self._peers)

    def lose(self, agent: str, generations: Iterable[int], detail: str) -> list[Effect]:
        """There is proof now that these starts are lost: tell all that can be reached.

        Not those that come later: meanwhile it may have been started again.
        """
        effects: list[Effect] = []
        for generation in generations:
            copy = self._copies.enter(agent, generation)
            if copy is None or copy.alive or (copy.state == "EXITED" and copy.outcome != "lost"):
                continue
            detail = clip(detail)
            if copy.state != "EXITED":
                copy.end("lost", detail, self._host)
                effects += self._copies.keep(copy)
                effects.append(Finished(agent, generation, "lost", detail, self._host))
            message = Ended(agent, generation, "lost", detail, self._host)
            self._untold[agent, generation] = message, set(self._links)
            effects += [Send(host, message) for host in sorted(self._links)]
        return effects

    def pass_on(self) -> list[Effect]:
        """This host is about to go: tell all it can reach of every ending but losses, wherever that was."""
        effects: list[Effect] = []
        for copy in self._copies:
            if copy.state == "EXITED" and copy.outcome and copy.outcome != "lost":
                message = Ended(copy.agent, copy.generation, copy.outcome, copy.detail, copy.ended_on)
                _, waiting = self._untold.setdefault((copy.agent, copy.generation), (message, set()))
                more = self._links.keys() - waiting - {copy.ended_on}
                waiting |= more
                effects += [Send(host, message) for host in sorted(more)]
        return effects

    def unconfirmed(self, hosts: Collection[str]) -> bool:
        """Whether one of these hosts has yet to confirm an ending."""
        return any(not waiting.isdisjoint(hosts) for _, waiting in self._untold.values())

    @property
    def untold(self) -> set[str]:
        """The hosts that have yet to confirm an ending."""
        return {host for _, hosts in self._untold.values() for host in hosts}

    @property
    def telling(self) -> set[tuple[str, int]]:
        """The starts of whose endings this host tells the others: mostly those that ended here."""
        return set(self._untold)

    def linked(self, host: str) -> list[Effect]:
        """Tell a host again what it has not confirmed."""
        return [Send(host, message) for message, hosts in self._untold.values() if host in hosts]

    def on_ended(self, host: str, message: Ended, now: float) -> list[Effect]:
        """A host tells of an ending."""
        effects = self.learn(message)
        key = message.agent, message.generation
        copy = self._copies.find(*key)
        if copy is not None and copy.state != "EXITED" and self.is_delayed(message):
            return effects
        if copy is not None and copy.outcome == message.outcome == "lost":
            self._losses.setdefault(key, now)
        return [*effects, Send(host, EndedAck(message.agent, message.generation))]

    def proven(self, since: float) -> set[str]:
        """The coordinators that were told to be lost since then, by hosts that had proof and went."""
        return {agent for (agent, _), at in self._losses.items() if at >= since}

    def on_ack(self, host: str, message: EndedAck) -> list[Effect]:
        """A host confirms that it knows."""
        key = message.agent, message.generation
        if key in self._untold:
            hosts = self._untold[key][1]
            hosts.discard(host)
            if not hosts:
                del self._untold[key]
        return []

    def unconfirmed_by(self, agent: str, generation: int) -> Collection[str]:
        """The hosts that have yet to confirm that they know of an ending here."""
        _, hosts = self._untold.get((agent, generation), (None, ()))
        return hosts

    def learn(self, ended: Ended) -> list[Effect]:
        """Take note of an ending elsewhere, unless the copy held here proves it wrong, or it is delayed."""
        return self.fence(ended.agent, ended.generation, ended.host) + self._learn(ended, self.is_delayed)

    def terminated(self, ended: Ended) -> list[Effect]:
        """`learn`, for an ending that need not wait any more; it is confirmed to the host where it ended."""
        effects = self._learn(ended, lambda ended: False)
        if ended.host in self._links:
            effects.append(Send(ended.host, EndedAck(ended.agent, ended.generation)))
        return effects

    def _learn(self, ended: Ended, is_delayed: Callable[[Ended], bool]) -> list[Effect]:
        parked = self._copies.parked.get((ended.agent, ended.generation))
        if parked is not None and parked.state == "RUN" and ended.outcome != "superseded":
            return []
        copy = self._copies.enter(ended.agent, ended.generation)
        if copy is None or (copy.state == "EXITED" and (copy.outcome != "lost" or ended.outcome == "lost")):
            return []
        if ended.outcome == "superseded":
            return self.stop(copy, ended.detail, ended.host)
        # Nothing can have ended while this host still holds it, nor be lost while it may yet go on here.
        if copy.state in ("RUN", "FROZEN"):
            return []
        if copy.state == "PREPARED" and ended.outcome == "lost" and not self._forsaken(copy):
            return []
        if is_delayed(ended):
            return []
        copy.end(ended.outcome, ended.detail, ended.host)
        return [
            *self._copies.keep(copy),
            Finished(ended.agent, ended.generation, ended.outcome, ended.detail, ended.host),
        ]

    def _forsaken(self, copy: Copy) -> bool:
        """Whether a copy in doubt waits for an answer from a life that is over: it can never come."""
        target = self._links.get(copy.target)
        return bool(copy.doubt) and target is not None and target.remembers != copy.memory

    def stop(self, copy: Copy, reason: str, host: str) -> list[Effect]:
        """End a copy because `host` said that another start goes on; no need to tell others."""
        held = copy.state in LIVE
        copy.end("superseded", reason, host)
        kept = self._copies.keep(copy)
        return [*kept, Supersede(copy.agent, copy.generation, reason)] if held else kept

    def compare(self, host: str, known: Known) -> list[Effect]:
        """`host` holds a live copy of a start: supersede that start, or those known here that it outranks."""
        by = self._outranking(known.agent, known.generation)
        if by is not None:
            beaten = self._copies.enter(known.agent, known.generation)
            return [] if beaten is None else self._supersede(beaten, by, self._host)
        return self.supersede(known.agent, known.generation, host)

    def supersede(self, agent: str, generation: int, host: str) -> list[Effect]:
        """A start is alive on `host`: supersede all that it outranks."""
        effects = self.fence(agent, generation, host)
        for copy in self._copies.of(agent):
            if copy.state != "EXITED" and outranks(generation, copy.generation):
                effects += self._supersede(copy, generation, host)
        return effects

    def fence(self, agent: str, generation: int, host: str) -> list[Effect]:
        """`host` knows of a start. If it is a recovery, no earlier one goes on, whatever became of it."""
        effects: list[Effect] = []
        for copy in self._copies.of(agent) if is_recovery(generation) else ():
            if copy.state != "EXITED" and copy.generation < generation:
                effects += self.stop(copy, why_stopped(agent, copy.generation, generation, host), host)
        return effects

    def outranked(self, recovery: Copy) -> list[Effect]:
        """A recovery is made here: all other starts have ended, and every host is told until it confirms."""
        effects: list[Effect] = []
        for copy in self._copies.of(recovery.agent):
            if copy.state != "EXITED" and copy is not recovery:
                effects += self._supersede(copy, recovery.generation, self._host)
        return effects

    def replaced(self, arrived: Copy) -> list[Effect]:
        """A start was injected here: an earlier one that is in doubt leaves the machine, which has one place.

        That is no proof of a loss: whoever may have taken it is still asked, and told of.
        """
        effects: list[Effect] = []
        for copy in self._copies.of(arrived.agent):
            if copy.doubt and copy.state == "PREPARED":
                reason = f"{copy.agent} was in doubt on {self._host} when a later start of it came"
                effects.append(Supersede(copy.agent, copy.generation, reason))
                copy.give_way()
                effects += self._copies.keep(copy)
        return effects

    def yields(self, copy: Copy) -> list[Effect]:
        """Supersede a start that arrives where one that outranks it is alive, or a recovery is known."""
        by = self._outranking(copy.agent, copy.generation)
        return [] if by is None else self._supersede(copy, by, self._host)

    def _outranking(self, agent: str, generation: int) -> int | None:
        """The start because of which this one does not go on, as far as is known here."""
        starts = (
            c.generation for c in self._copies.of(agent) if stops(c.generation, generation, alive=c.alive)
        )
        return next(starts, None)

    def _supersede(self, copy: Copy, by: int, host: str) -> list[Effect]:
        if copy.state == "EXITED" and copy.outcome != "lost":
            return []
        reason = why_stopped(copy.agent, copy.generation, by, host)
        stop: list[Effect] = [Supersede(copy.agent, copy.generation, reason)] if copy.state in LIVE else []
        return stop + self.end(copy, "superseded", reason)
