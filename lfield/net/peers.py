"""The links of one host: whom it calls, who calls it, and when a silent link is given up.

Of two hosts the one that stands first in the deployment calls the other, again and again until it answers;
so there is one link between two hosts, and they may come up in any order. A link counts when both have
taken the other's greeting: each then sends a Ping, and whoever is not taken gets a Refuse instead.
"""

from __future__ import annotations

import asyncio
import random
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Protocol

from lfield.clock import Clock
from lfield.errors import AddressError, GreetingError, LfieldError
from lfield.loop import spare_descriptors, spawn
from lfield.net.greeting import Greeting
from lfield.net.guests import Guests
from lfield.net.transport import Link, Listener, Transport
from lfield.wire.framing import Buffer
from lfield.wire.messages import Control, Hello, Message, Ping, Pong, Refuse, Transfer

#: Seconds between two attempts to reach a host: the first wait, and the longest.
FIRST_RETRY, LAST_RETRY = 0.05, 1.0
#: A link is asked for a sign of life every so many seconds, and given up after so many without one.
PING_EVERY, SILENT_FOR = 1.0, 3.0
#: Whoever has not greeted after so many seconds is no host.
GREETED_WITHIN = 10.0
#: So many links at most that have not greeted, and of observers.
MOST_UNGREETED, MOST_OBSERVERS = 64, 64
#: So many descriptors are kept for the next callers, one of which may be an emergency stop.
SPARE, FULL = 4, "this computer lets this host open no more links"
#: How many different complaints are remembered, so as not to be repeated.
MOST_COMPLAINTS = 100


class Owner(Protocol):
    """The host the links belong to."""

    def hello(self) -> Hello:
        """What this host says of itself now."""

    def linked(self, hello: Hello) -> None:
        """A host can be talked to."""

    def unlinked(self, host: str) -> None:
        """A host cannot be talked to any more."""

    def received(self, host: str, message: Control, link: Link) -> None:
        """A message came; `host` is '' when an observer sent it."""

    def arrived(self, host: str, header: Transfer, block: memoryview) -> None:
        """A coordinator came."""

    def too_large(self, host: str, header: Transfer, size: int) -> None:
        """A coordinator came whose block was not even read."""

    def note(self, text: str) -> None:
        """A line for the log."""


