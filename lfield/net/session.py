"""One link of a host, from its greeting to its end."""

from __future__ import annotations

import asyncio
import math
from contextlib import suppress
from typing import TYPE_CHECKING, NoReturn, Protocol

from lfield.errors import AddressError, GreetingError, LfieldError, OverBudget
from lfield.net.waiting.bars import LONGEST_BAR
from lfield.wire.coordinators import Transfer
from lfield.wire.messages import Control, Hello, Message, Ping, Refuse

if TYPE_CHECKING:
    from collections.abc import Callable

    from lfield.authority.identity import Identity
    from lfield.authority.judge import Verdict
    from lfield.net.greeting import Greeting
    from lfield.net.owner import Refusals
    from lfield.net.transport import Link

#: Whoever calls and has not greeted after so many seconds is no host; whoever is called has less time, and is
#: called again.
GREETED_WITHIN, ANSWERED_WITHIN = 10.0, 5.0


class Sessions(Protocol):
    """Who keeps the links of a host."""

    def new_greeting(self, dialled: str | None, who: Identity) -> Greeting:
        """The greeting for a new link with somebody, made when it can be sent."""

    def crossed(self, host: str, came: float) -> bool:
        """Whether this host's own call is the one that counts, of two that crossed; the other `came` then."""

    def known(self, session: Session, hello: Hello) -> None:
        """A link has greeted, and its other side has taken ours."""

    def gone(self, session: Session) -> None:
        """A link is closed."""

    @property
    def refusals(self) -> Refusals:
        """Where it is reported that a link was refused."""

    def heard(self, session: Session, message: Control) -> None:
        """A message came in on a greeted link."""

    @property
    def on_arrival(self) -> Callable[[str, Transfer, memoryview], None]:
        """Where coordinators go."""

    @property
    def on_oversize(self) -> Callable[[str, Transfer, int], None]:
        """Where the headers of coordinators go that are too large."""

    @property
    def now(self) -> Callable[[], float]:
        """The clock's monotonic time."""

    def complain(self, text: str) -> None:
        """A line for the log, once."""

    def note(self, text: str) -> None:
        """A line for the log."""

    def bar(self, host: str) -> float:
        """A host has sent too much: do not accept it for a while; for how many seconds."""

    def barred_for(self, host: str) -> float:
        """For how many seconds a host is not accepted, since it has sent too much."""


