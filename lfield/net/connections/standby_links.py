"""Standby connections to linked hosts with several addresses, and the change of a link to the other path.

One side of a link keeps one authenticated connection to another address of the peer. When data on the link
remains unacknowledged, either side starts the handshake of a link on the standby at once, which replaces the
link as any new link does; `lfield.net.health.path_choice` decides.
"""

from __future__ import annotations

import asyncio
from contextlib import suppress
from typing import TYPE_CHECKING, Protocol

from lfield.errors import AddressError, HandshakeError, WireError
from lfield.event_loop import spawn
from lfield.net.connections.standby_connection import ANSWER_TIMEOUT, StandbyConnection
from lfield.net.health.path_choice import Decision, PathChoice, PathState
from lfield.net.session import Session, SessionOwner
from lfield.net.transport import is_zenoh, split_address, split_addresses
from lfield.text import log_messages
from lfield.wire.messages import Hello

if TYPE_CHECKING:
    from lfield.authority.admission_policy import AdmissionPolicy
    from lfield.authority.identity import Identity
    from lfield.net.health.link_monitor import LinkMonitor
    from lfield.net.link_owner import TeamAddresses
    from lfield.net.transport import Link, Transport

#: Seconds between two readings of the paths of a link with a standby.
CHECK_EVERY = 0.1
#: Seconds between two attempts at a standby: when a standby is needed at once; and the additional pause
#: otherwise, which doubles up to a maximum.
SHORTEST_PAUSE, FIRST_DIAL, LAST_DIAL = 0.3, 0.7, 10.0


class StandbyLinksOwner(SessionOwner, Protocol):
    """The owner of the links."""

    monitor: LinkMonitor

    def link_of(self, host: str) -> Session | None:
        """The current link with a host."""


class _HostPaths:
    """The paths to one host."""

    def __init__(self) -> None:
        self.choice = PathChoice()
        self.standby: StandbyConnection | None = None
        #: The former standby while its handshake as the link is pending.
        self.next_link: Session | None = None
        self.task: asyncio.Task[None] | None = None
        #: Set when a standby is needed at once.
        self.needed = asyncio.Event()

    @property
    def is_moving(self) -> bool:
        """Whether the link is about to move to the other path."""
        return self.next_link is not None and not self.next_link.closed.is_set()

    def drop(self) -> None:
        """Close the standby connection, and stop dialling another one."""
        if self.task is not None:
            self.task.cancel()
        standby, self.standby = self.standby, None
        if standby is not None:
            standby.link.abort()


