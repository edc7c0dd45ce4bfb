"""Every link reconnects: after silence, after a change of the address of its name, and over IPv6."""

from __future__ import annotations

import asyncio
import socket
from contextlib import asynccontextmanager, suppress

import pytest

from lfield.driver.network import Attempts, Lookup
from lfield.driver.network.attempts import REPEAT_INTERVAL
from lfield_mavlink.link import tcp, udp
from lfield_mavlink.link.link_events import LinkEvents
from lfield_mavlink.link.links import make_link, parse_endpoint

HOSTS = ["127.0.0.1", "[::1]"]


@pytest.fixture(autouse=True)
def short_waits(monkeypatch):
    """Divides every wait of a link by 20."""
    for module in (tcp, udp):
        monkeypatch.setattr(module, "RETRY_INTERVAL", module.RETRY_INTERVAL / 20.0)
        monkeypatch.setattr(module, "SILENT", module.SILENT / 20.0)


async def until(condition):
    async with asyncio.timeout(60):
        while not condition():
            await asyncio.sleep(0.005)


class RecordedLink:
    """A link with its received data and notes."""

    def __init__(self):
        self.got, self.notes, self.senders, self.reopened = bytearray(), [], [], 0

    def link(self, endpoint):
        events = LinkEvents(self.notes.append, self._reopened, self.senders.append)
        return make_link(endpoint, self.got.extend, events)

    def _reopened(self):
        self.reopened += 1


@asynccontextmanager
async def tcp_server(host, port=0, greeting=b"hello"):
    """Sends a greeting to each client, and closes the connections when the test ends."""
    clients = []

    async def serve(_, writer):
        clients.append(writer)
        writer.write(greeting)

    server = await asyncio.start_server(serve, host.strip("[]"), port)
    try:
        yield clients, server.sockets[0].getsockname()[1]
    finally:
        server.close()
        for writer in clients:
            writer.close()
            with suppress(OSError):
                await writer.wait_closed()


@pytest.mark.parametrize("host", HOSTS)
async def test_silent_tcp_connection_is_reopened(host):
    recorded = RecordedLink()
    async with tcp_server(host) as (clients, port):
        link = recorded.link(f"tcp:{host}:{port}")
        await link.open()
        # The first connection stops sending without a FIN, like an interrupted path.
        await until(lambda: len(clients) >= 2 and recorded.got.count(b"hello") >= 2)

        def talks():
            clients[-1].write(b"+")
            return b"+" in recorded.got

        await until(talks)
        link.close()
    assert f"link lost: tcp:{host}:{port}: no data for 0.25 s" in recorded.notes
    assert any(f": connected to {host.strip('[]')}, after" in note for note in recorded.notes)
    assert recorded.reopened >= 1


def resolving(monkeypatch, *answers):
    """The address of `robot.local` at each lookup; the last one is repeated. An exception is raised."""
    left = list(answers)

    async def addresses(self, within):
        answer = left.pop(0) if len(left) > 1 else left[0]
        if isinstance(answer, Exception):
            raise answer
        family = socket.AF_INET6 if ":" in answer else socket.AF_INET
        found = await asyncio.get_running_loop().getaddrinfo(
            answer, self.port, type=self._kind, family=family
        )
        return [(found[0][0], tuple(found[0][4]))]

    monkeypatch.setattr(Lookup, "addresses", addresses)


@pytest.mark.parametrize("after", ["127.0.0.2", "::1"])
async def test_tcp_link_follows_the_address_of_its_name(monkeypatch, after):
    failure = socket.gaierror(-3, "Temporary failure in name resolution")
    resolving(monkeypatch, "127.0.0.1", failure, after)

    recorded = RecordedLink()
    async with tcp_server("127.0.0.1") as (clients, port):
        link = recorded.link(f"tcp:robot.local:{port}")
        await link.open()
        await until(lambda: b"hello" in recorded.got)
        async with tcp_server(after, port, b"there"):
            clients[0].transport.abort()
            await until(lambda: b"there" in recorded.got)
            link.close()
    assert any("Temporary failure in name resolution (attempt 1)" in note for note in recorded.notes)
    assert any(f"connected to {after}, after" in note for note in recorded.notes)


