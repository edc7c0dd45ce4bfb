"""How coordinators end, how every host comes to know, and which of two starts goes on.

A host of which a coordinator came may restart while the coordinator is away, and start it again. Then
there are two starts. The earlier one has done work and goes on; the later one is superseded wherever a
host learns of both.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from lfield.mobility.copies import LIVE, Copies, Copy
from lfield.mobility.effects import Effect, Finished, Send, Supersede
from lfield.wire.messages import Ended, EndedAck, Hello, Known, Outcome, clip

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping


class Endings:
    """The endings of one host's copies. `links` are the greetings of the hosts that can be reached."""

    def __init__(self, host: str, peers: frozenset[str], copies: Copies, links: Mapping[str, Hello]) -> None:
        self._host, self._peers, self._copies, self._links = host, peers, copies, links
        self._untold: dict[tuple[str, int], tuple[Ended, set[str]]] = {}

    def end(self, copy: Copy, outcome: Outcome, detail: str) -> list[Effect]:
        """End a copy here and tell every host, each until it confirms."""
        detail = clip(detail)
        copy.end(outcome, detail, self._host)
        message = Ended(copy.agent, copy.generation, outcome, detail, self._host)
        self._untold[copy.agent, copy.generation] = message, set(self._peers)
        return [Send(host, message) for host in sorted(self._peers & self._links.keys())]

    def pass_on(self) -> list[Effect]:
        """This host is about to go: tell all it can reach of every ending, wherever that was."""
        effects: list[Effect] = []
        for copy in self._copies:
            if copy.state == "EXITED" and copy.outcome:
                message = Ended(copy.agent, copy.generation, copy.outcome, copy.detail, copy.ended_on)
                _, waiting = self._untold.setdefault((copy.agent, copy.generation), (message, set()))
                more = self._links.keys() - waiting - {copy.ended_on}
                waiting |= more
                effects += [Send(host, message) for host in sorted(more)]
        return effects

    def unconfirmed(self, hosts: Collection[str]) -> bool:
        """Whether one of these hosts has yet to confirm an ending."""
        return any(not waiting.isdisjoint(hosts) for _, waiting in self._untold.values())

    def linked(self, host: str) -> list[Effect]:
        """Tell a host again what it has not confirmed."""
        return [Send(host, message) for message, hosts in self._untold.values() if host in hosts]

    def on_ended(self, host: str, message: Ended) -> list[Effect]:
        """A host tells of an ending."""
        return [*self.learn(message), Send(host, EndedAck(message.agent, message.generation))]

    def on_ack(self, host: str, message: EndedAck) -> list[Effect]:
        """A host confirms that it knows."""
        key = message.agent, message.generation
        if key in self._untold:
            hosts = self._untold[key][1]
            hosts.discard(host)
            if not hosts:
                del self._untold[key]
        return []

    def learn(self, ended: Ended) -> list[Effect]:
        """Take note of an ending elsewhere, unless the copy held here proves it wrong."""
        copy = self._copies.enter(ended.agent, ended.generation)
        if copy is None or (copy.state == "EXITED" and (copy.outcome != "lost" or ended.outcome == "lost")):
            return []
        if ended.outcome == "superseded":
            return self.stop(copy, ended.detail, ended.host)
        # 'lost' is only a presumption; and nothing can have ended while this host still holds it.
        if copy.state in ("RUN", "FROZEN") or (copy.state == "PREPARED" and ended.outcome == "lost"):
            return []
        copy.end(ended.outcome, ended.detail, ended.host)
        return [Finished(ended.agent, ended.generation, ended.outcome, ended.detail, ended.host)]

    def stop(self, copy: Copy, reason: str, host: str) -> list[Effect]:
        """End a copy because `host` said an earlier start is alive; no need to tell others."""
        held = copy.state in LIVE
        copy.end("superseded", reason, host)
        return [Supersede(copy.agent, copy.generation, reason)] if held else []

    def compare(self, host: str, known: Known) -> list[Effect]:
        """`host` holds a live copy of a start: supersede that start, or the later ones known here."""
        for copy in self._copies.of(known.agent):
            if copy.alive and copy.generation < known.generation:
                later = self._copies.enter(known.agent, known.generation)
                return [] if later is None else self._supersede(later, self._host)
        return self.supersede_after(known.agent, known.generation, host)

    def supersede_after(self, agent: str, generation: int, host: str) -> list[Effect]:
        """A start is alive on `host`: supersede all later ones."""
        effects: list[Effect] = []
        for copy in self._copies.of(agent):
            if copy.generation > generation:
                effects += self._supersede(copy, host)
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
        return effects

    def yields(self, copy: Copy) -> list[Effect]:
        """Supersede a start that arrives where an earlier one is alive."""
        if any(other.alive and other.generation < copy.generation for other in self._copies.of(copy.agent)):
            return self._supersede(copy, self._host)
        return []

    def _supersede(self, copy: Copy, host: str) -> list[Effect]:
        if copy.state == "EXITED":
            return []
        reason = f"an earlier start of {copy.agent} is alive on {host}, so this later one was stopped"
        stop: list[Effect] = [Supersede(copy.agent, copy.generation, reason)] if copy.state in LIVE else []
        return stop + self.end(copy, "superseded", reason)
