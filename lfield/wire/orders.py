"""Orders to stop, to pause, and to end either, as datagrams: one signed by a person, and what a host answers.

A datagram is `lfo`, one byte PROTOCOL and a msgpack array. `lfield/docs/formats.md` has the tables. An order
names for each host one of the two numbers of that host's `Epochs`. Both are random, so that no copy of an
earlier order fits a later state of the host, whatever any clock says. The same ids and numbers stand in
`EmergencyStop` and `Pause`, which take the same orders over links.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Annotated, Literal, TypeVar

import msgspec
from msgspec import Meta, Struct
from msgspec.structs import replace

from lfield.errors import WireError
from lfield.wire.fields import Name, OrderId, clip

#: The version of the datagrams. Datagrams of another version are dropped.
VERSION = 2
MAGIC = b"lfo" + bytes([VERSION])
#: The largest datagram that is sent or read, in bytes: it fits every path without fragments.
MAX_DATAGRAM = 1200
#: The longest reason in a datagram, in bytes of UTF-8, and the longest sentence of an answer.
MAX_REASON, MAX_SENTENCE = 160, 200
#: The size of an epoch, of an order's id, and of the shortened SHA-256 of a certificate, in bytes.
EPOCH_SIZE, ID_SIZE, DIGEST_SIZE = 8, 16, 16
#: What stands for a number that the desk does not know. No host draws it.
UNKNOWN = bytes(EPOCH_SIZE)
#: The most hosts that one datagram names.
MAX_HOSTS = 64

Kind = Literal["stop", "lift", "pause", "resume"]
#: The orders that make devices safe. The others end those.
HOLDS: Collection[Kind] = ("stop", "pause")

Epoch = Annotated[bytes, Meta(min_length=EPOCH_SIZE, max_length=EPOCH_SIZE)]
Digest = Annotated[bytes, Meta(min_length=DIGEST_SIZE, max_length=DIGEST_SIZE)]
Signature = Annotated[bytes, Meta(min_length=64, max_length=64)]
Certificate = Annotated[bytes, Meta(max_length=MAX_DATAGRAM)]
#: Which datagram of a desk to a host this is, and which is answered; after 255 it is counted from 0 again.
Attempt = Annotated[int, Meta(ge=0, le=255)]
#: Milliseconds between the arrival of the datagram that an answer names and the answer.
Held = Annotated[int, Meta(ge=0, le=0xFFFF)]
Sentence = Annotated[str, Meta(max_length=MAX_SENTENCE)]


class Epochs(Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """The numbers of a host that an order must name. `hold` is what a stop or a pause names: it is new with
    each life of the host and with each executed end. `end` is what an order to end either names: it is new
    with each life, each executed stop or pause and each lock-out of a device."""

    hold: Epoch = UNKNOWN
    end: Epoch = UNKNOWN

    def of(self, kind: Kind) -> bytes:
        """The number that an order of this kind names."""
        return self.hold if kind in HOLDS else self.end


class For(Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """A host that an order is for, and the number of its epochs that the desk knows, else UNKNOWN."""

    host: Name
    epoch: Epoch


class Order(Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """What a person signs. The same `id` may be signed again with other epochs: it is executed once."""

    kind: Kind
    id: OrderId
    reason: Annotated[str, Meta(max_length=MAX_REASON)]
    hosts: Annotated[tuple[For, ...], Meta(min_length=1, max_length=MAX_HOSTS)]

    def epoch_for(self, host: str) -> bytes | None:
        """The number that it names for a host, None where it is not for that host."""
        return next((one.epoch for one in self.hosts if one.host == host), None)


class SignedOrder(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=1):
    """From a desk: the bytes of an `Order` with the signature of a person, and the digest of the certificate.

    `certificate` is DER, b"" where the host should know it. What follows is not signed, and only a request:
    `relay` lists hosts (by their place in the order) that the desk does not reach itself, with `unknown` the
    host adds its own certificate to answers, and `attempt` counts the datagrams to a host: it is repeated in
    answers with the time that the host took, so that the desk can measure the round trip (as with LSR and
    DLSR of RFC 3550, section 6.4.1).
    """

    order: Annotated[bytes, Meta(max_length=MAX_DATAGRAM)]
    signer: Digest
    signature: Signature
    certificate: Certificate = b""
    relay: Annotated[tuple[Annotated[int, Meta(ge=0, lt=MAX_HOSTS)], ...], Meta(max_length=MAX_HOSTS)] = ()
    unknown: bool = False
    attempt: Attempt = 0


class SignedAnswer(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=2):
    """From a host: the bytes of an `Answer` with the host's signature, and the digest of its certificate."""

    answer: Annotated[bytes, Meta(max_length=MAX_DATAGRAM)]
    signer: Digest
    signature: Signature
    certificate: Certificate = b""


class CertificateRequest(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=3):
    """From a host that knows no certificate of this digest: send the order again with it, and with these
    epochs. It is not signed, since it answers whoever asks, and never larger than what it answers."""

    host: Name
    signer: Digest
    epochs: Epochs
    attempt: Attempt = 0


Datagram = SignedOrder | SignedAnswer | CertificateRequest


