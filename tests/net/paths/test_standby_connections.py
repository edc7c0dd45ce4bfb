"""Messages that a standby connection accepts: a Hello of a standby, keep-alives, and the Hello of a link."""

from __future__ import annotations

import asyncio

import pytest
from test_path_change import now, play, until
from virtual_paths import HOSTS

from lfield.authority.identity import ANONYMOUS
from lfield.errors import HandshakeError, WireError
from lfield.net.connections.standby_connection import ANSWER_TIMEOUT, MISSED_AFTER, StandbyConnection
from lfield.net.handshake import Handshake
from lfield.net.health.link_heartbeats import IDLE_PING_EVERY
from lfield.wire.messages import HandshakeRefused, Hello, Ping, Pong, WholeTransferRequest

STANDBY = Hello("standby", "alpha", 0)


class Wire:
    """A link that records the sent messages."""

    def __init__(self) -> None:
        self.peer, self.identity, self.sent, self.roles, self.handler = "there:1", ANONYMOUS, [], [], None

    def send(self, message):
        self.sent.append(message)

    def accept_role(self, role):
        self.roles.append(role)

    def set_handler(self, handler):
        self.handler = handler

    def on_idle(self):
        pass


class Owner:
    def __init__(self) -> None:
        self.events: list[object] = []

    def now(self):
        return 5.0

    def on_ready(self, connection):
        self.events.append("ready")

    def on_activated(self, connection, hello):
        self.events.append(hello)

    def on_closed(self, connection):
        self.events.append("closed")


def offered() -> tuple[StandbyConnection, Wire, Owner]:
    owner, wire = Owner(), Wire()
    connection = StandbyConnection(owner, "bravo", 0.0, dialled=True)
    connection.open(wire, STANDBY)
    return connection, wire, owner


def ready() -> tuple[StandbyConnection, Wire, Owner]:
    connection, wire, owner = offered()
    connection.on_message(wire, Hello("standby", "bravo", 0))
    return connection, wire, owner


def test_both_sides_send_a_hello_and_only_the_caller_sends_keep_alives():
    connection, wire, owner = ready()
    assert (wire.sent, wire.roles, owner.events) == ([STANDBY], ["host"], ["ready"])
    assert connection.keep_alive(IDLE_PING_EVERY)
    assert wire.sent[1:] == [Ping(1)]
    assert connection.keep_alive(IDLE_PING_EVERY + ANSWER_TIMEOUT)
    connection.on_message(wire, Pong(1))
    assert connection.keep_alive(2 * IDLE_PING_EVERY)
    assert wire.sent[2:] == [Ping(2)]
    connection.on_message(wire, Pong(1))
    assert not connection.keep_alive(2 * IDLE_PING_EVERY + ANSWER_TIMEOUT + 0.1)


def test_the_accepting_side_answers_and_expects_keep_alives():
    connection, wire = StandbyConnection(Owner(), "bravo", 0.0, dialled=False), Wire()
    connection.accept(wire, STANDBY)
    assert (wire.handler, wire.sent) == (connection, [STANDBY])
    assert connection.keep_alive(MISSED_AFTER)
    assert not connection.keep_alive(MISSED_AFTER + 0.1)

    connection.on_message(wire, Ping(5))
    assert wire.sent[1:] == [Pong(5)]
    assert connection.keep_alive(5.0 + MISSED_AFTER)


def test_a_link_hello_counts_only_after_the_standby_hello():
    """A host sends its Hello at once to an address that it knows."""
    connection, wire, owner = offered()
    connection.on_message(wire, Hello("host", "bravo", 1))
    connection.on_message(wire, Hello("standby", "bravo", 0))
    connection.on_message(wire, Hello("host", "bravo", 2))
    assert owner.events == ["ready", Hello("host", "bravo", 2)]


@pytest.mark.parametrize(
    "message", [Hello("observer", "bravo", 1), Hello("standby", "bravo", 0), WholeTransferRequest("a")]
)
def test_other_messages_close_a_standby(message):
    connection, wire, owner = ready()
    with pytest.raises(WireError):
        connection.on_message(wire, message)
    assert owner.events == ["ready"]


@pytest.mark.parametrize("message", [Ping(1), Pong(1)])
def test_a_keep_alive_before_the_hello_closes_a_standby(message):
    connection, wire, _ = offered()
    with pytest.raises(WireError):
        connection.on_message(wire, message)


def test_a_transfer_or_a_refusal_closes_a_standby():
    connection, wire, _ = ready()
    for event in (
        lambda: connection.on_transfer(wire, None, memoryview(b"")),
        lambda: connection.on_oversize(wire, None, 1),
        lambda: connection.on_message(wire, HandshakeRefused("no")),
    ):
        with pytest.raises(HandshakeError):
            event()


def test_a_link_handshake_refuses_a_standby_hello():
    handshake = Handshake(Hello("host", "bravo", 1), ANONYMOUS, hosts=HOSTS)
    with pytest.raises(WireError):
        handshake.receive(STANDBY)


@pytest.fixture(scope="session")
def runner():
    return play


@pytest.mark.parametrize("hello", [Hello("standby", "bravo", 0), Hello("standby", "charlie", 0)])
async def test_a_host_may_offer_a_standby_only_for_itself(network, alpha, bravo, /, hello):
    count, caller = (
        bravo.count("standby connection with"),
        StandbyConnection(Owner(), "bravo", now(), dialled=True),
    )
    link = await alpha.transport.connect("two-bravo:7001", caller, "bravo")
    caller.open(link, hello)
    await until(lambda: link.closed)
    assert bravo.count("standby connection with") == count
    assert not caller.was_ready


async def test_the_newer_of_two_standbys_is_kept(network, alpha, bravo, /):
    caller = StandbyConnection(Owner(), "bravo", now(), dialled=True)
    link = await alpha.transport.connect("two-bravo:7001", caller, "bravo")
    caller.open(link, STANDBY)
    await until(lambda: caller.was_ready)
    await until(lambda: bravo.count("standby connection with") >= 2)
    open_links = [each for each in network.links if not each.closed and each.peer.startswith("two-alpha")]
    assert len(open_links) == 1


async def test_a_host_that_lost_its_rights_loses_its_standby(network, alpha, bravo, /):
    assert alpha.peers.standbys.paths("bravo") == ("one-bravo", "two-bravo")
    assert bravo.peers.standbys.paths("alpha") == ("one-alpha", "two-alpha")
    bravo.peers.standbys._is_admitted = lambda who: False
    bravo.peers.reauthorise()
    await asyncio.sleep(0.1)
    assert [each.closed for each in network.links if each.peer.startswith("two-")] == [True, True]
    # No other standby is accepted.
    await asyncio.sleep(20.0)
    assert bravo.count("standby connection with") == 1
    assert alpha.peers.standbys.paths("bravo") == ("one-bravo", "")


async def test_a_cancelled_dial_closes_its_standby(network, alpha, bravo, /):
    """The link with the host was dropped while the peer had not answered."""
    dial = asyncio.ensure_future(alpha.peers.standbys._dial("bravo", "two-bravo:7001"))
    await asyncio.sleep(0.03)
    link = network.links[-2]
    assert link.peer == "two-bravo:7001"
    dial.cancel()
    await asyncio.sleep(1.0)
    assert link.closed