class Vehicle(asyncio.DatagramProtocol):
    """Answers each datagram with its name."""

    def __init__(self, name):
        self.name, self.peers = name, []

    def connection_made(self, transport):
        self.transport = transport

    def datagram_received(self, data, addr):
        self.peers.append(addr)
        self.transport.sendto(self.name, addr)


async def vehicle(name, host, port=0):
    _, made = await asyncio.get_running_loop().create_datagram_endpoint(
        lambda: Vehicle(name), local_addr=(host.strip("[]"), port)
    )
    return made, made.transport.get_extra_info("sockname")[1]


@pytest.mark.parametrize("host", HOSTS)
async def test_silent_udp_link_is_reopened(host):
    recorded = RecordedLink()
    other, port = await vehicle(b"a", host)
    link = recorded.link(f"udp:{host}:{port}")
    await link.open()

    def answers(number):
        link.send(b"x")
        return len(recorded.got) >= number

    await until(lambda: answers(1))
    # The local address may have changed: the link now sends from a new socket.
    await until(lambda: any(": it sends to" in note for note in recorded.notes))
    count = len(recorded.got)
    await until(lambda: answers(count + 1))
    assert other.peers[0] != other.peers[-1]
    link.close()
    other.transport.close()


async def test_udp_link_follows_the_address_of_its_name(monkeypatch):
    resolving(monkeypatch, "127.0.0.1", "127.0.0.2")

    recorded = RecordedLink()
    first, port = await vehicle(b"a", "127.0.0.1")
    second, _ = await vehicle(b"b", "127.0.0.2", port)
    link = recorded.link(f"udp:robot.local:{port}")
    await link.open()

    def comes(name):
        link.send(b"x")
        return name in recorded.got

    await until(lambda: comes(b"a"))
    first.transport.close()
    await until(lambda: comes(b"b"))
    assert f"link lost: udp:robot.local:{port}: no data for 0.15 s" in recorded.notes
    link.close()
    second.transport.close()


@pytest.mark.parametrize("host", HOSTS)
async def test_udpin_reports_senders_and_sends_to_one_address(host):
    recorded = RecordedLink()
    bare = host.strip("[]")
    family = socket.AF_INET6 if ":" in bare else socket.AF_INET
    with socket.socket(family, socket.SOCK_DGRAM) as free:
        free.bind((bare, 0))
        port = free.getsockname()[1]
    link = recorded.link(f"udpin:{host}:{port}")
    await link.open()
    ends = [await vehicle(name, host) for name in (b"a", b"b")]
    for made, _ in ends:
        made.transport.sendto(made.name, (bare, port))
    await until(lambda: sorted(recorded.got) == sorted(b"ab"))
    assert recorded.senders == [f"{host}:{number}" for _, number in ends]
    link.send_to(b"!", f"{host}:{ends[1][1]}")
    await until(lambda: ends[1][0].peers)
    assert not ends[0][0].peers
    link.close()
    for made, _ in ends:
        made.transport.close()


async def test_udpin_follows_the_local_address_of_its_name(monkeypatch):
    failure = OSError(99, "Cannot assign requested address")
    resolving(monkeypatch, "127.0.0.1", failure, "127.0.0.2")

    recorded = RecordedLink()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    link = recorded.link(f"udpin:robot.local:{port}")
    await link.open()
    made, _ = await vehicle(b"a", "127.0.0.2")

    def comes():
        made.transport.sendto(b"a", ("127.0.0.2", port))
        return b"a" in recorded.got

    await until(comes)
    assert any("it listens at 127.0.0.2" in note for note in recorded.notes)
    link.close()
    made.transport.close()