class Session:
    """One link from its greeting to its end."""

    link: Link
    _greeting: Greeting

    def __init__(self, peers: Sessions, dialled: str | None) -> None:
        self._peers, self._now = peers, peers.now
        self.dialled = dialled
        self.connected = False
        #: When it was made, and when the other took it.
        self.made, self.linked_at = self._now(), math.inf
        self.hello: Hello | None = None
        #: When something last came, and when this host last had no use for the link.
        self.heard = self.idle = 0.0
        self.reason = ""
        self.over = asyncio.Event()
        #: Whether it has been silent for so long that another link is tried beside it.
        self.is_suspected = False
        #: Set while that is so, and when it is over.
        self.doubtful = asyncio.Event()
        self._patience: asyncio.TimerHandle | None = None

    @property
    def linked(self) -> bool:
        """Whether the other has taken it."""
        return self.linked_at < math.inf

    def wait(self, link: Link) -> None:
        """Somebody calls: wait for the greeting, though not for ever. A stranger hears nothing before it."""
        self.link = link
        self._patience = asyncio.get_running_loop().call_later(self._bound, self._give_up)
        if link.who.kind != "stranger":
            self.begin(link)

    def begin(self, link: Link) -> None:
        """Greet first, and end the link where the other is to hear nothing but why."""
        try:
            self.greet(link)
        except GreetingError as error:
            self.reason = str(error)
            self._tell_refusal()
            if not self.dialled:
                self._complain(self.reason)
            link.close()

    def greet(self, link: Link) -> None:
        """Say who we are, and wait for the other's greeting, though not for ever. Again: nothing happens.

        What this host knows is told as it is now: to be connected may have taken long. Raises GreetingError.
        """
        if self.connected:
            return
        self.link, self.connected = link, True
        self._greeting = self._peers.new_greeting(self.dialled, link.who)
        if self._patience is None:
            self._patience = asyncio.get_running_loop().call_later(self._bound, self._give_up)
        with suppress(AddressError):
            link.send(self._greeting.begin())

    def on_message(self, link: Link, message: Message) -> None:
        """The greeting first, then whatever its sender may send."""
        try:
            self._heard(link, message)
        except GreetingError:
            self._tell_refusal()
            raise

    def _heard(self, link: Link, message: Message) -> None:
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
        hello = self._greeting.receive(message)
        if hello.role == "host" and self._peers.barred_for(hello.host):
            self._refuse(f"{hello.host} sent too much: this host accepts it again within {LONGEST_BAR:g} s")
        if self.dialled is None and hello.role == "host" and self._peers.crossed(hello.host, self.made):
            link.close()
            return
        self.hello = hello
        link.greeted(hello.role)
        if hello.role == "host":
            link.send(Ping(0))
        else:
            self._taken(hello)

    def _refuse(self, reason: str) -> NoReturn:
        with suppress(AddressError):
            self.link.send(Refuse(reason))
        raise GreetingError(reason)

    def _taken(self, hello: Hello) -> None:
        """Something came after the greeting: the other has taken ours."""
        self.heard = self._now()
        if self.linked_at < math.inf:
            if self.is_suspected:
                self.is_suspected = False
                self.doubtful.clear()
            return
        self._relax()
        self.linked_at = self.heard
        self._peers.known(self, hello)

    def _sender(self) -> str:
        """Who sends a coordinator. Raises GreetingError for anybody who is not a host."""
        hello = self.hello
        if hello is None or hello.role != "host":
            raise GreetingError("a coordinator came from nobody that has greeted as a host")
        self._taken(hello)
        return hello.host

    def on_excess(self, link: Link, error: OverBudget) -> None:
        """A host sends more than its messages may cost; where that is for too long, its link is closed.

        It may not have greeted: handshakes can be what is too much.
        """
        self.link, who = link, link.who
        if not error.closes:
            self._peers.note(
                f"{who} at {self.caller} sends too much: {error}; they are taken more slowly, and after "
                f"{error.seconds:g} s the link is closed"
            )
            return
        wait = self._peers.bar(who.name)
        then = f"{who.name} is accepted again after {wait:g} s"
        self._peers.note(f"{who} at {self.caller} sends too much: {error}; the link is closed, and {then}")
        self.dismiss(f"{who.name} sends too much; {then}")
        self._peers.gone(self)

    def on_closed(self, link: Link, error: LfieldError | None) -> None:
        """The end of the link."""
        self._relax()
        self.reason = self.reason or str(error or "")
        if isinstance(error, GreetingError) and not self.linked:
            self._report_refusal()
        # Whoever only looks goes as it likes, without a word.
        went = self.hello is not None and self.hello.role == "observer" and isinstance(error, AddressError)
        if error and not self.dialled and not went and not isinstance(error, OverBudget):
            # Whose address it is stands before, without the port: each attempt has another.
            self._complain(error.reason if isinstance(error, AddressError) else str(error))
        self._peers.gone(self)
        self.over.set()
        self.doubtful.set()

    def judged(self, verdict: Verdict) -> None:
        """The other is good for this now: for no link, or for less on this one than when it was made."""
        self._greeting.verdict = verdict
        if verdict.why:
            self._peers.complain(verdict.why)
        if verdict.extent == "nothing":
            self.dismiss(verdict.why)

    def dismiss(self, reason: str) -> None:
        """Tell the other why its link ends, and end it."""
        self.reason = reason
        with suppress(AddressError):
            self.link.send(Refuse(reason))
        self.link.close()

    def suspect(self) -> None:
        """It has been silent for so long that another link is tried beside it, until something comes."""
        self.is_suspected = True
        self.doubtful.set()

    def end(self) -> None:
        """Another link has taken its place. What waits for a silent one would keep it open for a while."""
        if self.is_suspected:
            self.link.abort()
        else:
            self.link.close()

    def _relax(self) -> None:
        if self._patience:
            self._patience.cancel()

    @property
    def _bound(self) -> float:
        return GREETED_WITHIN if self.dialled is None else ANSWERED_WITHIN

    def _give_up(self) -> None:
        self.turn_away(f"it has not greeted within {self._bound:g} s")

    def turn_away(self, reason: str) -> None:
        """Close the link at once."""
        self.reason = reason
        if not self.dialled:
            self._complain(reason)
        self.link.abort()

    def _tell_refusal(self) -> None:
        with suppress(AddressError):
            if self._greeting.refusal:
                self.link.send(self._greeting.refusal)

    def _report_refusal(self) -> None:
        """The host at the other end is the one that was dialled, or that its certificate names."""
        host = self.dialled or (self.link.who.name if self.link.who.kind == "host" else "")
        if host and self.connected:
            told = self._greeting.refusal
            reason = told.reason if told else self.reason
            self._peers.refusals.report(host, reason, self._greeting.refused_bundle)

    @property
    def caller(self) -> str:
        """The other's address without the port, which is another for every attempt."""
        return self.link.peer.rpartition(":")[0] or self.link.peer

    def _complain(self, reason: str) -> None:
        self._peers.complain(f"closed a link from {self.caller}: {reason}")