class Peers:
    """All links of one host. `hosts` and `addresses` are the deployment's, `here` this host's number."""

    def __init__(
        self,
        owner: Owner,
        transport: Transport,
        clock: Clock,
        dice: random.Random,
        hosts: Sequence[str],
        addresses: Sequence[str],
        here: int,
    ) -> None:
        self._owner, self._transport, self._clock = owner, transport, clock
        self._hosts, self._addresses, self._here = hosts, addresses, here
        self._links: dict[str, Session] = {}
        self._tasks: list[asyncio.Task[None]] = []
        self._listeners: list[Listener] = []
        self._complaints: set[str] = set()
        self._ungreeted: Guests[Session] = Guests(MOST_UNGREETED, dice)
        self._observers: Guests[Session] = Guests(MOST_OBSERVERS, dice)
        #: The hosts that have neither greeted yet nor failed to answer a call, and those that have greeted.
        self._unheard = {host for i, host in enumerate(hosts) if i != here}
        self._all_heard = asyncio.Event()
        self._met: set[str] = set()
        #: When each host that has no link any more was last heard.
        self._last_heard: dict[str, float] = {}
        #: Since when each host without a link has had none, on the monotonic clock.
        self.away: dict[str, float] = {}

    @property
    def incarnations(self) -> dict[str, int]:
        """The hosts that are linked now, with their incarnations."""
        return {host: s.hello.incarnation for host, s in self._links.items() if s.hello}

    def last_heard(self, host: str) -> float | None:
        """When something last came from a host, on the monotonic clock; None when nothing ever did."""
        session = self._links.get(host)
        return session.heard if session else self._last_heard.get(host)

    def gone_for(self, seconds: float, unmet: float) -> set[str]:
        """The hosts that have not been linked for so long; one that was never met has `unmet` seconds."""
        now = self._clock.monotonic()
        return {
            host
            for host, since in self.away.items()
            if now - since >= (seconds if host in self._met else unmet)
        }

    async def open(self, address: str) -> str:
        """Listen, begin to call the others; returns the address with its real port. Raises AddressError."""
        listener = await self._transport.listen(address, self._called)
        self._listeners.append(listener)
        now = self._clock.monotonic()
        self.away = {host: now for i, host in enumerate(self._hosts) if i != self._here}
        for number in range(self._here + 1, len(self._hosts)):
            self._tasks.append(spawn(self._keep_calling(number)))
        if not self._unheard:
            self._all_heard.set()
        self._tasks.append(spawn(self._keep_alive()))
        return listener.address

    async def open_door(self, address: str) -> None:
        """Listen there too, for observers alone. Raises AddressError."""

        def called(link: Link) -> Session:
            return self._called(link, observers_only=True)

        self._listeners.append(await self._transport.listen(address, called))

    async def first_round(self, bound: float) -> None:
        """Return when every host has greeted or did not answer when called, or after `bound` seconds.

        A host that calls this one cannot be told from one that is down: it is waited for.
        """
        with suppress(TimeoutError):
            async with asyncio.timeout(bound):
                await self._all_heard.wait()

    def close(self) -> None:
        """Close the port and every link."""
        for task in self._tasks:
            task.cancel()
        for listener in self._listeners:
            listener.close()
        for session in list(self._links.values()):
            session.link.close()

    def send(self, host: str, message: Control) -> None:
        """Send to a host; without a link the message is dropped, as mobility expects."""
        session = self._links.get(host)
        if session:
            with suppress(AddressError):
                session.link.send(message)

    def send_transfer(self, host: str, header: Transfer, block: Buffer) -> None:
        """Send a coordinator to a host. Where the link is just closing, `unlinked` is about to follow."""
        session = self._links.get(host)
        if session:
            with suppress(AddressError):
                session.link.send_transfer(header, block)

    # --- both directions ------------------------------------------------------------------------------

    def _called(self, link: Link, *, observers_only: bool = False) -> Session:
        session = Session(self, dialled=None, observers_only=observers_only)
        # The transport hands out messages only when this has returned.
        session.greet(link)
        last = not spare_descriptors(SPARE)
        pushed = self._ungreeted.enter(session, session.caller, last=last)
        if pushed is not None:
            pushed.turn_away(FULL if last else f"over {MOST_UNGREETED} links to this host have not greeted")
        return session

    async def _keep_calling(self, number: int) -> None:
        name, address = self._hosts[number], self._addresses[number]
        wait, told = FIRST_RETRY, ""
        while True:
            session = Session(self, dialled=name)
            try:
                session.greet(await self._transport.connect(address, session))
                await session.over.wait()
                reason = session.reason
                wait = FIRST_RETRY if session.linked else wait
            except AddressError as error:
                reason = str(error)
            self._heard_of(name)
            if reason and reason != told:
                # A host that is not up yet is no news; one that is there and refuses is.
                if session.connected and not session.linked:
                    self._owner.note(f"cannot talk to {name}: {reason}")
                told = reason
            await asyncio.sleep(wait)
            wait = min(LAST_RETRY, wait * 1.5)

    def _heard_of(self, host: str) -> None:
        self._unheard.discard(host)
        if not self._unheard:
            self._all_heard.set()

    async def _keep_alive(self) -> None:
        token = 0
        while True:
            await asyncio.sleep(PING_EVERY)
            token += 1
            now = self._clock.monotonic()
            for host, session in list(self._links.items()):
                if now - session.heard > SILENT_FOR:
                    self._owner.note(f"{host} has been silent for {SILENT_FOR:g} s: giving the link up")
                    session.link.close()
                    self.gone(session)
                else:
                    self.send(host, Ping(token))

    # --- what sessions report -------------------------------------------------------------------------

    def new_greeting(self, dialled: str | None, *, observers_only: bool) -> Greeting:
        """The greeting for a new link."""
        return Greeting(
            self._owner.hello(),
            hosts=self._hosts,
            linked=self.incarnations,
            dialled=dialled,
            observers_only=observers_only,
        )

    def known(self, session: Session, hello: Hello) -> None:
        """A link has greeted, and its other side has taken ours."""
        self._ungreeted.leave(session)
        if hello.role == "host":
            self._linked(session, hello)
            return
        pushed = self._observers.enter(session, session.caller)
        if pushed is not None:
            pushed.turn_away(f"over {MOST_OBSERVERS} observers have links to this host")

    def _linked(self, session: Session, hello: Hello) -> None:
        old = self._links.get(hello.host)
        self._links[hello.host] = session
        if old and old is not session:
            old.link.close()
        self.away.pop(hello.host, None)
        self._met.add(hello.host)
        self._owner.linked(hello)
        self._heard_of(hello.host)

    def gone(self, session: Session) -> None:
        """A link is closed."""
        self._ungreeted.leave(session)
        self._observers.leave(session)
        host = session.hello.host if session.hello else ""
        if self._links.get(host) is session:
            del self._links[host]
            self.away[host] = self._clock.monotonic()
            self._last_heard[host] = session.heard
            self._owner.unlinked(host)

    def heard(self, session: Session, message: Control) -> None:
        """A message came in on a greeted link."""
        if isinstance(message, Ping):
            session.link.send(Pong(message.token))
        elif not isinstance(message, Pong):
            hello = session.hello
            assert hello is not None
            self._owner.received(hello.host if hello.role == "host" else "", message, session.link)

    @property
    def on_arrival(self) -> Callable[[str, Transfer, memoryview], None]:
        """Where coordinators go."""
        return self._owner.arrived

    @property
    def on_oversize(self) -> Callable[[str, Transfer, int], None]:
        """Where the headers of coordinators go that are too large."""
        return self._owner.too_large

    def now(self) -> float:
        """The clock's monotonic time."""
        return self._clock.monotonic()

    def complain(self, text: str) -> None:
        """A line for the log, once: a caller that is refused calls again every second."""
        if text in self._complaints:
            return
        if len(self._complaints) >= MOST_COMPLAINTS:
            self._complaints.clear()
        self._complaints.add(text)
        self._owner.note(text)


