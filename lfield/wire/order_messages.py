"""Stop, pause and lift orders as UDP datagrams: signed by an operator, with signed answers of hosts.

A datagram is `lfo`, one byte PROTOCOL and a msgpack array. `lfield/docs/formats.md` has the tables. An order
names one of the two numbers of the `Epochs` of each host. Both are random nonces, so that a replayed order
never matches a later state of the host, independently of clocks. `EmergencyStop` and `Pause`, the same orders
over links, use the same ids and numbers.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Annotated, Literal, TypeVar

import msgspec
from msgspec import Meta, Struct
from msgspec.structs import replace

from lfield.errors import WireError
from lfield.wire.fields import Name, OrderId, truncate

#: The version of the datagrams. Datagrams of another version are dropped.
VERSION = 2
MAGIC = b"lfo" + bytes([VERSION])
#: The largest datagram that is sent or read, in bytes: it fits every path without fragmentation.
MAX_DATAGRAM = 1200
#: The longest reason in a datagram, and the longest sentence of an answer, in bytes of UTF-8.
MAX_REASON, MAX_SENTENCE = 160, 200
#: The size of an epoch, of an order's id, and of the shortened SHA-256 of a certificate, in bytes.
EPOCH_SIZE, ID_SIZE, DIGEST_SIZE = 8, 16, 16
#: The value for a number that the operator's computer does not know. No host draws this value.
UNKNOWN_EPOCH = bytes(EPOCH_SIZE)
#: The most hosts in one datagram.
MAX_HOSTS = 64

OrderKind = Literal["stop", "lift", "pause", "resume"]
#: The orders that make devices safe. The other orders lift these.
HOLDS: Collection[OrderKind] = ("stop", "pause")

Epoch = Annotated[bytes, Meta(min_length=EPOCH_SIZE, max_length=EPOCH_SIZE)]
Digest = Annotated[bytes, Meta(min_length=DIGEST_SIZE, max_length=DIGEST_SIZE)]
Signature = Annotated[bytes, Meta(min_length=64, max_length=64)]
Certificate = Annotated[bytes, Meta(max_length=MAX_DATAGRAM)]
#: The number of a datagram from the operator's computer to a host, repeated in its answer; modulo 256.
Attempt = Annotated[int, Meta(ge=0, le=255)]
#: Milliseconds between the arrival of a datagram and its answer.
Held = Annotated[int, Meta(ge=0, le=0xFFFF)]
Sentence = Annotated[str, Meta(max_length=MAX_SENTENCE)]


class Epochs(Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """The nonces of a host that an order must name. A stop or pause names `hold`, which changes with each
    incarnation of the host and with each executed lift. An order that lifts such an order names `end`, which
    changes with each incarnation, each executed stop or pause and each lock-out of a device.
    """

    hold: Epoch = UNKNOWN_EPOCH
    end: Epoch = UNKNOWN_EPOCH

    def of(self, kind: OrderKind) -> bytes:
        """The number that an order of this kind must name."""
        return self.hold if kind in HOLDS else self.end


class OrderTarget(Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """A recipient of an order, and the number of its epochs if it is known, otherwise UNKNOWN."""

    host: Name
    epoch: Epoch


class Order(Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """The part that an operator signs. The same `id` may be signed again with other epochs: the order is
    executed once.
    """

    kind: OrderKind
    id: OrderId
    reason: Annotated[str, Meta(max_length=MAX_REASON)]
    hosts: Annotated[tuple[OrderTarget, ...], Meta(min_length=1, max_length=MAX_HOSTS)]

    def epoch_for(self, host: str) -> bytes | None:
        """The number named for a host; None if the order is not for this host."""
        return next((target.epoch for target in self.hosts if target.host == host), None)


class SignedOrder(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=1):
    """From an operator: the bytes of an `Order` with the signature, and the digest of the certificate.

    `certificate` is DER, b"" if the host should have it. The other fields are not signed, and are only a
    request: `relay` lists hosts (by their index in the order) that the sender cannot reach; with `unknown`
    the host adds its certificate to answers, and `attempt` counts the datagrams to a host: answers repeat it
    with the processing time of the host, so that the sender can measure the round trip (as with LSR and DLSR
    of RFC 3550, section 6.4.1).
    """

    order: Annotated[bytes, Meta(max_length=MAX_DATAGRAM)]
    signer: Digest
    signature: Signature
    certificate: Certificate = b""
    relay: Annotated[tuple[Annotated[int, Meta(ge=0, lt=MAX_HOSTS)], ...], Meta(max_length=MAX_HOSTS)] = ()
    unknown: bool = False
    attempt: Attempt = 0


class SignedAnswer(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=2):
    """From a host: the bytes of an `OrderAnswer` with the host's signature and the digest of its
    certificate."""

    answer: Annotated[bytes, Meta(max_length=MAX_DATAGRAM)]
    signer: Digest
    signature: Signature
    certificate: Certificate = b""


class CertificateRequest(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=3):
    """From a host without a certificate of this digest: repeat the order with the certificate, and with these
    epochs. The request is not signed, since it answers any sender, and is never larger than the order (no
    amplification).
    """

    host: Name
    signer: Digest
    epochs: Epochs
    attempt: Attempt = 0


Datagram = SignedOrder | SignedAnswer | CertificateRequest


class OrderReceived(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=1):
    """The order is being executed: the confirmation follows when the devices are safe."""

    id: OrderId
    epochs: Epochs
    attempt: Attempt = 0
    held: Held = 0


class EpochChallenge(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=2):
    """The order names an epoch other than that of the host, so it may be a replay: to confirm it, the
    operator signs it again with the epochs of the challenge. On links the message is `OrderChallenge`.
    """

    id: OrderId
    epochs: Epochs
    attempt: Attempt = 0
    held: Held = 0


class OrderConfirmed(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=3):
    """The order is executed. `safe` are devices whose safe state is confirmed, `unsafe` the other devices,
    each with the reason; `more` is the number of devices that did not fit. `trouble` as in
    `EmergencyStopResult`.
    """

    id: OrderId
    epochs: Epochs
    safe: tuple[str, ...]
    unsafe: dict[str, Sentence]
    trouble: Sentence = ""
    more: int = 0
    attempt: Attempt = 0
    held: Held = 0


class OrderDenied(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=4):
    """The order is not executed: its signer does not have the permission, or the certificate is not valid."""

    id: OrderId
    reason: Sentence
    attempt: Attempt = 0
    held: Held = 0


OrderAnswer = OrderReceived | EpochChallenge | OrderConfirmed | OrderDenied


class RelayedOrder(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=47):
    """Between hosts, over their link: an operator's datagram, unchanged, with the remaining `hops`."""

    datagram: Annotated[bytes, Meta(max_length=MAX_DATAGRAM)]
    hops: Annotated[int, Meta(ge=0, le=4)]


