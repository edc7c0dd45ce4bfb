"""Event subscriptions of several hosts: one link for each, dialled again after it ends, and one handler.

The I/O shell of `StreamCursor`, which selects the requests. A host sends a message every second, an empty
one without events; a link without messages is closed after a time-out.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Sequence
from typing import Protocol

from msgspec import Struct
from msgspec.structs import replace

from lfield.clock import Clock
from lfield.errors import AddressError, HandshakeError, KeysError, LfieldError, NoListener
from lfield.net.handshake import Handshake
from lfield.net.transport import Link, Transport
from lfield.operator.dashboard.event_stream.stream_cursor import StreamCursor
from lfield.operator.observer_link import ObserverLink, OrderMessage, PresentedCrl, answer_challenge
from lfield.wire.messages import HandshakeRefused, Hello, Message, RevocationUpdate
from lfield.wire.observer_messages import EmergencyStopResult, OrderChallenge
from lfield.wire.order_messages import HOLDS, UNKNOWN_EPOCH, Epochs
from lfield.wire.subscription_messages import EventAck, EventBatch

#: Seconds without a message after which a link is closed, and seconds between two checks.
SILENCE_TIMEOUT, CHECK_INTERVAL = 6.0, 1.0
#: Seconds between two requests to a host, from its last position. The answers contain the host's clock.
REQUEST_INTERVAL = 60.0


class StreamHandler(Protocol):
    """Receives the events of hosts."""

    def on_linked(self, host: str) -> None:
        """Called when a host answers, and sends all telemetry again: after each connection, and every
        minute.
        """

    def on_unlinked(self, host: str, reason: str) -> None:
        """Called after every failed attempt: a host has no link."""

    def on_batch(self, host: str, batch: EventBatch, took: float | None) -> None:
        """Handles new events, none twice. `took`: seconds from the request to its first answer, else None."""


class FollowOptions(Struct, frozen=True):
    """The requests and reports of an `EventFollower`.

    `since`, `telemetry` (Hz): as in `StreamCursor`. `crl`: a revocation list for hosts with an older one.
    `hint`: a sentence to append when a host is not reachable, or "". `learn`: gets the epochs of each host,
    which its orders must contain.
    """

    since: int | None = None
    telemetry: float = 0.0
    crl: PresentedCrl | None = None
    hint: Callable[[], str] = lambda: ""
    learn: Callable[[str, Epochs], None] = lambda host, epochs: None


NO_OPTIONS = FollowOptions()


class EventFollower:
    """Follows `hosts`. `locate` returns the current address of a host; it is called before each attempt."""

    def __init__(
        self,
        transport: Transport,
        hosts: Sequence[str],
        locate: Callable[[str], Awaitable[str]],
        handler: StreamHandler,
        clock: Clock,
        options: FollowOptions = NO_OPTIONS,
    ) -> None:
        self._transport, self._hosts, self._locate, self._hint = transport, hosts, locate, options.hint
        self._handler, self._clock, self._crl, self._learn = handler, clock, options.crl, options.learn
        self._cursors = {host: StreamCursor(options.since, options.telemetry) for host in hosts}
        #: The last address of each host, and the open links.
        self._addresses: dict[str, str] = {}
        self._links: dict[str, EventLink] = {}

    async def run(self) -> None:
        """Follow all hosts until cancelled."""
        async with asyncio.TaskGroup() as group:
            for host in self._hosts:
                group.create_task(self._follow(host))

    async def order(self, host: str, message: OrderMessage) -> EmergencyStopResult:
        """Send an order over the open link of a host; returns its answer.

        Raises AddressError when there is no link or it ends before the answer, HandshakeError for a refusal.
        """
        watching = self._links.get(host)
        if watching is None:
            raise AddressError(host, "not connected")
        return await watching.order(message)

    async def _follow(self, host: str) -> None:
        cursor = self._cursors[host]
        while True:
            reason, is_unreached = await self._once(host, cursor)
            self._handler.on_unlinked(host, reason)
            await asyncio.sleep(cursor.next_retry(unreached=is_unreached))

    async def _once(self, host: str, cursor: StreamCursor) -> tuple[str, bool]:
        """Follow a host until its link ends; returns the reason, and whether the host never answered."""
        watching = EventLink(host, cursor, self._handler, self._clock, self._crl, self._learn)
        link: Link | None = None
        try:
            address = await self._locate(host)
            if self._addresses.get(host, address) != address:
                # The host has been started at another address.
                cursor.on_unreachable()
            self._addresses[host] = address
            self._links[host] = watching
            link = await self._transport.connect(address, watching, host)
            watching.greet(link)
            return await watching.closed, watching.is_silent
        except AddressError as error:
            if isinstance(error, NoListener):
                cursor.on_unreachable()
            return "; ".join(filter(None, (str(error), self._hint()))), True
        except LfieldError as error:
            return str(error), False
        finally:
            self._links.pop(host, None)
            watching.end()
            if link is not None:
                link.abort()


class _SentOrder(Struct):
    """An order that was sent, and its answer."""

    message: OrderMessage
    answer: asyncio.Future[EmergencyStopResult]


class EventLink(ObserverLink):
    """The handler of one link: handshake, subscription, events, acknowledgements."""

    def __init__(
        self,
        host: str,
        cursor: StreamCursor,
        handler: StreamHandler,
        clock: Clock,
        crl: PresentedCrl | None,
        learn: Callable[[str, Epochs], None],
    ) -> None:
        self._host, self._cursor, self._handler = host, cursor, handler
        self._clock, self._crl, self._learn = clock, crl, learn
        self._greeting: Handshake | None = None
        #: The times when the unanswered request was sent, and when the next one is due.
        self._requested_at: float | None = None
        self._due = 0.0
        self._last_contact = clock.monotonic()
        self._timer: asyncio.TimerHandle | None = None
        #: Whether the link was closed because no message arrived.
        self.is_silent = False
        #: The link once the host has sent its Hello, the epochs that it sent last, and the orders under way.
        self._link: Link | None = None
        self._epochs = Epochs()
        self._orders: dict[bytes, _SentOrder] = {}
        #: The reason why the link has ended.
        self.closed: asyncio.Future[str] = asyncio.get_running_loop().create_future()

    def greet(self, link: Link) -> Handshake:
        """Send the Hello once; the host's may arrive first. Raises KeysError."""
        if self._greeting is None:
            if link.identity.kind == "anonymous":
                raise KeysError(
                    f"the host at {link.peer} accepts only observers with keys: 'lfield keys person' makes "
                    "them, and --keys, $LFIELD_KEYS or ~/.config/lfield/keys/me names their folder"
                )
            self._greeting = Handshake(Hello("observer", "observer", 0), link.identity, dialled=self._host)
            link.send(self._greeting.first_message())
            self._timer = asyncio.get_running_loop().call_later(CHECK_INTERVAL, self._check_silence)
        return self._greeting

    def on_message(self, link: Link, message: Message) -> None:
        """Handle the Hello first, then batches."""
        greeting = self.greet(link)
        self._last_contact = self._clock.monotonic()
        if greeting.peer is None:
            hello = greeting.receive(message)
            link.accept_role(hello.role)
            if self._crl is not None and hello.revoked < self._crl.number:
                link.send(RevocationUpdate(self._crl.data))
            self._link = link
            self._on_epochs(hello.epochs)
            self._watch(link, hello.incarnation)
        elif isinstance(message, HandshakeRefused):
            refusal = HandshakeError(f"{greeting.peer.host} refused: {message.reason}")
            self._fail_orders(refusal)
            raise refusal
        elif isinstance(message, EventBatch):
            self._on_batch(link, message)
        elif isinstance(message, EmergencyStopResult | OrderChallenge):
            self._on_answer(link, message)

    def _on_epochs(self, epochs: Epochs) -> None:
        self._epochs = epochs
        self._learn(self._host, epochs)

    async def order(self, message: OrderMessage) -> EmergencyStopResult:
        """See `EventFollower.order`. An order that lifts one names no epoch: the host reports its own
        first."""
        if self._link is None:
            raise AddressError(self._host, "not connected")
        epoch = self._epochs.hold if message.kind in HOLDS else UNKNOWN_EPOCH
        sent = _SentOrder(replace(message, epoch=epoch), asyncio.get_running_loop().create_future())
        self._orders[message.id] = sent
        try:
            self._link.send(sent.message)
            return await sent.answer
        finally:
            del self._orders[message.id]

    def _on_answer(self, link: Link, message: EmergencyStopResult | OrderChallenge) -> None:
        self._on_epochs(message.epochs)
        sent = self._orders.get(message.id)
        if sent is None or sent.answer.done():
            return
        if isinstance(message, EmergencyStopResult):
            sent.answer.set_result(message)
        elif answer := answer_challenge(sent.message, message):
            sent.message = answer
            link.send(answer)

    def _fail_orders(self, error: LfieldError) -> None:
        for sent in self._orders.values():
            if not sent.answer.done():
                sent.answer.set_exception(error)

    def _watch(self, link: Link, incarnation: int) -> None:
        self._requested_at, self._due = self._last_contact, self._last_contact + REQUEST_INTERVAL
        link.send(self._cursor.watch_request(incarnation))

    def _on_batch(self, link: Link, batch: EventBatch) -> None:
        """Handle a batch; the host may send another one after the acknowledgement."""
        if self.closed.done():
            return
        if batch.snapshot is not None:
            self._on_epochs(batch.snapshot.epochs)
        took = None
        if self._requested_at is not None and batch.batch == 1:
            took, self._requested_at = self._last_contact - self._requested_at, None
            self._handler.on_linked(self._host)
        self._handler.on_batch(self._host, self._cursor.accept(batch), took)
        link.send(EventAck(batch.batch))
        if self._requested_at is None and self._last_contact >= self._due:
            self._watch(link, batch.incarnation)

    def _check_silence(self) -> None:
        """Close the link to a host that sends no messages."""
        silent = self._clock.monotonic() - self._last_contact
        if silent >= SILENCE_TIMEOUT:
            self.is_silent = True
            self._finish(f"nothing received for {silent:.0f} s")
            return
        self._timer = asyncio.get_running_loop().call_later(CHECK_INTERVAL, self._check_silence)

    def on_closed(self, link: Link, error: LfieldError | None) -> None:
        reason = str(error) if error is not None else "the host closed the link"
        self._finish(reason)
        self._fail_orders(error if isinstance(error, HandshakeError) else AddressError(self._host, reason))

    def _finish(self, reason: str) -> None:
        if not self.closed.done():
            self.closed.set_result(reason)

    def end(self) -> None:
        """End a link that is no longer needed."""
        self.closed.cancel()
        self._fail_orders(AddressError(self._host, "the connection has ended"))
        if self._timer is not None:
            self._timer.cancel()