class StandbyLinks:
    """The standby connections of one host of a `team`."""

    def __init__(
        self,
        owner: StandbyLinksOwner,
        transport: Transport,
        team: TeamAddresses,
        admission: AdmissionPolicy,
    ) -> None:
        self._owner, self._transport, self._addresses = owner, transport, team.addresses
        self._admission, self.now = admission, owner.now
        self._numbers, self._own_number = team.hosts, team.own_number
        own = next(host for host, number in team.hosts.items() if number == team.own_number)
        self._hello = Hello("standby", own, 0)
        self._paths: dict[str, _HostPaths] = {}
        self._ticker: asyncio.Task[None] | None = None

    # --- events of links ------------------------------------------------------------------------------

    def on_linked(self, host: str, session: Session) -> None:
        """A session is the link with a host from now on."""
        paths = self._paths.get(host)
        if paths is None:
            if not self._other_addresses(host, session):
                return
            paths = self._add(host)
        paths.choice.on_link()
        if paths.next_link is session:
            paths.next_link = None
        if paths.standby is not None and _ip(paths.standby.link) == _ip(session.link):
            paths.standby.link.abort()
        if paths.task is None and self._other_addresses(host, session):
            paths.task = spawn(self._maintain(host, paths))

    def on_link_lost(self, host: str) -> bool:
        """The link with a needed host is lost. Returns whether the standby becomes the link."""
        paths = self._paths.get(host)
        if paths is None:
            return False
        if not paths.is_moving and paths.standby is not None:
            self._move(host, paths, paths.standby)
        if paths.is_moving:
            return True
        self.drop(host)
        return False

    def drop(self, host: str) -> None:
        """The link with a host is closed, and is not needed."""
        if (paths := self._paths.pop(host, None)) is not None:
            paths.drop()
        if not self._paths and self._ticker is not None:
            self._ticker.cancel()
            self._ticker = None

    def close(self) -> None:
        """Close all standby connections."""
        for host in list(self._paths):
            self.drop(host)

    def close_rejected(self) -> None:
        """Close the standby connections of peers that lost their authorisation."""
        for paths in self._paths.values():
            if paths.standby is not None and not self._is_admitted(paths.standby.link.identity):
                paths.standby.link.abort()

    def on_hello(self, link: Link, hello: Hello) -> None:
        """A host offers a connection as a standby. Raises HandshakeError."""
        host = hello.host
        if link.identity.name != host or not self._is_admitted(link.identity):
            raise HandshakeError(f"{link.identity} may have no standby connection as {host}")
        if self._owner.link_of(host) is None:
            raise HandshakeError(f"there is no link with {host} beside which it would be a standby")
        connection = StandbyConnection(self, host, self.now(), dialled=False)
        connection.accept(link, self._hello)
        self.on_ready(connection)

    def paths(self, host: str) -> tuple[str, str]:
        """The networks of the link with a host and of its standby, by the address of the host in each; '' for
        no standby. Both are '' if there is only one network.
        """
        session, paths = self._owner.link_of(host), self._paths.get(host)
        if session is None or paths is None:
            return "", ""
        return _network(session.link), _network(paths.standby.link) if paths.standby is not None else ""

    # --- reports of standby connections ---------------------------------------------------------------

    def on_ready(self, connection: StandbyConnection) -> None:
        """See `StandbyOwner.on_ready`: of two connections, the last one is kept."""
        paths = self._paths.get(connection.host) or self._add(connection.host)
        old, paths.standby = paths.standby, connection
        if old is not None:
            old.link.abort()
        paths.choice.on_standby(self.now())
        self._owner.note(log_messages.STANDBY_READY.line(host=connection.host, address=connection.link.peer))

    def on_activated(self, connection: StandbyConnection, hello: Hello) -> None:
        """See `StandbyOwner.on_activated`."""
        link = connection.link
        self._new_session(connection).on_message(link, hello)

    def on_closed(self, connection: StandbyConnection) -> None:
        """See `StandbyOwner.on_closed`."""
        paths = self._paths.get(connection.host)
        if paths is not None and paths.standby is connection:
            paths.standby = None

    def _is_admitted(self, identity: Identity) -> bool:
        """Whether a peer is a host that may have a link now."""
        is_member = identity.kind == "host" and identity.name in self._numbers
        return (
            is_member
            and not self._owner.ban_remaining(identity.name)
            and self._admission.decide(identity, linked=True).extent != "nothing"
        )

    # --- changing the path ----------------------------------------------------------------------------

    def _add(self, host: str) -> _HostPaths:
        paths = self._paths[host] = _HostPaths()
        if self._ticker is None:
            self._ticker = spawn(self._check_all())
        return paths

    async def _check_all(self) -> None:
        while True:
            await asyncio.sleep(CHECK_EVERY)
            now = self.now()
            for host, paths in list(self._paths.items()):
                self._check(host, paths, now)

    def _check(self, host: str, paths: _HostPaths, now: float) -> None:
        session, standby = self._owner.link_of(host), paths.standby
        if standby is not None and not standby.keep_alive(now):
            standby.link.abort()
            return
        if session is None or paths.is_moving:
            return
        delivery = session.link.delivery()
        if delivery is None:
            return
        monitor = self._owner.monitor
        figures = monitor.latest.get(host)
        loss = figures.loss if figures is not None else None
        round_trip, bound = monitor.round_trip(host) or 0.0, monitor.answer_timeout(host) or 0.0
        state = PathState(delivery, round_trip, loss or 0.0, bound, session.link.work)
        # The accepting side does not know the delay of answers to keep-alives.
        other = standby.state(now) if standby is not None and standby.dialled else None
        decision = paths.choice.decide(now, state, other)
        if decision and standby is not None:
            self._move(host, paths, standby, decision)
        elif decision:
            paths.needed.set()

    def _move(
        self, host: str, paths: _HostPaths, standby: StandbyConnection, decision: Decision = "dead"
    ) -> None:
        """Make the standby the link: its handshake replaces the present link."""
        session = self._owner.link_of(host)
        reason = "the other path is better"
        if decision == "dead":
            paths.choice.on_left(self.now())
            reason = "no acknowledgement" if session is not None else "the connection was lost"
        old = session.link.peer if session is not None else "its path"
        self._owner.note(
            log_messages.PATH_CHANGED.line(host=host, old=old, new=standby.link.peer, reason=reason)
        )
        self._new_session(standby).open(standby.link)

    def _new_session(self, standby: StandbyConnection) -> Session:
        """A session for the handshake on a standby connection."""
        paths, dialled = self._paths[standby.host], standby.host if standby.dialled else None
        session = Session(self._owner, dialled, was_standby=True)
        paths.standby, paths.next_link = None, session
        standby.release().set_handler(session)
        return session

    # --- dialling -------------------------------------------------------------------------------------

    def _other_addresses(self, host: str, session: Session) -> list[str]:
        """The addresses at which this side dials a standby: all except the address of the link.

        The side that dialled the link dials the standby; the accepting side does so only if its own address
        leaves no choice.
        """
        if session.dialled is None and len(split_addresses(self._addresses[self._own_number])) > 1:
            return []
        addresses = split_addresses(self._addresses[self._numbers[host]])
        if len(addresses) < 2:
            return []
        return [address for address in addresses if _host_part(address) != _ip(session.link)]

    async def _maintain(self, host: str, paths: _HostPaths) -> None:
        """Keep a standby connection while there is a link."""
        pause = FIRST_DIAL
        while True:
            await asyncio.sleep(SHORTEST_PAUSE)
            with suppress(TimeoutError):
                async with asyncio.timeout(pause):
                    await paths.needed.wait()
            paths.needed.clear()
            pause = min(LAST_DIAL, 2 * pause)
            session = self._owner.link_of(host)
            if session is None and not paths.is_moving:
                break
            if session is None or paths.is_moving or paths.standby is not None:
                continue
            for address in self._other_addresses(host, session):
                connection = await self._dial(host, address)
                if connection is not None:
                    await connection.ended.wait()
                    pause = FIRST_DIAL
                    break
        paths.task = None
        self.drop(host)

    async def _dial(self, host: str, address: str) -> StandbyConnection | None:
        """A new standby connection to an address; None if it fails."""
        connection = StandbyConnection(self, host, self.now(), dialled=True)
        try:
            link = await self._transport.connect(address, connection, host)
        except (AddressError, HandshakeError, WireError):
            return None
        session = self._owner.link_of(host)
        is_useful = session is not None and _ip(session.link) != _ip(link)
        if not is_useful or link.identity.name != host or not self._is_admitted(link.identity):
            link.abort()
            return None
        connection.open(link, self._hello)
        try:
            with suppress(TimeoutError):
                async with asyncio.timeout(ANSWER_TIMEOUT):
                    await connection.settled.wait()
        finally:
            # Also after a cancel: the answer of the peer would keep a connection that no task owns.
            if not connection.was_ready:
                link.abort()
        return connection if connection.was_ready else None


def _ip(link: Link) -> str:
    """The address of the peer, without its port."""
    return _host_part(link.peer)


def _network(link: Link) -> str:
    """The address of the peer for people: a caller in a fabric has a random name."""
    return "zenoh" if is_zenoh(link.peer) else _ip(link)


def _host_part(address: str) -> str:
    with suppress(AddressError):
        return split_address(address)[0]
    return address
