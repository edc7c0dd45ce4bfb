"""Orders that come to a host as datagrams: what is checked, executed, answered and relayed. Pure.

What costs little comes first. A signature is checked elsewhere, within rations, and only where the datagram
is for this host or to be relayed. Nothing is relayed and nothing executed that was not verified here, and a
datagram that was not verified is answered by less than it has.
"""

from __future__ import annotations

import hashlib
from collections import OrderedDict
from collections.abc import Callable, Collection
from contextlib import suppress
from dataclasses import dataclass, field
from typing import NamedTuple

from lfield.authority.admission import Admission
from lfield.authority.orders.signing import Certificates, Known, Signer
from lfield.authority.rights import lacks
from lfield.errors import LfieldError, WireError
from lfield.host.stopping.rations import Rations, Sender, remember
from lfield.host.stopping.stops import Answered, Answering
from lfield.text.visible import in_one_line
from lfield.wire import orders as wire
from lfield.wire.fields import clip
from lfield.wire.observing import EmergencyStop, EmergencyStopped, OrderChallenge, Pause
from lfield.wire.orders import Epochs, Order, RelayedAnswer, RelayedOrder, SignedOrder

#: A confirmation that is not ready after so many seconds is announced, so that the desk repeats less often.
#: The announcement is repeated to a desk at this interval at most.
RECEIVED_AFTER = 0.2
#: A copy of the first confirmation is sent so many seconds after it: a desk that missed it would ask for it a
#: round trip later. Only the sender of a verified order gets it.
CONFIRMED_AGAIN = 0.03
#: A datagram of a desk passes so many hosts at most, goes on to so many that may know the way, and the same
#: one not again within so many seconds.
HOPS, WAYS, RELAY_EVERY = 2, 2, 0.15
#: So many orders, verified datagrams and relayed ones are remembered; an answer goes back to so many askers,
#: and so many answers of others are handed back for one order.
MOST, MOST_ASKERS, MOST_BACK = 256, 4, 256


class FromHost(NamedTuple):
    """A datagram that another host has relayed over its link; so many hops are left."""

    host: str
    hops: int


Origin = Sender | FromHost


@dataclass(slots=True)
class Checking:
    """A datagram whose signature is to be checked."""

    signed: SignedOrder
    order: Order
    data: bytes
    origin: Origin
    known: Known | None


@dataclass(slots=True)
class _Asker:
    """The latest datagram with an order that came from somewhere, and when; when it was last announced there
    that the order is being executed. In seconds."""

    signed: SignedOrder
    came: float
    announced: float


@dataclass(slots=True)
class _Asked:
    """An order that was verified here: where its answers go, and what is known of it."""

    askers: OrderedDict[Origin, _Asker] = field(default_factory=OrderedDict)
    is_executing: bool = False
    has_confirmed: bool = False
    handed_back: int = 0


