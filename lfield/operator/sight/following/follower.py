"""Follows the streams of hosts: a link to each, made anew after every cut, and what comes goes to one hearer.

The shell of `Cursor`, which knows what to ask for. A host tells something every second, be it that nothing
happened; one that says nothing has no link any more, however long the network takes to see it.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

from msgspec.structs import replace

from lfield.clock import Clock
from lfield.errors import AddressError, GreetingError, KeysError, LfieldError, NobodyListens
from lfield.net.greeting import Greeting
from lfield.net.transport import Link, Transport
from lfield.operator.observing import Brought, ObserverLink, OrderMessage, answered_challenge
from lfield.operator.sight.following.cursor import Cursor
from lfield.wire.messages import Hello, Message, Refuse, Revocations
from lfield.wire.observing import EmergencyStopped, OrderChallenge
from lfield.wire.orders import HOLDS, UNKNOWN, Epochs
from lfield.wire.watching import Events, Seen

#: Whoever is silent for so many seconds is given up; a look is taken every so many.
SILENT, LOOK = 6.0, 1.0
#: A host is asked anew every so many seconds, from where it was: so it is known what its clock shows now.
ASKED_EVERY = 60.0


class Hearer(Protocol):
    """Whoever wants to know what happens on hosts."""

    def linked(self, host: str) -> None:
        """A host is heard, and tells all its telemetry again: when it was called, and every minute."""

    def unlinked(self, host: str, why: str) -> None:
        """It is not, or not any more. Said after every try that failed."""

    def told(self, host: str, batch: Events, took: float | None) -> None:
        """What happened there, nothing twice; `took` seconds after it was asked for, of a first answer."""


class Follower:
    """Follows `hosts` by their names. `reach` says where one is to be found now, as often as it is called.

    `since` and `telemetry` (Hz) as a `Cursor` has them; `brings` is a revocation list for hosts that have an
    older one. `hint` is what else to say, if anything, of one that is not found there. `learn`
    gets the epochs that a host tells, which its orders must name.
    """

    def __init__(
        self,
        transport: Transport,
        hosts: Sequence[str],
        reach: Callable[[str], Awaitable[str]],
        hearer: Hearer,
        clock: Clock,
        *,
        since: int | None = None,
        telemetry: float = 0.0,
        brings: Brought | None = None,
        hint: Callable[[], str] = lambda: "",
        learn: Callable[[str, Epochs], None] = lambda host, epochs: None,
    ) -> None:
        self._transport, self._hosts, self._reach, self._hint = transport, hosts, reach, hint
        self._hearer, self._clock, self._brings, self._learn = hearer, clock, brings, learn
        self._cursors = {host: Cursor(since, telemetry) for host in hosts}
        #: Where each was called last, and those that are heard now.
        self._tried: dict[str, str] = {}
        self._watching: dict[str, Watching] = {}

    async def run(self) -> None:
        """Follow all of them until this is cancelled."""
        async with asyncio.TaskGroup() as group:
            for host in self._hosts:
                group.create_task(self._follow(host))

    async def order(self, host: str, message: OrderMessage) -> EmergencyStopped:
        """Give an order over the connection that stands with a host; what it answers.

        Raises AddressError where there is none, or it ends before that, and GreetingError for a refusal.
        """
        watching = self._watching.get(host)
        if watching is None:
            raise AddressError(host, "there is no connection with it")
        return await watching.order(message)

    async def _follow(self, host: str) -> None:
        cursor = self._cursors[host]
        while True:
            why, unheard = await self._once(host, cursor)
            self._hearer.unlinked(host, why)
            await asyncio.sleep(cursor.failed(unheard=unheard))

    async def _once(self, host: str, cursor: Cursor) -> tuple[str, bool]:
        """Follow a host until there is no link any more; why that is, and whether nothing was heard of it."""
        watching = Watching(host, cursor, self._hearer, self._clock, self._brings, self._learn)
        link: Link | None = None
        try:
            address = await self._reach(host)
            if self._tried.get(host, address) != address:
                # It was started elsewhere since it was last looked for.
                cursor.nobody()
            self._tried[host] = address
            self._watching[host] = watching
            link = await self._transport.connect(address, watching)
            watching.greet(link)
            return await watching.over, watching.is_silent
        except AddressError as error:
            if isinstance(error, NobodyListens):
                cursor.nobody()
            return "; ".join(filter(None, (str(error), self._hint()))), True
        except LfieldError as error:
            return str(error), False
        finally:
            self._watching.pop(host, None)
            watching.end()
            if link is not None:
                link.abort()


@dataclass(slots=True)
class _Given:
    """An order that was sent, and what comes of it."""

    message: OrderMessage
    answer: asyncio.Future[EmergencyStopped]


class Watching(ObserverLink):
    """The handler of one link: greets, watches, hands on what comes, and says that it was read."""

    def __init__(
        self,
        host: str,
        cursor: Cursor,
        hearer: Hearer,
        clock: Clock,
        brings: Brought | None,
        learn: Callable[[str, Epochs], None],
    ) -> None:
        self._host, self._cursor, self._hearer = host, cursor, hearer
        self._clock, self._brings, self._learn = clock, brings, learn
        self._greeting: Greeting | None = None
        #: When it was asked what has not been answered yet, and when it is to be asked anew.
        self._asked: float | None = None
        self._due = 0.0
        self._heard = clock.monotonic()
        self._timer: asyncio.TimerHandle | None = None
        #: Whether it was given up, since nothing came.
        self.is_silent = False
        #: The link once the host has greeted, with the epochs that it told last, and the orders under way.
        self._link: Link | None = None
        self._epochs = Epochs()
        self._orders: dict[bytes, _Given] = {}
        #: Why the link is over, when it is.
        self.over: asyncio.Future[str] = asyncio.get_running_loop().create_future()

    def greet(self, link: Link) -> Greeting:
        """Greet whoever is there, once; what the host says may come first. Raises KeysError."""
        if self._greeting is None:
            if link.who.kind == "stranger":
                raise KeysError(
                    f"the host at {link.peer} tells those alone who have keys: 'lfield keys person' makes "
                    "them, and --keys, $LFIELD_KEYS or ~/.config/lfield/keys/me says where they are"
                )
            self._greeting = Greeting(Hello("observer", "observer", 0), link.who, dialled=self._host)
            link.send(self._greeting.begin())
            self._timer = asyncio.get_running_loop().call_later(LOOK, self._look)
        return self._greeting

    def on_message(self, link: Link, message: Message) -> None:
        """The greeting first, then batches."""
        greeting = self.greet(link)
        self._heard = self._clock.monotonic()
        if greeting.peer is None:
            hello = greeting.receive(message)
            link.greeted(hello.role)
            if self._brings is not None and hello.revoked < self._brings.number:
                link.send(Revocations(self._brings.data))
            self._link = link
            self._told_epochs(hello.epochs)
            self._watch(link, hello.incarnation)
        elif isinstance(message, Refuse):
            refusal = GreetingError(f"{greeting.peer.host} refused: {message.reason}")
            self._fail_orders(refusal)
            raise refusal
        elif isinstance(message, Events):
            self._take(link, message)
        elif isinstance(message, EmergencyStopped | OrderChallenge):
            self._answered(link, message)

    def _told_epochs(self, epochs: Epochs) -> None:
        self._epochs = epochs
        self._learn(self._host, epochs)

    async def order(self, message: OrderMessage) -> EmergencyStopped:
        """See `Follower.order`. An order to end something names no state: the host tells its own first."""
        if self._link is None:
            raise AddressError(self._host, "there is no connection with it")
        epoch = self._epochs.hold if message.kind in HOLDS else UNKNOWN
        given = _Given(replace(message, epoch=epoch), asyncio.get_running_loop().create_future())
        self._orders[message.id] = given
        try:
            self._link.send(given.message)
            return await given.answer
        finally:
            del self._orders[message.id]

    def _answered(self, link: Link, message: EmergencyStopped | OrderChallenge) -> None:
        self._told_epochs(message.epochs)
        given = self._orders.get(message.id)
        if given is None or given.answer.done():
            return
        if isinstance(message, EmergencyStopped):
            given.answer.set_result(message)
        elif again := answered_challenge(given.message, message):
            given.message = again
            link.send(again)

    def _fail_orders(self, error: LfieldError) -> None:
        for given in self._orders.values():
            if not given.answer.done():
                given.answer.set_exception(error)

    def _watch(self, link: Link, incarnation: int) -> None:
        self._asked, self._due = self._heard, self._heard + ASKED_EVERY
        link.send(self._cursor.watch(incarnation))

    def _take(self, link: Link, batch: Events) -> None:
        """A batch; its host may send another for it once the hearer has it."""
        if self.over.done():
            return
        if batch.snapshot is not None:
            self._told_epochs(batch.snapshot.epochs)
        took = None
        if self._asked is not None and batch.batch == 1:
            took, self._asked = self._heard - self._asked, None
            self._hearer.linked(self._host)
        self._hearer.told(self._host, self._cursor.took(batch), took)
        link.send(Seen(batch.batch))
        if self._asked is None and self._heard >= self._due:
            self._watch(link, batch.incarnation)

    def _look(self) -> None:
        """Give up on a host that says nothing."""
        silent = self._clock.monotonic() - self._heard
        if silent >= SILENT:
            self.is_silent = True
            self._over(f"nothing was heard of it for {silent:.0f} s")
            return
        self._timer = asyncio.get_running_loop().call_later(LOOK, self._look)

    def on_closed(self, link: Link, error: LfieldError | None) -> None:
        """The link is gone."""
        why = str(error) if error is not None else "it has closed the link"
        self._over(why)
        self._fail_orders(error if isinstance(error, GreetingError) else AddressError(self._host, why))

    def _over(self, why: str) -> None:
        if not self.over.done():
            self.over.set_result(why)

    def end(self) -> None:
        """Nobody waits for it any more."""
        self.over.cancel()
        self._fail_orders(AddressError(self._host, "the connection with it has ended"))
        if self._timer is not None:
            self._timer.cancel()
