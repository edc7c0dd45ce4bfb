"""Endpoints and the links behind them: UDP, TCP and serial. Bytes only.

udp:HOST:PORT         sends to a vehicle that listens there
udpin:HOST:PORT       listens there for vehicles that send (what is sent goes to all who sent lately)
tcp:HOST:PORT         connects; reconnects when the connection breaks
serial:/dev/ttyX:BAUD a serial port, 8N1; reopened when it was unplugged

Several of them, with commas between, are links to the same vehicles.
"""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Callable
from contextlib import suppress
from typing import Protocol

from lfield.driver import DeviceError
from lfield.driver.serial import SerialPort, parse_serial_endpoint

#: Seconds between attempts to open a link again.
AGAIN = 1.0
#: Peers that a listening port answers.
PEERS = 16
#: Bytes of the largest datagram.
LARGEST = 65535
SYNTAX = "udp:HOST:PORT, udpin:HOST:PORT, tcp:HOST:PORT or serial:/dev/ttyX:BAUD"

OnData = Callable[[bytes], None]


class Link(Protocol):
    """One open endpoint."""

    async def open(self) -> None:
        """Open it. Raises DeviceError when that is impossible here and now."""

    def send(self, data: bytes) -> None:
        """Send one packet; what cannot be sent is lost, as on a radio."""

    def why_silent(self) -> str:
        """What is to be said when nothing at all was heard on it: what is known, and what to do."""

    def close(self) -> None:
        """Give it back."""


def split_endpoint(endpoint: str) -> list[str]:
    """The links of an endpoint: `udp:127.0.0.1:14550, serial:/dev/ttyUSB0:57600`."""
    return [part.strip() for part in endpoint.split(",")]


def parse_endpoint(endpoint: str) -> list[tuple[str, str, int]]:
    """Of each link its kind, its host or path, and its port or baud rate.

    Raises DeviceError with a sentence on how to write one.
    """
    return [_parsed(link) for link in split_endpoint(endpoint)]


def _parsed(link: str) -> tuple[str, str, int]:
    kind, _, rest = link.partition(":")
    place, _, number = rest.rpartition(":")
    if kind not in ("udp", "udpin", "tcp", "serial") or not place or not number.isdecimal():
        raise DeviceError("endpoint", f"'{link}' is not an endpoint; write {SYNTAX}")
    if kind == "serial":
        return kind, *parse_serial_endpoint(link)
    if not 0 < int(number) < 65536:
        raise DeviceError("endpoint", f"'{link}' has no port from 1 to 65535")
    return kind, place, int(number)


def make_link(link: str, on_data: OnData) -> Link:
    """One link of an endpoint, not open yet. Raises DeviceError as `parse_endpoint`."""
    kind, place, number = _parsed(link)
    if kind == "serial":
        return SerialLink(place, number, on_data)
    if kind == "tcp":
        return TcpLink(place, number, on_data)
    return UdpLink(place, number, on_data, listens=kind == "udpin")


class SerialLink:
    """A serial port; when its buffer is full, or it is away, a packet is lost, which MAVLink survives."""

    def __init__(self, path: str, baud: int, on_data: OnData) -> None:
        self.received, self.port = on_data, SerialPort(path, baud, self)

    async def open(self) -> None:
        """Open and configure the port, now."""
        self.port.open()

    def send(self, data: bytes) -> None:
        """Into the port."""
        self.port.write(data)

    def why_silent(self) -> str:
        """An autopilot's port has a baud rate, and speaks MAVLink if it was set up so."""
        return (
            f"nothing comes from {self.port.path}; check the cable, the baud rate of {self.port.baud}, and "
            "that the autopilot speaks MAVLink there (SERIALn_PROTOCOL 2, MAV_n_CONFIG)"
        )

    def close(self) -> None:
        """Give the port back."""
        self.port.close()

    def lost(self, reason: str) -> None:
        """The heartbeats that are missing tell of it."""

    def back(self) -> None:
        """And those that come again."""


