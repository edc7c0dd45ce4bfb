"""Endpoints and the links behind them: UDP, TCP and serial. Bytes only.

udp:HOST:PORT         sends to a vehicle that listens there
udpin:HOST:PORT       listens for vehicles that send (packets are sent to all recent senders)
tcp:HOST:PORT         connects
serial:/dev/ttyX:BAUD a serial port, 8N1

HOST is a name or an address, an IPv6 address in brackets: tcp:[fd00::5]:5760. A link that breaks or falls
silent is reopened automatically, and its name is resolved again. Several links, separated by commas, lead to
the same vehicles. `payload=udp:HOST:PORT` leads to their cameras and gimbals only.

MAVSDK's udp://:PORT, udpin://HOST:PORT, udpout://HOST:PORT, tcp://HOST:PORT and serial:///dev/ttyX:BAUD
are accepted too.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Protocol

from lfield.driver import DeviceError
from lfield.driver.network import is_host, unbracketed
from lfield.driver.serial import SerialPort, parse_serial_endpoint
from lfield_mavlink import log_messages
from lfield_mavlink.link.link_events import RETRY_INTERVAL, LinkEvents, OnData
from lfield_mavlink.link.tcp import TcpLink
from lfield_mavlink.link.udp import UdpLink, UdpListener

__all__ = [
    "RETRY_INTERVAL",
    "Link",
    "LinkEvents",
    "LinkUses",
    "OnData",
    "make_link",
    "parse_endpoint",
    "split_endpoint",
]

#: Prefix of a link to cameras and gimbals.
PAYLOAD = "payload="
SYNTAX = "udp:HOST:PORT, udpin:HOST:PORT, tcp:HOST:PORT or serial:/dev/ttyX:BAUD"


class Link(Protocol):
    """One open endpoint."""

    async def open(self) -> None:
        """Opens the endpoint. Raises DeviceError when that is impossible now."""

    def send(self, data: bytes) -> None:
        """Sends one packet; it is dropped if it cannot be sent."""

    def send_to(self, data: bytes, address: str) -> None:
        """Sends one packet to an address from which data was received."""

    def silence_reason(self) -> str:
        """The text to report when no data was received: known facts and a remedy."""

    def close(self) -> None:
        """Closes the endpoint."""


def split_endpoint(endpoint: str) -> list[str]:
    """The links of an endpoint: `udp:127.0.0.1:14550, serial:/dev/ttyUSB0:57600`; each once."""
    return list(dict.fromkeys(part.removeprefix(PAYLOAD) for part in _parts(endpoint)))


class LinkUses(NamedTuple):
    """The numbers of the links to vehicles, and of those to cameras and gimbals; a link may be both."""

    vehicles: Sequence[int]
    payload: Sequence[int]

    @classmethod
    def parse(cls, endpoint: str) -> LinkUses:
        """The link numbers of an endpoint; a link may occur with and without the prefix."""
        parts, links = _parts(endpoint), split_endpoint(endpoint)
        return cls(
            [number for number, link in enumerate(links) if link in parts],
            [number for number, link in enumerate(links) if PAYLOAD + link in parts],
        )


def _parts(endpoint: str) -> list[str]:
    return [part.strip() for part in endpoint.split(",")]


def parse_endpoint(endpoint: str) -> list[tuple[str, str, int]]:
    """The kind, host or path, and port or baud rate of each link.

    Raises DeviceError with the syntax.
    """
    if not LinkUses.parse(endpoint).vehicles:
        raise DeviceError("endpoint", f"'{endpoint}' has no link to the vehicle; write {SYNTAX}")
    return [_parsed(link) for link in split_endpoint(endpoint)]


def _parsed(text: str) -> tuple[str, str, int]:
    link = _from_url(text)
    kind, _, rest = link.partition(":")
    place, _, number = rest.rpartition(":")
    if kind not in ("udp", "udpin", "tcp", "serial") or not place:
        raise DeviceError("endpoint", f"'{text}' is not an endpoint; write {SYNTAX}")
    if kind == "serial":
        return kind, *parse_serial_endpoint(link)
    if not (number.isascii() and number.isdecimal() and 0 < int(number[:6]) < 65536):
        raise DeviceError("endpoint", f"'{text}': the port '{number}' is not a number from 1 to 65535")
    if not is_host(unbracketed(place)):
        raise DeviceError("endpoint", f"'{text}': '{place}' is neither a host name nor an address")
    return kind, unbracketed(place), int(number)


def _from_url(link: str) -> str:
    """The endpoint in lfield's form of one in MAVSDK's; raises DeviceError where that is ambiguous."""
    scheme, separator, rest = link.partition("://")
    if not separator:
        return link
    if scheme == "udp" and rest.startswith(":"):
        return f"udpin:0.0.0.0{rest}"
    if scheme == "udp":
        # The advice must be valid itself.
        _parsed(f"udp:{rest}")
        message = f"'{link}' is ambiguous: write udpin:{rest} to listen there, or udp:{rest} to send there"
        raise DeviceError("endpoint", message)
    kinds = {"udpin": "udpin", "udpout": "udp", "tcp": "tcp", "tcpout": "tcp", "serial": "serial"}
    if scheme in kinds:
        return f"{kinds[scheme]}:{rest}"
    raise DeviceError("endpoint", f"'{link}' is not an endpoint; write {SYNTAX}")


def make_link(link: str, on_data: OnData, events: LinkEvents | None = None) -> Link:
    """Creates one link of an endpoint, not opened yet. Raises DeviceError as `parse_endpoint`."""
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
    """A serial port; a packet is dropped when its buffer is full or the port is gone."""

    def __init__(self, path: str, baud: int, on_data: OnData, events: LinkEvents) -> None:
        self._on_data, self._events = on_data, events
        self.port = SerialPort(path, baud, self, tried=events.note)

    async def open(self) -> None:
        """Opens and configures the port."""
        self.port.open()

    def received(self, data: bytes) -> None:
        """Handles bytes of the port."""
        self._on_data(data)

    def send(self, data: bytes) -> None:
        """Writes to the port."""
        self.port.write(data)

    def send_to(self, data: bytes, address: str) -> None:
        """Writes to the port, which has one peer."""
        self.port.write(data)

    def silence_reason(self) -> str:
        """The text for a silent port: it needs the right baud rate and an autopilot configured for
        MAVLink.
        """
        return (
            f"nothing received from {self.port.path}; check the cable, the baud rate of {self.port.baud}, "
            "and that the autopilot is configured for MAVLink there (SERIALn_PROTOCOL 2, MAV_n_CONFIG)"
        )

    def close(self) -> None:
        """Closes the port."""
        self.port.close()

    def lost(self, reason: str) -> None:
        """Reports that the port is lost; it is reopened when it is back under its path."""
        self._events.note(log_messages.SERIAL_LOST.line(path=self.port.path, reason=reason))

    def back(self) -> None:
        """Reports that the port is open again."""
        self._events.note(log_messages.SERIAL_BACK.line(path=self.port.path))
        self._events.reopened()