class Received(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=1):
    """The order is being executed: the confirmation follows when the devices are safe."""

    id: OrderId
    epochs: Epochs
    attempt: Attempt = 0
    held: Held = 0


class Challenge(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=2):
    """The order names another epoch than the host has, so it may be old: whoever still wants it signs it
    again with these. Links have `OrderChallenge`."""

    id: OrderId
    epochs: Epochs
    attempt: Attempt = 0
    held: Held = 0


class Confirmed(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=3):
    """The order is executed. `safe` are devices whose safe state is confirmed, `unsafe` the others, each with
    the reason; `more` devices had no room here, and nothing is said of them. `trouble` as in
    `EmergencyStopped`."""

    id: OrderId
    epochs: Epochs
    safe: tuple[str, ...]
    unsafe: dict[str, Sentence]
    trouble: Sentence = ""
    more: int = 0
    attempt: Attempt = 0
    held: Held = 0


class Denied(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=4):
    """The order is not executed: its signer lacks the right, or the certificate counts no more."""

    id: OrderId
    why: Sentence
    attempt: Attempt = 0
    held: Held = 0


Answer = Received | Challenge | Confirmed | Denied


class RelayedOrder(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=47):
    """Between hosts, over their link: a datagram of a desk, unchanged. So many `hops` it may yet go on."""

    datagram: Annotated[bytes, Meta(max_length=MAX_DATAGRAM)]
    hops: Annotated[int, Meta(ge=0, le=4)]


class RelayedAnswer(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=48):
    """Back to the desk: the datagram that answers an order that was relayed."""

    id: OrderId
    datagram: Annotated[bytes, Meta(max_length=MAX_DATAGRAM)]


#: The bytes of a confirmation that are left to sentences and devices, beside signature and certificate.
_ROOM = MAX_DATAGRAM - 720

T = TypeVar("T")
_encode = msgspec.msgpack.Encoder().encode
_datagrams: msgspec.msgpack.Decoder[Datagram] = msgspec.msgpack.Decoder(Datagram)
_answers: msgspec.msgpack.Decoder[Answer] = msgspec.msgpack.Decoder(Answer)
_orders = msgspec.msgpack.Decoder(Order)


def encode_datagram(datagram: Datagram) -> bytes:
    """The bytes to send. Raises WireError where they are more than a datagram may have."""
    data = MAGIC + _encode(datagram)
    if len(data) > MAX_DATAGRAM:
        raise WireError(f"an order of {len(data)} bytes does not fit a datagram of {MAX_DATAGRAM}")
    return data


def decode_datagram(data: bytes) -> Datagram:
    """What was received. Raises WireError for anything else."""
    if len(data) > MAX_DATAGRAM or not data.startswith(MAGIC):
        raise WireError("it is no datagram of this version of lfield")
    return _strict(_datagrams, memoryview(data)[len(MAGIC) :])


def encode_part(part: Order | Answer) -> bytes:
    """The bytes that are signed, without the purpose of the signature."""
    return _encode(part)


def decode_order(data: bytes) -> Order:
    """The order of a `SignedOrder`. Raises WireError, also where it names a host twice."""
    order = _strict(_orders, data)
    if len({one.host for one in order.hosts}) < len(order.hosts):
        raise WireError("an order names a host twice")
    return order


def decode_answer(data: bytes) -> Answer:
    """The answer of a `SignedAnswer`. Raises WireError."""
    return _strict(_answers, data)


def short_reason(reason: str) -> str:
    """A reason as a datagram carries it: cut to MAX_REASON bytes of UTF-8."""
    return reason.encode("utf-8", "replace")[:MAX_REASON].decode("utf-8", "ignore")


def confirmed(id: bytes, epochs: Epochs, devices: Mapping[str, str], trouble: str) -> Confirmed:
    """A confirmation of what `EmergencyStopped` says, with as many devices as fit; unsafe ones come first."""
    safe: list[str] = []
    unsafe: dict[str, str] = {}
    trouble = clip(trouble, MAX_SENTENCE)
    room = _ROOM - len(_encode(trouble))
    for name, why in sorted(devices.items(), key=lambda device: not device[1]):
        why = clip(why, MAX_SENTENCE)
        room -= len(_encode(name)) + (len(_encode(why)) if why else 0)
        if room < 0:
            break
        if why:
            unsafe[name] = why
        else:
            safe.append(name)
    more = len(devices) - len(safe) - len(unsafe)
    return Confirmed(id, epochs, tuple(safe), unsafe, trouble, more)


def numbered(answer: Answer, attempt: int, held: float) -> Answer:
    """An answer to the datagram of that number, which came `held` seconds before."""
    return replace(answer, attempt=attempt, held=min(0xFFFF, round(held * 1000)))


def devices_of(answer: Confirmed) -> dict[str, str]:
    """The devices of a confirmation as `EmergencyStopped` has them."""
    return dict.fromkeys(answer.safe, "") | answer.unsafe


def _strict(decoder: msgspec.msgpack.Decoder[T], data: bytes | memoryview) -> T:
    try:
        return decoder.decode(data)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        raise WireError(f"a datagram cannot be read: {error}") from None
