"""Links of observers: how much is processed of one link, of all together, and in which order.

The links are real ones, without sockets between them; time is virtual.
"""

from __future__ import annotations

import asyncio
import socket

import pytest
from certificates import Team
from coroutine_tests import scenario

from lfield.authority.identity import Identity, Right
from lfield.net.connections.tls_link import OBSERVER_PIECE, TlsLink
from lfield.net.scheduling.handshake_scheduler import CPU_SHARE as HANDSHAKES
from lfield.net.scheduling.link_schedulers import AT_ONCE, LONGEST, ROUND, LinkScheduler
from lfield.net.stream_link import StreamLink, anonymous_identity
from lfield.net.tls import TlsChannel, TlsIdentity
from lfield.simulate.jumping_loop import run_jumping
from lfield.testing.transport_kit import MAX_BLOCK, Recorder, transfer
from lfield.wire.codec import encode, encode_transfer
from lfield.wire.fields import MAX_TEXT
from lfield.wire.framing import frame_header
from lfield.wire.messages import Hello, Ping, Role
from lfield.wire.observer_messages import EmergencyStop
from lfield.wire.subscription_messages import Subscribe

HELLO, STOP = Hello("observer", "observer", 0), EmergencyStop(bytes(16), "now")
FLOOD = encode(Subscribe(once=True)) * 20_000
#: As much as the event loops read at once.
READ = 256 << 10


class Wire(asyncio.Transport):
    """The transport of a link; it records the calls."""

    def __init__(self, family: int) -> None:
        super().__init__()
        self._socket = socket.socket(family)
        self.reads, self.closing, self.said = True, False, b""

    def get_extra_info(self, name: str, default: object = None) -> object:
        return self._socket if name == "socket" else "" if name == "peername" else default

    def pause_reading(self) -> None:
        self.reads = False

    def resume_reading(self) -> None:
        self.reads = True

    def write(self, data: object) -> None:
        self.said += bytes(data)

    def is_closing(self) -> bool:
        return self.closing

    def close(self) -> None:
        self.closing = True

    def abort(self) -> None:
        self.closing = True

    def get_write_buffer_size(self) -> int:
        return 0

    def set_write_buffer_limits(self, high: int | None = None, low: int | None = None) -> None:
        pass

    def free(self) -> None:
        self._socket.close()


class Greeter(Recorder):
    """Accepts a Hello as a host does, and works for each message."""

    def works(self) -> None:
        pass

    def on_message(self, link, message) -> None:
        self.works()
        super().on_message(link, message)
        if isinstance(message, Hello):
            link.accept_role(message.role)


class Caller:
    """A client at the Unix socket of a host, or in TLS with some keys; `recorder` is what the host
    received."""

    def __init__(self, inn: HostBench, name: str, link: StreamLink, family: int) -> None:
        self.recorder, self.wire, self.link, self._loop = Greeter(), Wire(family), link, inn.loop
        link._on_link = lambda _: self.recorder
        link.connection_made(self.wire)
        if family == socket.AF_UNIX:
            link.identity = Identity("local", name, frozenset({Right.OBSERVE, Right.STOP}))

    def say(self, data: bytes) -> None:
        assert self.wire.reads, "the link reads although it waits"
        self.link.data_received(data)

    @property
    def heard(self) -> int:
        return len(self.recorder.messages)


class TlsCaller(Caller):
    """A client whose handshake is complete but for the last bytes, which it sends with its first message."""

    def __init__(self, inn: HostBench, name: str, link: TlsLink, keys) -> None:
        super().__init__(inn, name, link, socket.AF_INET)
        self._channel = TlsIdentity(keys).channel(calls=True)
        self.link.data_received(self._channel.data_to_send())
        assert list(self._channel.receive(self.wire.said)) == []
        assert self._channel.proven
        #: The bytes of the host that were read.
        self.read = len(self.wire.said)

    def say(self, data: bytes, record: int = 550) -> None:
        parts = (data[start : start + record] for start in range(0, len(data), record))
        super().say(b"".join([self._channel.data_to_send(), *map(self._channel.encrypt, parts)]))


