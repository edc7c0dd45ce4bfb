"""Messages to frames and back.

| kind         | payload                                                             |
|--------------|---------------------------------------------------------------------|
| HELLO (1)    | `lfld`, version (2 bytes, big-endian), msgpack of `Hello`           |
| REFUSE (2)   | a sentence in UTF-8                                                 |
| TRANSFER (3) | header length (2 bytes, big-endian), msgpack of `Transfer`, block   |
| CONTROL (4)  | msgpack of one of the `Control` messages                            |

HELLO's first six bytes and the whole of REFUSE stay as they are in every version to come, so that two
hosts of different versions can tell each other what is wrong.
"""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, TypeVar

import msgspec

from lfield.errors import WireError
from lfield.wire.framing import Buffer, FrameDecoder, frame, frame_header
from lfield.wire.messages import MAX_TEXT, PROTOCOL, Control, ForeignHello, Hello, Message, Refuse, Transfer

if TYPE_CHECKING:
    from collections.abc import Callable

T = TypeVar("T")

HELLO, REFUSE, TRANSFER, CONTROL = 1, 2, 3, 4

MAGIC = b"lfld"

#: The most bytes a Transfer's header takes: a name of 128 characters of 4 bytes, a hash, and numbers.
MAX_TRANSFER_HEADER = 1024

_HELLO_START = struct.Struct(">4sH")
_HEADER_LENGTH = struct.Struct(">H")
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
        header, start = _split_transfer(head)
        on_oversize(header, length - start)

    limits = _LIMITS | {TRANSFER: max_block + MAX_TRANSFER_HEADER}
    return FrameDecoder(limits, skippable={TRANSFER: MAX_TRANSFER_HEADER}, on_skipped=skipped)


def encode(message: Message) -> bytes:
    """The whole frame of a message."""
    if isinstance(message, Hello):
        return frame(HELLO, _HELLO_START.pack(MAGIC, PROTOCOL) + _encode(message))
    if isinstance(message, Refuse):
        return frame(REFUSE, message.reason[:MAX_TEXT].encode())
    return frame(CONTROL, _encode(message))


def encode_transfer(header: Transfer, size: int) -> bytes:
    """The bytes to send before a block of `size` bytes: frame header and transfer header."""
    body = _encode(header)
    start = _HEADER_LENGTH.pack(len(body))
    return frame_header(TRANSFER, len(start) + len(body) + size) + start + body


def decode(kind: int, payload: Buffer) -> Message:
    """The message of a frame that is not a TRANSFER. Raises WireError."""
    if kind == CONTROL:
        return _strict(_control, payload)
    if kind == HELLO:
        return _decode_hello(payload)
    if kind == REFUSE:
        return Refuse(bytes(payload).decode(errors="replace"))
    raise WireError(f"a frame of kind {kind} is not a message")


def decode_transfer(payload: Buffer) -> tuple[Transfer, memoryview]:
    """Header and block of a TRANSFER frame; the block is a view into the payload. Raises WireError."""
    header, start = _split_transfer(payload)
    block = memoryview(payload)[start:]
    if len(block) != header.size:
        raise WireError(f"a transfer of {header.agent} promised {header.size} bytes and has {len(block)}")
    return header, block


def _decode_hello(payload: Buffer) -> Hello | ForeignHello:
    if len(payload) < _HELLO_START.size:
        raise WireError("a greeting is too short; the peer is not an lfield host")
    magic, protocol = _HELLO_START.unpack_from(payload)
    if magic != MAGIC:
        raise WireError("a greeting does not begin with 'lfld'; the peer is not an lfield host")
    if protocol != PROTOCOL:
        return ForeignHello(protocol)
    return _strict(_hello, memoryview(payload)[_HELLO_START.size :])


def _split_transfer(payload: Buffer) -> tuple[Transfer, int]:
    """The transfer header and where the block begins."""
    if len(payload) < _HEADER_LENGTH.size:
        raise WireError("a transfer is too short to have a header")
    (length,) = _HEADER_LENGTH.unpack_from(payload)
    start = _HEADER_LENGTH.size + length
    if start > MAX_TRANSFER_HEADER:
        raise WireError(f"a transfer has a header of {length} bytes; the peer does not speak lfield")
    return _strict(_transfer, memoryview(payload)[_HEADER_LENGTH.size : start]), start


def _strict(decoder: msgspec.msgpack.Decoder[T], payload: Buffer) -> T:
    try:
        return decoder.decode(payload)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        raise WireError(f"a message cannot be read: {error}") from None
