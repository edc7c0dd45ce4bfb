"""One order to several hosts, as datagrams: what to send, when to repeat it, what each has answered. Pure.

The order is signed for the hosts together, and sent to each of them. A host that answers with a challenge
gets the same order, signed again with its present epoch. What a host does not answer is repeated by the
measured round trip; after two datagrams without an answer, hosts that do answer are asked to relay it.
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
    MAX_DATAGRAM,
    UNKNOWN,
    Answer,
    CertificateRequest,
    Challenge,
    Confirmed,
    Denied,
    Epochs,
    Kind,
    Order,
    Received,
    SignedAnswer,
    SignedOrder,
    decode_datagram,
    encode_datagram,
    parts,
    short_reason,
)

#: After so many datagrams without an answer a host is also asked through others, so many at a time.
RELAY_AFTER, RELAYS = 2, 2
#: A connection, whose handshake takes 4-5 kB, is begun after RELAY_AFTER of them, and after so many where
#: datagrams have come through before.
LINK_AFTER = 5
#: A host gets an order signed anew at most so often.
MOST_SIGNED = 8
#: A confirmation is a measurement of the round trip where there is none, of so many seconds at most.
PROMPT = 0.1
#: What stands beside the hosts in a datagram at most, in bytes: reason, signature, id and framing.
_BESIDE = 320


#: Before any round trip is measured, the shortest interval in seconds, and the rate in bytes/s that all hosts
#: together are sent: half of a radio of 57.6 kbit/s, whose other half is for the answers.
FIRST, RATE = 0.1, 3600.0
#: The shortest and the longest interval, in seconds. So many are alike, since radio loses at random; by this
#: factor each further one is longer.
SHORTEST, LONGEST, ALIKE, BACKOFF = 0.04, 1.0, 4, 1.5
#: How much the round trip may vary is not known after one measurement: this part of it.
FIRST_VARIATION = 0.25
#: A variation of the round trip of less than so many seconds is taken for so many.
LEAST_VARIATION = 0.01
#: An answer is missed after the round trip and so many variations of it.
VARIATIONS = 2.0
#: What is received but not confirmed is asked for after one interval, then two, up to so many.
EXECUTING = 4


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

    @property
    def time_out(self) -> float | None:
        """After so many seconds an answer is missed; None while nothing is measured.

        A repeat that was not needed costs some 300 bytes, and one that comes late delays a stop. So this is
        shorter than the time-out of RFC 6298, which is for whole windows of data.
        """
        if self.mean is None:
            return None
        late = self.mean + max(VARIATIONS * self.variation, LEAST_VARIATION)
        return min(max(late, SHORTEST), LONGEST)


@dataclass(slots=True)
class _Host:
    """What is known of one host of the order. `place` is its number in `signed`."""

    epochs: Epochs
    trip: RoundTrip
    signed: SignedOrder
    place: int
    named: bytes
    known: Known | None = None
    certificate: bytes = b""
    #: Whether it has answered this order itself, and how often it has said that it is executing it.
    has_answered: bool = False
    receipts: int = 0
    #: How many datagrams were sent, how many of those since the latest answer, and when each was.
    attempts: int = 0
    unanswered: int = 0
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
        named = {host: epochs.of(kind) for host, epochs in hosts.items()}
        for part in parts(named, MAX_DATAGRAM - len(signer.certificate) - _BESIDE):
            signed = signer.order(Order(kind, id, self._reason, part))
            for place, one in enumerate(part):
                trip = RoundTrip((trips or {}).get(one.host))
                shown = (known or {}).get(one.host)
                self._hosts[one.host] = _Host(hosts[one.host], trip, signed, place, one.epoch, shown)

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
        measured = {name: host.trip.mean for name, host in self._hosts.items()}
        return {name: seconds for name, seconds in measured.items() if seconds is not None}

    @property
    def certificates(self) -> dict[str, bytes]:
        """The certificates of hosts that are known, in DER, for a later order."""
        return {name: host.known.certificate for name, host in self._hosts.items() if host.known is not None}

    @property
    def silent(self) -> frozenset[str]:
        """The hosts that have answered so few datagrams lately that a connection is needed."""
        waiting = ((name, host) for name, host in self._hosts.items() if host.due is not None)
        return frozenset(name for name, host in waiting if host.unanswered > _most_lost(host))

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
        sent = host.sent.get(answer.attempt)
        if not isinstance(answer, Confirmed):
            self._measure(host, answer.attempt, now)
        elif host.trip.mean is None and sent is not None:
            # The devices took a part of it, but it is better than no measurement.
            self._measure(host, answer.attempt, min(now, sent + PROMPT))
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
        (part,) = parts({name: host.named}, MAX_DATAGRAM)
        host.signed, host.place = self._signer.order(Order(self.kind, self.id, self._reason, part)), 0
        host.times_signed += 1

    def _measure(self, host: _Host, attempt: int, now: float) -> None:
        sent = host.sent.pop(attempt, None)
        if sent is None:
            return
        host.trip.count(now - sent)
        # Hosts that have answered nothing yet were waited for without any measurement.
        for other in self._hosts.values():
            if other.due is not None and other.trip.mean is None and other.sent:
                other.due = min(other.due, max(other.sent.values()) + self._pause(other))

    # --- sending --------------------------------------------------------------------------------------

    def _send(self, name: str, now: float) -> None:
        host = self._hosts[name]
        host.attempts = (host.attempts + 1) % 256
        host.sent[host.attempts] = now
        host.unanswered += 1
        self._put(name, host, host.attempts, ())
        self._plan(host, now)

    def _send_around(self, name: str, host: _Host) -> None:
        """Ask hosts that have answered to relay the order to one that has not."""
        others = [other for other, seen in self._hosts.items() if other != name and seen.has_answered]
        for turn in range(min(RELAYS, len(others))):
            relay = others[(host.attempts * RELAYS + turn) % len(others)]
            self._put(relay, host, 0, (host.place,))

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
        waiting = [one for one in self._hosts.values() if one.result is None]
        size = sum(len(one.signed.order) + len(one.certificate) + 100 for one in waiting)
        others = {name: one.trip for name, one in self._hosts.items()}
        return _interval(host.trip, others, max(0, host.unanswered - 1), size)


def _most_lost(host: _Host) -> int:
    return RELAY_AFTER if host.trip.mean is None else LINK_AFTER


def _interval(trip: RoundTrip, others: Mapping[str, RoundTrip], repeats: int, size: int) -> float:
    """Seconds until a datagram is repeated that was sent `repeats` times before.

    Without a measurement of its own, a host is waited for as the slowest of the others. Where none is
    measured, `size` bytes of all datagrams of a round bound the rate.
    """
    measured = trip.time_out
    if measured is None:
        known = [late for other in others.values() if (late := other.time_out) is not None]
        measured = max(known) if known else max(FIRST, size / RATE)
    return min(measured * BACKOFF ** max(0, repeats - ALIKE), max(LONGEST, measured))
