"""Stop and pause orders that arrive at a host as datagrams: checked, executed, relayed. Sans-IO.

Cheap checks come first. A signature is checked in a thread, within rate limits, and only if the datagram is
for this host or to be relayed. Only verified datagrams are relayed or executed, and the answer to an
unverified datagram is smaller than the datagram (no amplification).
"""

from __future__ import annotations

import hashlib
from collections import OrderedDict
from collections.abc import Callable, Collection
from contextlib import suppress
from typing import NamedTuple

from msgspec import Struct, field

from lfield.authority.admission_policy import AdmissionPolicy
from lfield.authority.order_signing.order_signatures import CertificateCache, OrderSigner, VerifiedCertificate
from lfield.authority.rights import missing_permission
from lfield.errors import LfieldError, WireError
from lfield.host.stop_orders.datagram_limits import DatagramLimits, Sender, remember_newest
from lfield.host.stop_orders.order_executor import OrderCallback, OrderResponse
from lfield.text import log_messages
from lfield.text.log_messages import LogLine
from lfield.text.terminal_escape import escape_line
from lfield.wire import order_messages as wire
from lfield.wire.fields import truncate
from lfield.wire.observer_messages import EmergencyStop, EmergencyStopResult, OrderChallenge, Pause
from lfield.wire.order_messages import Epochs, Order, RelayedAnswer, RelayedOrder, SignedOrder

#: A confirmation that takes longer than this number of seconds is announced, so that the sender repeats less
#: often. The announcement is repeated to a sender at this interval at most.
RECEIPT_DELAY = 0.2
#: The first confirmation is repeated after this number of seconds: a sender that missed it would otherwise
#: request it a round trip later. Only the sender of a verified order gets it.
CONFIRMATION_COPY_DELAY = 0.03
#: Limits of relaying: hops of a datagram, number of hosts to which it is relayed, and seconds until the same
#: one may be relayed again.
MAX_HOPS, MAX_RELAYS, RELAY_EVERY = 2, 2, 0.15
#: Numbers of remembered orders, verified datagrams and relayed ones; of recipients of an answer; and of
#: answers returned for one relayed order.
MAX_ORDERS, MAX_ASKERS, MAX_HANDED_BACK = 256, 4, 256


class FromHost(NamedTuple):
    """A datagram that another host has relayed over its link, with the remaining hops."""

    host: str
    hops: int


Origin = Sender | FromHost


class PendingCheck(Struct):
    """A datagram whose signature is to be checked."""

    signed: SignedOrder
    order: Order
    data: bytes
    origin: Origin
    known: VerifiedCertificate | None


class _Requester(Struct):
    """The latest datagram with an order from one origin, and when it arrived; the time when execution was
    last announced to that origin. Times are in seconds.
    """

    signed: SignedOrder
    received_at: float
    announced: float


class _VerifiedOrder(Struct):
    """An order that was verified here: the recipients of its answers, and its state."""

    askers: OrderedDict[Origin, _Requester] = field(default_factory=OrderedDict)
    is_executing: bool = False
    has_confirmed: bool = False
    handed_back: int = 0


class OrderPorts(Struct, frozen=True):
    """The host interface of an `OrderReceiver`.

    `send` sends bytes to an address, `relay` a message to a host that is in `linked()`. `check` checks a
    signature and calls `on_checked` with the result. `execute` gives an order to the host. `later` calls a
    function after a delay in seconds. `note` writes a line to the log.
    """

    send: Callable[[Sender, bytes], None]
    relay: Callable[[str, RelayedOrder | RelayedAnswer], None]
    linked: Callable[[], Collection[str]]
    check: Callable[[PendingCheck], None]
    execute: Callable[[EmergencyStop | Pause, str, OrderCallback], None]
    later: Callable[[float, Callable[[], None]], None]
    note: Callable[[LogLine], None] = lambda line: None