@pytest.mark.parametrize("talks", [True, False])
async def test_udpin_binds_an_address_later_when_it_becomes_free(monkeypatch, talks):
    """With and without traffic on the other address, whose socket is kept."""
    recorded = RecordedLink()
    one, _ = await vehicle(b"1", "127.0.0.2")
    other, _ = await vehicle(b"2", "127.0.0.3")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as occupied:
        occupied.bind(("127.0.0.3", 0))
        port = occupied.getsockname()[1]
        found = [(socket.AF_INET, (f"127.0.0.{host}", port)) for host in (2, 3)]

        async def addresses(self, within):
            return found

        monkeypatch.setattr(Lookup, "addresses", addresses)
        link = recorded.link(f"udpin:robot.local:{port}")
        await link.open()
        (sock,) = link._sockets.open
        assert [note for note in recorded.notes if "127.0.0.3: Address already in use" in note]
        await asyncio.sleep(0.3)
        assert sum("127.0.0.3" in note for note in recorded.notes) == 1

    def comes():
        if talks:
            one.transport.sendto(b"1", ("127.0.0.2", port))
        other.transport.sendto(b"2", ("127.0.0.3", port))
        return b"2" in recorded.got

    await until(comes)
    assert any("it listens at 127.0.0.3" in note for note in recorded.notes)
    assert sock in link._sockets.open
    # Each peer is answered over the socket that received its packet.
    link.send(b"?")
    await until(lambda: ("127.0.0.3", port) in other.peers)
    link.close()
    for made in (one, other):
        made.transport.close()


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("tcp:[fd00::5]:5760", ("tcp", "fd00::5", 5760)),
        ("udp:[fe80::1%eth0]:14550", ("udp", "fe80::1%eth0", 14550)),
        ("udpin:[::]:14550", ("udpin", "::", 14550)),
        ("udpin:::1:14550", ("udpin", "::1", 14550)),
    ],
)
def test_ipv6_endpoints_are_parsed(text, parts):
    assert parse_endpoint(text) == [parts]


async def test_unresolved_name_has_one_lookup_at_a_time(monkeypatch):
    requests = []

    loop = asyncio.get_running_loop()

    async def hangs(*names, **_):
        requests.append(names)
        await asyncio.sleep(3600.0)

    monkeypatch.setattr(loop, "getaddrinfo", hangs)
    lookup = Lookup("robot.local", 5760, socket.SOCK_STREAM)
    for _ in range(3):
        with pytest.raises(TimeoutError, match="not resolved within"):
            await lookup.addresses(0.01)
    assert len(requests) == 1


def test_failed_attempts_are_logged_once_per_interval():
    tries = Attempts("tcp:10.0.0.5:5760")
    assert tries.opened("10.0.0.5", 0.0) == ""
    assert tries.lost("it hung up", 1.0).startswith("link lost: tcp:10.0.0.5:5760: it hung up")
    lines = [tries.failed("No route to host", 2.0 + number) for number in range(60)]
    assert lines[0] == "link not opened: tcp:10.0.0.5:5760: No route to host (attempt 1)"
    again = int(REPEAT_INTERVAL)
    assert [number for number, line in enumerate(lines) if line] == [0, again - 1, 2 * again - 1]
    assert tries.failed("Connection refused", 62.0).endswith("(attempt 61)")
    line = tries.opened("connected to 10.0.0.6", 63.0)
    assert line == "link opened: tcp:10.0.0.5:5760: connected to 10.0.0.6, after 62 attempts and 62 s"
    tries.works()
    assert tries.lost("it hung up", 64.0) != ""


async def test_unreachable_addresses_do_not_delay_a_reachable_one(monkeypatch):
    monkeypatch.setattr("lfield.address_race.ATTEMPT_DELAY", 0.01)
    recorded = RecordedLink()
    async with tcp_server("127.0.0.1") as (_, port):
        with socket.socket() as hole:
            # Its accept queue is full: connections are not answered.
            hole.bind(("127.0.0.9", port))
            hole.listen(0)
            callers = [socket.socket() for _ in range(3)]
            for caller in callers:
                caller.setblocking(False)
                caller.connect_ex(hole.getsockname())
            silent = [(socket.AF_INET, ("127.0.0.9", port))] * 6

            async def addresses(self, within):
                return [*silent, (socket.AF_INET, ("127.0.0.1", port))]

            monkeypatch.setattr(Lookup, "addresses", addresses)
            link = recorded.link(f"tcp:robot.local:{port}")
            await link.open()
            await until(lambda: recorded.got)
            link.close()
            for caller in callers:
                caller.close()
