"""The links of one host: whom it calls, who calls it, and when a silent link is given up.

A host has links with those that it wants, and calls them again and again until they answer. Of two
neighbours the one that stands first in the deployment calls; any other link is made by whoever wants it, and
goes when neither has had a use for it for a while. Of two calls that cross, the one of the host that stands
first counts; so there is one link between two hosts, and they may come up in any order. A link counts when
both have taken the other's greeting: each then sends a Ping, and whoever is not taken gets a Refuse instead.
"""

from __future__ import annotations

import asyncio
import random
from collections.abc import Collection, Sequence
from contextlib import suppress

from lfield.authority.admission import Admission
from lfield.authority.identity import Identity
from lfield.clock import Clock
from lfield.errors import AddressError, KeysError, WireError
from lfield.loop import spare_descriptors, spawn
from lfield.net.greeting import Greeting
from lfield.net.guests import Guests
from lfield.net.health.heartbeats import LOST_AFTER, PING_EVERY
from lfield.net.health.watch import Watch
from lfield.net.owner import Complaints, Owner, Refusals
from lfield.net.paths.dialler import Dialler
from lfield.net.session import Session
from lfield.net.transport import Link, Listener, Transport
from lfield.net.waiting.bars import Bars
from lfield.net.waiting.handshakes import source_of
from lfield.wire.coordinators import Transfer
from lfield.wire.framing import Buffer
from lfield.wire.messages import QUESTION, Control, Hello, Ping, Pong, Revocations

#: So many seconds a link is wanted that was needed for once, and one that nobody wants is kept.
QUIET_FOR = 10.0
#: After so many seconds without a link both of two neighbours call.
BOTH_CALL_AFTER = 3.0
#: So long at most a call is new, in seconds.
NEW_FOR = 1.0
#: So many links at most that have not greeted, by address, and of observers, by who they are.
MOST_UNGREETED, MOST_OBSERVERS = 64, 64
#: So many descriptors are kept for the next callers, one of which may be an emergency stop.
SPARE, FULL = 4, "this computer lets this host open no more links"


