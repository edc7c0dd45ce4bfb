"""Messages to frames and back.

| kind         | payload                                                                          |
|--------------|----------------------------------------------------------------------------------|
| HELLO (1)    | `lfld`, version (2 bytes), checksum, msgpack of `Hello`                          |
| REFUSE (2)   | a sentence in UTF-8                                                              |
| CONTROL (4)  | checksum, msgpack of one of the `Control` messages                               |
| TRANSFER (7) | checksum, that of the block, header length (2 bytes), msgpack of `Transfer`, block |
| PART (8)     | the next bytes of one long CONTROL or TRANSFER frame, its own header included    |

Numbers are big-endian. A checksum is the CRC-32 of what follows it, begun with the length of the payload
instead of zero. That of a transfer ends before the block, which has its own, so that a header can be believed
whose block was never read. The block has an Adler-32, which costs a fifth of it and finds every single
flipped bit as well. A frame that does not fit its checksum is a WireError: the link is closed, and whatever
was on its way is asked for again. The kinds differ by two bits at least: one bit that flips makes none of
them another.

A long frame may be sent as parts, so that an order to stop passes between two of them. Parts of one frame
follow one another, and no part has bytes of two frames.

HELLO's first six bytes and the whole of REFUSE stay as they are in every version to come, so that two
hosts of different versions can tell each other what is wrong. A REFUSE needs no checksum: whatever its
sentence says, it ends the link.
"""

from __future__ import annotations

import struct
import zlib
from typing import TYPE_CHECKING, TypeVar

import msgspec
from msgspec.structs import replace

from lfield.errors import WireError
from lfield.wire.coordinators import Transfer
from lfield.wire.fields import MAX_TEXT
from lfield.wire.framing import HEADER_SIZE, Buffer, FrameDecoder, frame, frame_header
from lfield.wire.messages import PROTOCOL, Control, ForeignHello, Hello, Message, Refuse, Role

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

T = TypeVar("T")

HELLO, REFUSE, CONTROL, TRANSFER, PART = 1, 2, 4, 7, 8

MAGIC = b"lfld"

#: The most bytes a Transfer's header takes: a name of 128 characters of 4 bytes, a hash, and numbers.
MAX_TRANSFER_HEADER = 1024

_HELLO_START = struct.Struct(">4sH")
_CHECKSUM = struct.Struct(">I")
#: The header's checksum, the block's, the size of `Transfer`; and what of that the first one is of.
_TRANSFER_START, _TRANSFER_CHECKED = struct.Struct(">IIH"), struct.Struct(">IH")

#: What may come before the greeting, in bytes: anybody may send that, and hold so much memory.
GREETING_LIMITS = {HELLO: 1 << 18, REFUSE: 4 * MAX_TEXT}
_OBSERVER_LIMITS = GREETING_LIMITS | {CONTROL: 8 * MAX_TEXT}
_HOST_LIMITS = GREETING_LIMITS | {CONTROL: 1 << 20}
#: The longest payload of a part, in bytes.
MAX_PART = 1 << 17
_PARTS = {PART: MAX_PART}

_encode = msgspec.msgpack.Encoder().encode
_hello: msgspec.msgpack.Decoder[Hello] = msgspec.msgpack.Decoder(Hello)
_transfer: msgspec.msgpack.Decoder[Transfer] = msgspec.msgpack.Decoder(Transfer)
_control: msgspec.msgpack.Decoder[Control] = msgspec.msgpack.Decoder(Control)


def frame_decoder(on_oversize: Callable[[Transfer, int], None]) -> FrameDecoder:
    """A decoder for one link, which lets only greetings pass until its limits are widened.

    The block of a larger transfer is thrown away as it arrives, then `on_oversize` is called with its
    header and its size in bytes. It may raise WireError, as `FrameDecoder.feed` then does.
    """

    def skipped(kind: int, length: int, head: bytes) -> None:
        header, start, _ = _split_transfer(head, length)
        on_oversize(header, length - start)

    return FrameDecoder(GREETING_LIMITS, skippable={TRANSFER: MAX_TRANSFER_HEADER}, on_skipped=skipped)


