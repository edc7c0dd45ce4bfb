"""Links between two computers are restored within 10 s after the path works again, after any kind of failure.

The computers are network namespaces; tests/net/test_paths.py has the cases for loopback.
"""

from __future__ import annotations

import subprocess
import sys
import time
import uuid
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import pytest
from namespaces import Network, Process, command, namespaces, network  # noqa: F401

from lfield.testing.keyring import Keyring

pytestmark = pytest.mark.process

#: Seconds until a link is restored.
PROMISE = 10.0


@dataclass
class TwoHosts:
    """Two linked hosts; faults are applied to `net`."""

    net: Network
    a: Process
    b: Process
    places: tuple[str, ...]

    def lost(self) -> None:
        """Wait until both have closed the link."""
        for process, other in ((self.a, "b"), (self.b, "a")):
            process.wait_for(f"unlinked {other}")


@pytest.fixture
def net(request, tmp_path) -> Iterator[Network]:
    if not request.getfixturevalue("namespaces"):
        pytest.skip("no network namespace can be made here: test_paths.py has the variants on loopback")
    ring = Keyring(tmp_path / "keys")
    yield from network(ring.give("a", "b"))


def linked(net: Network, *places: str) -> TwoHosts:
    a, b = net.start("a", *places), net.start("b", *places)
    for process, other in ((a, "b"), (b, "a")):
        process.wait_for(f" linked {other}")
    return TwoHosts(net, a, b, places)


def by_numbers(net: Network, a: str, b: str) -> TwoHosts:
    net.address("a", f"{a}/64" if ":" in a else f"{a}/24")
    net.address("b", f"{b}/64" if ":" in b else f"{b}/24")
    bracketed = [f"[{address}]:7001" if ":" in address else f"{address}:7001" for address in (a, b)]
    return linked(net, f"a={bracketed[0]}", f"b={bracketed[1]}")


def by_names(net: Network) -> TwoHosts:
    net.address("a", "10.9.0.1/24")
    net.address("b", "10.9.0.2/24")
    for host in "ab":
        net.name(host, "10.9.0.1 alpha", "10.9.0.2 bravo")
    return linked(net, "a=alpha:7001", "b=bravo:7001")


def silence(two: TwoHosts) -> Callable[[], None]:
    """All packets are lost for a while: the router has no power."""
    two.net.silence()
    two.lost()
    return two.net.heal


def silence_v6(net: Network) -> tuple[TwoHosts, Callable[[], None]]:
    two = by_numbers(net, "fd00::1", "fd00::2")
    return two, silence(two)


def silence_v4(net: Network) -> tuple[TwoHosts, Callable[[], None]]:
    two = by_numbers(net, "10.9.0.1", "10.9.0.2")
    return two, silence(two)


def peer_died(net: Network) -> tuple[TwoHosts, Callable[[], None]]:
    """The peer loses power, and starts with a new incarnation."""
    two = by_numbers(net, "10.9.0.1", "10.9.0.2")
    net.silence()
    two.b.kill()
    two.a.wait_for("unlinked b")
    two.b = net.start("b", *two.places)
    two.b.wait_for("listens")
    return two, net.heal


def interface(net: Network, a: str, b: str) -> tuple[TwoHosts, Callable[[], None]]:
    """The interface of the listening host is removed with its address, and restored."""
    two = by_numbers(net, a, b)
    net.pull_out("b")
    two.lost()

    def back() -> None:
        net.plug_in("b")
        net.address("b", f"{b}/64" if ":" in b else f"{b}/24")

    return two, back


def interface_v4(net: Network) -> tuple[TwoHosts, Callable[[], None]]:
    return interface(net, "10.9.0.1", "10.9.0.2")


def interface_v6(net: Network) -> tuple[TwoHosts, Callable[[], None]]:
    return interface(net, "fd00::1", "fd00::2")


def own_interface(net: Network) -> tuple[TwoHosts, Callable[[], None]]:
    """The same at the host that dials."""
    two = by_numbers(net, "10.9.0.1", "10.9.0.2")
    net.pull_out("a")
    two.lost()

    def back() -> None:
        net.plug_in("a")
        net.address("a", "10.9.0.1/24")

    return two, back


def link_local(net: Network) -> tuple[TwoHosts, Callable[[], None]]:
    """The zone of the address has another number when the interface is back."""
    for host, number in (("a", 1), ("b", 2)):
        net.address(host)
        net._ip(net._named(host), "addr", "add", f"fe80::{number}/64", "dev", "eth0", "nodad")
    two = linked(net, "a=[fe80::1%eth0]:7001", "b=[fe80::2%eth0]:7001")
    net.pull_out("b")
    two.lost()

    def back() -> None:
        net.plug_in("b")
        net._ip(net._named("b"), "addr", "add", "fe80::2/64", "dev", "eth0", "nodad")

    return two, back


def peer_moved(net: Network) -> tuple[TwoHosts, Callable[[], None]]:
    """The listening host gets another address, and its name is changed."""
    two = by_names(net)
    net.address("b")
    two.lost()

    def back() -> None:
        net.address("b", "10.9.0.22/24")
        for host in "ab":
            net.name(host, "10.9.0.1 alpha", "10.9.0.22 bravo")

    return two, back


def moved(net: Network) -> tuple[TwoHosts, Callable[[], None]]:
    """The host that dials gets another address."""
    two = by_names(net)
    net.address("a")
    two.lost()
    return two, lambda: net.address("a", "10.9.0.11/24")


