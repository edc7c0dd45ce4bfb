"""A standby connection: authenticated and idle on another path than the link, until either side makes it the
link.

Both sides send a Hello of the role "standby"; the dialling side then sends rare keep-alives (Ping), which the
other side answers. A Hello of the role "host", from either side, starts the ordinary handshake of a link.
"""

from __future__ import annotations

import asyncio
from contextlib import suppress
from typing import TYPE_CHECKING, Protocol

from lfield.errors import AddressError, HandshakeError, WireError
from lfield.net.health.link_heartbeats import IDLE_PING_EVERY, SmoothedRtt
from lfield.net.health.path_choice import PathState
from lfield.net.health.traffic import LinkTraffic
from lfield.wire.messages import HandshakeRefused, Hello, Message, Ping, Pong

if TYPE_CHECKING:
    from collections.abc import Callable

    from lfield.errors import CpuBudgetExceeded, LfieldError
    from lfield.net.transport import Link
    from lfield.wire.coordinator_messages import Transfer

#: Seconds within which a keep-alive is answered, and after which the accepting side regards keep-alives as
#: missing.
ANSWER_TIMEOUT, MISSED_AFTER = 5.0, 3 * IDLE_PING_EVERY


class StandbyOwner(Protocol):
    """The owner of standby connections."""

    @property
    def now(self) -> Callable[[], float]:
        """The monotonic time."""

    def on_ready(self, connection: StandbyConnection) -> None:
        """The peer also keeps the connection."""

    def on_activated(self, connection: StandbyConnection, hello: Hello) -> None:
        """The peer makes the connection the link."""

    def on_closed(self, connection: StandbyConnection) -> None:
        """The connection is closed."""


class StandbyConnection:
    """One standby connection with a `host`, the handler of its link until `release`."""

    link: Link

    def __init__(self, owner: StandbyOwner, host: str, now: float, *, dialled: bool) -> None:
        self._owner, self.host, self.dialled = owner, host, dialled
        #: Whether both sides keep the connection, and whether they ever kept it.
        self.is_ready = self.was_ready = False
        #: Events: the peer has answered or closed the connection; the connection is closed, or has become the
        #: link.
        self.settled, self.ended = asyncio.Event(), asyncio.Event()
        self._traffic, self._round_trip = LinkTraffic(), SmoothedRtt()
        #: The time when the last keep-alive was sent or received, and whether it awaits an answer.
        self._last, self._is_awaiting, self._token = now, dialled, 0

    def open(self, link: Link, own: Hello) -> None:
        """Offer a dialled connection: send the Hello of a standby."""
        self.link = link
        with suppress(AddressError):
            link.send(own)

    def accept(self, link: Link, own: Hello) -> None:
        """Accept the offer of a caller."""
        self.link = link
        self._mark_ready()
        link.set_handler(self)
        link.accept_role("host")
        with suppress(AddressError):
            link.send(own)

    def release(self) -> Link:
        """The link, for another handler."""
        self.is_ready = False
        self.ended.set()
        return self.link

    def _mark_ready(self) -> None:
        self.is_ready = self.was_ready = True
        self._is_awaiting = False
        self.settled.set()

    def keep_alive(self, now: float) -> bool:
        """Send a keep-alive when due. Returns False if the peer has not answered in time."""
        # With this option, the acknowledgement of a keep-alive is part of the answer.
        self.link.on_idle()
        silent = now - self._last
        if not self.dialled:
            return silent <= MISSED_AFTER
        if self._is_awaiting:
            return silent <= ANSWER_TIMEOUT
        if silent >= IDLE_PING_EVERY:
            self._ping(now)
        return True

    def _ping(self, now: float) -> None:
        self._token += 1
        self._last, self._is_awaiting = now, True
        with suppress(AddressError):
            self.link.send(Ping(self._token))

    def _on_answer(self, pong: Pong) -> None:
        if self._is_awaiting and pong.token == self._token:
            self._is_awaiting = False
            self._round_trip.update(self._owner.now() - self._last)

    def state(self, now: float) -> PathState | None:
        """A reading of the path of the connection; None without the kernel's counters."""
        delivery = self.link.delivery()
        if delivery is None:
            return None
        if self._traffic.is_due(now):
            self._traffic.record(self.link.counts(), now)
        return PathState(delivery, self._round_trip.mean or 0.0, self._traffic.loss or 0.0)

    # --- reports of the link --------------------------------------------------------------------------

    def on_message(self, link: Link, message: Message) -> None:
        """Process a keep-alive, or a Hello. Raises HandshakeError and WireError."""
        if isinstance(message, HandshakeRefused):
            raise HandshakeError(f"{self.host} refused a standby connection: {message.reason}")
        if isinstance(message, Ping) and self.is_ready:
            self._last = self._owner.now()
            link.send(Pong(message.token))
        elif isinstance(message, Pong) and self.is_ready:
            self._on_answer(message)
        elif isinstance(message, Hello) and message.role == "standby" and not self.is_ready:
            self._mark_ready()
            link.accept_role("host")
            self._owner.on_ready(self)
        elif isinstance(message, Hello) and message.role == "host":
            # Before the answer, this message is the Hello that a peer sends to known addresses without a
            # request.
            if self.is_ready:
                self._owner.on_activated(self, message)
        else:
            raise WireError(f"received {type(message).__name__} on a standby connection")

    def on_transfer(self, link: Link, header: Transfer, block: memoryview) -> None:
        """See `LinkHandler.on_transfer`: not before the handshake of a host."""
        raise HandshakeError("a coordinator came on a standby connection")

    def on_oversize(self, link: Link, header: Transfer, size: int) -> None:
        """See `LinkHandler.on_oversize`."""
        raise HandshakeError("a coordinator came on a standby connection")

    def on_excess(self, link: Link, error: CpuBudgetExceeded) -> None:
        """See `LinkHandler.on_excess`: the link is slowed down or closed."""

    def on_closed(self, link: Link, error: LfieldError | None) -> None:
        """See `LinkHandler.on_closed`."""
        self.is_ready = False
        self.settled.set()
        self.ended.set()
        self._owner.on_closed(self)