class HostBench:
    """A host without a program, and its clients, over Unix sockets or TLS."""

    def __init__(self, way: str) -> None:
        self.work = 0.0
        self.loop, self.reception, self.way = asyncio.get_running_loop(), LinkScheduler(self.busy), way
        self.callers: list[Caller] = []
        self.team = Team()
        self.tls = TlsIdentity(self.team.host("alpha"))

    def caller(self, name: str, *, host: bool = False) -> Caller:
        if self.way == "unix":
            link = StreamLink(MAX_BLOCK, 1 << 20, Recorder, self.reception, anonymous_identity, calls=False)
            made: Caller = Caller(self, name, link, socket.AF_UNIX)
        else:
            keys = self.team.host(name) if host else self.team.person(name, Right.OBSERVE)
            tls = TlsLink(MAX_BLOCK, 1 << 20, Recorder, self.reception, self.tls, calls=False)
            made = TlsCaller(self, name, tls, keys)
        self.callers.append(made)
        return made

    def busy(self) -> float:
        return self.work

    @property
    def heard(self) -> int:
        return sum(caller.heard for caller in self.callers)

    def close(self) -> None:
        for caller in self.callers:
            caller.link.connection_lost(None)
            caller.wire.free()


@pytest.fixture(params=["unix", "tls"])
def runner(request):
    """Run the steps of a test at a host."""

    def run(steps) -> None:
        async def main() -> None:
            server = HostBench(request.param)
            try:
                await steps(server)
            finally:
                server.close()

        run_jumping(main())

    return run


async def test_a_read_of_thousands_of_messages_is_processed_in_rounds(inn, /):
    anna = inn.caller("anna")
    anna.say(encode(HELLO) + FLOOD)
    assert anna.heard == AT_ONCE
    assert not anna.wire.reads
    await asyncio.sleep(10.5 * ROUND)
    assert 6 * AT_ONCE <= anna.heard <= 11 * AT_ONCE
    assert not anna.wire.reads


async def test_waiting_messages_are_processed_in_order_then_reading_resumes(inn, /):
    anna = inn.caller("anna")
    lines = [Ping(number) for number in range(200)]
    anna.say(b"".join(map(encode, [HELLO, *lines])))
    assert not anna.wire.reads
    while not anna.wire.reads:
        await asyncio.sleep(ROUND)
    assert anna.recorder.messages == [HELLO, *lines]
    await asyncio.sleep(ROUND)
    encoded = encode(STOP)
    anna.say(encoded[:7])
    anna.say(encoded[7:])
    assert anna.recorder.messages[-1] == STOP


async def test_fewer_costly_messages_are_processed_per_round(inn, /):
    anna = inn.caller("anna")
    anna.recorder.works = lambda: setattr(inn, "work", inn.work + LONGEST / 2)
    anna.say(encode(HELLO) + FLOOD)
    assert anna.heard == 2
    await asyncio.sleep(9.5 * ROUND)
    assert anna.heard == 20


async def test_sixty_links_together_are_processed_like_one(inn, /):
    for _ in range(60):
        inn.caller("anna").say(encode(HELLO) + FLOOD)
    assert inn.heard <= AT_ONCE
    await asyncio.sleep(9.5 * ROUND)
    assert inn.heard <= 10 * AT_ONCE
    assert max(caller.heard for caller in inn.callers[1:]) <= 3


async def test_a_stop_on_a_new_link_passes_a_flood_in_the_next_round(inn, /):
    for _ in range(60):
        inn.caller("anna").say(encode(HELLO) + FLOOD)
    await asyncio.sleep(5 * ROUND)
    ben = inn.caller("ben")
    ben.say(encode(HELLO) + encode(STOP))
    await asyncio.sleep(1.1 * ROUND)
    assert ben.recorder.messages == [HELLO, STOP]
    # A stop of the flooding person waits for one turn of each other link.
    again = inn.caller("anna")
    again.say(encode(HELLO) + encode(STOP))
    await asyncio.sleep(18 * ROUND)
    assert again.recorder.messages == [HELLO, STOP]


async def test_occasional_requests_are_processed_at_once(inn, /):
    anna = inn.caller("anna")
    anna.say(encode(HELLO))
    for count in range(2, 50):
        anna.say(encode(Subscribe(once=True)))
        assert anna.heard == count
        await asyncio.sleep(ROUND)


async def test_a_long_message_is_delivered_whole(inn, /):
    anna = inn.caller("anna")
    stop = EmergencyStop(bytes(16), "x" * MAX_TEXT)
    anna.say(encode(HELLO) + encode(stop) + FLOOD)
    await asyncio.sleep(ROUND * 20)
    assert anna.recorder.messages[:3] == [HELLO, stop, Subscribe(once=True)]


