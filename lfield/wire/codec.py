"""Encodes messages as frames, and decodes them.

| kind         | payload                                                                          |
|--------------|----------------------------------------------------------------------------------|
| HELLO (1)    | `lfld`, version (2 bytes), checksum, msgpack of `Hello`                          |
| REFUSE (2)   | a sentence in UTF-8                                                              |
| CONTROL (4)  | checksum, msgpack of one of the `Control` messages                               |
| TRANSFER (7) | checksum, that of the block, header length (2 bytes), msgpack of `Transfer`, block |
| PART (8)     | the next bytes of one long frame of another kind, its own header included        |
| TRANSFER_DELTA (11) | a TRANSFER payload as the difference from an earlier one (`lfield.net.coding`) |
| COMPRESSED (13) | checksum, a CONTROL message compressed in the context of earlier ones            |

Numbers are big-endian. A checksum is the CRC-32 of the bytes after it, initialised with the length of the
payload instead of zero. The checksum of a transfer covers only the header; the block has a checksum of its
own, so that a header can be verified without reading its block. The block has an Adler-32, which takes a
fifth of the time and also detects every single flipped bit. A frame with a wrong checksum is a WireError: the
link is closed, and lost messages are requested again. Any two kinds differ in at least two bits, so that one
flipped bit never changes a kind into another one.

A long frame may be sent in parts, so that a stop order can be sent between two of them. The parts of a frame
are consecutive, and no part has bytes of two frames.

The first six bytes of HELLO and the whole of REFUSE stay unchanged in all future versions, so that hosts of
different versions can report the mismatch. A REFUSE needs no checksum: it ends the link in any case.
"""

from __future__ import annotations

import struct
import zlib
from typing import TYPE_CHECKING, TypeVar

import msgspec
from msgspec.structs import replace

from lfield.errors import WireError
from lfield.wire.coordinator_messages import Transfer
from lfield.wire.fields import MAX_TEXT
from lfield.wire.framing import FRAME_HEADER, HEADER_SIZE, Buffer, FrameDecoder, frame
from lfield.wire.messages import PROTOCOL, Control, HandshakeRefused, Hello, IncompatibleHello, Message, Role

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

T = TypeVar("T")

HELLO, REFUSE, CONTROL, TRANSFER, PART = 1, 2, 4, 7, 8
TRANSFER_DELTA, COMPRESSED = 11, 13

MAGIC = b"lfld"

#: The maximum size of a Transfer's header in bytes: a name of 128 characters of 4 bytes, a hash, and numbers.
MAX_TRANSFER_HEADER = 1024

_HELLO_START = struct.Struct(">4sH")
_CHECKSUM = struct.Struct(">I")
#: The header's checksum, the block's, the size of `Transfer`; and the offset at which the part covered by the
#: first one begins.
_TRANSFER_START, _TRANSFER_CHECKED = struct.Struct(">IIH"), struct.Struct(">IH")

#: The maximum size of a message before the handshake, in bytes: unauthenticated peers may send such messages
#: and occupy memory.
HANDSHAKE_LIMITS = {HELLO: 1 << 18, REFUSE: 4 * MAX_TEXT}
_OBSERVER_LIMITS = HANDSHAKE_LIMITS | dict.fromkeys((CONTROL, COMPRESSED), 8 * MAX_TEXT)
_HOST_LIMITS = HANDSHAKE_LIMITS | dict.fromkeys((CONTROL, COMPRESSED), 1 << 20)
#: The longest payload of a part, in bytes.
MAX_PART = 1 << 17
_PARTS = {PART: MAX_PART}

#: The exceptions of the decoders for malformed bytes.
UNREADABLE = (msgspec.MsgspecError, UnicodeDecodeError, RecursionError)

_encode = msgspec.msgpack.Encoder().encode
_hello: msgspec.msgpack.Decoder[Hello] = msgspec.msgpack.Decoder(Hello)
_transfer: msgspec.msgpack.Decoder[Transfer] = msgspec.msgpack.Decoder(Transfer)
_control: msgspec.msgpack.Decoder[Control] = msgspec.msgpack.Decoder(Control)


def frame_decoder(on_oversize: Callable[[Transfer, int], None]) -> FrameDecoder:
    """A decoder for one link, which accepts only handshakes until its limits are widened.

    The block of an oversized transfer is discarded as it arrives, then `on_oversize` is called with its
    header and its size in bytes. `on_oversize` may raise WireError, which `FrameDecoder.feed` passes on.
    """

    def skipped(kind: int, length: int, head: bytes) -> None:
        header, start, _ = _split_transfer(head, length)
        on_oversize(header, length - start)

    return FrameDecoder(HANDSHAKE_LIMITS, skippable={TRANSFER: MAX_TRANSFER_HEADER}, on_skipped=skipped)


def limits(role: Role, max_block: int) -> Mapping[int, int]:
    """The limits for a peer after its handshake; `max_block` is the largest accepted block, in bytes."""
    return part_limits(role, max_block) | _PARTS


def part_limits(role: Role, max_block: int) -> dict[int, int]:
    """The limits for frames in parts."""
    if role == "observer":
        return _OBSERVER_LIMITS
    return _HOST_LIMITS | dict.fromkeys((TRANSFER, TRANSFER_DELTA), max_block + MAX_TRANSFER_HEADER)


def may_be_fragmented(frame: Buffer) -> bool:
    """Whether a frame may be sent in parts: handshake messages may not, because it is unknown whether the
    peer supports parts.
    """
    return frame[HEADER_SIZE - 1] not in (HELLO, REFUSE, PART)