def dead_first_address(net: Network) -> tuple[TwoHosts, Callable[[], None]]:
    """A name has an address that does not answer, and one that does."""
    net.address("a", "10.9.0.1/24")
    net.address("b", "10.9.0.2/24")
    net.name("a", "10.9.0.1 alpha", "10.9.0.2 bravo")
    net.name("b", "10.9.0.1 alpha", "10.9.0.2 bravo")
    two = linked(net, "a=alpha:7001", "b=bravo:7001")
    net.silence()
    two.lost()
    # No host has the first addresses: they do not even refuse.
    net.name("a", "10.9.0.1 alpha", "10.9.0.77 bravo", "10.9.0.78 bravo", "10.9.0.2 bravo")
    return two, net.heal


CASES = [
    silence_v4,
    silence_v6,
    peer_died,
    interface_v4,
    interface_v6,
    own_interface,
    link_local,
    peer_moved,
    moved,
    dead_first_address,
]


@pytest.mark.few(0)
@pytest.mark.parametrize("case", CASES, ids=lambda case: case.__name__)
def test_a_link_is_restored_within_ten_seconds(net, case):
    two, works_again = case(net)
    # Every attempt has reached its longest pause.
    time.sleep(4.0)
    counts = len(two.a.lines), len(two.b.lines)
    started = time.monotonic()
    works_again()
    back = [
        process.wait_for(f" linked {other}", count) - started
        for process, other, count in ((two.a, "b", counts[0]), (two.b, "a", counts[1]))
    ]
    print(f"{case.__name__}: linked again after {max(back):.1f} s", *two.a.lines, *two.b.lines, sep="\n")
    assert max(back) < PROMISE


#: A link to a vehicle, which answers each datagram; prints "heard" for each, at most every 0.1 s.
VEHICLE = """
import socket
with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as made:
    made.bind(("10.9.0.2", 14550))
    while True:
        made.sendto(b"+", made.recvfrom(99)[1])
"""
STATION = """
import asyncio, time
from lfield_mavlink.link.link_events import LinkEvents
from lfield_mavlink.link.links import make_link

def say(text):
    print(time.monotonic(), text, flush=True)

async def main():
    link = make_link("udp:10.9.0.2:14550", lambda data: say("heard"), LinkEvents(say))
    await link.open()
    while True:
        link.send(b"?")
        await asyncio.sleep(0.1)

asyncio.run(main())
"""


@pytest.mark.few(0)
@pytest.mark.parametrize("gone", [0.0, 6.0])
def test_a_udp_link_works_again_from_another_interface_with_another_address(net, gone):
    """tests/mavlink/link/test_mavlink_reconnects.py has the cases for loopback."""
    net.address("a", "10.9.0.1/24")
    net.address("b", "10.9.0.2/24")
    net.run("b", sys.executable, "-c", VEHICLE)
    station = net.run("a", sys.executable, "-c", STATION)
    station.wait_for("heard")
    net.pull_out("a")
    time.sleep(gone)
    count = len(station.lines)
    net.plug_in("a")
    net.address("a", "10.9.0.11/24")
    started = time.monotonic()
    back = station.wait_for("heard", count) - started
    print(
        f"heard again after {back:.1f} s", *[line for line in station.lines if "heard" not in line], sep="\n"
    )
    assert back < PROMISE
    assert any("link lost: udp:10.9.0.2:14550: no data for 3 s" in line for line in station.lines)
    assert any(": it sends to 10.9.0.2" in line for line in station.lines)


#: A link to an address that is valid only with its zone.
ZONE = """
import asyncio
from lfield_mavlink.link.links import make_link
from lfield_can.bus.socketcand import open_socketcand
from lfield_can.bus.endpoint import parse_endpoint
from lfield_can.bus.frames import Listener

async def serve(reader, writer):
    writer.write(b"< hi >")
    while data := await reader.read(99):
        writer.write(b"< ok >")

async def main():
    server = await asyncio.start_server(serve, "fe80::7%zone0", 0)
    port, got = server.sockets[0].getsockname()[1], bytearray()
    link = make_link(f"tcp:[fe80::7%zone0]:{port}", got.extend)
    await link.open()
    while not got:
        await asyncio.sleep(0.01)
    print("mavlink linked")
    nothing = lambda *_: None
    place = parse_endpoint(f"socketcand:[fe80::7%zone0]:{port}/can0")
    await open_socketcand(place, Listener(nothing, nothing, nothing))
    print("socketcand linked", flush=True)
    link.close()

asyncio.run(asyncio.wait_for(main(), 20))
"""


def test_mavlink_and_socketcand_addresses_keep_their_zone(request):
    if not request.getfixturevalue("namespaces"):
        pytest.skip("no network namespace can be made here")
    name = f"lf-{uuid.uuid4().hex[:8]}"
    command("ip", "netns", "add", name)
    try:
        command("ip", "-n", name, "link", "add", "name", "zone0", "type", "veth", "peer", "name", "zone1")
        for end in ("lo", "zone0", "zone1"):
            command("ip", "-n", name, "link", "set", "dev", end, "up")
        command("ip", "-n", name, "addr", "add", "fe80::7/64", "dev", "zone0", "nodad")
        arguments = ["ip", "netns", "exec", name, sys.executable, "-c", ZONE]
        done = subprocess.run(arguments, capture_output=True, text=True)
        assert done.stdout == "mavlink linked\nsocketcand linked\n", done.stderr
    finally:
        command("ip", "netns", "del", name)
