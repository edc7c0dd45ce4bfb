"""Flooding relay for transfer queries and answers between hosts without a direct link. Sans-IO.

The receiver decides the outcome of a transfer whose link broke. Other hosts that connect the two relay the
sender's query and the receiver's answer. Each message crosses each link once; lost messages are repeated by
the sender. Every host on the path that has proof of the outcome also answers. So if two hosts are connected,
the host with the older copy is in doubt only if the other one is.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, ClassVar, Generic, TypeVar

from lfield.clock import Clock
from lfield.replication.membership.membership import HighestCounters, Membership
from lfield.replication.transfer.core import Mobility
from lfield.replication.transfer.effects import Effect, Send
from lfield.wire.coordinator_messages import TransferAccepted, TransferQuery, TransferRefused
from lfield.wire.messages import LivenessCounter, RelayedMessage

#: Seconds between two queries about a transfer, and about a transfer in doubt, which may stay in doubt for
#: days.
ASK_EVERY, ASK_IN_DOUBT_EVERY = 1.0, 3.0
#: Maximum number of messages of one sender that are relayed per second.
MAX_PER_SECOND = 64
#: Maximum number of relayed queries that wait for the disk. Answers to further queries need a direct link.
MAX_PENDING = 256

TransferAnswer = TransferAccepted | TransferRefused
#: The effects of a host, including messages.
E = TypeVar("E")


class QueryRelay(Generic[E]):
    """The relay of host `own_number`, for its own messages and messages of other hosts.

    `incarnation` is that of the host; effects are passed to `out`. `membership` knows the links; `mobility`
    processes messages for this host.
    """

    #: The relay has no handlers of its own: `Coordinators` calls it.
    handles: ClassVar[dict[Any, Any]] = {}
    observes: ClassVar[dict[Any, Any]] = {}
    is_polled = False

    def __init__(
        self,
        hosts: Sequence[str],
        own_number: int,
        incarnation: int,
        clock: Clock,
        out: Callable[[E | Send], None],
        membership: Membership,
        mobility: Mobility,
    ) -> None:
        self._hosts, self._own_number, self._incarnation = hosts, own_number, incarnation
        self._clock, self._out, self._membership, self._mobility = clock, out, membership, mobility
        #: The time when `on_tick` is due, in seconds; None while no transfer from here awaits an answer.
        self.due: float | None = None
        self._count = 0
        self._handled = HighestCounters()
        #: Start of the current second, and the messages of each sender relayed since.
        self._rates: dict[int, tuple[float, int]] = {}
        #: Queries that were relayed to this host: a link to their senders may seem open here although it is
        #: lost.
        self._pending: dict[tuple[str, str, int, int], None] = {}

    def arm(self) -> None:
        """Schedule a query: a link has changed, or coordinators were restored from disk."""
        if len(self._hosts) > 2:
            self.due = self._clock.monotonic()

    def on_tick(self, now: float) -> None:
        """Query every transfer from here whose receiver has no link."""
        self.due = None
        for question, is_in_doubt in self._mobility.pending_queries():
            self._send_relayed(question)
            due = now + (ASK_IN_DOUBT_EVERY if is_in_doubt else ASK_EVERY)
            self.due = due if self.due is None else min(self.due, due)

    def send(self, effect: E) -> None:
        """Emit an effect; relay an answer whose recipient has no link here."""
        if isinstance(effect, Send) and isinstance(effect.message, TransferAccepted | TransferRefused):
            is_pending = _key(effect.host, effect.message) in self._pending
            if is_pending or not self._membership.is_linked(effect.host):
                self._pending.pop(_key(effect.host, effect.message), None)
                self._send_relayed(effect)
                return
        self._out(effect)

    def on_relayed(self, host: str, relayed: RelayedMessage) -> list[Effect]:
        """Process a relayed message, or relay it to all others. Returns effects of mobility."""
        number = relayed.origin.host
        if max(number, relayed.receiver) >= len(self._hosts) or number == self._own_number:
            return []
        if not self._handled.update(relayed.origin) or not self._may_forward(number):
            return []
        origin, message = self._hosts[number], relayed.message
        if relayed.receiver == self._own_number:
            if isinstance(message, TransferQuery):
                self._note(_key(origin, message))
            return self._mobility.on_message(origin, message, self._clock.monotonic())
        if isinstance(message, TransferQuery) and (proof := self._mobility.prove_outcome(message)):
            self._send_relayed(Send(origin, proof))
        else:
            self._forward(relayed, {host, origin})
        return []

    def _may_forward(self, number: int) -> bool:
        now = self._clock.monotonic()
        since, count = self._rates.get(number, (now, 0))
        if now - since >= 1.0:
            since, count = now, 0
        self._rates[number] = since, count + 1
        return count < MAX_PER_SECOND

    def _note(self, key: tuple[str, str, int, int]) -> None:
        self._pending[key] = None
        if len(self._pending) > MAX_PENDING:
            del self._pending[next(iter(self._pending))]

    def _send_relayed(self, effect: Send) -> None:
        assert isinstance(effect.message, TransferAccepted | TransferRefused | TransferQuery)
        self._count += 1
        origin = LivenessCounter(self._own_number, self._incarnation, self._count)
        self._forward(RelayedMessage(origin, self._hosts.index(effect.host), effect.message), set())

    def _forward(self, relayed: RelayedMessage, but: set[str]) -> None:
        for host in self._membership.links:
            if host not in but:
                self._out(Send(host, relayed))


def _key(host: str, message: TransferAnswer | TransferQuery) -> tuple[str, str, int, int]:
    return host, message.agent, message.generation, message.sequence
