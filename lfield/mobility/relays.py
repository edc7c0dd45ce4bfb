"""Questions about transfers, and their answers, between hosts that have no link with each other. Pure.

A hop that was under way when its link broke is decided by its receiver. While other hosts connect the two,
they pass on the sender's question and the receiver's answer, so that the sender need not wait for the link.
Each message goes once over each link. What is lost on the way is asked again. Every host that a question
comes to answers as well when it has a proof: so of two hosts that are connected, the one whose copy is older
is never in doubt when the other is.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Generic, TypeVar

from lfield.clock import Clock
from lfield.mobility.core import Mobility
from lfield.mobility.effects import Effect, Send
from lfield.mobility.hearsay import Hearsay, HighestCounts
from lfield.wire.coordinators import Accepted, Inquire, Refused
from lfield.wire.messages import Relayed, SignOfLife

#: Seconds between two questions about a transfer, and about one in doubt, which may stay so for days.
ASK_EVERY, ASK_IN_DOUBT_EVERY = 1.0, 3.0
#: The most messages of one sender that are passed on in one second.
MOST_IN_A_SECOND = 64
#: The most relayed questions that wait for the disk; the answers to more go over the link, if there is one.
MOST_ASKED = 256

Answer = Accepted | Refused
#: What a host does, messages among it.
E = TypeVar("E")


class Relays(Generic[E]):
    """What the host `here` relays, for itself and for others.

    `hosts` are the deployment's, `incarnation` is this life, effects go to `out`; `join` comes before all
    else.
    """

    def __init__(
        self,
        hosts: Sequence[str],
        here: str,
        incarnation: int,
        clock: Clock,
        out: Callable[[E | Send], None],
    ) -> None:
        self._hosts, self._here, self._life = hosts, hosts.index(here), incarnation
        self._clock, self._out = clock, out
        #: When `tick` is due, in seconds; None while no transfer from here is without an answer.
        self.due: float | None = None
        self._count = 0
        self._seen = HighestCounts()
        #: Since when in seconds, and how many messages of each sender were passed on since.
        self._rates: dict[int, tuple[float, int]] = {}
        #: Questions that came through others: the link to their senders may seem to stand here, and does not.
        self._asked: dict[tuple[str, str, int, int], None] = {}

    def join(
        self, hearsay: Hearsay, mobility: Mobility, carry_out: Callable[[Iterable[Effect]], None]
    ) -> None:
        """Know the links, and what decides on what comes for this host; `carry_out` its effects."""
        self._hearsay, self._mobility, self._carry_out = hearsay, mobility, carry_out

    def arm(self) -> None:
        """A link has changed, or coordinators have come from the disk: there may be something to ask."""
        if len(self._hosts) > 2:
            self.due = self._clock.monotonic()

    def tick(self, now: float) -> None:
        """Ask about every transfer from here whose receiver has no link, if it is time."""
        if self.due is None or now < self.due:
            return
        self.due = None
        for question, doubt in self._mobility.questions():
            self._begin(question)
            due = now + (ASK_IN_DOUBT_EVERY if doubt else ASK_EVERY)
            self.due = due if self.due is None else min(self.due, due)

    def send(self, effect: E) -> None:
        """Give out an effect; an answer to a host that has no link here is relayed."""
        if isinstance(effect, Send) and isinstance(effect.message, Accepted | Refused):
            asked = _key(effect.host, effect.message) in self._asked
            if asked or not self._hearsay.is_linked(effect.host):
                self._asked.pop(_key(effect.host, effect.message), None)
                self._begin(effect)
                return
        self._out(effect)

    def received(self, host: str, relayed: Relayed) -> None:
        """A host passes something on: it is for this host, or goes on to all others."""
        number = relayed.origin.host
        if max(number, relayed.receiver) >= len(self._hosts) or number == self._here:
            return
        if not self._seen.take(relayed.origin) or not self._may_pass(number):
            return
        origin, message = self._hosts[number], relayed.message
        if relayed.receiver == self._here:
            if isinstance(message, Inquire):
                self._note(_key(origin, message))
            self._carry_out(self._mobility.receive(origin, message, self._clock.monotonic()))
        elif isinstance(message, Inquire) and (proof := self._mobility.vouch(message)):
            self._begin(Send(origin, proof))
        else:
            self._pass_on(relayed, {host, origin})

    def _may_pass(self, number: int) -> bool:
        now = self._clock.monotonic()
        since, count = self._rates.get(number, (now, 0))
        if now - since >= 1.0:
            since, count = now, 0
        self._rates[number] = since, count + 1
        return count < MOST_IN_A_SECOND

    def _note(self, key: tuple[str, str, int, int]) -> None:
        self._asked[key] = None
        if len(self._asked) > MOST_ASKED:
            del self._asked[next(iter(self._asked))]

    def _begin(self, effect: Send) -> None:
        assert isinstance(effect.message, Accepted | Refused | Inquire)
        self._count += 1
        origin = SignOfLife(self._here, self._life, self._count)
        self._pass_on(Relayed(origin, self._hosts.index(effect.host), effect.message), set())

    def _pass_on(self, relayed: Relayed, but: set[str]) -> None:
        for host in self._hearsay.links:
            if host not in but:
                self._out(Send(host, relayed))


def _key(host: str, message: Answer | Inquire) -> tuple[str, str, int, int]:
    return host, message.agent, message.generation, message.sequence