def encode(message: Message) -> bytes:
    """The whole frame of a message."""
    if isinstance(message, Hello):
        return _encode_hello(message)
    if isinstance(message, HandshakeRefused):
        return frame(REFUSE, message.reason[:MAX_TEXT].encode())
    return frame(CONTROL, _with_checksum(message, 0))


def compress_frame(whole: Buffer, compress: Callable[[Buffer], bytes]) -> bytes:
    """The COMPRESSED frame for a CONTROL frame."""
    body = memoryview(whole)[HEADER_SIZE + _CHECKSUM.size :]
    return frame(COMPRESSED, _checked(compress(body), 0))


def encode_transfer(header: Transfer, block: Buffer) -> bytes:
    """The bytes to send before a block: frame header and transfer header."""
    body = _encode(header)
    start = _TRANSFER_CHECKED.pack(zlib.adler32(block), len(body)) + body
    length = _CHECKSUM.size + len(start) + len(block)
    return FRAME_HEADER.pack(length + 1, TRANSFER) + _CHECKSUM.pack(zlib.crc32(start, length)) + start


def decode(kind: int, payload: Buffer) -> Message:
    """The message of a frame that is not a TRANSFER. Raises WireError."""
    if kind == CONTROL:
        return _strict(_control, _verify_checksum(payload, 0))
    if kind == HELLO:
        return _decode_hello(payload)
    if kind == REFUSE:
        return HandshakeRefused(bytes(payload).decode(errors="replace"))
    raise WireError(f"a frame of kind {kind} is not a message")


def decode_compressed(payload: Buffer, expand: Callable[[Buffer], bytes]) -> Control:
    """The message of a COMPRESSED frame. Raises WireError."""
    return _strict(_control, expand(_verify_checksum(payload, 0)))


def decode_transfer(payload: Buffer) -> tuple[Transfer, memoryview]:
    """Header and block of a TRANSFER frame; the block is a view into the payload. Raises WireError."""
    header, start, check = _split_transfer(payload, len(payload))
    block = memoryview(payload)[start:]
    if len(block) != header.size:
        raise WireError(f"a transfer of {header.agent} promised {header.size} bytes and has {len(block)}")
    if zlib.adler32(block) != check:
        raise WireError(f"the block of {header.agent} was damaged on the way: its checksum does not fit")
    return header, block


def transfer_header(start: Buffer, length: int) -> Transfer:
    """The header of a TRANSFER payload of `length` bytes, from its first bytes. Raises WireError."""
    return _split_transfer(start, length)[0]


def _encode_hello(hello: Hello) -> bytes:
    payload = _HELLO_START.pack(MAGIC, PROTOCOL) + _with_checksum(hello, _HELLO_START.size)
    if len(payload) > HANDSHAKE_LIMITS[HELLO] and any(known.detail for known in hello.coordinators):
        # The reasons are repeated by each Terminated; only the terminations themselves are needed here.
        return _encode_hello(replace(hello, coordinators=[replace(k, detail="") for k in hello.coordinators]))
    return frame(HELLO, payload)


def _decode_hello(payload: Buffer) -> Hello | IncompatibleHello:
    if len(payload) < _HELLO_START.size:
        raise WireError("a greeting is too short; the peer is not an lfield host")
    magic, protocol = _HELLO_START.unpack_from(payload)
    if magic != MAGIC:
        raise WireError("a greeting does not begin with 'lfld'; the peer is not an lfield host")
    if protocol != PROTOCOL:
        return IncompatibleHello(protocol)
    return _strict(_hello, _verify_checksum(payload, _HELLO_START.size))


def _split_transfer(payload: Buffer, length: int) -> tuple[Transfer, int, int]:
    """The transfer header, the offset of the block, and the block's checksum.

    `length` is the length of the whole payload; the beginning of it is sufficient.
    """
    if len(payload) < _TRANSFER_START.size:
        raise WireError("a transfer is too short to have a header")
    expected, check, size = _TRANSFER_START.unpack_from(payload)
    start = _TRANSFER_START.size + size
    if start > MAX_TRANSFER_HEADER:
        raise WireError(f"a transfer has a header of {size} bytes; the peer does not speak lfield")
    head = memoryview(payload)[:start]
    if zlib.crc32(head[_CHECKSUM.size :], length) != expected:
        raise WireError("the header of a transfer was damaged on the way: its checksum does not fit")
    try:
        return _transfer.decode(head[_TRANSFER_START.size :]), start, check
    except UNREADABLE as error:
        raise WireError(f"a message cannot be read: {error}") from None


def _with_checksum(message: Message, before: int) -> bytes:
    """A message after its checksum; `before` are the bytes of the payload before these two."""
    return _checked(_encode(message), before)


def _checked(body: bytes, before: int) -> bytes:
    return _CHECKSUM.pack(zlib.crc32(body, before + _CHECKSUM.size + len(body))) + body


def _verify_checksum(payload: Buffer, before: int) -> memoryview:
    """The bytes after the checksum at `before`. Raises WireError."""
    if len(payload) < before + _CHECKSUM.size:
        raise WireError("a message is too short to have a checksum")
    body = memoryview(payload)[before + _CHECKSUM.size :]
    if zlib.crc32(body, len(payload)) != _CHECKSUM.unpack_from(payload, before)[0]:
        raise WireError("a message was damaged on the way: its checksum does not fit")
    return body


def _strict(decoder: msgspec.msgpack.Decoder[T], payload: Buffer) -> T:
    try:
        return decoder.decode(payload)
    except UNREADABLE as error:
        raise WireError(f"a message cannot be read: {error}") from None
