"""A stop or pause order to several hosts as datagrams: transmission, retransmission, answers. Sans-IO.

The order is signed for each host, and sent twice at first: the second copy does not wait for the round trip.
A host that answers with a challenge gets the same order, signed again with its present epoch. Retransmission
follows the measured round trip, at a rate that a slow radio can carry; after some datagrams without an
answer, hosts that do answer relay it.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from msgspec import Struct, field
from msgspec.structs import replace

from lfield.authority.order_signing.order_signatures import (
    CertificateCache,
    OrderSigner,
    VerifiedCertificate,
    verify_answer,
)
from lfield.errors import LfieldError, WireError
from lfield.net.health.link_heartbeats import SmoothedRtt
from lfield.wire.order_messages import (
    HOLDS,
    UNKNOWN_EPOCH,
    CertificateRequest,
    EpochChallenge,
    Epochs,
    Order,
    OrderAnswer,
    OrderConfirmed,
    OrderDenied,
    OrderKind,
    OrderReceived,
    OrderTarget,
    SignedAnswer,
    SignedOrder,
    decode_datagram,
    encode_datagram,
    short_reason,
)

#: Number of unanswered datagrams after which a host is also addressed through other hosts, in turns.
RELAY_AFTER = 3
#: Number of unanswered datagrams after which a new link is opened (its handshake takes 4-5 kB); and, if any
#: host has answered datagrams, the larger number and the time (s).
LINK_AFTER, LINK_AFTER_MORE, LINK_AFTER_SECONDS = 2, 5, 0.4
#: The most signatures of the order for one host.
MAX_SIGNATURES = 8
#: The shortest interval in seconds, before any round trip is measured.
FIRST_INTERVAL = 0.06
#: The data rate in bytes/s to all hosts together: less than half of a radio of 57.6 kbit/s; answers and links
#: need the rest. Once one datagram of EXCHANGE bytes per host has passed within the longest round trip, the
#: rate is at least that. The number is between the size of an order, 170, and that of an order with its
#: answer, 340, which would leave nothing to the links.
SEND_RATE, EXCHANGE = 3000.0, 250.0
#: Bytes of a datagram besides order and certificate, with IPv6 and UDP headers; and of a certificate in an
#: answer.
OVERHEAD, CERTIFICATE_SIZE = 148, 500
#: The shortest and the longest interval, in seconds; the number of equal intervals, since radio losses are
#: random; the factor of each further one.
MIN_INTERVAL, MAX_INTERVAL, EQUAL_INTERVALS, BACKOFF = 0.04, 1.0, 6, 1.5
#: The number of equal intervals without any answer: a queue may hold the datagrams.
EQUAL_UNANSWERED = 4
#: The assumed variation of the round trip after one measurement, as a part of it.
FIRST_VARIATION = 0.25
#: The minimum variation of the round trip, in seconds.
MIN_VARIATION = 0.01
#: An answer is missing after the round trip plus this multiple of its variation.
VARIATIONS = 2.0
#: Least time (s) after which a received but unconfirmed order is queried, and the most intervals if the host
#: has repeated that it is executing it.
LEAST_EXECUTING, MAX_EXECUTION_WAIT = 0.1, 4


class OutgoingDatagram(NamedTuple):
    """A datagram for the address of a host."""

    host: str
    datagram: bytes


class EarlierContacts(NamedTuple):
    """Round trips in seconds and certificates of hosts, measured and verified before this order."""

    trips: Mapping[str, float] = {}
    certificates: Mapping[str, VerifiedCertificate | None] = {}


NO_CONTACTS = EarlierContacts()


#: The result of an order at a host.
OrderResult = OrderConfirmed | OrderDenied


class OrderRoundTrip(SmoothedRtt):
    """The round trip of datagrams to one host."""

    def __init__(self, measured: float | None = None) -> None:
        super().__init__(measured, FIRST_VARIATION)
        #: The latest and the least sample of this order in seconds: the initial values of a later order.
        self.latest, self.minimum = 0.0, measured

    @property
    def time_out(self) -> float | None:
        """Seconds after which an answer is missing; None before a measurement.

        An unnecessary repetition costs some 300 bytes, and a late one delays a stop. So this time is shorter
        than the time-out of RFC 6298, which is for whole windows of data.
        """
        if self.mean is None:
            return None
        late = max(self.mean + max(VARIATIONS * self.variation, MIN_VARIATION), self.latest)
        return min(max(late, MIN_INTERVAL), MAX_INTERVAL)

    def update(self, sample: float) -> None:
        """See `SmoothedRtt.update`. An answer later than the mean indicates a queue that still exists."""
        super().update(sample)
        # The first sample of an order replaces the values of an earlier one.
        self.minimum = min(sample, self.minimum) if self.latest and self.minimum else sample
        self.latest = sample


class _Host(Struct):
    """One host of the order."""

    epochs: Epochs
    trip: OrderRoundTrip
    signed: SignedOrder
    named: bytes
    known: VerifiedCertificate | None = None
    certificate: bytes = b""
    #: Whether the host itself has answered this order, and the number of reports that it is executing it.
    has_answered: bool = False
    receipts: int = 0
    #: The number of datagrams sent, the number since the latest answer, and the time of each.
    attempts: int = 0
    unanswered: int = 0
    #: The time when the first since then was sent, and the seconds from it to the last one.
    silent_since: float = 0.0
    silent_for: float = 0.0
    sent: dict[int, float] = field(default_factory=dict)
    times_signed: int = 1
    due: float | None = None
    result: OrderResult | None = None


class OrderProtocol:
    """An order of one `kind` with an `id` of 16 random bytes.

    `hosts` are the recipients, each with its last known epochs (`Epochs()` for none). A host in
    `earlier.certificates` need not send its certificate. Times are in seconds of one monotonic clock.
    """

    def __init__(
        self,
        kind: OrderKind,
        id: bytes,
        reason: str,
        hosts: Mapping[str, Epochs],
        signer: OrderSigner,
        certificates: CertificateCache,
        earlier: EarlierContacts = NO_CONTACTS,
    ) -> None:
        self.kind, self.id = kind, id
        self._reason, self._signer, self._certificates = short_reason(reason), signer, certificates
        self._hosts: dict[str, _Host] = {}
        self._out: list[OutgoingDatagram] = []
        for host, epochs in hosts.items():
            trip, certificate = OrderRoundTrip(earlier.trips.get(host)), earlier.certificates.get(host)
            self._hosts[host] = _Host(epochs, trip, self._signed(host, epochs), epochs.of(kind), certificate)

    # --- results --------------------------------------------------------------------------------------

    @property
    def results(self) -> dict[str, OrderResult]:
        """The result of the order for each host that has one."""
        return {name: host.result for name, host in self._hosts.items() if host.result is not None}

    @property
    def received(self) -> frozenset[str]:
        """The hosts that are executing the order, or have executed it."""
        done = (name for name, host in self._hosts.items() if isinstance(host.result, OrderConfirmed))
        return frozenset((*done, *(name for name, host in self._hosts.items() if host.receipts)))

    @property
    def epochs(self) -> dict[str, Epochs]:
        """The latest epochs of each host, for a later order."""
        return {name: host.epochs for name, host in self._hosts.items()}

    @property
    def trips(self) -> dict[str, float]:
        """The measured round trips, in seconds, for a later order."""
        measured = {name: host.trip.minimum for name, host in self._hosts.items()}
        return {name: seconds for name, seconds in measured.items() if seconds is not None}

    @property
    def certificates(self) -> dict[str, bytes]:
        """The known certificates of hosts, in DER, for a later order."""
        return {name: host.known.certificate for name, host in self._hosts.items() if host.known is not None}

    @property
    def unresponsive(self) -> frozenset[str]:
        """The hosts that have answered so few datagrams lately that a link is needed."""
        passes = any(host.trip.mean is not None for host in self._hosts.values())
        waiting = ((name, host) for name, host in self._hosts.items() if host.due is not None)
        return frozenset(name for name, host in waiting if _is_silent(host, passes))

    @property
    def due(self) -> float | None:
        """The time of the next `tick`; None when every host has a result."""
        return min((host.due for host in self._hosts.values() if host.due is not None), default=None)

    def drain_effects(self) -> list[OutgoingDatagram]:
        """The datagrams to send now, each once."""
        out, self._out = self._out, []
        return out

    # --- events ---------------------------------------------------------------------------------------

    def start(self, now: float) -> None:
        """Send the order to all hosts."""
        for name in self._hosts:
            self._send(name, now)

    def tick(self, now: float) -> None:
        """Repeat the datagrams that are due."""
        for name, host in self._hosts.items():
            if host.due is not None and host.due <= now:
                self._send(name, now)
                if host.unanswered > RELAY_AFTER:
                    self._send_around(name, host)

    def finish(self, host: str) -> None:
        """End the order at a host that has it by another path, such as a link: no more datagrams are sent."""
        if host in self._hosts:
            self._hosts[host].due = None

    def on_datagram(self, data: bytes, now: float) -> None:
        """Handle a datagram from any address; it is ignored unless it answers this order."""
        try:
            datagram = decode_datagram(data)
            if isinstance(datagram, CertificateRequest):
                self._on_certificate_request(datagram, now)
            elif isinstance(datagram, SignedAnswer):
                known = self._certificates.get(datagram.signer)
                if known is None and not datagram.certificate:
                    self._need_certificates(now)
                    return
                answer, known = verify_answer(datagram, known, self._certificates.authority)
                self._on_answer(answer, known, now)
        except LfieldError:
            return

    def _on_certificate_request(self, request: CertificateRequest, now: float) -> None:
        """Send the certificate to a host that does not know it. The request is not signed, so it is
        accepted once, and its epochs are a hint: a false one costs a challenge.
        """
        host = self._hosts.get(request.host)
        if host is None or host.due is None or host.certificate or request.signer != self._signer.digest:
            return
        self._measure(host, request.attempt, now)
        host.certificate, host.unanswered = self._signer.certificate, 0
        claimed = request.epochs.of(self.kind)
        # A restarted host knows neither its earlier epochs nor any certificate.
        if host.named == UNKNOWN_EPOCH or (self.kind in HOLDS and claimed != host.named):
            self._sign_again(request.host, host, request.epochs)
        self._send(request.host, now)

    def _need_certificates(self, now: float) -> None:
        """A host has another certificate than the cached one: request it, once."""
        for name, host in self._hosts.items():
            if host.due is not None and host.known is not None and not host.has_answered:
                host.known, host.unanswered = None, 0
                self._send(name, now)

    def _on_answer(self, answer: OrderAnswer, known: VerifiedCertificate, now: float) -> None:
        name = known.identity.name
        host = self._hosts.get(name)
        if known.identity.kind != "host" or host is None or answer.id != self.id or host.result is not None:
            return
        self._certificates.add(known)
        host.known, host.has_answered, host.unanswered = known, True, 0
        self._measure(host, answer.attempt, now - answer.held / 1000)
        if not isinstance(answer, OrderDenied):
            host.epochs = answer.epochs
        match answer:
            case OrderReceived():
                host.receipts += 1
                if host.receipts == 1:
                    self._plan(host, now)
            case EpochChallenge():
                self._on_challenge(name, host, answer.epochs, now)
            case _:
                host.result, host.due = answer, None

    def _on_challenge(self, name: str, host: _Host, epochs: Epochs, now: float) -> None:
        """Repeat the order, unless it would lift a stop or pause that is unknown here."""
        if epochs.of(self.kind) == host.named or host.times_signed >= MAX_SIGNATURES:
            return
        if self.kind not in HOLDS and host.named != UNKNOWN_EPOCH:
            return
        self._sign_again(name, host, epochs)
        self._send(name, now)

    def _sign_again(self, name: str, host: _Host, epochs: Epochs) -> None:
        host.epochs, host.named = epochs, epochs.of(self.kind)
        host.signed = self._signed(name, epochs)
        host.times_signed += 1

    def _signed(self, name: str, epochs: Epochs) -> SignedOrder:
        """The order for one host alone: one for all would need larger datagrams."""
        targets = (OrderTarget(name, epochs.of(self.kind)),)
        return self._signer.order(Order(self.kind, self.id, self._reason, targets))

    def _measure(self, host: _Host, attempt: int, now: float) -> None:
        sent = host.sent.pop(attempt, None)
        if sent is None:
            return
        host.trip.update(max(0.001, now - sent))
        # Hosts without an answer so far were waited for without any measurement.
        for other in self._hosts.values():
            if other.due is not None and other.trip.mean is None and other.sent:
                other.due = min(other.due, max(other.sent.values()) + self._pause(other))

    # --- sending --------------------------------------------------------------------------------------

    def _send(self, name: str, now: float) -> None:
        host = self._hosts[name]
        host.attempts = (host.attempts + 1) % 256
        host.sent[host.attempts] = now
        if not host.unanswered:
            host.silent_since = now
        host.unanswered += 1
        host.silent_for = now - host.silent_since
        self._queue(name, host, host.attempts, ())
        self._plan(host, now)

    def _send_around(self, name: str, host: _Host) -> None:
        """Ask a host that has answered to relay the order to one that has not."""
        others = [other for other, state in self._hosts.items() if other != name and state.has_answered]
        if others:
            self._queue(others[host.attempts % len(others)], host, 0, (0,))

    def _queue(self, name: str, host: _Host, attempt: int, relay: tuple[int, ...]) -> None:
        certificate = host.certificate or (self._hosts[name].certificate if relay else b"")
        signed = replace(
            host.signed,
            certificate=certificate,
            relay=relay,
            unknown=host.known is None,
            attempt=attempt,
        )
        try:
            self._out.append(OutgoingDatagram(name, encode_datagram(signed)))
        except WireError:
            # The certificate does not fit together with a long name: the link must be used.
            host.due = None

    def _plan(self, host: _Host, now: float) -> None:
        host.due = now + self._pause(host) * min(MAX_EXECUTION_WAIT, max(1, host.receipts))

    def _pause(self, host: _Host) -> float:
        """Seconds until a datagram is repeated.

        A host without a measurement of its own is waited for like the slowest of the others.
        """
        measured = [late for other in self._hosts.values() if (late := other.trip.time_out) is not None]
        late = host.trip.time_out or max(measured, default=FIRST_INTERVAL)
        repeats = max(0, host.unanswered - 1)
        if not repeats and not host.has_answered:
            # Most losses are repaired by a copy that waits for no answer.
            late = min(late, MIN_INTERVAL)
        if host.receipts and not host.unanswered:
            late = max(late, LEAST_EXECUTING)
        minimum_pause = self._minimum_pause()
        if not measured:
            late = max(late, minimum_pause)
        longer = late * BACKOFF ** max(0, repeats - (EQUAL_INTERVALS if measured else EQUAL_UNANSWERED))
        return max(minimum_pause, min(longer, max(MAX_INTERVAL, late)))

    def _minimum_pause(self) -> float:
        """Seconds that a slow radio takes for a datagram to each host that has no result, and the answers."""
        waiting = [host for host in self._hosts.values() if host.result is None]
        size = sum(len(host.signed.order) + len(host.certificate) + OVERHEAD for host in waiting)
        size += sum(CERTIFICATE_SIZE for host in waiting if host.certificate and host.known is None)
        trips = [host.trip.mean for host in self._hosts.values() if host.trip.mean is not None]
        return size / max(SEND_RATE, EXCHANGE * len(trips) / max(trips, default=1.0))


def _is_silent(host: _Host, passes: bool) -> bool:
    if not passes:
        return host.unanswered > LINK_AFTER
    return host.unanswered > LINK_AFTER_MORE and host.silent_for >= LINK_AFTER_SECONDS
