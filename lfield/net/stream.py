"""A link over a connection of asyncio: plain between processes of one computer, else in TLS."""

from __future__ import annotations

import asyncio
import socket
from typing import TYPE_CHECKING, cast

from lfield.authority.identity import STRANGER, Identity
from lfield.errors import AddressError, LfieldError, OverBudget, WireError
from lfield.net.door import caller_at, host_at, socket_address
from lfield.net.framed import FramedLink
from lfield.net.health.tcp_options import counts, set_options, set_time_outs
from lfield.net.waiting.handshakes import source_of
from lfield.net.waiting.sending import HIGH_WATER, Sending

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from lfield.net.health.tcp_options import Socket
    from lfield.net.health.traffic import Counts
    from lfield.net.tls import Channel, Tls
    from lfield.net.transport import Link, LinkHandler
    from lfield.net.waiting.reception import Reception
    from lfield.wire.framing import Buffer
    from lfield.wire.messages import Role

#: Seconds that a peer has to take the last words of a link that is closed.
LAST_WORDS = 5.0
#: So many bytes may wait at most for somebody who only looks: some of the longest answers.
FOR_OBSERVERS = 4 << 20
#: So many bytes of TLS at most are taken at a time, of guests and of members: what is in them may be work
#: without a message.
PIECE, MEMBERS_PIECE = 1 << 10, 1 << 14
#: Who is no host of the team, as TLS or the kernel says.
GUESTS = ("person", "local")
#: Who called and was gone before anybody looked: it has no address any more.
GONE = "somebody who was gone at once"


