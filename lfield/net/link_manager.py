"""Link manager of one host: dials the needed hosts, accepts links, and closes silent ones.

Needed hosts are dialled repeatedly until they answer. Of two neighbours, the first in the deployment dials;
any other link is made by the host that needs it, and closed after a while without use. Of two crossing dials,
the dial of the first host wins, so two hosts have one link and may start in any order. A link is established
when both have accepted the other's Hello: each then sends a Ping; a rejected host gets a Refuse.
"""

from __future__ import annotations

import asyncio
import random
from contextlib import suppress

from lfield.authority.admission_policy import AdmissionPolicy
from lfield.authority.identity import Identity
from lfield.clock import Clock
from lfield.errors import AddressError
from lfield.event_loop import has_spare_descriptors, spawn
from lfield.net.connection_limiter import ConnectionLimiter
from lfield.net.connections.dialler import Dialler
from lfield.net.connections.standby_links import StandbyLinks
from lfield.net.handshake import Handshake
from lfield.net.health.link_heartbeats import IDLE_PING_EVERY, PING_EVERY
from lfield.net.health.link_monitor import LinkMonitor
from lfield.net.link_owner import (
    InitialContact,
    LinkOwner,
    RateLimitedLog,
    RefusedHosts,
    TeamAddresses,
    apply_revocations,
)
from lfield.net.scheduling.handshake_scheduler import source_of
from lfield.net.scheduling.temporary_bans import TemporaryBans
from lfield.net.session import Session, live_incarnations
from lfield.net.transport import Link, Listener, Transport
from lfield.text import log_messages
from lfield.wire.coordinator_messages import Transfer
from lfield.wire.framing import Buffer
from lfield.wire.messages import QUESTION, TOO_MANY_OBSERVERS, Control, Hello, Ping, Pong, RevocationUpdate

#: Seconds for which a link is kept after a single need, and an unneeded link remains open.
IDLE_TIMEOUT = 10.0
#: Seconds without a link after which both of two neighbours dial.
BOTH_DIAL_AFTER = 3.0
#: Maximum age of a new dial, in seconds.
NEW_HOST_PERIOD = 1.0
#: Connection limits: pending handshakes (evicted per address) and observers (evicted per identity).
MAX_HANDSHAKES, MAX_OBSERVERS = 64, 64
#: File descriptors reserved for the next callers, one of which may be an emergency stop.
SPARE_DESCRIPTORS, FULL = 4, "this host has reached its limit of open files"