async def test_an_invalid_message_closes_the_link_and_drops_the_rest(inn, /):
    anna, ben = inn.caller("anna"), inn.caller("ben")
    anna.say(encode(HELLO) + encode(Ping(1)) * 30 + frame_header(99, 1) + FLOOD)
    await asyncio.sleep(ROUND * 10)
    assert anna.heard == 31
    assert anna.wire.closing
    assert anna.link.closed
    ben.say(encode(HELLO) + FLOOD)
    ben.link.abort()
    had = ben.heard
    await asyncio.sleep(ROUND * 10)
    assert ben.heard == had
    assert ben.link._remaining is None


async def test_a_link_that_closes_while_it_waits_is_removed(inn, /):
    anna = inn.caller("anna")
    anna.say(encode(HELLO) + FLOOD)
    anna.link.connection_lost(None)
    had = anna.heard
    await asyncio.sleep(ROUND * 10)
    assert anna.heard == had
    assert anna.recorder.ends == [None]
    inn.callers.remove(anna)
    anna.wire.free()


# TLS only


def run_tls(steps) -> None:
    async def main() -> None:
        server = HostBench("tls")
        try:
            await steps(server)
        finally:
            server.close()

    run_jumping(main())


@scenario(run_tls)
async def test_records_without_a_whole_message_are_counted(inn, /, monkeypatch):
    """Each record of a message in a thousand records is work; so is a record without a message."""
    anna, parts = inn.caller("anna"), []
    received = StreamLink.received
    monkeypatch.setattr(StreamLink, "received", lambda link, data: (parts.append(1), received(link, data)))
    anna.say(encode(HELLO) + FLOOD[: READ // 30], record=1)
    assert len(parts) <= AT_ONCE
    await asyncio.sleep(9.5 * ROUND)
    assert len(parts) <= 10 * AT_ONCE


@scenario(run_tls)
async def test_at_most_a_piece_is_decrypted_at_once(inn, /, monkeypatch):
    anna, fed = inn.caller("anna"), []
    feed = TlsChannel.receive
    monkeypatch.setattr(
        TlsChannel, "receive", lambda self, data: (fed.append(len(data)), feed(self, data))[1]
    )
    anna.say(encode(HELLO) + FLOOD, record=16 << 10)
    assert max(fed) <= OBSERVER_PIECE


@scenario(run_tls)
async def test_handshakes_of_unknown_peers_get_their_share_of_each_turn(inn, /, monkeypatch):
    """Sixty at once, each part of which costs a slow computer five milliseconds."""
    first = TlsChannel._continue_handshake
    cost = 5e-3
    monkeypatch.setattr(
        TlsChannel,
        "_continue_handshake",
        lambda self, data: (setattr(inn, "work", inn.work + cost), first(self, data))[1],
    )
    words = TlsIdentity(inn.team.person("anna", Right.STOP)).channel(calls=True).data_to_send()
    links = []
    for _ in range(60):
        link = TlsLink(MAX_BLOCK, 1 << 20, lambda _: Recorder(), inn.reception, inn.tls, calls=False)
        wire = Wire(socket.AF_INET)
        link.connection_made(wire)
        before = inn.work
        link.data_received(words)
        assert inn.work - before <= cost
        links.append((link, wire))
    answered = [wire for _, wire in links if wire.said]
    assert 1 <= len(answered) <= 2
    assert not links[-1][1].reads
    started, before = inn.loop.time(), inn.work
    while not all(wire.said for _, wire in links):
        turn = inn.work
        await asyncio.sleep(1e-3)
        assert inn.work - turn <= 2 * cost
    assert inn.work - before <= HANDSHAKES * (inn.loop.time() - started) + 2 * cost
    assert links[-1][1].reads
    for link, wire in links:
        link.connection_lost(None)
        wire.free()


@pytest.mark.parametrize("role", ["host", "observer"])
@scenario(run_tls)
async def test_a_host_does_not_wait_behind_observers_unless_it_observes(inn, /, role: Role):
    """Also a host that reconnects, with all messages after its Hello."""
    for _ in range(60):
        inn.caller("anna").say(encode(HELLO) + FLOOD)
    bravo, block = inn.caller("bravo", host=True), b"block"
    bravo.say(encode(Hello(role, "bravo", 7)) + encode(Ping(1)) * 100)
    assert bravo.heard == (101 if role == "host" else 1)
    if role == "host":
        bravo.say(encode_transfer(transfer(len(block)), block) + block + encode(Ping(2)) * 100)
        assert bravo.heard == 202
