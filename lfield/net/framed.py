"""What every link does alike: messages to bytes, bytes to messages, and closing on bad ones."""

from __future__ import annotations

from typing import TYPE_CHECKING

from lfield.authority.identity import STRANGER
from lfield.errors import AddressError, GreetingError, WireError
from lfield.loop import unexpected
from lfield.net.waiting.rations import PROVEN
from lfield.wire.codec import (
    PART,
    TRANSFER,
    decode,
    decode_transfer,
    encode,
    encode_transfer,
    frame_decoder,
    limits,
    part_limits,
)
from lfield.wire.messages import Ping, Pong, Refuse
from lfield.wire.observing import EmergencyStop, EmergencyStopped, OrderChallenge, Pause
from lfield.wire.orders import RelayedAnswer, RelayedOrder

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

#: A block that is so many times as long as one may be proves that they never end.
_MUCH_TOO_LONG = 16
#: What precedes all that is queued: orders to stop and to pause with their answers, and heartbeats, so that a
#: link with much to send is not taken for a silent one.
_ORDERS = (EmergencyStop, EmergencyStopped, Pause, OrderChallenge, RelayedOrder, RelayedAnswer)
_URGENT = (*_ORDERS, Ping, Pong)
#: What is never withheld: nobody sends a coordinator because of it, and some of it makes robots stop.
_NEVER_WITHHELD = (*_URGENT, Refuse)


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
        #: For the frame that comes in parts.
        self._parts = frame_decoder(self._oversize)

    def write(self, data: Buffer) -> None:
        """Queue bytes as they are. Only `send` and `send_transfer`, and tests of bad bytes, call it."""
        raise NotImplementedError

    def write_now(self, data: Buffer) -> None:
        """Write bytes at once, behind what is queued; the same where a transport knows no difference."""
        self.write(data)

    def write_urgent(self, data: Buffer) -> None:
        """Write a whole frame before all that is queued; as `write` where a transport has no queue."""
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
        self._parts.limits = part_limits(role, self._max_block)

    def expect(self, round_trip: float) -> None:
        """See `Link.expect`: nothing to do without a socket."""

    def counts(self) -> Counts | None:
        """See `Link.counts`."""
        return None

    def send(self, message: Message) -> None:
        """Queue a message, or send it before what is queued. Raises AddressError on a closed link."""
        self._require_open()
        if isinstance(message, _URGENT):
            self.write_urgent(encode(message))
        elif self._withheld is None or isinstance(message, _NEVER_WITHHELD):
            self.write(encode(message))
        else:
            self._withheld.append(encode(message))

    def send_transfer(self, header: Transfer, block: Buffer) -> None:
        """Send a coordinator, at once. Raises AddressError on a closed link."""
        self._require_open()
        data = b"".join((encode_transfer(header, block), block))
        if self._withheld is not None:
            self._withheld.append(data)
        else:
            self.write_now(data)

    def received(self, data: Buffer) -> None:
        """Hand on what the next bytes complete; close on bytes or messages that must not be."""
        frame = self._decoder.whole(data)
        try:
            for kind, payload in self._decoder.feed(data) if frame is None else (frame,):
                if kind == PART:
                    self._take_part(payload)
                else:
                    self._take(kind, payload)
                if self.closed:
                    break
        except (WireError, GreetingError) as error:
            self._error = error
            self.close()
        except Exception as error:
            self.close()
            unexpected(error)

    def _take_part(self, data: memoryview) -> None:
        if self._parts.one(data) < len(data):
            raise WireError("a part has bytes of two frames")
        for kind, payload in self._parts.feed(data):
            self._take(kind, payload)

    def _take(self, kind: int, payload: memoryview) -> None:
        if kind == TRANSFER:
            header, block = decode_transfer(payload)
            if self._withheld is not None:
                self._weigh(header)
            self.handler.on_transfer(self, header, block)
        else:
            if self._withheld is not None:
                self._weight += 1 + len(payload) // _HEAVY
            self.handler.on_message(self, decode(kind, payload))

    def withhold(self, *, on: bool) -> None:
        """Send neither coordinators nor answers from now on, or all of them that wait.

        A link that is lost meanwhile loses them, as it loses what waits in a socket.
        """
        waiting, self._withheld = self._withheld, [] if on else None
        if on:
            self._weight, self._came = 0, set()
            self._decoder.skipped = self._parts.skipped = 0
        for data in waiting or ():
            self.write(data)

    @property
    def weight(self) -> int:
        """How much has come since answers are withheld, in messages: 0 while they are not.

        A transfer counts one, a message one and one more for each _HEAVY bytes. A host sends a coordinator
        again only after an answer, so a second transfer of one is a proof (PROVEN); of blocks that are too
        long so many bytes are that no host sends them before an answer.
        """
        skipped = self._decoder.skipped + self._parts.skipped
        return self._weight + PROVEN * skipped // (_MUCH_TOO_LONG * self._max_block)

    def _weigh(self, header: Transfer) -> None:
        self._weight += PROVEN if header.agent in self._came else 1
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
        half = not self.closed and (self._decoder.unfinished or self._parts.unfinished)
        self.closed = True
        # Now, and not when the collector finds this link: what never greeted must not pile up until then.
        self._decoder.forget()
        self._parts.forget()
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
