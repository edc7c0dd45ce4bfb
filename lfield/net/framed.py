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
from lfield.wire.messages import Ping, Pong, Refuse
from lfield.wire.observing import EmergencyStop, EmergencyStopped, Pause

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

#: A block that is so many times as long as one may be counts as a crowd by itself.
_MUCH_TOO_LONG = 16
#: What is never withheld: nobody sends a coordinator because of it, and some of it makes robots stop.
_NEVER_WITHHELD = (Ping, Pong, EmergencyStop, EmergencyStopped, Pause, Refuse)

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
        self.closed = self.is_answered = False
        #: What is not sent yet while coordinators and answers are withheld, None while they are not; how much
        #: has come since then, and which coordinators.
        self._withheld: list[Buffer] | None = None
        self._weight, self._came = 0, set[str]()
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
        if self._withheld is None or isinstance(message, _NEVER_WITHHELD):
            self.write(encode(message))
        else:
            self._withheld.append(encode(message))

    def send_transfer(self, header: Transfer, block: Buffer) -> None:
        """Send a coordinator, at once. Raises AddressError on a closed link."""
        self._require_open()
        head = encode_transfer(header, block)
        if self._withheld is not None:
            self._withheld += (head, block)
        elif len(block) <= _ONE_WRITE:
            self.write_now(b"".join((head, block)))
        else:
            self.write_now(head)
            self.write_now(block)

    def received(self, data: Buffer) -> None:
        """Hand on what the next bytes complete; close on bytes or messages that must not be."""
        frame = self._decoder.whole(data)
        try:
            for kind, payload in self._decoder.feed(data) if frame is None else (frame,):
                if kind == TRANSFER:
                    header, block = decode_transfer(payload)
                    if self._withheld is not None:
                        self._weigh(header)
                    self.handler.on_transfer(self, header, block)
                else:
                    if self._withheld is not None:
                        self._weight += 1 + len(payload) // _HEAVY
                    self.handler.on_message(self, decode(kind, payload))
                if self.closed:
                    break
        except (WireError, GreetingError) as error:
            self._error = error
            self.close()
        except Exception as error:
            self.close()
            unexpected(error)

    def withhold(self, *, on: bool) -> None:
        """Send neither coordinators nor answers from now on, or all of them that wait.

        A link that is lost meanwhile loses them, as it loses what waits in a socket.
        """
        waiting, self._withheld = self._withheld, [] if on else None
        if on:
            self._weight, self._came = 0, set()
            self._decoder.skipped = 0
        for data in waiting or ():
            self.write(data)

    @property
    def weight(self) -> int:
        """How much has come since answers are withheld, in messages: 0 while they are not.

        A transfer counts one, a message one and one more for each _HEAVY bytes. A host sends a coordinator
        again only after an answer, so a second transfer of one counts as a crowd, and of blocks that are too
        long so many bytes that no host sends them before an answer.
        """
        return self._weight + CROWD * self._decoder.skipped // (_MUCH_TOO_LONG * self._max_block)

    def _weigh(self, header: Transfer) -> None:
        self._weight += CROWD if header.agent in self._came else 1
        self._came.add(header.agent)

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
        if self._withheld is not None:
            self._weigh(header)
        self.handler.on_oversize(self, header, size)

    def _require_open(self) -> None:
        if self.closed:
            raise AddressError(self.peer, "the link to it is closed")
