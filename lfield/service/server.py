"""The links of a service: accepts desks and the services of other hosts, and passes on permitted messages."""

from __future__ import annotations

import random
from collections.abc import Awaitable, Callable
from contextlib import suppress
from typing import Protocol

from lfield.authority.admission_policy import AdmissionPolicy
from lfield.authority.identity import Identity
from lfield.clock import Clock
from lfield.errors import AddressError, HandshakeError, LfieldError, WireError
from lfield.event_loop import spawn
from lfield.net.connection_limiter import ConnectionLimiter
from lfield.net.handshake import Handshake
from lfield.net.link_owner import RateLimitedLog, RefusedHosts, apply_revocations
from lfield.net.scheduling.handshake_scheduler import source_of
from lfield.net.session import Session
from lfield.net.transport import Link, Listener, Transport
from lfield.text.log_messages import LogLine
from lfield.wire.coordinator_messages import Transfer
from lfield.wire.fields import truncate
from lfield.wire.messages import Control, HandshakeRefused, Hello, Ping, Pong, RevocationUpdate
from lfield.wire.service_messages import ServiceMessage

#: The most handshakes and the most linked peers at once.
MAX_HANDSHAKES, MAX_PEERS = 64, 64


class RequestHandler(Protocol):
    """Answers requests (`service.Service`)."""

    def answer(self, message: ServiceMessage, operator: str, person: str = "") -> Awaitable[ServiceMessage]:
        """The answer to `operator`; `person` is the name in the certificate of a person, '' for others.

        Raises LfieldError, whose text is sent to the peer before its link is closed.
        """

    def note(self, line: LogLine) -> None:
        """Write a log line."""


class ServiceServer:
    """The listener of one service, and its sessions. See `session.SessionOwner`."""

    def __init__(
        self,
        host: str,
        handler: RequestHandler,
        transport: Transport,
        clock: Clock,
        rng: random.Random,
        admission: AdmissionPolicy,
    ) -> None:
        self._handler, self._transport, self._admission = handler, transport, admission
        self._hello = Hello("host", host, rng.getrandbits(63))
        self.now: Callable[[], float] = clock.monotonic
        self._log = RateLimitedLog(handler.note, self.now)
        self._ungreeted: ConnectionLimiter[Session] = ConnectionLimiter(
            MAX_HANDSHAKES, rng, lambda session: session.link.is_answered
        )
        self._peers: ConnectionLimiter[Session] = ConnectionLimiter(MAX_PEERS, rng)
        self._listeners: list[Listener] = []
        self.refusals = RefusedHosts(())
        self.on_arrival: Callable[[str, Transfer, memoryview], None] = lambda *_: _refuse_transfer()
        self.on_oversize: Callable[[str, Transfer, int], None] = lambda *_: _refuse_transfer()

    async def listen(self, address: str) -> str:
        """Listen; returns the address with its actual port. Raises AddressError."""
        self._listeners.append(await self._transport.listen(address, self._on_incoming))
        return self._listeners[-1].address

    def close(self) -> None:
        """Close the port and every link."""
        for listener in self._listeners:
            listener.close()
        for session in (*self._ungreeted, *self._peers):
            session.link.abort()

    def reauthorise(self) -> None:
        """Close the links of peers whose keys have expired or were revoked."""
        for session in (*self._peers, *self._ungreeted):
            if session.connected:
                session.on_reauthorised(self._admission.decide(session.link.identity))

    def _on_incoming(self, link: Link) -> Session:
        (session := Session(self, dialled=None)).await_greeting(link)
        evicted = self._ungreeted.admit(session, source_of(link.peer))
        if evicted is not None:
            evicted.reject(f"over {MAX_HANDSHAKES} handshakes are pending at this service")
        return session

    # --- reports of sessions --------------------------------------------------------------------------

    def new_handshake(self, dialled: str | None, identity: Identity) -> Handshake:
        """See `SessionOwner`."""
        hello = self._admission.sign_hello(self._hello)
        return Handshake(hello, identity, decision=self._admission.decide(identity), dialled=dialled)

    def prefers_outgoing(self, host: str, made_at: float) -> bool:
        """See `SessionOwner`: a service dials with links of observers."""
        return False

    def on_standby_hello(self, link: Link, hello: Hello, session: Session) -> None:
        """See `SessionOwner`: a service has no links with hosts."""
        raise HandshakeError("this is the port of the service; hosts link at the port of the mission")

    def on_greeted(self, session: Session, hello: Hello) -> None:
        """See `SessionOwner`."""
        self._ungreeted.on_authenticated(session, source_of(session.link.peer))
        if hello.role != "observer":
            session.close_with_error("this is the port of the service; hosts link at the port of the mission")
            return
        self._admission.on_handshake(session.link.identity, hello)
        if hello.revoked < self._admission.number:
            session.link.send(RevocationUpdate(self._admission.list))
        evicted = self._peers.admit(session, str(session.link.identity))
        if evicted is not None:
            evicted.reject(f"over {MAX_PEERS} peers are linked to this service")

    def on_link_closed(self, session: Session) -> None:
        """See `SessionOwner`."""
        for limiter in (self._ungreeted, self._peers):
            limiter.release(session)

    def on_message(self, session: Session, message: Control) -> None:
        """See `SessionOwner`. A request is answered in a task of its own."""
        match message:
            case Ping():
                session.link.send(Pong(message.token))
            case RevocationUpdate():
                if apply_revocations(self._admission, message.list, self._handler.note):
                    self.reauthorise()
            case _ if type(message).__module__.endswith("service_messages"):
                # The module has the classes of `ServiceMessage` only.
                spawn(self._answer(session.link, message))  # type: ignore[arg-type]
            case _:
                raise WireError(
                    f"{type(message).__name__} is for a mission's host, and this is the port of its service"
                )

    async def _answer(self, link: Link, message: ServiceMessage) -> None:
        identity = link.identity
        person = identity.name if identity.kind == "person" else ""
        try:
            answer: ServiceMessage | HandshakeRefused = await self._handler.answer(
                message, str(identity), person
            )
        except LfieldError as error:
            answer = HandshakeRefused(truncate(str(error)))
        with suppress(AddressError):
            link.send(answer)

    def ban(self, host: str) -> float:
        """See `SessionOwner`: no host is banned, since its links are those of an observer."""
        return 0.0

    def ban_remaining(self, host: str) -> float:
        """See `SessionOwner`."""
        return 0.0

    def note(self, line: LogLine) -> None:
        """Write a log line."""
        self._handler.note(line)

    def log_once(self, line: LogLine) -> None:
        """Write a log line once."""
        self._log.write(line)


def _refuse_transfer() -> None:
    raise WireError("a coordinator was sent to a service")
