"""Messages to frames and back.

| kind         | payload                                                                           |
|--------------|-----------------------------------------------------------------------------------|
| HELLO (1)    | `lfld`, version (2 bytes), checksum, msgpack of `Hello`                           |
| REFUSE (2)   | a sentence in UTF-8                                                               |
| CONTROL (4)  | checksum, msgpack of one of the `Control` messages                                |
| TRANSFER (7) | header length (2 bytes), checksum, that of the block, msgpack of `Transfer`, block |

Numbers are big-endian. A checksum is the CRC-32 of everything else in its frame, the frame's own header
included; a transfer has one for all before the block, so that a header can be believed whose block was never
read, and one for the block. A frame that does not fit its checksum is a WireError: the link is closed and
whatever was on its way is asked for again. The kinds differ by two bits at least: one bit that flips
makes none of them another.

HELLO's first six bytes and the whole of REFUSE stay as they are in every version to come, so that two
hosts of different versions can tell each other what is wrong. A REFUSE needs no checksum: whatever its
sentence says, it ends the link.
"""

from __future__ import annotations

import struct
import zlib
from typing import TYPE_CHECKING, TypeVar

import msgspec

from lfield.errors import WireError
from lfield.wire.framing import Buffer, FrameDecoder, frame, frame_header
from lfield.wire.messages import MAX_TEXT, PROTOCOL, Control, ForeignHello, Hello, Message, Refuse, Transfer

if TYPE_CHECKING:
    from collections.abc import Callable

T = TypeVar("T")

HELLO, REFUSE, CONTROL, TRANSFER = 1, 2, 4, 7

MAGIC = b"lfld"

#: The most bytes a Transfer's header takes: a name of 128 characters of 4 bytes, a hash, and numbers.
MAX_TRANSFER_HEADER = 1024

_HELLO_START = struct.Struct(">4sH")
_CHECKSUM = struct.Struct(">I")
_TRANSFER_START = struct.Struct(">HII")
_UNDER_CHECK = struct.Struct(">HI")  # what of it is under the first checksum
_LIMITS = {HELLO: 2 << 20, REFUSE: 4 * MAX_TEXT, CONTROL: 1 << 20}

_encode = msgspec.msgpack.Encoder().encode
_hello: msgspec.msgpack.Decoder[Hello] = msgspec.msgpack.Decoder(Hello)
_transfer: msgspec.msgpack.Decoder[Transfer] = msgspec.msgpack.Decoder(Transfer)
_control: msgspec.msgpack.Decoder[Control] = msgspec.msgpack.Decoder(Control)


def frame_decoder(max_block: int, on_oversize: Callable[[Transfer, int], None]) -> FrameDecoder:
    """A decoder for one link; `max_block` is the largest block to take, in bytes.

    The block of a larger transfer is thrown away as it arrives, then `on_oversize` is called with its
    header and its size in bytes. It may raise WireError, as `FrameDecoder.feed` then does.
    """

    def skipped(kind: int, length: int, head: bytes) -> None:
        header, start, _ = _split_transfer(head, length)
        on_oversize(header, length - start)

    limits = _LIMITS | {TRANSFER: max_block + MAX_TRANSFER_HEADER}
    return FrameDecoder(limits, skippable={TRANSFER: MAX_TRANSFER_HEADER}, on_skipped=skipped)


def encode(message: Message) -> bytes:
    """The whole frame of a message."""
    if isinstance(message, Hello):
        return _checked_frame(HELLO, _HELLO_START.pack(MAGIC, PROTOCOL), _encode(message))
    if isinstance(message, Refuse):
        return frame(REFUSE, message.reason[:MAX_TEXT].encode())
    return _checked_frame(CONTROL, b"", _encode(message))


def encode_transfer(header: Transfer, block: Buffer) -> bytes:
    """The bytes to send before a block: frame header and transfer header."""
    body, check = _encode(header), zlib.crc32(block)
    before = frame_header(TRANSFER, _TRANSFER_START.size + len(body) + len(block))
    start = _TRANSFER_START.pack(len(body), _head_checksum(before, check, body), check)
    return b"".join((before, start, body))


