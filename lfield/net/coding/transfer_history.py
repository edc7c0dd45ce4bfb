"""Encodes transfers as deltas against the last transfer of the same coordinator on a link. Sans-IO.

Both ends of a link keep the last transfer of each coordinator, in either direction, up to a limit of bytes. A
delta names its reference by agent and digest. If the receiver does not have it (two transfers crossed), it
requests the whole transfer.

A delta frame contains: size of the whole transfer (4 bytes), digest of the reference (8), length of the
agent's name (2), name, delta. Numbers are big-endian. The frame needs no checksum, because the expanded
transfer has two.
"""

from __future__ import annotations

import hashlib
import struct
from typing import TYPE_CHECKING, NamedTuple

from lfield.errors import WireError
from lfield.net.coding.delta import encode_delta, expand_delta
from lfield.wire.codec import MAX_TRANSFER_HEADER, TRANSFER_DELTA
from lfield.wire.framing import HEADER_SIZE, frame

if TYPE_CHECKING:
    from lfield.wire.framing import Buffer

#: Maximum bytes kept for a link. A transfer that does not fit is not kept and is sent whole, instead of
#: evicting others: coordinators that take turns would evict one another. Both ends remove a coordinator after
#: this number of transfers of others.
MAX_KEPT, FORGET_AFTER = 512 << 10, 64
#: Up to this round trip in seconds transfers are not coded: the network takes less time for the bytes than
#: the processor for coding them.
FAST_PATH = 0.001

_START = struct.Struct(">I8sH")


class Delta(NamedTuple):
    """A decoded delta frame whose reference is known: expand it only as far as permitted."""

    agent: str
    size: int
    reference: Buffer
    delta: memoryview

    def expand(self) -> bytes:
        """The whole transfer. Raises WireError."""
        return expand_delta(self.delta, self.reference, self.size)

    def leading_bytes(self) -> bytes:
        """The beginning of the transfer, with its header. Raises WireError."""
        return expand_delta(self.delta, self.reference, min(self.size, MAX_TRANSFER_HEADER))


class MissingReference(NamedTuple):
    """The receiver has no copy that a delta refers to."""

    agent: str


class TransferHistory:
    """The last transfers of a link, as payloads of TRANSFER frames, by coordinator."""

    def __init__(self) -> None:
        #: The payload, whether this end sent it, and its number; the least recently used one first.
        self._transfers: dict[str, tuple[Buffer, bool, int]] = {}
        self._size = self._count = 0

    def encode(self, agent: str, whole: bytes, *, is_fast: bool) -> bytes:
        """The frame to send for a transfer, given as a TRANSFER frame; keeps this transfer as the next
        reference.

        `is_fast`: whether the network takes less time for the bytes than the processor for the delta.
        """
        previous, payload = self._transfers.get(agent), memoryview(whole)[HEADER_SIZE:]
        is_kept = self.keep(agent, payload, is_sent=True)
        if previous is None or is_fast or not is_kept:
            return whole
        reference = previous[0]
        name, delta = agent.encode(), encode_delta(payload, reference)
        if len(delta) >= len(payload):
            return whole
        start = _START.pack(len(payload), _digest(reference), len(name))
        return frame(TRANSFER_DELTA, b"".join((start, name, delta)))

    def keep(self, agent: str, payload: Buffer, *, is_sent: bool) -> bool:
        """Keep a transfer that was sent or has arrived, unless it does not fit; returns whether it is kept.

        `payload` must not change.
        """
        self._count += 1
        if (before := self._transfers.pop(agent, None)) is not None:
            self._size -= len(before[0])
        while (
            self._transfers
            and self._transfers[oldest := next(iter(self._transfers))][2] < self._count - FORGET_AFTER
        ):
            self._size -= len(self._transfers.pop(oldest)[0])
        if self._size + len(payload) > MAX_KEPT:
            return False
        self._transfers[agent] = payload, is_sent, self._count
        self._size += len(payload)
        return True

    def decode(self, payload: memoryview) -> Delta | MissingReference:
        """The delta of a frame. Raises WireError."""
        if len(payload) < _START.size:
            raise WireError("a delta is too short to have a header")
        size, digest, length = _START.unpack_from(payload)
        end = _START.size + length
        try:
            agent = bytes(payload[_START.size : end]).decode()
        except UnicodeDecodeError as error:
            raise WireError(f"a delta names no agent: {error}") from None
        previous = self._transfers.get(agent)
        if previous is None or _digest(previous[0]) != digest:
            return MissingReference(agent)
        return Delta(agent, size, previous[0], payload[end:])

    def whole(self, agent: str) -> Buffer | None:
        """The last transfer of a coordinator if this end sent it."""
        transfer = self._transfers.get(agent)
        return transfer[0] if transfer is not None and transfer[1] else None


def _digest(payload: Buffer) -> bytes:
    return hashlib.blake2b(payload, digest_size=8).digest()