class StreamLink(FramedLink, asyncio.Protocol):
    """One connection in plain bytes, the end that `calls` or the other. `resident` says who is at an address
    of a network.

    What comes of a member is taken as its ration allows. Whoever else calls waits at the `reception` for each
    message, and is read no further meanwhile. What comes before the greeting of whom this end has called, or
    from a host that an observer has called at a Unix socket, is taken as it comes.
    """

    _transport: asyncio.Transport

    def __init__(
        self,
        max_block: int,
        max_pending: int,
        on_link: Callable[[Link], LinkHandler],
        reception: Reception,
        resident: Callable[[str], Identity],
        *,
        calls: bool,
    ) -> None:
        super().__init__("a peer", max_block)
        self._max_pending, self._calls = max_pending, calls
        self._on_link, self._reception, self._resident = on_link, reception, resident
        self._loop = asyncio.get_running_loop()
        #: The frames of this turn, and those that the connection does not take yet.
        self._waiting: list[Buffer] = []
        self._sending = Sending()
        self._patience: asyncio.TimerHandle | None = None
        #: Whether no message waits as one of a guest, and whether the other has greeted as an observer.
        self._straight, self._looks = calls, False
        #: Which member has proven to be there, and whether it has greeted as one.
        self._member, self._is_rationed = "", False
        #: What has come and was not taken yet, of whoever has to wait.
        self._left: Iterator[None] | None = None
        #: Whether the member is not to be read for now, and whether nothing is read.
        self._is_held = self._is_paused = False
        #: The socket of a connection over TCP, and the round trip in seconds that its time-outs are set for.
        self._socket: Socket | None = None
        self._expected = 0.0

    async def ready(self) -> None:
        """Return when messages can be sent. Raises GreetingError, WireError and AddressError."""

    def write(self, data: Buffer) -> None:
        """Messages of one turn leave together: a system call costs more than all the rest of a hop."""
        if not self._waiting:
            self._loop.call_soon(self._flush)
        self._waiting.append(data)

    def write_now(self, data: Buffer) -> None:
        """Nothing is planned for later where nothing waits: mostly a coordinator leaves alone."""
        if self._waiting:
            self._waiting.append(data)
            self._flush()
        elif not self._transport.is_closing():
            self._hand_over(data)

    def write_urgent(self, data: Buffer) -> None:
        """See `FramedLink.write_urgent`: in front of it may be only what this turn has sent before, such as a
        greeting. Where nothing waits, it leaves with this turn."""
        if not self._sending.is_busy and sum(map(len, self._waiting)) <= HIGH_WATER:
            self.write(data)
            return
        self._flush()
        if not self._transport.is_closing():
            self._put(data)

    def _flush(self) -> None:
        waiting, self._waiting = self._waiting, []
        if not waiting or self._transport.is_closing():
            return
        if not self._sending.is_busy and sum(map(len, waiting)) <= self._sending.part:
            self._put(waiting[0] if len(waiting) == 1 else b"".join(waiting))
            return
        for data in waiting:
            self._hand_over(data)

    def _hand_over(self, data: Buffer) -> None:
        """Give a frame to the transport, or keep it until that takes more."""
        if not self._sending.is_busy and len(data) <= self._sending.part:
            self._put(data)
            return
        self._sending.add(data)
        self._send_on()
        if self._sending.size > self._max_pending:
            self._error = WireError(f"it does not read: over {self._max_pending} bytes wait for it")
            self.closed = True
            self._transport.abort()

    def _send_on(self) -> None:
        while self._sending.is_due and not self._transport.is_closing():
            self._put(self._sending.next())
            if not self._sending.is_full:
                self._sending.taken()

    def _put(self, data: Buffer) -> None:
        self._transport.write(data)

    def greeted(self, role: Role) -> None:
        """See `Link.greeted`."""
        super().greeted(role)
        self._looks = role == "observer"
        self._straight = not self._looks
        self._is_rationed = self._straight and self.who.kind == "host"
        if self._is_rationed:
            self._join()
        if self._looks:
            self._max_pending = min(self._max_pending, FOR_OBSERVERS)

    def expect(self, round_trip: float) -> None:
        """See `Link.expect`: the time-outs are set when the round trip changes by a quarter."""
        is_near = 0.8 * self._expected <= round_trip <= 1.25 * self._expected
        if self._socket is not None and not self.closed and not is_near:
            self._expected = round_trip
            set_time_outs(self._socket, round_trip)

    def counts(self) -> Counts | None:
        """See `Link.counts`."""
        return None if self._socket is None or self.closed else counts(self._socket)

    def close(self) -> None:
        self.withhold(on=False)
        self._flush()
        if not self._transport.is_closing():
            for data in self._sending.rest():
                self._put(data)
        self.closed = True
        self._transport.close()
        if self._patience is None and self._transport.get_write_buffer_size():
            self._patience = self._loop.call_later(LAST_WORDS, self._transport.abort)

    def abort(self) -> None:
        self.closed = True
        self._transport.abort()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast("asyncio.Transport", transport)
        name = transport.get_extra_info("peername")
        self.peer = GONE if name is None else socket_address(name)
        made = transport.get_extra_info("socket")
        if made.family == socket.AF_UNIX:
            self.who = host_at(made) if self._calls else caller_at(made)
        else:
            set_options(made)
            self._socket = made
            self.who = self._resident(self.peer)
        self._transport.set_write_buffer_limits(high=HIGH_WATER)
        self.handler = self._on_link(self)

    def data_received(self, data: bytes) -> None:
        self._meet(self.one_by_one(data))

    def _join(self) -> None:
        """It is proven which member is there."""
        if not self._member:
            self._member = str(self.who)
            self._reception.members.join(self, self._member)

    def _meet(self, coming: Iterator[None]) -> None:
        """Take what has come, until it turns out to be of a member or a guest: then it waits for its turn."""
        if self._is_rationed:
            self._queue(coming)
            return
        for _ in coming:
            if self._is_rationed or self._is_guest:
                self._queue(coming)
                return

    def _queue(self, coming: Iterator[None]) -> None:
        self._left = coming
        if self._is_rationed:
            self._reception.members.enter(self, self._member)
        else:
            self._reception.enter(self, str(self.who))
        self._read_on()

    @property
    def _is_guest(self) -> bool:
        """Whether this is no host, as far as it is known. A host that comes back waits behind nobody."""
        return self._looks or (not self._straight and self.who.kind in GUESTS)

    def hold(self, *, on: bool) -> None:
        """See `MemberLink.hold`."""
        self._is_held = on
        self._read_on()

    def _read_on(self) -> None:
        """Read while nothing waits and nobody holds this link; TCP tells the peer otherwise."""
        waits = self._is_held or self._left is not None
        if waits == self._is_paused or self._transport.is_closing():
            return
        self._is_paused = waits
        if waits:
            self._transport.pause_reading()
        else:
            self._transport.resume_reading()

    def take_one(self) -> bool:
        """See `Waiting.take_one`: whoever has nothing left is read on."""
        assert self._left is not None
        for _ in self._left:
            return True
        self._left = None
        self._read_on()
        return False

    def on_excess(self, error: OverBudget) -> None:
        """See `MemberLink.on_excess`."""
        self.handler.on_excess(self, error)
        if error.closes:
            self._error = self._error or error
            self.close()

    def pause_writing(self) -> None:
        """The transport has as much as it should."""
        self._sending.full(self._loop.time())

    def resume_writing(self) -> None:
        """It takes more."""
        self._sending.free(self._loop.time())
        self._send_on()

    def connection_lost(self, exc: Exception | None) -> None:
        if self._patience is not None:
            self._patience.cancel()
        self._reception.leave(self)
        self._reception.members.leave(self, self._member)
        self._left = None
        self._sending.clear()
        self.finished(AddressError(self.peer, f"the connection was lost: {exc}") if exc else None)


