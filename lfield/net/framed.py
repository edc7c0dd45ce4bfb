"""What every link does alike: messages to bytes, bytes to messages, and closing on bad ones."""

from __future__ import annotations

from typing import TYPE_CHECKING

from lfield.authority.identity import STRANGER
from lfield.errors import AddressError, GreetingError, WireError
from lfield.loop import unexpected
from lfield.net.waiting.rations import CROWD
from lfield.wire.codec import (
    TRANSFER,
    decode,
    decode_transfer,
    encode,
    encode_transfer,
    frame_decoder,
    limits,
)

if TYPE_CHECKING:
    from collections.abc import Iterator

    from lfield.authority.identity import Identity
    from lfield.errors import LfieldError
    from lfield.net.health.traffic import Counts
    from lfield.net.transport import LinkHandler
    from lfield.wire.coordinators import Transfer
    from lfield.wire.framing import Buffer
    from lfield.wire.messages import Message, Role

#: So many bytes of a message count as one more (`FramedLink.weight`).
_HEAVY = 1 << 11

#: Coordinators of which it is remembered when they came last.
_MOST_REMEMBERED = 256

# Up to here one copy is cheaper than a second system call; a larger block is written by itself.
_ONE_WRITE = 64 * 1024


class FramedLink:
    """A link over some stream of bytes. A transport's own link gives it `write` and `close`.

    The transport sets `handler` before the first bytes arrive, passes these to `received`, and the end of
    the stream to `finished`.
    """

    handler: LinkHandler

    def __init__(self, peer: str, max_block: int) -> None:
        self.peer = peer
        self.who: Identity = STRANGER
        self.closed = False
        #: How much was taken: a transfer counts one, a message one and one more for each _HEAVY bytes. A
        #: transfer that did not wait for the answer to the one before counts as a crowd: see `_weigh`.
        self.weight = 0
        #: How many reads there were, in which of them the current message began, and in which the last
        #: transfer of each coordinator was complete.
        self.reads = self._began = 0
        self._completed: dict[str, int] = {}
        self._error: LfieldError | None = None
        self._max_block = max_block
        self._decoder = frame_decoder(self._oversize)

    def write(self, data: Buffer) -> None:
        """Queue bytes as they are. Only `send` and `send_transfer`, and tests of bad bytes, call it."""
        raise NotImplementedError

    def write_now(self, data: Buffer) -> None:
        """Write bytes at once, behind what is queued; the same where a transport knows no difference."""
        self.write(data)

    def close(self) -> None:
        """Send what is queued, then close; sets `closed`."""
        raise NotImplementedError

    def abort(self) -> None:
        """Close and lose what is queued; sets `closed`."""
        raise NotImplementedError

    def greeted(self, role: Role) -> None:
        """See `Link.greeted`."""
        self._decoder.limits = limits(role, self._max_block)

    def expect(self, round_trip: float) -> None:
        """See `Link.expect`: nothing to do without a socket."""

    def counts(self) -> Counts | None:
        """See `Link.counts`."""
        return None

    def send(self, message: Message) -> None:
        """Queue a message. Raises AddressError on a closed link."""
        self._require_open()
        self.write(encode(message))

    def send_transfer(self, header: Transfer, block: Buffer) -> None:
        """Send a coordinator, at once. Raises AddressError on a closed link."""
        self._require_open()
        head = encode_transfer(header, block)
        if len(block) <= _ONE_WRITE:
            self.write_now(b"".join((head, block)))
        else:
            self.write_now(head)
            self.write_now(block)

    def received(self, data: Buffer) -> None:
        """Hand on what the next bytes complete; close on bytes or messages that must not be."""
        if not self._decoder.unfinished:
            self._began = self.reads
        frame = self._decoder.whole(data)
        try:
            for kind, payload in self._decoder.feed(data) if frame is None else (frame,):
                if kind == TRANSFER:
                    header, block = decode_transfer(payload)
                    self._weigh(header)
                    self.handler.on_transfer(self, header, block)
                else:
                    self.weight += 1 + len(payload) // _HEAVY
                    self.handler.on_message(self, decode(kind, payload))
                if self.closed:
                    break
        except (WireError, GreetingError) as error:
            self._error = error
            self.close()
        except Exception as error:
            self.close()
            unexpected(error)

    @property
    def is_amid(self) -> bool:
        """Whether a message has begun to come and is not complete."""
        return self._decoder.unfinished

    def _weigh(self, header: Transfer) -> None:
        """A host sends a coordinator again only after the answer. One that began to come in the read with
        which the last transfer of the same coordinator was complete was sent before any answer.
        """
        self.weight += CROWD if self._completed.get(header.agent) == self._began else 1
        if len(self._completed) >= _MOST_REMEMBERED:
            self._completed.clear()
        self._completed[header.agent] = self.reads

    def one_by_one(self, data: Buffer) -> Iterator[None]:
        """The same for somebody who may have sent thousands: goes on with one message, or less, at a time."""
        rest = memoryview(data)
        while True:
            yield
            if self.closed:
                return
            size = self._decoder.one(rest)
            self.received(rest[:size])
            rest = rest[size:]
            if not rest:
                return

    def finished(self, error: LfieldError | None) -> None:
        """The stream has ended; the first reason known is the one reported."""
        half = not self.closed and self._decoder.unfinished
        self.closed = True
        # Now, and not when the collector finds this link: what never greeted must not pile up until then.
        self._decoder.forget()
        if self._error is None and error is None and half:
            error = WireError("it closed the link in the middle of a message")
        self.handler.on_closed(self, self._error or error)

    def _oversize(self, header: Transfer, size: int) -> None:
        self._weigh(header)
        self.handler.on_oversize(self, header, size)

    def _require_open(self) -> None:
        if self.closed:
            raise AddressError(self.peer, "the link to it is closed")
