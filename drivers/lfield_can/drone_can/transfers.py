"""Transfers of DroneCAN in frames of CAN 2.0B (specification, 4.1 CAN bus transport layer). Pure.

The id of a frame has priority, data type, and source; the last byte of its data is the tail: start, end,
toggle, and the number of the transfer. A transfer of several frames starts with a CRC of signature and data.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from msgspec import Struct, field

from lfield_can.bus.frames import Frame
from lfield_can.dbc.checksums import crc

#: Bytes of data in a frame beside the tail.
CAPACITY = 7
START, END, TOGGLE, NUMBER = 0x80, 0x40, 0x20, 0x1F
#: Seconds after which an unfinished transfer is discarded, and bytes of the longest.
TIMEOUT, LONGEST = 1.0, 512
#: Stored unfinished transfers; a bus has at most 127 nodes.
MAX_UNFINISHED = 512
_SERVICE = 0x80


class TransferKind(NamedTuple):
    """The content of a transfer: a message, or a service of node `destination` (request or response)."""

    type_id: int
    destination: int = 0
    is_request: bool = False

    @property
    def is_service(self) -> bool:
        """Whether the transfer is a request or a response."""
        return self.destination != 0


class Transfer(NamedTuple):
    """A complete transfer. Source 0 is an anonymous node."""

    kind: TransferKind
    source: int
    number: int
    data: bytes


def frame_id(kind: TransferKind, source: int, priority: int) -> int:
    """The 29-bit id of the frames of a transfer of a node with an id."""
    if kind.is_service:
        service = kind.type_id << 16 | kind.is_request << 15 | kind.destination << 8 | _SERVICE
        return priority << 24 | service | source
    return priority << 24 | kind.type_id << 8 | source


def parse_frame_id(identifier: int) -> tuple[TransferKind, int]:
    """The kind of transfer of a frame, and its source. An anonymous frame has only the lowest two bits of
    the type id."""
    source = identifier & 0x7F
    if identifier & _SERVICE:
        destination, is_request = identifier >> 8 & 0x7F, bool(identifier & 0x8000)
        return TransferKind(identifier >> 16 & 0xFF, destination, is_request), source
    return TransferKind(identifier >> 8 & (0xFFFF if source else 0x3)), source


def transfer_crc(signature: int, data: bytes) -> int:
    """CRC-16-CCITT of the signature of the data type and the data."""
    return crc(signature.to_bytes(8, "little") + data, 0x1021, 0xFFFF, width=16)


def frames_of(transfer: Transfer, signature: int, priority: int = 16) -> Iterator[Frame]:
    """The frames of a transfer, in order."""
    identifier = frame_id(transfer.kind, transfer.source, priority)
    data = transfer.data
    if len(data) > CAPACITY:
        data = transfer_crc(signature, data).to_bytes(2, "little") + data
    last = max(0, len(data) - 1) // CAPACITY
    for at in range(last + 1):
        tail = START * (at == 0) | END * (at == last) | TOGGLE * (at % 2) | transfer.number & NUMBER
        yield Frame(identifier, data[at * CAPACITY : (at + 1) * CAPACITY] + bytes([tail]), extended=True)


class _Unfinished(Struct):
    """An unfinished transfer."""

    number: int
    since: float
    toggle: int = TOGGLE
    parts: list[bytes] = field(default_factory=list)


class Assembler:
    """Assembles transfers from frames; `malformed` counts frames and transfers that are not valid.

    `signatures` are those of the data types that are received, by type and whether it is a service.
    """

    def __init__(self, signatures: dict[tuple[int, bool], int]) -> None:
        self.malformed = 0
        self._signatures = signatures
        self._unfinished: dict[int, _Unfinished] = {}

    def on_frame(self, frame: Frame, now: float) -> Transfer | None:
        """The transfer that a frame completes. Never raises."""
        if not frame.data or frame.fd:
            return None
        kind, source = parse_frame_id(frame.id)
        tail, data = frame.data[-1], frame.data[:-1]
        if tail & START and tail & END:
            self._unfinished.pop(frame.id, None)
            return Transfer(kind, source, tail & NUMBER, data)
        signature = self._signatures.get((kind.type_id, kind.is_service))
        if signature is None or source == 0:
            return None
        return self._next(frame.id, tail, data, now, signature)

    def _next(self, identifier: int, tail: int, data: bytes, now: float, signature: int) -> Transfer | None:
        if tail & START:
            self._discard_old(now)
            if tail & TOGGLE or len(data) < CAPACITY:
                self.malformed += 1
                return None
            self._unfinished[identifier] = _Unfinished(tail & NUMBER, now, parts=[data])
            return None
        unfinished = self._unfinished.get(identifier)
        if unfinished is None:
            return None  # its start was lost
        expected = unfinished.toggle | unfinished.number
        too_long = len(unfinished.parts) * CAPACITY > LONGEST
        if tail & (TOGGLE | NUMBER) != expected or now - unfinished.since > TIMEOUT or too_long:
            del self._unfinished[identifier]
            self.malformed += 1
            return None
        unfinished.toggle ^= TOGGLE
        unfinished.parts.append(data)
        if not tail & END:
            return None
        del self._unfinished[identifier]
        payload = b"".join(unfinished.parts)
        kind, source = parse_frame_id(identifier)
        if int.from_bytes(payload[:2], "little") != transfer_crc(signature, payload[2:]):
            self.malformed += 1
            return None
        return Transfer(kind, source, unfinished.number, payload[2:])

    def _discard_old(self, now: float) -> None:
        """Discards old unfinished transfers when there are many."""
        if len(self._unfinished) >= MAX_UNFINISHED:
            self._unfinished = {
                key: transfer for key, transfer in self._unfinished.items() if now - transfer.since <= TIMEOUT
            }
        if len(self._unfinished) >= MAX_UNFINISHED:
            self._unfinished.clear()