class Peers:
    """All links of one host. `hosts` and `addresses` are the deployment's, `here` this host's number.

    `near` are the hosts that want a link with this one as it does with them.
    """

    def __init__(
        self,
        owner: Owner,
        transport: Transport,
        clock: Clock,
        dice: random.Random,
        hosts: Sequence[str],
        addresses: Sequence[str],
        here: int,
        near: Collection[str],
        admission: Admission | None = None,
    ) -> None:
        self._owner, self._transport, self._clock = owner, transport, clock
        self._admission, self.now = admission or Admission(), clock.monotonic
        self._hosts, self._addresses, self._here, self._near = hosts, addresses, here, near
        self._numbers = {host: number for number, host in enumerate(hosts)}
        #: Whom this host wants to talk to: always, and until when.
        self._wanted: frozenset[str] = frozenset()
        self._needed: dict[str, float] = {}
        #: Those that call, by host.
        self._callers: dict[str, Dialler] = {}
        #: When each last called, and the hosts that sent too much.
        self._came, self._bars = dict[str, float](), Bars()
        self._links: dict[str, Session] = {}
        self.watch = Watch(hosts, here, self.now)
        self._tasks, self._listeners = list[asyncio.Task[None]](), list[Listener]()
        self.on_arrival = lambda *transfer: owner.arrived(*transfer)
        self.on_oversize = lambda *transfer: owner.too_large(*transfer)
        self._complaints, self.refusals = Complaints(owner.note, self.now), Refusals(hosts)
        self._ungreeted: Guests[Session] = Guests(MOST_UNGREETED, dice, lambda one: one.link.is_answered)
        self._observers: Guests[Session] = Guests(MOST_OBSERVERS, dice)
        #: The hosts that have neither greeted yet nor failed to answer a call, and those that have greeted.
        self._unheard = {host for i, host in enumerate(hosts) if i != here}
        self._all_heard = asyncio.Event()
        #: When each host that has no link any more was last heard.
        self._last_heard: dict[str, float] = {}
        #: Since when each host that is wanted and has no link has had none, on the monotonic clock.
        self.away: dict[str, float] = {}

    @property
    def incarnations(self) -> dict[str, int]:
        """The hosts that are linked now, with their incarnations."""
        return {host: s.hello.incarnation for host, s in self._links.items() if s.hello}

    def last_heard(self, host: str) -> float | None:
        """When something last came from a host, on the monotonic clock; None when nothing ever did."""
        session = self._links.get(host)
        return session.heard if session else self._last_heard.get(host)

    async def open(self, address: str) -> str:
        """Listen, begin to call the others; returns the address with its real port. Raises AddressError.

        Where the address is '', nobody but commands at the door will call.
        """
        if address:
            self._listeners.append(await self._transport.listen(address, self._called))
            address = self._listeners[0].address
        self._want(self._clock.monotonic())
        if not self._unheard:
            self._all_heard.set()
        self._tasks.append(spawn(self._keep_alive()))
        return address

    async def open_door(self, address: str) -> None:
        """Listen there too, at a Unix socket, for commands of this computer. Raises AddressError."""
        self._listeners.append(await self._transport.listen(address, self._called))

    async def first_round(self, bound: float) -> None:
        """Return when every host has greeted or did not answer when called, or after `bound` seconds.

        A host that calls this one cannot be told from one that is down: it is waited for.
        """
        for host in sorted(self._unheard):
            self.reach(host)
        with suppress(TimeoutError):
            async with asyncio.timeout(bound):
                await self._all_heard.wait()

    def close(self) -> None:
        """Close the port and every link."""
        self._wanted, self._needed = frozenset(), {}
        for task in self._tasks:
            task.cancel()
        for caller in self._callers.values():
            caller.cancel()
        for listener in self._listeners:
            listener.close()
        for session in list(self._links.values()):
            session.link.close()
        for session in self._ungreeted:
            session.link.abort()

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

    def _called(self, link: Link) -> Session:
        # The transport hands out messages only when this has returned.
        (session := Session(self, dialled=None)).wait(link)
        last = not spare_descriptors(SPARE)
        pushed = self._ungreeted.enter(session, source_of(link.peer), last=last)
        if pushed is not None:
            pushed.turn_away(FULL if last else f"over {MOST_UNGREETED} links to this host have not greeted")
        return session

    def reach(self, host: str) -> None:
        """A host is needed for a while: call it if there is no link."""
        now = self._clock.monotonic()
        self._needed[host] = now + QUIET_FOR
        if host not in self._links:
            self.away.setdefault(host, now)
        self._call(host)

    def is_new(self, host: str) -> bool:
        """Whether a host has no link yet, and this one has just begun to call it."""
        since = self.away.get(host, -NEW_FOR)
        caller = self._callers.get(host)
        called = caller is not None and not caller.has_failed
        return called and self._clock.monotonic() - since < NEW_FOR

    def wants(self, host: str) -> bool:
        """See `Diallers.wants`."""
        return host in self._wanted or self._needed.get(host, 0.0) > self._clock.monotonic()

    def _call(self, host: str) -> None:
        session = self._links.get(host)
        if session is not None and not session.is_suspected:
            return
        # A neighbour that stands before this one calls.
        if host in self._near and self._numbers[host] < self._here and not self._is_missed(host):
            return
        caller = self._callers.get(host)
        if caller is None or caller.is_over:
            at, note = self._addresses[self._numbers[host]], self._owner.note
            self._callers[host] = Dialler(self, self._transport, self._clock, host, at, note)

    def _is_missed(self, host: str) -> bool:
        """Whether a host has neither had a link nor called for so long that both of the two call: it may not
        find this one, as when this computer has another network card now."""
        now = self._clock.monotonic()
        return now - max(self.away.get(host, now), self._came.get(host, 0.0)) >= BOTH_CALL_AFTER

    # --- what diallers ask ----------------------------------------------------------------------------

    def link_of(self, host: str) -> Session | None:
        """See `Diallers.link_of`."""
        return self._links.get(host)

    def barred_for(self, host: str) -> float:
        """For how many seconds a host is not accepted, since it has sent too much."""
        return self._bars.left(host, self.now())

    def called(self, host: str) -> None:
        """A host was called, whatever came of it, or has greeted."""
        self._unheard.discard(host)
        if not self._unheard:
            self._all_heard.set()

    async def _keep_alive(self) -> None:
        while True:
            await asyncio.sleep(PING_EVERY)
            now = self._clock.monotonic()
            self._want(now)
            for host, session in list(self._links.items()):
                self._look_at(host, session, now)
            self.judge()

    def _want(self, now: float) -> None:
        """Call whom this host wants now and has no link with; no others any more."""
        self._wanted = frozenset(self._owner.wanted())
        self._needed = {host: until for host, until in self._needed.items() if until > now}
        wanted = self._wanted | self._needed.keys()
        self.away = {
            host: self.away.get(host, now)
            for host in sorted(wanted - self._links.keys(), key=self._numbers.__getitem__)
        }
        for host in self.away:
            self._call(host)
        for host in sorted(self._callers.keys() - wanted - self._links.keys()):
            self._callers.pop(host).cancel()

    def _look_at(self, host: str, session: Session, now: float) -> None:
        silent = now - session.heard
        if not self.wants(host):
            session.idle = now
            if silent > QUIET_FOR:
                session.link.close()
                self.gone(session)
            return
        silent = now - max(session.heard, session.idle)
        match self.watch.look(host, silent):
            case "lost":
                self._owner.note(f"{host} has been silent for {silent:.1f} s: giving the link up")
                # What waits for it would keep the link open for a while yet.
                session.link.abort()
                self.gone(session)
            case "suspected":
                session.suspect()
                self._call(host)

    # --- what sessions report -------------------------------------------------------------------------

    def new_greeting(self, dialled: str | None, who: Identity) -> Greeting:
        """The greeting for a new link."""
        if dialled is None:
            self._came[who.name] = self.now()
        return Greeting(
            self._admission.signed(self._owner.hello()),
            who,
            verdict=self._admission.verdict(who, expected=dialled or ""),
            hosts=self._hosts,
            linked=self._lively(),
            dialled=dialled,
        )

    def _lively(self) -> dict[str, int]:
        """The lives of the linked hosts; the end of a link that is not wanted may go unnoticed."""
        now = self._clock.monotonic()
        return {
            host: session.hello.incarnation
            for host, session in self._links.items()
            if session.hello and (self.wants(host) or now - session.heard <= LOST_AFTER)
        }

    def crossed(self, host: str, came: float) -> bool:
        """Whether this host's own call is the one that counts, of two that crossed; the other `came` then."""
        caller = self._callers.get(host)
        own = caller.session if caller is not None else None
        if own is None or not own.connected:
            return False
        if self._here < self._numbers.get(host, -1):
            # Who calls when the own call has long been taken has lost that link, and may not have told.
            return came < own.linked_at
        if not own.linked:
            own.link.close()
        return False

    def judge(self) -> None:
        """End the links of whoever is not to have one any more, and leave others what they still may.

        What a revoked host may finish it does as a host: the link on which it only looks is none that stands.
        """
        dialling = [caller.session for caller in self._callers.values() if caller.session is not None]
        links, others = self._links.values(), (*self._observers, *self._ungreeted, *dialling)
        for session in dict.fromkeys((*links, *others)):
            if session.connected:
                session.judged(self._admission.verdict(session.link.who, linked=session in links))

    def _take_list(self, data: bytes) -> None:
        """A revocation list has come: pass on one that is new to all, and to its end whom it is about."""
        try:
            line = self._admission.news(data)
        except KeysError as error:
            raise WireError(str(error)) from None
        if line:
            self._owner.note(line)
            for host in self._links:
                self.send(host, Revocations(data))
            self.judge()

    def known(self, session: Session, hello: Hello) -> None:
        """A link has greeted, and its other side has taken ours."""
        self._ungreeted.prove(session, source_of(session.link.peer))
        self._admission.greeted(session.link.who, hello)
        if line := self._admission.line():
            self.complain(line)
        if hello.role == "host" and hello.revoked < self._admission.number:
            session.link.send(Revocations(self._admission.list))
        if hello.role == "host":
            self._linked(session, hello)
            return
        pushed = self._observers.enter(session, str(session.link.who))
        if pushed is not None:
            pushed.turn_away(f"over {MOST_OBSERVERS} observers have links to this host")

    def _linked(self, session: Session, hello: Hello) -> None:
        self.watch.linked(hello.host, session.link)
        old = self._links.get(hello.host)
        self._links[hello.host] = session
        if old and old is not session:
            old.end()
        self.away.pop(hello.host, None)
        if caller := self._callers.get(hello.host):
            caller.has_failed = False
        self.refusals.report(hello.host, "")
        self._owner.linked(hello)
        self.called(hello.host)

    def gone(self, session: Session) -> None:
        """A link is closed."""
        for guests in (self._ungreeted, self._observers):
            guests.leave(session)
        host = session.hello.host if session.hello else ""
        if self._links.get(host) is session:
            del self._links[host]
            self.watch.unlinked(host)
            self._last_heard[host] = session.heard
            wanted = self.wants(host)
            if wanted:
                self.away[host] = self._clock.monotonic()
            self._owner.unlinked(host, quietly=not wanted)
            if wanted:
                self._call(host)

    def heard(self, session: Session, message: Control) -> None:
        """A message came in on a greeted link."""
        hello = session.hello
        assert hello is not None
        host = hello.host if hello.role == "host" else ""
        if isinstance(message, Ping):
            self.watch.asked(host, session.link, message)
        elif isinstance(message, Revocations):
            self._take_list(message.list)
        elif isinstance(message, Pong) and message.token != QUESTION:
            self.watch.answered(host, message)
        else:
            self._owner.received(host, message, session.link)

    def bar(self, host: str) -> float:
        """A host has sent too much: do not accept it for a while; for how many seconds."""
        return self._bars.bar(host, self.now())

    def note(self, text: str) -> None:
        """A line for the log."""
        self._owner.note(text)

    def complain(self, text: str) -> None:
        """A line for the log, once: a caller that is refused calls again every second."""
        self._complaints.say(text)
