"""Endpoints and the links behind them: UDP, TCP and serial. Bytes only.

udp:HOST:PORT         sends to a vehicle that listens there
udpin:HOST:PORT       listens there for vehicles that send (what is sent goes to all who sent lately)
tcp:HOST:PORT         connects
serial:/dev/ttyX:BAUD a serial port, 8N1

HOST is a name or an address, an IPv6 address in brackets: tcp:[fd00::5]:5760. Each link is opened again by
itself, with the name resolved anew, when it breaks or falls silent. Several of them, with commas between, are
links to the same vehicles.
"""

from __future__ import annotations

from typing import Protocol

from lfield.driver import DeviceError
from lfield.driver.network import unbracketed
from lfield.driver.serial import SerialPort, parse_serial_endpoint
from lfield_mavlink.link.events import AGAIN, LinkEvents, OnData
from lfield_mavlink.link.tcp import TcpLink
from lfield_mavlink.link.udp import UdpLink, UdpListener

__all__ = ["AGAIN", "Link", "LinkEvents", "OnData", "make_link", "parse_endpoint", "split_endpoint"]

SYNTAX = "udp:HOST:PORT, udpin:HOST:PORT, tcp:HOST:PORT or serial:/dev/ttyX:BAUD"


class Link(Protocol):
    """One open endpoint."""

    async def open(self) -> None:
        """Open it. Raises DeviceError when that is impossible here and now."""

    def send(self, data: bytes) -> None:
        """Send one packet; what cannot be sent is lost, as on a radio."""

    def send_to(self, data: bytes, address: str) -> None:
        """Send one packet to one of the addresses that were given with what was received."""

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
    return kind, unbracketed(place), int(number)


def make_link(link: str, on_data: OnData, events: LinkEvents | None = None) -> Link:
    """One link of an endpoint, not open yet. Raises DeviceError as `parse_endpoint`."""
    kind, place, number = _parsed(link)
    events = events or LinkEvents()
    if kind == "serial":
        return SerialLink(place, number, on_data, events)
    if kind == "tcp":
        return TcpLink(place, number, on_data, events)
    if kind == "udp":
        return UdpLink(place, number, on_data, events)
    return UdpListener(place, number, on_data, events)


class SerialLink:
    """A serial port; when its buffer is full, or it is away, a packet is lost, which MAVLink survives."""

    def __init__(self, path: str, baud: int, on_data: OnData, events: LinkEvents) -> None:
        self._on_data, self._events = on_data, events
        self.port = SerialPort(path, baud, self, tried=events.note)

    async def open(self) -> None:
        """Open and configure the port, now."""
        self.port.open()

    def received(self, data: bytes) -> None:
        """Bytes of the port."""
        self._on_data(data)

    def send(self, data: bytes) -> None:
        """Into the port."""
        self.port.write(data)

    def send_to(self, data: bytes, address: str) -> None:
        """Into the port: there is one far end."""
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
        """The port has gone; it is opened again as soon as it is back under its path."""
        self._events.note(f"serial:{self.port.path} is lost: {reason}")

    def back(self) -> None:
        """It is open again."""
        self._events.note(f"serial:{self.port.path} is open again")
        self._events.reopened()