class Session:
    """One link from its greeting to its end."""

    link: Link

    def __init__(self, peers: Peers, dialled: str | None, *, observers_only: bool = False) -> None:
        self._peers = peers
        self.dialled = dialled
        self.connected = self.linked = False
        self._greeting = peers.new_greeting(dialled, observers_only=observers_only)
        self.hello: Hello | None = None
        self.heard = 0.0
        self.reason = ""
        self.over = asyncio.Event()
        self._patience: asyncio.TimerHandle | None = None

    def greet(self, link: Link) -> None:
        """Say who we are, and wait for the other's greeting, though not for ever. Again: nothing happens."""
        if self.connected:
            return
        self.link, self.connected = link, True
        self._patience = asyncio.get_running_loop().call_later(GREETED_WITHIN, self._give_up)
        with suppress(AddressError):
            link.send(self._greeting.own)

    def on_message(self, link: Link, message: Message) -> None:
        """The greeting first, then whatever its sender may send."""
        if self.hello is None:
            self._greeted(link, message)
            return
        if isinstance(message, Refuse):
            raise GreetingError(f"{self.hello.host} refused this host: {message.reason}")
        self._greeting.admit(message)
        self._taken(self.hello)
        self._peers.heard(self, message)  # type: ignore[arg-type]  # admit lets only Control pass

    def on_transfer(self, link: Link, header: Transfer, block: memoryview) -> None:
        """A coordinator: only from a greeted host."""
        self._peers.on_arrival(self._sender(), header, block)

    def on_oversize(self, link: Link, header: Transfer, size: int) -> None:
        """A coordinator over the limit."""
        self._peers.on_oversize(self._sender(), header, size)

    def _greeted(self, link: Link, message: Message) -> None:
        """The other's greeting: tell it that it is taken, or why it is not."""
        # On a link just made, the other's greeting may be read before whoever called gets its turn.
        self.greet(link)
        try:
            hello = self._greeting.receive(message)
        except GreetingError:
            if self._greeting.refusal:
                link.send(self._greeting.refusal)
            raise
        self.hello = hello
        link.greeted(hello.role)
        if hello.role == "host":
            link.send(Ping(0))
        else:
            self._taken(hello)

    def _taken(self, hello: Hello) -> None:
        """Something came after the greeting: the other has taken ours."""
        self.heard = self._peers.now()
        if self.linked:
            return
        self._relax()
        self.linked = True
        self._peers.known(self, hello)

    def _sender(self) -> str:
        """Who sends a coordinator. Raises GreetingError for anybody who is not a host."""
        if self.hello is None or self.hello.role != "host":
            raise GreetingError("a coordinator came from nobody that has greeted as a host")
        self._taken(self.hello)
        return self.hello.host

    def on_closed(self, link: Link, error: LfieldError | None) -> None:
        """The end of the link."""
        self._relax()
        self.reason = self.reason or str(error or "")
        if error and not self.dialled:
            self._complain(str(error))
        self._peers.gone(self)
        self.over.set()

    def _relax(self) -> None:
        if self._patience:
            self._patience.cancel()

    def _give_up(self) -> None:
        self.turn_away(f"it has not greeted within {GREETED_WITHIN:g} s")

    def turn_away(self, reason: str) -> None:
        """Close the link at once."""
        self.reason = reason
        if not self.dialled:
            self._complain(reason)
        self.link.abort()

    @property
    def caller(self) -> str:
        """The other's address without the port, which is another for every attempt."""
        return self.link.peer.rpartition(":")[0] or self.link.peer

    def _complain(self, reason: str) -> None:
        self._peers.complain(f"closed a link from {self.caller}: {reason}")