class LinkManager:
    """All links of one host of a `team`."""

    def __init__(
        self,
        owner: LinkOwner,
        transport: Transport,
        clock: Clock,
        rng: random.Random,
        team: TeamAddresses,
        admission: AdmissionPolicy | None = None,
    ) -> None:
        self._owner, self._transport, self._clock = owner, transport, clock
        self._admission, self.now = admission or AdmissionPolicy(), clock.monotonic
        self._hosts, self._addresses, self._number, self._neighbours, _ = team
        hosts, own_number = team.hosts, team.own_number
        #: Hosts needed permanently, and hosts needed until a time.
        self._desired: frozenset[str] = frozenset()
        self._required_until: dict[str, float] = {}
        #: The diallers, by host.
        self._diallers: dict[str, Dialler] = {}
        #: The time when each host last dialled, and the banned hosts.
        self._last_incoming, self._bans = dict[str, float](), TemporaryBans()
        self._links: dict[str, Session] = {}
        self.monitor = LinkMonitor(
            hosts,
            own_number,
            self.now,
            owner.hybrid_clock,
            PING_EVERY if team.has_live_values else IDLE_PING_EVERY,
        )
        self.standbys = StandbyLinks(self, transport, team, self._admission)
        self._tasks, self._listeners = list[asyncio.Task[None]](), list[Listener]()
        self.on_arrival = lambda *transfer: owner.on_transfer(*transfer)
        self.on_oversize = lambda *transfer: owner.on_oversize(*transfer)
        self._log_limiter, self.refusals = (
            RateLimitedLog(owner.note, self.now),
            RefusedHosts(hosts, lambda *refusal: owner.on_link_refused(*refusal)),
        )
        self._ungreeted: ConnectionLimiter[Session] = ConnectionLimiter(
            MAX_HANDSHAKES, rng, lambda session: session.link.is_answered
        )
        self._observers: ConnectionLimiter[Session] = ConnectionLimiter(MAX_OBSERVERS, rng)
        self._initial_contact = InitialContact(hosts, own_number)
        #: Time of last contact of each unlinked host.
        self._last_contacts: dict[str, float] = {}
        #: The time since when each needed host has had no link, on the monotonic clock.
        self.down_since: dict[str, float] = {}

    @property
    def incarnations(self) -> dict[str, int]:
        """The linked hosts with their incarnations."""
        return {host: s.hello.incarnation for host, s in self._links.items() if s.hello}

    def last_contact_at(self, host: str) -> float | None:
        """Monotonic time of the last message from a host; None if none arrived."""
        session = self._links.get(host)
        return session.last_received if session else self._last_contacts.get(host)

    async def open(self, address: str) -> str:
        """Listen and start dialling; returns the address with its actual port. Raises AddressError.

        Without an address (''), only local commands can connect, at the control socket.
        """
        if address:
            self._listeners.append(await self._transport.listen(address, self._on_incoming))
            address = self._listeners[0].address
        self._update_links(self._clock.monotonic())
        self._tasks.append(spawn(self._keep_alive()))
        return address

    async def open_control_socket(self, address: str) -> None:
        """Also listen at a Unix socket, for commands on this computer. Raises AddressError."""
        self._listeners.append(await self._transport.listen(address, self._on_incoming))

    async def wait_for_initial_contact(self, bound: float) -> None:
        """Return when every host has completed a handshake or failed to answer, at most after `bound`
        seconds.

        A host that is to dial this one cannot be distinguished from a host that is down, so this host waits
        for it.
        """
        for host in self._initial_contact.missing:
            self.require_link(host)
        await self._initial_contact.wait(bound)

    def close(self) -> None:
        """Close the port and every link."""
        self._desired, self._required_until = frozenset(), {}
        for task in self._tasks:
            task.cancel()
        self.standbys.close()
        for dialler in self._diallers.values():
            dialler.cancel()
        for listener in self._listeners:
            listener.close()
        for session in list(self._links.values()):
            session.link.close()
        for session in self._ungreeted:
            session.link.abort()

    def send(self, host: str, message: Control) -> None:
        """Send to a host. Without a link the message is dropped, as mobility expects."""
        session = self._links.get(host)
        if session:
            with suppress(AddressError):
                session.link.send(message)

    def send_transfer(self, host: str, header: Transfer, block: Buffer) -> None:
        """Send a coordinator to a host. On a closing link, `LinkOwner.on_unlinked` follows."""
        session = self._links.get(host)
        if session:
            with suppress(AddressError):
                session.link.send_transfer(header, block)

    # --- both directions ------------------------------------------------------------------------------

    def _on_incoming(self, link: Link) -> Session:
        """Admit a connection before its handshake; where there are too many, another one is rejected."""
        # The transport delivers messages only after this has returned.
        (session := Session(self, dialled=None)).await_greeting(link)
        last = not has_spare_descriptors(SPARE_DESCRIPTORS)
        evicted = self._ungreeted.admit(session, source_of(link.peer), last=last)
        if evicted is not None:
            evicted.reject(FULL if last else f"over {MAX_HANDSHAKES} handshakes are pending at this host")
        return session

    def require_link(self, host: str) -> None:
        """Request a link with a host for a while; dial if there is none."""
        now = self._clock.monotonic()
        self._required_until[host] = now + IDLE_TIMEOUT
        if host not in self._links:
            self.down_since.setdefault(host, now)
        self._dial(host)

    def is_new(self, host: str) -> bool:
        """Whether a host has no link, and this host has just started to dial it."""
        since = self.down_since.get(host, -NEW_HOST_PERIOD)
        dialler = self._diallers.get(host)
        is_dialling = dialler is not None and not dialler.has_failed
        return is_dialling and self._clock.monotonic() - since < NEW_HOST_PERIOD

    def needs_link(self, host: str) -> bool:
        """See `DialOwner.needs_link`."""
        return host in self._desired or self._required_until.get(host, 0.0) > self._clock.monotonic()

    def _dial(self, host: str) -> None:
        session = self._links.get(host)
        if session is not None and not session.is_suspected:
            return
        # A neighbour earlier in the deployment dials.
        if host in self._neighbours and self._hosts[host] < self._number and not self._is_unreachable(host):
            return
        dialler = self._diallers.get(host)
        if dialler is None or dialler.is_over:
            at, note = self._addresses[self._hosts[host]], self._owner.note
            self._diallers[host] = Dialler(self, self._transport, self._clock, host, at, note)

    def _is_unreachable(self, host: str) -> bool:
        """Whether a host has had no link and has not dialled for so long that both sides dial: it may not
        find this host, for example after a change of the network card.
        """
        now = self._clock.monotonic()
        return (
            now - max(self.down_since.get(host, now), self._last_incoming.get(host, 0.0)) >= BOTH_DIAL_AFTER
        )

    # --- queries of diallers --------------------------------------------------------------------------

    def link_of(self, host: str) -> Session | None:
        """See `DialOwner.link_of`."""
        return self._links.get(host)

    def ban_remaining(self, host: str) -> float:
        """Remaining seconds of a host's ban for flooding."""
        return self._bans.remaining(host, self.now())

    def on_dialled(self, host: str) -> None:
        """A dial to a host has ended, or the host has completed a handshake."""
        self._initial_contact.on_contact(host)

    async def _keep_alive(self) -> None:
        while True:
            await asyncio.sleep(PING_EVERY)
            now = self._clock.monotonic()
            self._update_links(now)
            for host, session in list(self._links.items()):
                self._check_link(host, session, now)
            self.reauthorise()

    def _update_links(self, now: float) -> None:
        """Dial the needed hosts without a link, and stop the other diallers."""
        self._desired = frozenset(self._owner.desired_hosts())
        self._required_until = {host: until for host, until in self._required_until.items() if until > now}
        required = self._desired | self._required_until.keys()
        self.down_since = {
            host: self.down_since.get(host, now)
            for host in sorted(required - self._links.keys(), key=self._hosts.__getitem__)
        }
        for host in self.down_since:
            self._dial(host)
        for host in sorted(self._diallers.keys() - required - self._links.keys()):
            self._diallers.pop(host).cancel()

    def _check_link(self, host: str, session: Session, now: float) -> None:
        silent = now - session.last_received
        if not self.needs_link(host):
            session.mark_idle(now)
            if silent > IDLE_TIMEOUT:
                session.link.close()
                self.on_link_closed(session)
            return
        silent = now - max(session.last_received, session.last_idle)
        match self.monitor.check(host, silent):
            case "lost":
                self._owner.note(log_messages.LINK_TIMED_OUT.line(host=host, seconds=silent))
                session.link.abort()  # queued data would keep it open
                self.on_link_closed(session)
            case "suspected":
                session.suspect()
                self._dial(host)

    # --- reports of sessions --------------------------------------------------------------------------

    def new_handshake(self, dialled: str | None, identity: Identity) -> Handshake:
        if dialled is None:
            self._last_incoming[identity.name] = self.now()
        return Handshake(
            self._admission.sign_hello(self._owner.hello()),
            identity,
            decision=self._admission.decide(identity, expected=dialled or ""),
            hosts=self._hosts,
            linked=live_incarnations(self._links, self.needs_link, self.now()),
            dialled=dialled,
        )

    def prefers_outgoing(self, host: str, made_at: float) -> bool:
        """Whether this host's own dial wins over a crossing one of time `made_at`; closes one that loses."""
        dialler = self._diallers.get(host)
        own = dialler.session if dialler is not None else None
        if own is None or not own.connected:
            return False
        if self._number < self._hosts.get(host, -1):
            # A host that dials long after its link was accepted has lost this link, perhaps undetected here.
            return made_at < own.linked_at
        if not own.linked:
            own.link.close()
        return False

    def reauthorise(self) -> None:
        """Close the links of peers that lost their authorisation, and reduce the permissions of other peers.

        A revoked host completes pending work as a host; its observer links are closed.
        """
        dialling = [dialler.session for dialler in self._diallers.values() if dialler.session is not None]
        links, others = self._links.values(), (*self._observers, *self._ungreeted, *dialling)
        for session in dict.fromkeys((*links, *others)):
            if session.connected:
                identity = session.link.identity
                session.on_reauthorised(self._admission.decide(identity, linked=session in links))
        self.standbys.close_rejected()

    def _on_revocations(self, data: bytes) -> None:
        """Apply a certificate revocation list; forward a new one to all hosts, the revoked ones last."""
        if apply_revocations(self._admission, data, self._owner.note):
            for host in self._links:
                self.send(host, RevocationUpdate(data))
            self.reauthorise()

    def on_standby_hello(self, link: Link, hello: Hello, session: Session) -> None:
        """See `SessionOwner.on_standby_hello`."""
        self._ungreeted.on_authenticated(session, source_of(link.peer))
        self.standbys.on_hello(link, hello)

    def on_greeted(self, session: Session, hello: Hello) -> None:
        """A link has completed its handshake on both sides."""
        self._ungreeted.on_authenticated(session, source_of(session.link.peer))
        self._admission.on_handshake(session.link.identity, hello)
        if warning := self._admission.clock_warning():
            self.log_once(warning)
        if hello.role == "host" and hello.revoked < self._admission.number:
            session.link.send(RevocationUpdate(self._admission.list))
        if hello.role == "host":
            self._on_linked(session, hello)
            return
        session.link.count_in(self.monitor.observers)
        evicted = self._observers.admit(session, str(session.link.identity))
        if evicted is not None:
            evicted.reject(f"over {MAX_OBSERVERS} {TOO_MANY_OBSERVERS}")

    def _on_linked(self, session: Session, hello: Hello) -> None:
        self.monitor.on_linked(hello.host, session.link)
        old = self._links.get(hello.host)
        self._links[hello.host] = session
        if old and old is not session:
            old.on_replaced()
        self.standbys.on_linked(hello.host, session)
        self.down_since.pop(hello.host, None)
        if dialler := self._diallers.get(hello.host):
            dialler.clear_failure()
        self.refusals.report(hello.host, "")
        self._owner.on_linked(hello)
        self.on_dialled(hello.host)

    def on_link_closed(self, session: Session) -> None:
        for limiter in (self._ungreeted, self._observers):
            limiter.release(session)
        host = session.hello.host if session.hello else ""
        if self._links.get(host) is session:
            del self._links[host]
            self.monitor.on_unlinked(host)
            self._last_contacts[host] = session.last_received
            is_required = self.needs_link(host)
            if is_required:
                self.down_since[host] = self._clock.monotonic()
            self._owner.on_unlinked(host, quietly=not is_required)
            if not is_required:
                self.standbys.drop(host)
            elif not self.standbys.on_link_lost(host):
                self._dial(host)

    def on_message(self, session: Session, message: Control) -> None:
        """A message arrived on an established link."""
        hello = session.hello
        assert hello is not None
        host = hello.host if hello.role == "host" else ""
        if isinstance(message, Ping):
            self.monitor.on_ping(host, session.link, message)
        elif isinstance(message, RevocationUpdate):
            self._on_revocations(message.list)
        elif isinstance(message, Pong) and message.token != QUESTION:
            self.monitor.on_pong(host, message)
        else:
            self._owner.on_message(host, message, session.link)

    def ban(self, host: str) -> float:
        """Ban a flooding host for a while. Returns the seconds."""
        return self._bans.ban(host, self.now())

    def note(self, line: log_messages.LogLine) -> None:
        """Write a log line."""
        self._owner.note(line)

    def log_once(self, line: log_messages.LogLine) -> None:
        """Write a log line once: a refused peer dials again every second."""
        self._log_limiter.write(line)
