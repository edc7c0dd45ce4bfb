"""The sockets of datagrams: what reaches a host, and what the kernel drops before."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Callable

import pytest

from lfield.net.datagrams.datagram_port import (
    FLOODING_PORTS,
    Address,
    DatagramPort,
    datagram_socket_at,
    network_of,
)
from lfield.net.datagrams.kernel_filter import ANY_PORT, Flooder, attach, flooder_at
from lfield.net.tcp_transport import TcpTransport
from lfield.net.transport import split_address
from lfield.wire.order_messages import MAGIC, MAX_DATAGRAM

SOUND = MAGIC + bytes(150)


class Noted:
    """Reads everything, but of some addresses so many only."""

    def __init__(self) -> None:
        self.came: list[bytes] = []
        self.left: dict[object, int] = {}

    def received(self, port: DatagramPort, address: Address, data: bytes) -> bool:
        left = self.left.get(address, 1000)
        self.left[address] = left - 1
        if left <= 0:
            return False
        self.came.append(data)
        port.send(address, b"seen")
        return True


async def until(fact: Callable[[], bool]) -> None:
    async with asyncio.timeout(60.0):
        while not fact():
            await asyncio.sleep(0.002)


def sender(at: str = "127.0.0.1") -> socket.socket:
    made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    made.bind((at, 0))
    made.settimeout(60.0)
    return made


@pytest.mark.parametrize("at", ["127.0.0.1:0", "[::1]:0"])
async def test_datagrams_come_to_the_number_of_the_listening_port_and_end_with_it(at: str) -> None:
    transport, noted = TcpTransport(1 << 16), Noted()
    transport.datagrams = noted
    try:
        listener = await transport.listen(at, lambda link: None)  # type: ignore[arg-type,return-value]
    except OSError:
        pytest.skip("no IPv6 on this computer")
    host, port = split_address(listener.address)
    asks = socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET, socket.SOCK_DGRAM)
    asks.sendto(SOUND, (host, port))
    await until(lambda: noted.came == [SOUND])
    asks.settimeout(60.0)
    assert asks.recv(100) == b"seen"
    listener.close()
    again = socket.socket(asks.family, socket.SOCK_DGRAM)
    again.bind((host, port))
    again.close()
    asks.close()


async def test_what_cannot_be_an_order_is_dropped() -> None:
    noted, asks = Noted(), sender()
    made = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    made.bind(("127.0.0.1", 0))
    at = made.getsockname()
    port = DatagramPort(datagram_socket_at(made), noted, float)
    for wrong in (b"", MAGIC, b"GET / HTTP/1.1" + bytes(200), SOUND[:100], MAGIC + bytes(MAX_DATAGRAM)):
        asks.sendto(wrong, at)
    asks.sendto(SOUND, at)
    await until(lambda: bool(noted.came))
    assert noted.came == [SOUND]
    port.close()
    made.close()
    asks.close()


def test_of_a_sender_that_sends_too_much_the_kernel_drops_all_and_of_nobody_else() -> None:
    made, floods, asks = sender(), sender(), sender()
    made.settimeout(60.0)
    if not attach(made, [flooder_at(*floods.getsockname())]):
        pytest.skip("this kernel has no socket filters")
    for _ in range(5):
        floods.sendto(SOUND, made.getsockname())
    asks.sendto(SOUND, made.getsockname())
    assert made.recvfrom(2000)[1] == asks.getsockname()
    made.setblocking(False)
    with pytest.raises(BlockingIOError):
        made.recv(2000)
    attach(made, [])
    floods.sendto(SOUND, made.getsockname())
    made.settimeout(60.0)
    assert made.recvfrom(2000)[1] == floods.getsockname()
    for each in (made, floods, asks):
        each.close()


async def test_a_flood_that_is_refused_does_not_hold_up_others() -> None:
    noted, floods, asks = Noted(), sender(), sender()
    noted.left[floods.getsockname()] = 3
    made = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    made.bind(("127.0.0.1", 0))
    port = DatagramPort(datagram_socket_at(made), noted, float)
    for _ in range(100):
        floods.sendto(SOUND, made.getsockname())
    await until(lambda: len(noted.came) == 3)
    asks.sendto(SOUND + b"!", made.getsockname())
    await until(lambda: SOUND + b"!" in noted.came)
    assert len(noted.came) == 4
    port.close()
    made.close()
    floods.close()
    asks.close()


async def test_a_flood_from_many_ports_of_one_address_is_dropped_with_all_ports() -> None:
    with sender() as tried:
        if not attach(tried, []):
            pytest.skip("this kernel has no socket filters")
    noted, asks = Noted(), sender("127.0.0.2")
    floods = [sender() for _ in range(FLOODING_PORTS + 2)]
    made = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    made.bind(("127.0.0.1", 0))
    port = DatagramPort(datagram_socket_at(made), noted, float)
    for one in floods[: FLOODING_PORTS + 1]:
        noted.left[one.getsockname()] = 0
        one.sendto(SOUND, made.getsockname())
    await until(lambda: [found.port for found in port.flooders] == [ANY_PORT])
    # Of this port nothing came before.
    floods[-1].sendto(SOUND, made.getsockname())
    asks.sendto(SOUND + b"!", made.getsockname())
    await until(lambda: noted.came == [SOUND + b"!"])
    port.close()
    for each in (made, asks, *floods):
        each.close()


@pytest.mark.parametrize(
    ("host", "network", "packed"),
    [
        ("10.1.2.3", "10.1.2.3", b"\x0a\x01\x02\x03"),
        ("::ffff:10.1.2.3", "10.1.2.3", b"\x0a\x01\x02\x03"),
        ("fe80::1%lo", "fe80000000000000", b"\xfe\x80" + bytes(13) + b"\x01"),
        ("2001:db8::7", "20010db800000000", b"\x20\x01\x0d\xb8" + bytes(11) + b"\x07"),
    ],
)
def test_addresses_are_rationed_by_their_networks(host: str, network: str, packed: bytes) -> None:
    assert network_of((host, 1)) == network
    assert flooder_at(host, 7) == Flooder(packed, 7)
