"""A link over an asyncio stream: plain between local processes, otherwise in TLS."""

from __future__ import annotations

import asyncio
import socket
from typing import TYPE_CHECKING, cast

from lfield.authority.identity import ANONYMOUS, Identity
from lfield.errors import AddressError, CpuBudgetExceeded, WireError
from lfield.net.coding.traffic_kinds import TrafficKind
from lfield.net.framed_link import FramedLink
from lfield.net.health.tcp_options import (
    delay_acknowledgements,
    read_counts,
    read_delivery,
    set_options,
    set_time_outs,
)
from lfield.net.peer_credentials import identity_of_caller, identity_of_listener, socket_address
from lfield.net.scheduling.send_queue import HIGH_WATER, SendQueue
from lfield.net.transport import is_this_computer

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from lfield.net.health.tcp_options import TcpSocket
    from lfield.net.health.traffic import Delivery, TcpCounts
    from lfield.net.scheduling.link_schedulers import LinkScheduler
    from lfield.net.transport import Link, LinkHandler
    from lfield.wire.framing import Buffer
    from lfield.wire.messages import Role

#: Seconds for a peer to accept the last message of a closing link.
FLUSH_TIMEOUT = 5.0
#: Maximum bytes queued for an observer: a few of the longest answers.
MAX_OBSERVER_PENDING = 4 << 20
#: The identity of a peer that is no host of the team, from TLS or the kernel.
OBSERVER_KINDS = ("person", "local")
#: A caller that disconnected before its address was read.
CLOSED_PEER = "a peer that closed at once"


