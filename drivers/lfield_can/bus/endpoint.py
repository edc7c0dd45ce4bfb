"""Endpoints of CAN buses: `INTERFACE:CHANNEL[?key=value&...]` for every interface of python-can.

socketcan:can0                               an interface of the kernel
slcan:/dev/ttyACM0@115200?bitrate=500000     a serial adapter; the number after @ is the baud rate of the tty
socketcand:127.0.0.1:29536/can0              a socketcand server
virtual:name                                 buses inside one process, for tests
pcan:PCAN_USBBUS1?bitrate=500000             any other: the keys are the parameters of its class in python-can
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from urllib.parse import parse_qsl

from msgspec import Struct, field

from lfield.driver import DeviceError
from lfield.driver.recording.wire_formats import channel_name

SYNTAX = (
    "INTERFACE:CHANNEL[?key=value&...], as in socketcan:can0, slcan:/dev/ttyACM0@115200?bitrate=500000 "
    "or socketcand:127.0.0.1:29536/can0"
)

Value = bool | int | float | str

_SOCKETCAND = re.compile(
    r"(?P<host>[^/:]+|\[[0-9a-fA-F:.]+(?:%[^\]/]+)?\]):(?P<port>[0-9]{1,5})/(?P<channel>[A-Za-z0-9_.-]+)"
)
_SLCAN = re.compile(r"(?P<tty>/[^@?]+)(@(?P<baud>[0-9]{2,8}))?")


class Endpoint(Struct, frozen=True):
    """A parsed endpoint.

    `arguments` are the keyword arguments of `can.Bus`; `tty` is the serial port to be locked, and `server`
    the host and port of a socketcand server, which needs no python-can.
    """

    text: str
    arguments: Mapping[str, Value]
    tty: str = ""
    server: tuple[str, int] | None = field(default=None)

    @property
    def channel(self) -> str:
        """The name of the bus in a log."""
        return channel_name(str(self.arguments.get("channel", "")))


def parse_endpoint(text: str) -> Endpoint:
    """Parses an endpoint. Raises DeviceError with the syntax."""
    interface, colon, rest = text.partition(":")
    channel, _, query = rest.partition("?")
    if not colon or not channel:
        raise _syntax_error(text, f"write {SYNTAX}")
    if interface not in _KNOWN and interface not in (interfaces := _interfaces()):
        names = ", ".join(sorted({*_KNOWN, *interfaces}))
        raise _syntax_error(text, f"python-can has no interface '{interface}'; it has {names}")
    try:
        pairs = parse_qsl(query, strict_parsing=bool(query), keep_blank_values=True)
    except ValueError:
        raise _syntax_error(text, f"write {SYNTAX}") from None
    options = {key: _value(value) for key, value in pairs}
    return _READERS.get(interface, _any)(text, interface, channel, options)


def _interfaces() -> frozenset[str]:
    """The interfaces of python-can, which is slow to import: only needed for unusual ones."""
    import can

    return frozenset(can.VALID_INTERFACES)


def _any(text: str, interface: str, channel: str, options: dict[str, Value]) -> Endpoint:
    return Endpoint(text, {"interface": interface, "channel": channel, **options})


def _socketcan(text: str, interface: str, channel: str, options: dict[str, Value]) -> Endpoint:
    # A socket for CAN FD also sends and receives classic frames, on any interface.
    return Endpoint(text, {"interface": interface, "channel": channel, "fd": True, **options})


def _slcan(text: str, interface: str, channel: str, options: dict[str, Value]) -> Endpoint:
    match = _SLCAN.fullmatch(channel)
    if match is None:
        raise _syntax_error(text, "write slcan:/dev/ttyACM0@115200?bitrate=500000")
    # By default the interface sleeps two seconds, for boards that restart when opened.
    arguments: dict[str, Value] = {"interface": interface, "channel": match["tty"], "sleep_after_open": 0.0}
    if match["baud"]:
        arguments["tty_baudrate"] = int(match["baud"])
    return Endpoint(text, {**arguments, **options}, tty=match["tty"])


def _socketcand(text: str, interface: str, channel: str, options: dict[str, Value]) -> Endpoint:
    match = _SOCKETCAND.fullmatch(channel)
    if match is None or not 0 < int(match["port"]) < 65536:
        raise _syntax_error(text, "write socketcand:HOST:PORT/CHANNEL, as in socketcand:127.0.0.1:29536/can0")
    if options:
        raise _syntax_error(text, "socketcand takes no parameters; its server sets the bit rate")
    server = (match["host"].strip("[]"), int(match["port"]))
    return Endpoint(text, {"interface": interface, "channel": match["channel"]}, server=server)


_READERS: Mapping[str, Callable[[str, str, str, dict[str, Value]], Endpoint]] = {
    "slcan": _slcan,
    "socketcan": _socketcan,
    "socketcand": _socketcand,
}
_KNOWN = frozenset({"virtual", *_READERS})


def _value(text: str) -> Value:
    """Converts a value: `500000` to a number, `true` to a boolean, others are text."""
    if text in ("true", "false"):
        return text == "true"
    for convert in (int, float):
        try:
            return convert(text)
        except ValueError:
            continue
    return text


def _syntax_error(text: str, reason: str) -> DeviceError:
    return DeviceError("endpoint", f"'{text}' is not a CAN bus: {reason}")
