"""Endpoints and the links behind them, over real sockets and a pseudo-terminal."""

from __future__ import annotations

import asyncio
import os
import pty
import socket

import pytest
from loopback import own_address

from lfield.errors import DeviceError
from lfield_mavlink.link.links import make_link

HERE = own_address()


@pytest.mark.parametrize(
    "text",
    [
        "",
        "udp",
        "udp:14550",
        "udp:h:x",
        "serial:/dev/x",
        "tcp::1",
        "tcp:h:0",
        "http:h:1",
        "udp://h",
        "udp://1.2..3:x",
    ],
)
def test_invalid_endpoint_is_refused(text):
    with pytest.raises(DeviceError, match=r"is not an endpoint|is not a number from 1 to 65535"):
        make_link(text, lambda data: None)


async def until(condition):
    async with asyncio.timeout(60):
        while not condition():
            await asyncio.sleep(0.005)


async def test_udpin_sends_to_every_peer_that_has_sent():
    got = bytearray()
    loop = asyncio.get_running_loop()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind((HERE, 0))
        port = free.getsockname()[1]
    link = make_link(f"udpin:{HERE}:{port}", got.extend)
    await link.open()
    link.send(b"no peer yet")
    replies = asyncio.Queue()

    class Vehicle(asyncio.DatagramProtocol):
        def datagram_received(self, data, addr):
            replies.put_nowait(data)

    transport, _ = await loop.create_datagram_endpoint(Vehicle, remote_addr=(HERE, port))
    transport.sendto(b"hello")
    await until(lambda: got == b"hello")
    link.send(b"you")
    assert await replies.get() == b"you"
    other, _ = await loop.create_datagram_endpoint(Vehicle, remote_addr=(HERE, port))
    other.sendto(b" there")
    await until(lambda: got == b"hello there")
    link.send(b"both")
    assert [await replies.get(), await replies.get()] == [b"both", b"both"]
    other.close()
    with pytest.raises(DeviceError, match=rf"cannot open udp:{HERE}:{port}: .*in use"):
        await make_link(f"udpin:{HERE}:{port}", got.extend).open()
    transport.close()
    link.close()


async def test_port_without_listener_is_reported_with_usual_endpoints():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind((HERE, 0))
        port = free.getsockname()[1]
    link = make_link(f"udp:{HERE}:{port}", lambda data: None)
    await link.open()
    assert link.silence_reason().startswith(f"nothing received from udp:{HERE}:{port}; simulators use")
    link.send(b"ping")
    await until(lambda: link.silence_reason().startswith(f"no process listens at udp:{HERE}:{port}; "))
    assert "tcp:127.0.0.1:5760" in link.silence_reason()
    assert "udpin:127.0.0.1:14550" in link.silence_reason()
    link.close()


async def test_tcp_reconnects_after_a_broken_connection(monkeypatch):
    monkeypatch.setattr("lfield_mavlink.link.links.RETRY_INTERVAL", 0.01)

    got, writers = bytearray(), []

    async def serve(reader, writer):
        writers.append(writer)
        writer.write(b"hello")

    server = await asyncio.start_server(serve, "127.0.0.1", 0)
    port = server.sockets[0].getsockname()[1]
    link = make_link(f"tcp:127.0.0.1:{port}", got.extend)
    await link.open()
    await until(lambda: got == b"hello")
    assert "is connected but sends nothing" in link.silence_reason()
    writers[0].transport.abort()
    await until(lambda: got == b"hellohello")
    link.send(b"x")
    link.close()
    for writer in writers:
        writer.close()
    server.close()


async def test_serial_port_reads_writes_and_is_locked():
    master, slave = pty.openpty()
    path = os.ttyname(slave)
    got = bytearray()
    link = make_link(f"serial:{path}:57600", got.extend)
    await link.open()
    os.write(master, b"\x00\xfd\r\n\x11\x13")
    await until(lambda: got == b"\x00\xfd\r\n\x11\x13")
    link.send(b"\n\xff\x03")
    assert os.read(master, 10) == b"\n\xff\x03"
    with pytest.raises(DeviceError, match=f"{path} is in use by another program"):
        await make_link(f"serial:{path}:57600", got.extend).open()
    os.close(master)
    await until(lambda: not link.port.is_open)
    link.send(b"lost")
    link.close()
    os.close(slave)
