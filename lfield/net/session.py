"""Link session of a host: handshake, acceptance, messages, end."""

from __future__ import annotations

import asyncio
import math
from contextlib import suppress
from typing import TYPE_CHECKING, NoReturn, Protocol

from lfield.errors import AddressError, CpuBudgetExceeded, HandshakeError, LfieldError
from lfield.net.health.link_heartbeats import LOST_AFTER
from lfield.net.scheduling.temporary_bans import LONGEST_BAN
from lfield.text import log_messages
from lfield.text.log_messages import LogLine
from lfield.wire.coordinator_messages import Transfer
from lfield.wire.messages import Control, HandshakeRefused, Hello, Message, Ping, Pong

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from lfield.authority.identity import Identity
    from lfield.authority.peer_verification import AdmissionDecision
    from lfield.net.handshake import Handshake
    from lfield.net.link_owner import RefusedHosts
    from lfield.net.transport import Link

#: Seconds for an incoming handshake, and for an outgoing one, which is shorter because dialling is repeated.
HANDSHAKE_TIMEOUT, ANSWER_TIMEOUT = 10.0, 5.0


class SessionOwner(Protocol):
    """The owner of a host's sessions."""

    def new_handshake(self, dialled: str | None, identity: Identity) -> Handshake:
        """The handshake for a new link, created when it can be sent."""

    def prefers_outgoing(self, host: str, made_at: float) -> bool:
        """Whether this host's own dial wins over a crossing one of time `made_at`."""

    def on_standby_hello(self, link: Link, hello: Hello, session: Session) -> None:
        """A caller offers its connection as a standby; `session` receives no more messages from it."""

    def on_greeted(self, session: Session, hello: Hello) -> None:
        """A link has completed its handshake on both sides."""

    def on_link_closed(self, session: Session) -> None:
        """A link is closed."""

    @property
    def refusals(self) -> RefusedHosts:
        """Receives reports of refused links."""

    def on_message(self, session: Session, message: Control) -> None:
        """A message arrived on an established link."""

    @property
    def on_arrival(self) -> Callable[[str, Transfer, memoryview], None]:
        """Receives coordinators."""

    @property
    def on_oversize(self) -> Callable[[str, Transfer, int], None]:
        """Receives the headers of oversized coordinators."""

    @property
    def now(self) -> Callable[[], float]:
        """The monotonic time."""

    def log_once(self, line: LogLine) -> None:
        """Write a log line once."""

    def note(self, line: LogLine) -> None:
        """Write a log line."""

    def ban(self, host: str) -> float:
        """Ban a flooding host for a while. Returns the seconds."""

    def ban_remaining(self, host: str) -> float:
        """Remaining seconds of a host's ban for flooding."""