class TlsLink(StreamLink):
    """The same in TLS, which proves who is there. Of whoever is called nothing is held before bytes come."""

    def __init__(
        self,
        max_block: int,
        max_pending: int,
        on_link: Callable[[Link], LinkHandler],
        reception: Reception,
        tls: Tls,
        *,
        calls: bool,
    ) -> None:
        super().__init__(max_block, max_pending, on_link, reception, nobody_known, calls=calls)
        self._tls = tls
        self._channel: Channel | None = None
        self._proven: asyncio.Future[None] = self._loop.create_future()
        #: What its address counts as, and seconds of a processor that its handshake has taken.
        self._source = ""
        self._spent = 0.0

    async def ready(self) -> None:
        await self._proven

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        super().connection_made(transport)
        self._source = source_of(self.peer)
        if self._calls:
            self._channel = self._tls.channel(calls=True)
            self._transport.write(self._channel.take())

    def data_received(self, data: bytes) -> None:
        channel = self._channel = self._channel or self._tls.channel(calls=self._calls)
        coming = self._opened(channel, data)
        if channel.proven or self._calls:
            self._meet(coming)
            return
        self._left = coming
        strangers, is_answered, self.is_answered = self._reception.strangers, self.is_answered, True
        strangers.enter(self, self._source, is_answered=is_answered)
        self._read_on()

    def shake_hands(self) -> bool:
        """See `Shaking.shake_hands`. What comes behind the handshake is met as that of anybody known."""
        coming, channel = self._left, self._channel
        if coming is None or channel is None or self.closed:
            return False
        began = self._reception.busy()
        more = next(coming, coming) is None
        self._spent += self._reception.busy() - began
        if more and not channel.proven:
            return True
        self._left = None
        if channel.proven and channel.who.kind == "host":
            self._join()
            self._reception.members.on_handshake(self, self._member, self._spent)
        if more and (self._is_rationed or self._is_guest):
            self._queue(coming)
        elif more:
            self._meet(coming)
        self._read_on()
        return False

    def _opened(self, channel: Channel, data: bytes) -> Iterator[None]:
        """A little at a time: a record may have a thousand messages, or nothing but work."""
        view = memoryview(data)
        size = MEMBERS_PIECE if self._straight else PIECE
        try:
            for start in range(0, len(view), size):
                for plain in channel.feed(view[start : start + size]):
                    self.who = channel.who
                    yield from self.one_by_one(plain)
                    if self.closed:
                        return
                self._say(channel)
                self.who = channel.who
                if channel.proven and not self._proven.done():
                    self._proven.set_result(None)
                    self._reception.strangers.on_proven(self._source)
                if start + size < len(view):
                    yield
        except LfieldError as error:
            self._broken(channel, error)

    def _broken(self, channel: Channel, error: LfieldError) -> None:
        self._error = self._error or error
        self._say(channel)
        self.close()

    def _put(self, data: Buffer) -> None:
        # Before it is known who is there, there is nobody to tell anything.
        if self._channel is not None and self._channel.proven:
            self._transport.write(self._channel.seal(data))

    def _say(self, channel: Channel) -> None:
        if data := channel.take():
            self._transport.write(data)

    def connection_lost(self, exc: Exception | None) -> None:
        self._reception.strangers.leave(self)
        if not (self._calls or self._proven.done()):
            self._reception.strangers.on_failed(self._source)
        super().connection_lost(exc)

    def finished(self, error: LfieldError | None) -> None:
        # Now, and not when the collector finds this link: of strangers that would pile up until then.
        self._channel = None
        if not self._calls or (self._proven.done() and not self._proven.cancelled()):
            super().finished(error)
        elif not self._proven.done():
            # Whoever calls hears it from `connect`, and has no link.
            lost = AddressError(self.peer, "it closed the connection before it had proven who it is")
            self._proven.set_exception(self._error or error or lost)


def nobody_known(address: str) -> Identity:
    """Who is at an address: on a network that is no proof of anything."""
    return STRANGER
