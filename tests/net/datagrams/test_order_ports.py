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


class DatagramLog:
    """Reads datagrams, up to a limit for some addresses."""

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
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sock.bind((at, 0))
    sock.settimeout(60.0)
    return sock


@pytest.mark.parametrize("at", ["127.0.0.1:0", "[::1]:0"])
async def test_datagrams_use_the_number_of_the_listening_port_and_close_with_it(at: str) -> None:
    transport, log = TcpTransport(1 << 16), DatagramLog()
    transport.datagrams = log
    try:
        listener = await transport.listen(at, lambda link: None)  # type: ignore[arg-type,return-value]
    except OSError:
        pytest.skip("no IPv6 on this computer")
    host, port = split_address(listener.address)
    client = socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET, socket.SOCK_DGRAM)
    client.sendto(SOUND, (host, port))
    await until(lambda: log.came == [SOUND])
    client.settimeout(60.0)
    assert client.recv(100) == b"seen"
    listener.close()
    again = socket.socket(client.family, socket.SOCK_DGRAM)
    again.bind((host, port))
    again.close()
    client.close()


async def test_datagrams_that_are_no_orders_are_dropped() -> None:
    log, client = DatagramLog(), sender()
    sock = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    sock.bind(("127.0.0.1", 0))
    at = sock.getsockname()
    port = DatagramPort(datagram_socket_at(sock), log, float)
    for wrong in (b"", MAGIC, b"GET / HTTP/1.1" + bytes(200), SOUND[:100], MAGIC + bytes(MAX_DATAGRAM)):
        client.sendto(wrong, at)
    client.sendto(SOUND, at)
    await until(lambda: bool(log.came))
    assert log.came == [SOUND]
    port.close()
    sock.close()
    client.close()


def test_the_kernel_filter_drops_only_the_datagrams_of_the_flooding_address() -> None:
    sock, floods, client = sender(), sender(), sender()
    sock.settimeout(60.0)
    if not attach(sock, [flooder_at(*floods.getsockname())]):
        pytest.skip("this kernel has no socket filters")
    for _ in range(5):
        floods.sendto(SOUND, sock.getsockname())
    client.sendto(SOUND, sock.getsockname())
    assert sock.recvfrom(2000)[1] == client.getsockname()
    sock.setblocking(False)
    with pytest.raises(BlockingIOError):
        sock.recv(2000)
    attach(sock, [])
    floods.sendto(SOUND, sock.getsockname())
    sock.settimeout(60.0)
    assert sock.recvfrom(2000)[1] == floods.getsockname()
    for each in (sock, floods, client):
        each.close()


async def test_a_refused_flood_does_not_delay_other_senders() -> None:
    log, floods, client = DatagramLog(), sender(), sender()
    log.left[floods.getsockname()] = 3
    sock = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    sock.bind(("127.0.0.1", 0))
    port = DatagramPort(datagram_socket_at(sock), log, float)
    for _ in range(100):
        floods.sendto(SOUND, sock.getsockname())
    await until(lambda: len(log.came) == 3)
    client.sendto(SOUND + b"!", sock.getsockname())
    await until(lambda: SOUND + b"!" in log.came)
    assert len(log.came) == 4
    port.close()
    sock.close()
    floods.close()
    client.close()


async def test_a_flood_from_many_ports_of_one_address_blocks_all_its_ports() -> None:
    with sender() as tried:
        if not attach(tried, []):
            pytest.skip("this kernel has no socket filters")
    log, client = DatagramLog(), sender("127.0.0.2")
    floods = [sender() for _ in range(FLOODING_PORTS + 2)]
    sock = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    sock.bind(("127.0.0.1", 0))
    port = DatagramPort(datagram_socket_at(sock), log, float)
    for one in floods[: FLOODING_PORTS + 1]:
        log.left[one.getsockname()] = 0
        one.sendto(SOUND, sock.getsockname())
    await until(lambda: [found.port for found in port.flooders] == [ANY_PORT])
    # This port has sent nothing before.
    floods[-1].sendto(SOUND, sock.getsockname())
    client.sendto(SOUND + b"!", sock.getsockname())
    await until(lambda: log.came == [SOUND + b"!"])
    port.close()
    for each in (sock, client, *floods):
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
def test_address_rations_are_per_network(host: str, network: str, packed: bytes) -> None:
    assert network_of((host, 1)) == network
    assert flooder_at(host, 7) == Flooder(packed, 7)