class OrderDatagrams:
    """The datagrams of one host.

    `send` sends bytes to an address, `relay` a message to a host that is in `linked()`, `check` has a
    signature checked and calls `checked` with what came of it, `execute` gives an order to the host, `later`
    calls something after so many seconds. `now` is the monotonic clock, in seconds.
    """

    def __init__(
        self,
        signer: Signer,
        certificates: Certificates,
        admission: Admission,
        epochs: Callable[[], Epochs],
        now: Callable[[], float],
    ) -> None:
        self._signer, self._certificates, self._admission = signer, certificates, admission
        self._epochs, self._now, self._name = epochs, now, signer.who.name
        self.send: Callable[[Sender, bytes], None] = lambda sender, data: None
        self.relay: Callable[[str, RelayedOrder | RelayedAnswer], None] = lambda host, message: None
        self.linked: Callable[[], Collection[str]] = tuple
        self.check: Callable[[Checking], None] = lambda checking: None
        self.execute: Callable[[EmergencyStop | Pause, str, Answering], None] = lambda *order: None
        self.later: Callable[[float, Callable[[], None]], None] = lambda seconds, event: None
        self.note: Callable[[str], None] = lambda line: None
        self._rations = Rations()
        #: The datagrams that were verified, by their digest.
        self._verified: OrderedDict[bytes, Known] = OrderedDict()
        self._asked: OrderedDict[bytes, _Asked] = OrderedDict()
        #: When each datagram was last relayed.
        self._relayed: OrderedDict[bytes, float] = OrderedDict()
        self._checking: set[bytes] = set()

    # --- in -------------------------------------------------------------------------------------------

    def may_look(self, sender: Sender) -> bool:
        """Whether a datagram from there is to be given to `came`; it costs least to ask first."""
        return self._rations.may_look(sender, self._now())

    def came(self, data: bytes, origin: Origin) -> None:
        """A datagram has come. Whatever is no order for this host, or to be relayed, is dropped."""
        try:
            signed = wire.decode_datagram(data)
            if not isinstance(signed, SignedOrder):
                return
            order = wire.decode_order(signed.order)
        except WireError:
            return
        is_relayed = any(place < len(order.hosts) for place in signed.relay)
        if order.epoch_for(self._name) is None and not is_relayed:
            return
        known = self._certificates.get(signed.signer)
        checking = Checking(signed, order, data, origin, known)
        verified = self._verified.get(_digest(signed))
        if verified is None and known is None and not signed.certificate:
            self._request_certificate(checking)
        elif self._may_check(checking):
            # A copy needs no check, and counts as one: it is answered, and answers are signed.
            if verified is not None:
                self._good(checking, verified)
            else:
                self._checking.add(_digest(signed))
                self.check(checking)

    def relayed(self, host: str, message: RelayedOrder | RelayedAnswer) -> None:
        """A host relays a datagram of a desk, or the answer to one that this host has relayed."""
        if isinstance(message, RelayedOrder):
            self.came(message.datagram, FromHost(host, message.hops))
        else:
            self._hand_back(message)

    def _hand_back(self, message: RelayedAnswer) -> None:
        """The answer goes to whoever has asked for that."""
        asked = self._asked.get(message.id)
        if asked is None or asked.handed_back >= MOST_BACK:
            return
        asked.handed_back += 1
        for origin, asker in asked.askers.items():
            if asker.signed.relay:
                self._reply(origin, message.id, message.datagram)

    def checked(self, checking: Checking, found: Known | LfieldError) -> None:
        """What came of a check. Nothing is answered to whoever has forged a signature."""
        digest = _digest(checking.signed)
        self._checking.discard(digest)
        if isinstance(found, LfieldError):
            return
        self._certificates.add(found)
        remember(self._verified, digest, found, MOST)
        if isinstance(checking.origin, Sender):
            self._rations.proven(checking.origin, checking.signed.signer)
        self._good(checking, found)

    def _may_check(self, checking: Checking) -> bool:
        if _digest(checking.signed) in self._checking:
            return False
        origin, signer = checking.origin, checking.signed.signer
        # What a host relays it has verified: all of one host are as those of one sender.
        sender = origin if isinstance(origin, Sender) else Sender(origin.host, FromHost)
        return self._rations.may_check(sender, signer, self._now(), is_known=checking.known is not None)

    def _request_certificate(self, checking: Checking) -> None:
        request = wire.CertificateRequest(
            self._name, checking.signed.signer, self._epochs(), checking.signed.attempt
        )
        data = wire.encode_datagram(request)
        if len(data) <= len(checking.data):
            self._reply(checking.origin, checking.order.id, data)

    # --- verified -------------------------------------------------------------------------------------

    def _good(self, checking: Checking, known: Known) -> None:
        """The signature is good: whether its signer may is judged now, also of a repeated datagram."""
        signed, order, origin = checking.signed, checking.order, checking.origin
        message = _message(order, order.epoch_for(self._name) or wire.UNKNOWN)
        who = known.who
        asked = self._asked.get(order.id) or _Asked()
        remember(self._asked, order.id, asked, MOST)
        before, now = asked.askers.get(origin), self._now()
        asker = _Asker(signed, now, before.announced if before else -RECEIVED_AFTER)
        remember(asked.askers, origin, asker, MOST_ASKERS)
        if why := lacks(who, self._admission.verdict(who), message):
            self.note(f"an order of {who} is not carried out: {why}")
            self._answer(order.id, wire.Denied(order.id, clip(why, wire.MAX_SENTENCE)))
            return
        self._relay(checking)
        if order.epoch_for(self._name) is None:
            return
        if asked.is_executing:
            self._announce(order.id)
            return
        asked.is_executing = True
        self.execute(message, str(who), lambda answer: self._executed(order.id, answer))
        self.later(RECEIVED_AFTER, lambda: self._announce(order.id))

    def _announce(self, id: bytes) -> None:
        """Tell the senders that got no announcement lately that the order is being executed."""
        asked, now = self._asked.get(id), self._now()
        if asked is None or not asked.is_executing:
            return
        for origin, asker in asked.askers.items():
            if now - asker.announced >= RECEIVED_AFTER:
                asker.announced = now
                self._answer(id, wire.Received(id, self._epochs()), origin)

    def _executed(self, id: bytes, answer: Answered) -> None:
        asked = self._asked.get(id)
        if asked is None:
            return
        asked.is_executing = False
        if isinstance(answer, OrderChallenge):
            self._answer(id, wire.Challenge(id, answer.epochs))
        else:
            self._confirm(id, _confirmed(id, answer))

    def _confirm(self, id: bytes, confirmed: wire.Confirmed) -> None:
        asked = self._asked[id]
        self._answer(id, confirmed)
        if asked.has_confirmed:
            return
        asked.has_confirmed = True
        self.later(CONFIRMED_AGAIN, lambda: self._confirm_again(id, confirmed))

    def _confirm_again(self, id: bytes, confirmed: wire.Confirmed) -> None:
        """To those who know the certificate: with that the copy would be a large datagram."""
        asked = self._asked.get(id)
        askers = asked.askers.items() if asked is not None else ()
        for origin in [origin for origin, asker in askers if not asker.signed.unknown]:
            self._answer(id, confirmed, origin)

    def _relay(self, checking: Checking) -> None:
        """Hand the datagram on, unchanged, to those for which the desk asks that."""
        hops = checking.origin.hops if isinstance(checking.origin, FromHost) else HOPS
        hosts = checking.order.hosts
        places = [place for place in checking.signed.relay if place < len(hosts)]
        targets = [hosts[place].host for place in places if hosts[place].host != self._name]
        digest, now = hashlib.sha256(checking.data).digest(), self._now()
        if not targets or not hops or now - self._relayed.get(digest, -RELAY_EVERY) < RELAY_EVERY:
            return
        remember(self._relayed, digest, now, MOST)
        linked = [host for host in self.linked() if not _is_from(checking.origin, host)]
        direct = [host for host in targets if host in linked]
        around = linked[:WAYS] if len(direct) < len(targets) else []
        for host in dict.fromkeys((*direct, *around)):
            self.relay(host, RelayedOrder(checking.data, hops - 1))

    # --- out ------------------------------------------------------------------------------------------

    def _answer(self, id: bytes, answer: wire.Answer, only: Origin | None = None) -> None:
        """Answer all who ask, each with the number of the latest datagram."""
        for origin, asker in self._asked[id].askers.items():
            if only is None or origin == only:
                numbered = wire.numbered(answer, asker.signed.attempt, self._now() - asker.came)
                reply = self._signer.answer(numbered, unknown=asker.signed.unknown)
                # A certificate with a very long name has no room in a datagram: the connection has to do.
                with suppress(WireError):
                    self._reply(origin, id, wire.encode_datagram(reply))

    def _reply(self, origin: Origin, id: bytes, data: bytes) -> None:
        if isinstance(origin, Sender):
            self.send(origin, data)
        else:
            self.relay(origin.host, RelayedAnswer(id, data))


def _digest(signed: SignedOrder) -> bytes:
    return hashlib.sha256(signed.signer + signed.signature + signed.order).digest()


def _is_from(origin: Origin, host: str) -> bool:
    return isinstance(origin, FromHost) and origin.host == host


def _message(order: Order, epoch: bytes) -> EmergencyStop | Pause:
    """The order as it comes over links."""
    lift = order.kind not in wire.HOLDS
    if order.kind in ("stop", "lift"):
        return EmergencyStop(order.id, in_one_line(order.reason), lift, epoch)
    return Pause(order.id, lift, epoch)


def _confirmed(id: bytes, answer: EmergencyStopped) -> wire.Confirmed:
    return wire.confirmed(id, answer.epochs, answer.devices, answer.trouble)