class StreamLink(FramedLink, asyncio.Protocol):
    """One connection in plain bytes, dialled if `calls`. `identify` returns the identity at a network
    address.

    Messages of a member are processed within its CPU budget. Other callers wait at the `scheduler` for each
    message, and reading pauses during the wait. Data before the Hello of a dialled peer, or from a host
    dialled by an observer at a Unix socket, is processed at once.
    """

    _transport: asyncio.Transport

    def __init__(
        self,
        max_block: int,
        max_pending: int,
        on_link: Callable[[Link], LinkHandler],
        scheduler: LinkScheduler,
        identify: Callable[[str], Identity],
        *,
        calls: bool,
    ) -> None:
        super().__init__("a peer", max_block)
        self._max_pending, self._calls = max_pending, calls
        self._on_link, self._scheduler, self._identify = on_link, scheduler, identify
        self._loop = asyncio.get_running_loop()
        #: Frames of this turn, and frames that the connection does not accept yet.
        self._waiting: list[tuple[Buffer, TrafficKind]] = []
        self._sending = SendQueue(self.coded)
        self._flush_timer: asyncio.TimerHandle | None = None
        #: Whether the peer was dialled or has a role other than observer, and whether its role is observer.
        self._is_direct, self._is_greeted_observer = calls, False
        #: The authenticated member, and whether its handshake is complete.
        self._member, self._is_rationed = "", False
        #: Unprocessed input of a peer that must wait.
        self._remaining: Iterator[None] | None = None
        #: Whether reading of the member is paused, and whether reading is off.
        self._is_held = self._is_paused = False
        #: The TCP socket, and the round trip in seconds for which its time-outs are set.
        self._socket: TcpSocket | None = None
        self._expected = 0.0

    async def ready(self) -> None:
        """Return when messages can be sent. Raises HandshakeError, WireError and AddressError."""

    def require_host(self, host: str) -> None:
        """Let `ready` raise HandshakeError if another host has authenticated itself; '' for any host.

        Without TLS, hosts are not authenticated.
        """

    def write(self, data: Buffer) -> None:
        """See `FramedLink.write`."""
        self._flush()
        if not self._transport.is_closing():
            self._put(data)

    def write_frame(self, data: Buffer, kind: TrafficKind) -> None:
        """Send messages of one turn together: a system call costs more than the rest of a hop."""
        if not self._waiting:
            self._loop.call_soon(self._flush)
        self._waiting.append((data, kind))

    def write_now(self, data: Buffer) -> None:
        """Write at once if no frame waits: mostly a coordinator is sent alone."""
        if self._waiting:
            self._waiting.append((data, TrafficKind.HOP))
            self._flush()
        elif self._transport.is_closing():
            return
        elif not self._sending.is_idle or len(data) > self._sending.part:
            self._queue_frame(data, TrafficKind.HOP)
        else:
            self._put(data)

    def write_urgent(self, data: Buffer) -> None:
        """See `FramedLink.write_urgent`. Only frames of this turn, such as a Hello, may precede. If no frame
        waits, the data is sent in this turn.
        """
        if not self._sending.is_busy and self._waiting_size <= HIGH_WATER:
            self.write_frame(data, TrafficKind.STOP)
            return
        self._flush()
        if not self._transport.is_closing():
            self._put(data)

    @property
    def _waiting_size(self) -> int:
        return sum(len(data) for data, _ in self._waiting)

    def _flush(self) -> None:
        if not self._waiting or self._transport.is_closing():
            self._waiting.clear()
            return
        is_short = not self._sending.is_busy and self._waiting_size <= self._sending.part
        waiting, self._waiting = self._waiting, []
        if is_short:
            self._put(b"".join(self.coded(data, kind) for data, kind in waiting))
            return
        for data, kind in waiting:
            self._queue_frame(data, kind)

    def _queue_frame(self, data: Buffer, kind: TrafficKind) -> None:
        """Pass a frame to the transport, or queue it until the transport accepts data."""
        if not self._sending.is_busy and len(data) <= self._sending.part:
            self._put(self.coded(data, kind))
            return
        self._sending.add(data, kind)
        self._send_on()
        if self._sending.size > self._max_pending:
            self._error = WireError(f"peer does not read: over {self._max_pending} bytes queued")
            self.closed = True
            self._transport.abort()

    def _send_on(self) -> None:
        while self._sending.is_due and not self._transport.is_closing():
            self._put(self._sending.next())
            if not self._sending.is_full:
                self._sending.on_accepted()

    def _put(self, data: Buffer) -> None:
        self._transport.write(data)

    def accept_role(self, role: Role) -> None:
        """See `Link.accept_role`."""
        super().accept_role(role)
        self._is_greeted_observer = role == "observer"
        self._is_direct = not self._is_greeted_observer
        self._is_rationed = self._is_direct and self.identity.kind == "host"
        if self._is_rationed:
            self._join()
        if self._is_greeted_observer:
            self._max_pending = min(self._max_pending, MAX_OBSERVER_PENDING)

    def set_round_trip(self, round_trip: float) -> None:
        """See `Link.set_round_trip`: time-outs are set when the round trip changes by a quarter."""
        super().set_round_trip(round_trip)
        is_near = 0.8 * self._expected <= round_trip <= 1.25 * self._expected
        if self._socket is not None and not self.closed and not is_near:
            self._expected = round_trip
            set_time_outs(self._socket, round_trip)

    def on_idle(self) -> None:
        """See `Link.on_idle`."""
        if self._socket is not None and not self.closed:
            delay_acknowledgements(self._socket)

    def counts(self) -> TcpCounts | None:
        """See `Link.counts`."""
        return None if self._socket is None or self.closed else read_counts(self._socket)

    def delivery(self) -> Delivery | None:
        """See `Link.delivery`."""
        if self._socket is None or self.closed:
            return None
        own: Delivery | None = self._transport.get_extra_info("delivery")
        return own or read_delivery(self._socket)

    def close(self) -> None:
        self.withhold(on=False)
        self._flush()
        if not self._transport.is_closing():
            for data in self._sending.rest():
                self._put(data)
        self.closed = True
        self._transport.close()
        if self._flush_timer is None and self._transport.get_write_buffer_size():
            self._flush_timer = self._loop.call_later(FLUSH_TIMEOUT, self._transport.abort)

    def abort(self) -> None:
        self.closed = True
        self._transport.abort()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast("asyncio.Transport", transport)
        name = transport.get_extra_info("peername")
        self.peer = CLOSED_PEER if name is None else socket_address(name)
        sock = transport.get_extra_info("socket")
        if sock.family == socket.AF_UNIX:
            self.identity = identity_of_listener(sock) if self._calls else identity_of_caller(sock)
            self.mark_local()
        else:
            set_options(sock)
            self._socket = sock
            if is_this_computer(self.peer):
                self.mark_local()
            self.identity = self._identify(self.peer)
        self._transport.set_write_buffer_limits(high=HIGH_WATER)
        self.handler = self._on_link(self)

    def data_received(self, data: bytes) -> None:
        # The common case is one message of a member while no other message waits.
        if (
            self._is_rationed
            and self._remaining is None
            and not self._is_held
            and self._scheduler.members.process_at_once(self, self._member, data)
        ):
            return
        self._process_coming(self.deliver_pending(data))

    def _join(self) -> None:
        """The peer was authenticated as a member."""
        if not self._member:
            self._member = str(self.identity)
            self._scheduler.members.join(self, self._member)

    def _process_coming(self, coming: Iterator[None]) -> None:
        """Process input until the peer proves to be a member or a guest; then the scheduler processes it."""
        if self._is_rationed:
            self._queue(coming)
            return
        for _ in coming:
            if self._is_rationed or self._is_observer:
                self._queue(coming)
                return

    def _queue(self, coming: Iterator[None]) -> None:
        self._remaining = coming
        if self._is_rationed:
            self._scheduler.members.add(self, self._member)
        else:
            self._scheduler.add(self, str(self.identity))
        self._update_reading()

    @property
    def _is_observer(self) -> bool:
        """Whether the peer is no host, as far as known. A returning host does not wait for other peers."""
        return self._is_greeted_observer or (not self._is_direct and self.identity.kind in OBSERVER_KINDS)

    def pause_reading(self, *, on: bool) -> None:
        """See `MemberLink.pause_reading`."""
        self._is_held = on
        self._update_reading()

    def _update_reading(self) -> None:
        """Read while no input is pending and the link is not paused; TCP applies back-pressure."""
        waits = self._is_held or self._remaining is not None
        if waits == self._is_paused or self._transport.is_closing():
            return
        self._is_paused = waits
        if waits:
            self._transport.pause_reading()
        else:
            self._transport.resume_reading()

    def process_next(self) -> bool:
        """See `PendingInput.process_next`: reading resumes when no input is left."""
        assert self._remaining is not None
        for _ in self._remaining:
            return True
        self._remaining = None
        self._update_reading()
        return False

    def on_excess(self, error: CpuBudgetExceeded) -> None:
        """See `MemberLink.on_excess`."""
        self.handler.on_excess(self, error)
        if error.closes:
            self._error = self._error or error
            self.close()

    def pause_writing(self) -> None:
        """The transport's buffer is full."""
        self._sending.on_full(self._loop.time())

    def resume_writing(self) -> None:
        """The transport accepts data again."""
        self._sending.on_writable(self._loop.time())
        self._send_on()

    def connection_lost(self, exc: Exception | None) -> None:
        if self._flush_timer is not None:
            self._flush_timer.cancel()
        self._scheduler.remove(self)
        self._scheduler.members.remove(self, self._member)
        self._remaining = None
        self._sending.clear()
        self.on_eof(AddressError(self.peer, f"the connection was lost: {exc}") if exc else None)


def anonymous_identity(address: str) -> Identity:
    """The identity at a network address: unauthenticated."""
    return ANONYMOUS