class Session:
    """One link from its handshake to its end; `was_standby`: on a former standby connection."""

    link: Link
    _handshake: Handshake

    def __init__(self, owner: SessionOwner, dialled: str | None, *, was_standby: bool = False) -> None:
        self._owner, self._now, self._was_standby = owner, owner.now, was_standby
        self.dialled = dialled
        self.connected = False
        #: The time when the link was made, and when the peer accepted it.
        self.made_at, self.linked_at = self._now(), math.inf
        self.hello: Hello | None = None
        #: The time when data last arrived, and when this host last had no use for the link.
        self.last_received = self.last_idle = 0.0
        self.reason = ""
        self.closed = asyncio.Event()
        #: Whether the link is silent and a replacement is being tried.
        self.is_suspected = False
        #: Set while the link is silent, and at the end of the session.
        self.suspected = asyncio.Event()
        self._timer: asyncio.TimerHandle | None = None

    @property
    def linked(self) -> bool:
        """Whether the peer has accepted the link."""
        return self.linked_at < math.inf

    def mark_connected(self) -> None:
        """The peer has answered, even if the handshake failed."""
        self.connected = True

    def mark_idle(self, now: float) -> None:
        """Record that this host has no use for the link at this time."""
        self.last_idle = now

    def await_greeting(self, link: Link) -> None:
        """Wait for the Hello of a caller, with a time-out.

        An unauthenticated peer receives no data before the Hello.
        """
        self.link = link
        self._timer = asyncio.get_running_loop().call_later(self._timeout, self._on_timeout)
        if link.identity.kind != "anonymous":
            self.open(link)

    def open(self, link: Link) -> None:
        """Send the Hello first; close the link if the peer may receive only a refusal."""
        try:
            self.greet(link)
        except HandshakeError as error:
            self.reason = str(error)
            self._send_refusal()
            if not self.dialled:
                self._log_once(self.reason)
            link.close()

    def greet(self, link: Link) -> None:
        """Send the Hello and wait for the peer's, with a time-out. Repeated calls have no effect.

        The Hello has the present state: connecting may have taken long. Raises HandshakeError.
        """
        if self.connected:
            return
        self.link, self.connected = link, True
        self._handshake = self._owner.new_handshake(self.dialled, link.identity)
        if self._timer is None:
            self._timer = asyncio.get_running_loop().call_later(self._timeout, self._on_timeout)
        with suppress(AddressError):
            link.send(self._handshake.first_message())

    def on_message(self, link: Link, message: Message) -> None:
        """Process the Hello first, then permitted messages."""
        try:
            self._on_message(link, message)
        except HandshakeError:
            self._send_refusal()
            raise

    def _on_message(self, link: Link, message: Message) -> None:
        if self.hello is None:
            self._on_greeting(link, message)
            return
        if isinstance(message, HandshakeRefused):
            raise HandshakeError(f"{self.hello.host} refused the connection: {message.reason}")
        self._handshake.admit(message)
        self._on_accepted(self.hello)
        self._owner.on_message(self, message)  # type: ignore[arg-type]  # admit lets only Control pass

    def on_transfer(self, link: Link, header: Transfer, block: memoryview) -> None:
        """Receive a coordinator, only from a host after the handshake."""
        hello = self.hello
        if hello is not None and hello.role == "host" and self.linked_at < math.inf and not self.is_suspected:
            self.last_received, sender = self._now(), hello.host
        else:
            sender = self._sender()
        self._owner.on_arrival(sender, header, block)

    def on_oversize(self, link: Link, header: Transfer, size: int) -> None:
        """Receive the header of an oversized coordinator."""
        self._owner.on_oversize(self._sender(), header, size)

    def _on_greeting(self, link: Link, message: Message) -> None:
        """Accept or refuse the peer's Hello."""
        if self._was_standby and isinstance(message, Ping | Pong):
            # This message is a keep-alive that was under way.
            return
        if isinstance(message, Hello) and message.role == "standby" and self.dialled is None:
            self._cancel_timeout()
            self._owner.on_standby_hello(link, message, self)
            return
        # The peer's Hello may be read before the dialling task runs.
        self.greet(link)
        hello = self._handshake.receive(message)
        if hello.role == "host" and self._owner.ban_remaining(hello.host):
            self._refuse(f"{hello.host} sent too much: this host accepts it again within {LONGEST_BAN:g} s")
        if (
            self.dialled is None
            and hello.role == "host"
            and self._owner.prefers_outgoing(hello.host, self.made_at)
        ):
            link.close()
            return
        self.hello = hello
        link.accept_role(hello.role)
        if hello.role == "host":
            link.send(Ping(0))
        else:
            self._on_accepted(hello)

    def _refuse(self, reason: str) -> NoReturn:
        with suppress(AddressError):
            self.link.send(HandshakeRefused(reason))
        raise HandshakeError(reason)

    def _on_accepted(self, hello: Hello) -> None:
        """A message has arrived after the Hello: the peer has accepted the Hello of this host."""
        self.last_received = self._now()
        if self.linked_at < math.inf:
            if self.is_suspected:
                self.is_suspected = False
                self.suspected.clear()
            return
        self._cancel_timeout()
        self.linked_at = self.last_received
        self._owner.on_greeted(self, hello)

    def _sender(self) -> str:
        """The sending host of a coordinator. Raises HandshakeError for a peer that is no host."""
        hello = self.hello
        if hello is None or hello.role != "host":
            raise HandshakeError("a coordinator came before the handshake of a host")
        self._on_accepted(hello)
        return hello.host

    def on_excess(self, link: Link, error: CpuBudgetExceeded) -> None:
        """A host exceeds its CPU budget; its link is closed if this lasts too long.

        The host may not have completed a handshake: handshakes can exceed the budget too.
        """
        self.link, identity = link, link.identity
        if not error.closes:
            self._owner.note(
                log_messages.PEER_SLOWED.line(
                    peer=identity, caller=self.caller, reason=error, seconds=error.seconds
                )
            )
            return
        wait = self._owner.ban(identity.name)
        self._owner.note(
            log_messages.PEER_BANNED.line(
                peer=identity, caller=self.caller, reason=error, name=identity.name, seconds=wait
            )
        )
        self.close_with_error(
            f"{identity.name} sends too much; {identity.name} is accepted again after {wait:g} s"
        )
        self._owner.on_link_closed(self)

    def on_closed(self, link: Link, error: LfieldError | None) -> None:
        self._cancel_timeout()
        self.reason = self.reason or str(error or "")
        if isinstance(error, HandshakeError) and not self.linked:
            self._report_refusal()
        # The end of an observer's link is not logged.
        is_observer_end = (
            self.hello is not None and self.hello.role == "observer" and isinstance(error, AddressError)
        )
        if error and not self.dialled and not is_observer_end and not isinstance(error, CpuBudgetExceeded):
            # The log has the address without the port, which differs for each attempt.
            self._log_once(error.reason if isinstance(error, AddressError) else str(error))
        self._owner.on_link_closed(self)
        self.closed.set()
        self.suspected.set()

    def on_reauthorised(self, verdict: AdmissionDecision) -> None:
        """Apply a changed authorisation: close the link, or reduce its permissions."""
        self._handshake.reauthorise(verdict)
        identity, reason = self.link.identity, verdict.reason
        if verdict.extent == "nothing":
            self._owner.log_once(log_messages.PEER_REFUSED.line(peer=identity, reason=reason))
            self.close_with_error(reason)
        elif reason:
            self._owner.log_once(log_messages.PEER_RESTRICTED.line(peer=identity, reason=reason))

    def close_with_error(self, reason: str) -> None:
        """Send the reason, and close the link."""
        self.reason = reason
        with suppress(AddressError):
            self.link.send(HandshakeRefused(reason))
        self.link.close()

    def suspect(self) -> None:
        """The link is silent: a replacement is tried until data arrives."""
        self.is_suspected = True
        self.suspected.set()

    def on_replaced(self) -> None:
        """Another link replaces this one. Queued data would keep a silent link open for a while."""
        if self.is_suspected:
            self.link.abort()
        else:
            self.link.close()

    def _cancel_timeout(self) -> None:
        if self._timer:
            self._timer.cancel()

    @property
    def _timeout(self) -> float:
        return HANDSHAKE_TIMEOUT if self.dialled is None else ANSWER_TIMEOUT

    def _on_timeout(self) -> None:
        self.reject(f"it has not greeted within {self._timeout:g} s")

    def reject(self, reason: str) -> None:
        """Close the link at once."""
        self.reason = reason
        if not self.dialled:
            self._log_once(reason)
        self.link.abort()

    def _send_refusal(self) -> None:
        with suppress(AddressError):
            if self.connected and self._handshake.refusal:
                self.link.send(self._handshake.refusal)

    def _report_refusal(self) -> None:
        """Report the dialled host, or the host in its certificate, as refused."""
        host = self.dialled or (self.link.identity.name if self.link.identity.kind == "host" else "")
        if host and self.connected:
            refusal = self._handshake.refusal
            reason = refusal.reason if refusal else self.reason
            self._owner.refusals.report(host, reason, self._handshake.refused_bundle)

    @property
    def caller(self) -> str:
        """The peer's address without the port, which differs for each attempt."""
        return self.link.peer.rpartition(":")[0] or self.link.peer

    def _log_once(self, reason: str) -> None:
        self._owner.log_once(log_messages.LINK_CLOSED.line(caller=self.caller, reason=reason))


def live_incarnations(
    links: Mapping[str, Session], is_needed: Callable[[str], bool], now: float
) -> dict[str, int]:
    """Incarnations of the linked hosts; the end of an unneeded link may be undetected."""
    return {
        host: session.hello.incarnation
        for host, session in links.items()
        if session.hello and (is_needed(host) or now - session.last_received <= LOST_AFTER)
    }