def decode(kind: int, payload: Buffer) -> Message:
    """The message of a frame that is not a TRANSFER. Raises WireError."""
    if kind == CONTROL:
        return _strict(_control, _checked_body(CONTROL, payload, 0))
    if kind == HELLO:
        return _decode_hello(payload)
    if kind == REFUSE:
        return Refuse(bytes(payload).decode(errors="replace"))
    raise WireError(f"a frame of kind {kind} is not a message")


def decode_transfer(payload: Buffer) -> tuple[Transfer, memoryview]:
    """Header and block of a TRANSFER frame; the block is a view into the payload. Raises WireError."""
    header, start, check = _split_transfer(payload, len(payload))
    block = memoryview(payload)[start:]
    if len(block) != header.size:
        raise WireError(f"a transfer of {header.agent} promised {header.size} bytes and has {len(block)}")
    if zlib.crc32(block) != check:
        raise WireError(f"the block of {header.agent} was damaged on the way: its checksum does not fit")
    return header, block


def _decode_hello(payload: Buffer) -> Hello | ForeignHello:
    if len(payload) < _HELLO_START.size:
        raise WireError("a greeting is too short; the peer is not an lfield host")
    magic, protocol = _HELLO_START.unpack_from(payload)
    if magic != MAGIC:
        raise WireError("a greeting does not begin with 'lfld'; the peer is not an lfield host")
    if protocol != PROTOCOL:
        return ForeignHello(protocol)
    return _strict(_hello, _checked_body(HELLO, payload, _HELLO_START.size))


def _split_transfer(payload: Buffer, length: int) -> tuple[Transfer, int, int]:
    """The transfer header, where the block begins, and the block's checksum.

    `length` is that of the whole payload, of which the beginning is enough.
    """
    if len(payload) < _TRANSFER_START.size:
        raise WireError("a transfer is too short to have a header")
    size, expected, check = _TRANSFER_START.unpack_from(payload)
    start = _TRANSFER_START.size + size
    if start > MAX_TRANSFER_HEADER:
        raise WireError(f"a transfer has a header of {size} bytes; the peer does not speak lfield")
    body = memoryview(payload)[_TRANSFER_START.size : start]
    if _head_checksum(frame_header(TRANSFER, length), check, body) != expected:
        raise WireError("the header of a transfer was damaged on the way: its checksum does not fit")
    return _strict(_transfer, body), start, check


def _head_checksum(before: bytes, check: int, body: Buffer) -> int:
    """That of a transfer without its block: frame header, both numbers before the header, header."""
    return zlib.crc32(body, zlib.crc32(_UNDER_CHECK.pack(len(body), check), zlib.crc32(before)))


def _checked_frame(kind: int, start: bytes, body: bytes) -> bytes:
    """A frame with the checksum between the two parts of its payload."""
    before = frame_header(kind, len(start) + _CHECKSUM.size + len(body)) + start
    return b"".join((before, _CHECKSUM.pack(zlib.crc32(body, zlib.crc32(before))), body))


def _checked_body(kind: int, payload: Buffer, start: int) -> memoryview:
    """What follows the checksum that stands at `start`. Raises WireError."""
    view, body = memoryview(payload), start + _CHECKSUM.size
    if len(view) < body:
        raise WireError("a message is too short to have a checksum")
    before = zlib.crc32(view[:start], zlib.crc32(frame_header(kind, len(view))))
    if zlib.crc32(view[body:], before) != _CHECKSUM.unpack_from(view, start)[0]:
        raise WireError("a message was damaged on the way: its checksum does not fit")
    return view[body:]


def _strict(decoder: msgspec.msgpack.Decoder[T], payload: Buffer) -> T:
    try:
        return decoder.decode(payload)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        raise WireError(f"a message cannot be read: {error}") from None