class OrderReceiver:
    """The datagrams of one host. `now` is the monotonic clock, in seconds."""

    def __init__(
        self,
        signer: OrderSigner,
        certificates: CertificateCache,
        admission: AdmissionPolicy,
        epochs: Callable[[], Epochs],
        now: Callable[[], float],
        ports: OrderPorts,
    ) -> None:
        self._ports = ports
        self._signer, self._certificates, self._admission = signer, certificates, admission
        self._epochs, self._now, self._name = epochs, now, signer.identity.name
        self._limits = DatagramLimits()
        #: The verified datagrams, by their digest.
        self._verified: OrderedDict[bytes, VerifiedCertificate] = OrderedDict()
        self._orders: OrderedDict[bytes, _VerifiedOrder] = OrderedDict()
        #: The time when each datagram was last relayed.
        self._relayed: OrderedDict[bytes, float] = OrderedDict()
        self._checking: set[bytes] = set()

    # --- input ----------------------------------------------------------------------------------------

    def may_decode(self, sender: Sender) -> bool:
        """Whether a datagram from this sender may be passed to `on_datagram`; this cheapest check comes
        first.
        """
        return self._limits.may_decode(sender, self._now())

    def on_datagram(self, data: bytes, origin: Origin) -> None:
        """A datagram arrived. A datagram that is neither an order for this host nor to be relayed is
        dropped.
        """
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
        checking = PendingCheck(signed, order, data, origin, known)
        verified = self._verified.get(_digest(signed))
        if verified is None and known is None and not signed.certificate:
            self._request_certificate(checking)
        elif self._may_check(checking):
            # A copy needs no check but counts as a check: the host answers it with a signature.
            if verified is not None:
                self._on_verified(checking, verified)
            else:
                self._checking.add(_digest(signed))
                self._ports.check(checking)

    def on_relayed(self, host: str, message: RelayedOrder | RelayedAnswer) -> None:
        """A host relays an operator's datagram, or the answer to one that this host has relayed."""
        if isinstance(message, RelayedOrder):
            self.on_datagram(message.datagram, FromHost(host, message.hops))
        else:
            self._return_answer(message)

    def _return_answer(self, message: RelayedAnswer) -> None:
        """Return the answer to the senders of the order."""
        verified = self._orders.get(message.id)
        if verified is None or verified.handed_back >= MAX_HANDED_BACK:
            return
        verified.handed_back += 1
        for origin, asker in verified.askers.items():
            if asker.signed.relay:
                self._reply(origin, message.id, message.datagram)

    def on_checked(self, checking: PendingCheck, certificate: VerifiedCertificate | LfieldError) -> None:
        """The result of a check. A forged signature gets no answer."""
        digest = _digest(checking.signed)
        self._checking.discard(digest)
        if isinstance(certificate, LfieldError):
            return
        self._certificates.add(certificate)
        remember_newest(self._verified, digest, certificate, MAX_ORDERS)
        if isinstance(checking.origin, Sender):
            self._limits.on_proven(checking.origin, checking.signed.signer)
        self._on_verified(checking, certificate)

    def _may_check(self, checking: PendingCheck) -> bool:
        if _digest(checking.signed) in self._checking:
            return False
        origin, signer = checking.origin, checking.signed.signer
        # A host relays only verified datagrams: all of one host count as one sender.
        sender = origin if isinstance(origin, Sender) else Sender(origin.host, FromHost)
        return self._limits.may_check(sender, signer, self._now(), is_known=checking.known is not None)

    def _request_certificate(self, checking: PendingCheck) -> None:
        request = wire.CertificateRequest(
            self._name, checking.signed.signer, self._epochs(), checking.signed.attempt
        )
        data = wire.encode_datagram(request)
        if len(data) <= len(checking.data):
            self._reply(checking.origin, checking.order.id, data)

    # --- verified -------------------------------------------------------------------------------------

    def _on_verified(self, checking: PendingCheck, known: VerifiedCertificate) -> None:
        """The signature is valid: authorise its signer now, also for a repeated datagram."""
        signed, order, origin = checking.signed, checking.order, checking.origin
        message = _link_message(order, order.epoch_for(self._name) or wire.UNKNOWN_EPOCH)
        operator = known.identity
        verified = self._orders.get(order.id) or _VerifiedOrder()
        remember_newest(self._orders, order.id, verified, MAX_ORDERS)
        before, now = verified.askers.get(origin), self._now()
        asker = _Requester(signed, now, before.announced if before else -RECEIPT_DELAY)
        remember_newest(verified.askers, origin, asker, MAX_ASKERS)
        if reason := missing_permission(operator, self._admission.decide(operator), message):
            self._ports.note(log_messages.ORDER_DENIED.line(operator=operator, reason=reason))
            self._answer(order.id, wire.OrderDenied(order.id, truncate(reason, wire.MAX_SENTENCE)))
            return
        self._relay(checking)
        if order.epoch_for(self._name) is None:
            return
        if verified.is_executing:
            self._send_receipt(order.id)
            return
        verified.is_executing = True
        self._ports.execute(message, str(operator), lambda answer: self._on_executed(order.id, answer))
        self._ports.later(RECEIPT_DELAY, lambda: self._send_receipt(order.id))

    def _send_receipt(self, id: bytes) -> None:
        """Announce the execution to the senders without a recent announcement."""
        verified, now = self._orders.get(id), self._now()
        if verified is None or not verified.is_executing:
            return
        for origin, asker in verified.askers.items():
            if now - asker.announced >= RECEIPT_DELAY:
                asker.announced = now
                self._answer(id, wire.OrderReceived(id, self._epochs()), origin)

    def _on_executed(self, id: bytes, answer: OrderResponse) -> None:
        verified = self._orders.get(id)
        if verified is None:
            return
        verified.is_executing = False
        if isinstance(answer, OrderChallenge):
            self._answer(id, wire.EpochChallenge(id, answer.epochs))
        else:
            self._confirm(id, _confirmation(id, answer))

    def _confirm(self, id: bytes, confirmed: wire.OrderConfirmed) -> None:
        verified = self._orders[id]
        self._answer(id, confirmed)
        if verified.has_confirmed:
            return
        verified.has_confirmed = True
        self._ports.later(CONFIRMATION_COPY_DELAY, lambda: self._confirm_again(id, confirmed))

    def _confirm_again(self, id: bytes, confirmed: wire.OrderConfirmed) -> None:
        """Repeat the confirmation to the senders that know the certificate: with a certificate the copy would
        be large.
        """
        verified = self._orders.get(id)
        askers = verified.askers.items() if verified is not None else ()
        for origin in [origin for origin, asker in askers if not asker.signed.unknown]:
            self._answer(id, confirmed, origin)

    def _relay(self, checking: PendingCheck) -> None:
        """Relay the datagram unchanged to the hosts that the sender requests."""
        hops = checking.origin.hops if isinstance(checking.origin, FromHost) else MAX_HOPS
        hosts = checking.order.hosts
        places = [place for place in checking.signed.relay if place < len(hosts)]
        targets = [hosts[place].host for place in places if hosts[place].host != self._name]
        digest, now = hashlib.sha256(checking.data).digest(), self._now()
        if not targets or not hops or now - self._relayed.get(digest, -RELAY_EVERY) < RELAY_EVERY:
            return
        remember_newest(self._relayed, digest, now, MAX_ORDERS)
        linked = [host for host in self._ports.linked() if not _is_from(checking.origin, host)]
        direct = [host for host in targets if host in linked]
        around = linked[:MAX_RELAYS] if len(direct) < len(targets) else []
        for host in dict.fromkeys((*direct, *around)):
            self._ports.relay(host, RelayedOrder(checking.data, hops - 1))

    # --- output ---------------------------------------------------------------------------------------

    def _answer(self, id: bytes, answer: wire.OrderAnswer, only: Origin | None = None) -> None:
        """Answer all senders, each with the number of its latest datagram."""
        for origin, asker in self._orders[id].askers.items():
            if only is None or origin == only:
                numbered = wire.numbered_answer(answer, asker.signed.attempt, self._now() - asker.received_at)
                reply = self._signer.answer(numbered, unknown=asker.signed.unknown)
                # A certificate with a very long name does not fit a datagram: the sender must use a link.
                with suppress(WireError):
                    self._reply(origin, id, wire.encode_datagram(reply))

    def _reply(self, origin: Origin, id: bytes, data: bytes) -> None:
        if isinstance(origin, Sender):
            self._ports.send(origin, data)
        else:
            self._ports.relay(origin.host, RelayedAnswer(id, data))


def _digest(signed: SignedOrder) -> bytes:
    return hashlib.sha256(signed.signer + signed.signature + signed.order).digest()


def _is_from(origin: Origin, host: str) -> bool:
    return isinstance(origin, FromHost) and origin.host == host


def _link_message(order: Order, epoch: bytes) -> EmergencyStop | Pause:
    lift = order.kind not in wire.HOLDS
    if order.kind in ("stop", "lift"):
        return EmergencyStop(order.id, escape_line(order.reason), lift, epoch)
    return Pause(order.id, lift, epoch)


def _confirmation(id: bytes, answer: EmergencyStopResult) -> wire.OrderConfirmed:
    return wire.order_confirmation(id, answer.epochs, answer.devices, answer.trouble)
