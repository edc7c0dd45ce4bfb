"""One order to several hosts, as datagrams: what to send, when to repeat it, what each has answered. Pure.

The order is signed for each host, and sent twice to begin with: the second copy does not wait for the round
trip. A host that answers with a challenge gets the same order, signed again with its present epoch. What a
host does not answer is repeated by the measured round trip, at a rate that a slow radio can carry; after some
datagrams without an answer, hosts that do answer are asked to relay it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from msgspec.structs import replace

from lfield.authority.orders.signing import Certificates, Known, Signer, verified_answer
from lfield.errors import LfieldError, WireError
from lfield.net.health.heartbeats import Smoothed
from lfield.wire.orders import (
    HOLDS,
    UNKNOWN,
    Answer,
    CertificateRequest,
    Challenge,
    Confirmed,
    Denied,
    Epochs,
    For,
    Kind,
    Order,
    Received,
    SignedAnswer,
    SignedOrder,
    decode_datagram,
    encode_datagram,
    short_reason,
)

#: After so many datagrams without an answer a host is also asked through another one, in turns.
RELAY_AFTER = 3
#: A connection, whose handshake takes 4-5 kB, is begun after so many of them. Where datagrams of any host
#: have come through, it is begun after more, and after so many seconds.
LINK_AFTER, LINK_AFTER_MORE, LINK_AFTER_SECONDS = 2, 5, 0.4
#: A host gets an order signed anew at most so often.
MOST_SIGNED = 8
#: Before any round trip is measured, the shortest interval in seconds.
FIRST = 0.06
#: The rate in bytes/s at which all hosts together are sent to: half of a radio of 57.6 kbit/s, whose other
#: half is for the answers. Where an order to each of some hosts and the answers, so many bytes each, have
#: passed within the longest round trip, the rate is at least that.
RATE, EXCHANGE = 3600.0, 400.0
#: Bytes beside order and certificate in a datagram, headers of IPv6 and UDP included, and of a certificate
#: that a host shows in its answer.
BESIDE, SHOWN = 148, 500
#: The shortest and the longest interval, in seconds. So many are alike, since radio loses at random; by this
#: factor each further one is longer.
SHORTEST, LONGEST, ALIKE, BACKOFF = 0.04, 1.0, 6, 1.5
#: So many are alike where nothing was ever answered: it may be that a queue holds what was sent.
ALIKE_UNANSWERED = 4
#: How much the round trip may vary is not known after one measurement: this part of it.
FIRST_VARIATION = 0.25
#: A variation of the round trip of less than so many seconds is taken for so many.
LEAST_VARIATION = 0.01
#: An answer is missed after the round trip and so many variations of it.
VARIATIONS = 2.0
#: What is received but not confirmed is asked for after so many seconds at least, and after so many
#: intervals at most where the host has said again that it is executing.
LEAST_EXECUTING, EXECUTING = 0.1, 4


class Send(NamedTuple):
    """A datagram for the address of a host."""

    host: str
    datagram: bytes


#: How an order has ended at a host.
Result = Confirmed | Denied


class RoundTrip(Smoothed):
    """The round trip of datagrams to one host."""

    def __init__(self, measured: float | None = None) -> None:
        super().__init__(measured, FIRST_VARIATION)
        #: The latest sample of this order in seconds, and the least: what a later order begins with.
        self.latest, self.least = 0.0, measured

    @property
    def time_out(self) -> float | None:
        """After so many seconds an answer is missed; None while nothing is measured.

        A repeat that was not needed costs some 300 bytes, and one that comes late delays a stop. So this is
        shorter than the time-out of RFC 6298, which is for whole windows of data.
        """
        if self.mean is None:
            return None
        late = max(self.mean + max(VARIATIONS * self.variation, LEAST_VARIATION), self.latest)
        return min(max(late, SHORTEST), LONGEST)

    def count(self, sample: float) -> None:
        """See `Smoothed.count`. An answer that came later than the mean shows a queue that is still there."""
        super().count(sample)
        # The first sample of an order takes the place of what an earlier one has measured.
        self.least = min(sample, self.least) if self.latest and self.least else sample
        self.latest = sample


@dataclass(slots=True)
class _Host:
    """What is known of one host of the order."""

    epochs: Epochs
    trip: RoundTrip
    signed: SignedOrder
    named: bytes
    known: Known | None = None
    certificate: bytes = b""
    #: Whether it has answered this order itself, and how often it has said that it is executing it.
    has_answered: bool = False
    receipts: int = 0
    #: How many datagrams were sent, how many of those since the latest answer, and when each was.
    attempts: int = 0
    unanswered: int = 0
    #: When the first of those was sent, and how long before the last of them.
    silent_since: float = 0.0
    silent_for: float = 0.0
    sent: dict[int, float] = field(default_factory=dict)
    times_signed: int = 1
    due: float | None = None
    result: Result | None = None


class Asking:
    """An order of one `kind` with an `id` of 16 random bytes.

    `hosts` are those that it is for, each with the epochs that the desk last heard of it (`Epochs()` for
    none). `trips` are round trips that were measured before, in seconds, and `known` are certificates of
    hosts that need not send them. Times are in seconds of one monotonic clock.
    """

    def __init__(
        self,
        kind: Kind,
        id: bytes,
        reason: str,
        hosts: Mapping[str, Epochs],
        signer: Signer,
        certificates: Certificates,
        trips: Mapping[str, float] | None = None,
        known: Mapping[str, Known | None] | None = None,
    ) -> None:
        self.kind, self.id = kind, id
        self._reason, self._signer, self._certificates = short_reason(reason), signer, certificates
        self._hosts: dict[str, _Host] = {}
        self._out: list[Send] = []
        for host, epochs in hosts.items():
            trip, shown = RoundTrip((trips or {}).get(host)), (known or {}).get(host)
            self._hosts[host] = _Host(epochs, trip, self._signed(host, epochs), epochs.of(kind), shown)

    # --- out ------------------------------------------------------------------------------------------

    @property
    def results(self) -> dict[str, Result]:
        """How the order has ended, for each host where it has."""
        return {name: host.result for name, host in self._hosts.items() if host.result is not None}

    @property
    def received(self) -> frozenset[str]:
        """The hosts that are executing the order, or have executed it."""
        done = (name for name, host in self._hosts.items() if isinstance(host.result, Confirmed))
        return frozenset((*done, *(name for name, host in self._hosts.items() if host.receipts)))

    @property
    def epochs(self) -> dict[str, Epochs]:
        """The latest epochs of each host, for a later order."""
        return {name: host.epochs for name, host in self._hosts.items()}

    @property
    def trips(self) -> dict[str, float]:
        """The round trips that are measured, in seconds, for a later order."""
        measured = {name: host.trip.least for name, host in self._hosts.items()}
        return {name: seconds for name, seconds in measured.items() if seconds is not None}

    @property
    def certificates(self) -> dict[str, bytes]:
        """The certificates of hosts that are known, in DER, for a later order."""
        return {name: host.known.certificate for name, host in self._hosts.items() if host.known is not None}

    @property
    def silent(self) -> frozenset[str]:
        """The hosts that have answered so few datagrams lately that a connection is needed."""
        passes = any(host.trip.mean is not None for host in self._hosts.values())
        waiting = ((name, host) for name, host in self._hosts.items() if host.due is not None)
        return frozenset(name for name, host in waiting if _is_silent(host, passes))

    @property
    def due(self) -> float | None:
        """When `tick` is to be called next; None when every host has a result."""
        return min((host.due for host in self._hosts.values() if host.due is not None), default=None)

    def take(self) -> list[Send]:
        """The datagrams to send now, each once."""
        out, self._out = self._out, []
        return out

    # --- events ---------------------------------------------------------------------------------------

    def start(self, now: float) -> None:
        """Send the order to all hosts."""
        for name in self._hosts:
            self._send(name, now)

    def tick(self, now: float) -> None:
        """Repeat what is due."""
        for name, host in self._hosts.items():
            if host.due is not None and host.due <= now:
                self._send(name, now)
                if host.unanswered > RELAY_AFTER:
                    self._send_around(name, host)

    def ended(self, host: str) -> None:
        """The order has ended at this host by another way, as over a connection: nothing is sent any more."""
        if host in self._hosts:
            self._hosts[host].due = None

    def heard(self, data: bytes, now: float) -> None:
        """A datagram has come, from any address. Whatever is no answer to this order is ignored."""
        try:
            datagram = decode_datagram(data)
            if isinstance(datagram, CertificateRequest):
                self._requested(datagram, now)
            elif isinstance(datagram, SignedAnswer):
                known = self._certificates.get(datagram.signer)
                if known is None and not datagram.certificate:
                    self._need_certificates(now)
                    return
                answer, known = verified_answer(datagram, known, self._certificates.authority)
                self._answered(answer, known, now)
        except LfieldError:
            return

    def _requested(self, request: CertificateRequest, now: float) -> None:
        """A host does not know the certificate. That is not signed, so it is heard once, and what it says of
        epochs is a hint: a false one costs a challenge."""
        host = self._hosts.get(request.host)
        if host is None or host.due is None or host.certificate or request.signer != self._signer.digest:
            return
        self._measure(host, request.attempt, now)
        host.certificate, host.unanswered = self._signer.certificate, 0
        told = request.epochs.of(self.kind)
        # A host that was started again knows neither its earlier epochs nor any certificate.
        if host.named == UNKNOWN or (self.kind in HOLDS and told != host.named):
            self._sign_again(request.host, host, request.epochs)
        self._send(request.host, now)

    def _need_certificates(self, now: float) -> None:
        """Some host has another certificate than the one that was kept of it: ask for it, once."""
        for name, host in self._hosts.items():
            if host.due is not None and host.known is not None and not host.has_answered:
                host.known, host.unanswered = None, 0
                self._send(name, now)

    def _answered(self, answer: Answer, known: Known, now: float) -> None:
        name = known.who.name
        host = self._hosts.get(name)
        if known.who.kind != "host" or host is None or answer.id != self.id or host.result is not None:
            return
        self._certificates.add(known)
        host.known, host.has_answered, host.unanswered = known, True, 0
        self._measure(host, answer.attempt, now - answer.held / 1000)
        if not isinstance(answer, Denied):
            host.epochs = answer.epochs
        match answer:
            case Received():
                host.receipts += 1
                if host.receipts == 1:
                    self._plan(host, now)
            case Challenge():
                self._challenged(name, host, answer.epochs, now)
            case _:
                host.result, host.due = answer, None

    def _challenged(self, name: str, host: _Host, epochs: Epochs, now: float) -> None:
        """The order is still wanted, unless it would end a stop or pause that nobody here has heard of."""
        if epochs.of(self.kind) == host.named or host.times_signed >= MOST_SIGNED:
            return
        if self.kind not in HOLDS and host.named != UNKNOWN:
            return
        self._sign_again(name, host, epochs)
        self._send(name, now)

    def _sign_again(self, name: str, host: _Host, epochs: Epochs) -> None:
        host.epochs, host.named = epochs, epochs.of(self.kind)
        host.signed = self._signed(name, epochs)
        host.times_signed += 1

    def _signed(self, name: str, epochs: Epochs) -> SignedOrder:
        """The order for one host alone: all of them together would need larger datagrams."""
        to = (For(name, epochs.of(self.kind)),)
        return self._signer.order(Order(self.kind, self.id, self._reason, to))

    def _measure(self, host: _Host, attempt: int, now: float) -> None:
        sent = host.sent.pop(attempt, None)
        if sent is None:
            return
        host.trip.count(max(0.001, now - sent))
        # Hosts that have answered nothing yet were waited for without any measurement.
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
        self._put(name, host, host.attempts, ())
        self._plan(host, now)

    def _send_around(self, name: str, host: _Host) -> None:
        """Ask a host that has answered to relay the order to one that has not."""
        others = [other for other, seen in self._hosts.items() if other != name and seen.has_answered]
        if others:
            self._put(others[host.attempts % len(others)], host, 0, (0,))

    def _put(self, to: str, host: _Host, attempt: int, relay: tuple[int, ...]) -> None:
        certificate = host.certificate or (self._hosts[to].certificate if relay else b"")
        signed = replace(
            host.signed,
            certificate=certificate,
            relay=relay,
            unknown=host.known is None,
            attempt=attempt,
        )
        try:
            self._out.append(Send(to, encode_datagram(signed)))
        except WireError:
            # The certificate has no room beside a long name: the connection has to do.
            host.due = None

    def _plan(self, host: _Host, now: float) -> None:
        host.due = now + self._pause(host) * min(EXECUTING, max(1, host.receipts))

    def _pause(self, host: _Host) -> float:
        """Seconds until a datagram is repeated.

        Without a measurement of its own, a host is waited for as the slowest of the others.
        """
        measured = [late for one in self._hosts.values() if (late := one.trip.time_out) is not None]
        late = host.trip.time_out or max(measured, default=FIRST)
        repeats = max(0, host.unanswered - 1)
        if not repeats and not host.has_answered:
            # Most of what is lost is made good by a copy that waits for no answer.
            late = min(late, SHORTEST)
        if host.receipts and not host.unanswered:
            late = max(late, LEAST_EXECUTING)
        pace = self._pace()
        if not measured:
            late = max(late, pace)
        longer = late * BACKOFF ** max(0, repeats - (ALIKE if measured else ALIKE_UNANSWERED))
        return max(pace, min(longer, max(LONGEST, late)))

    def _pace(self) -> float:
        """Seconds that a slow radio takes for a datagram to each host that has no result, and the answers."""
        waiting = [one for one in self._hosts.values() if one.result is None]
        size = sum(len(one.signed.order) + len(one.certificate) + BESIDE for one in waiting)
        size += sum(SHOWN for one in waiting if one.certificate and one.known is None)
        trips = [one.trip.mean for one in self._hosts.values() if one.trip.mean is not None]
        return size / max(RATE, EXCHANGE * len(trips) / max(trips, default=1.0))


def _is_silent(host: _Host, passes: bool) -> bool:
    if not passes:
        return host.unanswered > LINK_AFTER
    return host.unanswered > LINK_AFTER_MORE and host.silent_for >= LINK_AFTER_SECONDS