def limits(role: Role, max_block: int) -> Mapping[int, int]:
    """What may come from a peer that has greeted; `max_block` is the largest block to take, in bytes."""
    return part_limits(role, max_block) | _PARTS


def part_limits(role: Role, max_block: int) -> dict[int, int]:
    """What may come of it in parts."""
    if role == "observer":
        return _OBSERVER_LIMITS
    return _HOST_LIMITS | {TRANSFER: max_block + MAX_TRANSFER_HEADER}


def may_be_parted(frame: Buffer) -> bool:
    """Whether a frame may be sent in parts: greetings and refusals are read before that is known."""
    return frame[HEADER_SIZE - 1] in (CONTROL, TRANSFER)


def encode(message: Message) -> bytes:
    """The whole frame of a message."""
    if isinstance(message, Hello):
        return _encode_hello(message)
    if isinstance(message, Refuse):
        return frame(REFUSE, message.reason[:MAX_TEXT].encode())
    return frame(CONTROL, _checked(message, 0))


def encode_transfer(header: Transfer, block: Buffer) -> bytes:
    """The bytes to send before a block: frame header and transfer header."""
    body = _encode(header)
    start = _TRANSFER_CHECKED.pack(zlib.adler32(block), len(body)) + body
    length = _CHECKSUM.size + len(start) + len(block)
    return frame_header(TRANSFER, length) + _CHECKSUM.pack(zlib.crc32(start, length)) + start


def decode(kind: int, payload: Buffer) -> Message:
    """The message of a frame that is not a TRANSFER. Raises WireError."""
    if kind == CONTROL:
        return _strict(_control, _check(payload, 0))
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
    if zlib.adler32(block) != check:
        raise WireError(f"the block of {header.agent} was damaged on the way: its checksum does not fit")
    return header, block


def _encode_hello(hello: Hello) -> bytes:
    payload = _HELLO_START.pack(MAGIC, PROTOCOL) + _checked(hello, _HELLO_START.size)
    if len(payload) > GREETING_LIMITS[HELLO] and any(known.detail for known in hello.coordinators):
        # Why hundreds have ended is told by each Ended too; that they have ended must be told here.
        return _encode_hello(replace(hello, coordinators=[replace(k, detail="") for k in hello.coordinators]))
    return frame(HELLO, payload)


def _decode_hello(payload: Buffer) -> Hello | ForeignHello:
    if len(payload) < _HELLO_START.size:
        raise WireError("a greeting is too short; the peer is not an lfield host")
    magic, protocol = _HELLO_START.unpack_from(payload)
    if magic != MAGIC:
        raise WireError("a greeting does not begin with 'lfld'; the peer is not an lfield host")
    if protocol != PROTOCOL:
        return ForeignHello(protocol)
    return _strict(_hello, _check(payload, _HELLO_START.size))


def _split_transfer(payload: Buffer, length: int) -> tuple[Transfer, int, int]:
    """The transfer header, where the block begins, and the block's checksum.

    `length` is that of the whole payload, of which the beginning is enough.
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
    return _strict(_transfer, head[_TRANSFER_START.size :]), start, check


def _checked(message: Message, before: int) -> bytes:
    """A message behind its checksum; `before` are the bytes of the payload that go before the two."""
    body = _encode(message)
    return _CHECKSUM.pack(zlib.crc32(body, before + _CHECKSUM.size + len(body))) + body


def _check(payload: Buffer, before: int) -> memoryview:
    """What stands behind the checksum, which is at `before`. Raises WireError."""
    if len(payload) < before + _CHECKSUM.size:
        raise WireError("a message is too short to have a checksum")
    body = memoryview(payload)[before + _CHECKSUM.size :]
    if zlib.crc32(body, len(payload)) != _CHECKSUM.unpack_from(payload, before)[0]:
        raise WireError("a message was damaged on the way: its checksum does not fit")
    return body


def _strict(decoder: msgspec.msgpack.Decoder[T], payload: Buffer) -> T:
    try:
        return decoder.decode(payload)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        raise WireError(f"a message cannot be read: {error}") from None