class UdpLink:
    """Datagrams to one peer that we were told, or to all that we have heard.

    A socket of its own on the loop, of which one datagram is taken at a time: whoever waits for the answer
    that it is goes on before the next one is looked at.
    """

    def __init__(self, host: str, port: int, on_data: OnData, *, listens: bool) -> None:
        self._address, self._on_data, self._listens = (host, port), on_data, listens
        self._socket: socket.socket | None = None
        # Whether the other computer has said that nobody listens there.
        self._unreachable = False
        # Several vehicles may send to one port; each leaves alone what is addressed to another.
        self._peers: dict[tuple[str, int], None] = {}

    async def open(self) -> None:
        """Bind or connect the socket."""
        loop = asyncio.get_running_loop()
        try:
            found = await loop.getaddrinfo(*self._address, type=socket.SOCK_DGRAM)
            family, kind, protocol, _, address = found[0]
            opened = self._socket = socket.socket(family, kind, protocol)
            opened.setblocking(False)
            if self._listens:
                opened.bind(address)
            else:
                opened.connect(address)
        except OSError as error:
            self.close()
            raise _cannot("udp", self._address, error) from None
        loop.add_reader(opened, self._receive, opened)

    def _receive(self, opened: socket.socket) -> None:
        """A packet from a vehicle."""
        try:
            data, peer = opened.recvfrom(LARGEST)
        except OSError:
            # Nobody listens there yet; the heartbeat says when somebody does.
            self._unreachable = True
            return
        self._unreachable = False
        if self._listens:
            # The newest is last; the one that was silent longest is forgotten.
            self._peers.pop(peer, None)
            self._peers[peer] = None
            if len(self._peers) > PEERS:
                del self._peers[next(iter(self._peers))]
        self._on_data(data)

    def send(self, data: bytes) -> None:
        """To the peers, if there are any."""
        if self._socket is None:
            return
        if not self._listens:
            with suppress(OSError):
                self._socket.send(data)
        for peer in tuple(self._peers):
            with suppress(OSError):
                self._socket.sendto(data, peer)

    def why_silent(self) -> str:
        """Simulators do not listen on UDP as radios and routers do: which endpoint is meant instead."""
        place = f"{self._address[0]}:{self._address[1]}"
        if self._listens:
            return (
                f"nothing comes to udpin:{place}; does the vehicle, the simulator or the router send there?"
            )
        nobody = "nobody listens at" if self._unreachable else "nothing comes back from"
        return (
            f"{nobody} udp:{place}; a simulator is met otherwise: ArduPilot's at tcp:127.0.0.1:5760, "
            "and PX4's sends to udpin:127.0.0.1:14550 and 14540"
        )

    def close(self) -> None:
        """Close the socket."""
        if self._socket is not None:
            asyncio.get_running_loop().remove_reader(self._socket)
            self._socket.close()
            self._socket = None


class TcpLink(asyncio.Protocol):
    """A connection that comes back."""

    def __init__(self, host: str, port: int, on_data: OnData) -> None:
        self._address, self._on_data = (host, port), on_data
        self._transport: asyncio.WriteTransport | None = None
        self._task: asyncio.Task[None] | None = None
        self._closed = False

    async def open(self) -> None:
        """Connect, now."""
        try:
            await self._connect()
        except OSError as error:
            raise _cannot("tcp", self._address, error) from None

    async def _connect(self) -> None:
        transport, _ = await asyncio.get_running_loop().create_connection(lambda: self, *self._address)
        self._transport = transport

    def data_received(self, data: bytes) -> None:
        """Bytes of the stream."""
        self._on_data(data)

    def connection_lost(self, exc: Exception | None) -> None:
        """Try again until it works or we are closed."""
        self._transport = None
        if not self._closed:
            self._task = asyncio.get_running_loop().create_task(self._reconnect())

    async def _reconnect(self) -> None:
        while self._transport is None:
            await asyncio.sleep(AGAIN)
            try:
                await self._connect()
            except OSError:
                continue

    def send(self, data: bytes) -> None:
        """Into the stream, if there is one."""
        if self._transport is not None:
            self._transport.write(data)

    def why_silent(self) -> str:
        """Connected, or not any more."""
        place = f"tcp:{self._address[0]}:{self._address[1]}"
        if self._transport is None:
            return f"{place} hung up"
        return (
            f"{place} is connected and says nothing; a simulator serves one client at a time: has it another?"
        )

    def close(self) -> None:
        """Hang up."""
        self._closed = True
        if self._task is not None:
            self._task.cancel()
        if self._transport is not None:
            self._transport.close()


def _cannot(kind: str, address: tuple[str, int], error: Exception) -> DeviceError:
    reason = getattr(error, "strerror", None) or str(error)
    return DeviceError("endpoint", f"cannot open {kind}:{address[0]}:{address[1]}: {reason}")