class RelayedAnswer(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=48):
    """Back to the operator: the datagram that answers a relayed order."""

    id: OrderId
    datagram: Annotated[bytes, Meta(max_length=MAX_DATAGRAM)]


#: The bytes of a confirmation available for sentences and devices, without signature and certificate.
_DEVICE_BYTES = MAX_DATAGRAM - 720

T = TypeVar("T")
_encode = msgspec.msgpack.Encoder().encode
_datagrams: msgspec.msgpack.Decoder[Datagram] = msgspec.msgpack.Decoder(Datagram)
_answers: msgspec.msgpack.Decoder[OrderAnswer] = msgspec.msgpack.Decoder(OrderAnswer)
_orders = msgspec.msgpack.Decoder(Order)


def encode_datagram(datagram: Datagram) -> bytes:
    """The bytes to send. Raises WireError if they exceed the size of a datagram."""
    data = MAGIC + _encode(datagram)
    if len(data) > MAX_DATAGRAM:
        raise WireError(f"an order of {len(data)} bytes does not fit a datagram of {MAX_DATAGRAM}")
    return data


def decode_datagram(data: bytes) -> Datagram:
    """The received datagram. Raises WireError for other bytes."""
    if len(data) > MAX_DATAGRAM or not data.startswith(MAGIC):
        raise WireError("it is no datagram of this version of lfield")
    return _strict(_datagrams, memoryview(data)[len(MAGIC) :])


def encode_part(part: Order | OrderAnswer) -> bytes:
    """The bytes that are signed, without the purpose of the signature."""
    return _encode(part)


def decode_order(data: bytes) -> Order:
    """The order in a `SignedOrder`. Raises WireError, also if the order names a host twice."""
    order = _strict(_orders, data)
    if len({target.host for target in order.hosts}) < len(order.hosts):
        raise WireError("an order names a host twice")
    return order


def decode_answer(data: bytes) -> OrderAnswer:
    """The answer in a `SignedAnswer`. Raises WireError."""
    return _strict(_answers, data)


def short_reason(reason: str) -> str:
    """A reason, shortened to MAX_REASON bytes of UTF-8."""
    return reason.encode("utf-8", "replace")[:MAX_REASON].decode("utf-8", "ignore")


def order_confirmation(id: bytes, epochs: Epochs, devices: Mapping[str, str], problem: str) -> OrderConfirmed:
    """A confirmation with the contents of an `EmergencyStopResult`: as many devices as fit, unsafe ones
    first."""
    safe: list[str] = []
    unsafe: dict[str, str] = {}
    problem = truncate(problem, MAX_SENTENCE)
    free_bytes = _DEVICE_BYTES - len(_encode(problem))
    for name, reason in sorted(devices.items(), key=lambda device: not device[1]):
        reason = truncate(reason, MAX_SENTENCE)
        free_bytes -= len(_encode(name)) + (len(_encode(reason)) if reason else 0)
        if free_bytes < 0:
            break
        if reason:
            unsafe[name] = reason
        else:
            safe.append(name)
    more = len(devices) - len(safe) - len(unsafe)
    return OrderConfirmed(id, epochs, tuple(safe), unsafe, problem, more)


def numbered_answer(answer: OrderAnswer, attempt: int, held: float) -> OrderAnswer:
    """An answer to the datagram with this number, which arrived `held` seconds before."""
    return replace(answer, attempt=attempt, held=min(0xFFFF, round(held * 1000)))


def devices_of(answer: OrderConfirmed) -> dict[str, str]:
    """The devices of a confirmation in the form of `EmergencyStopResult`."""
    return dict.fromkeys(answer.safe, "") | answer.unsafe


def _strict(decoder: msgspec.msgpack.Decoder[T], data: bytes | memoryview) -> T:
    try:
        return decoder.decode(data)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        raise WireError(f"a datagram cannot be read: {error}") from None
