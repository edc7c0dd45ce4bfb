"""One owner for each endpoint of this computer, whatever it leads to.

A serial port or a bound UDP port has one owner by itself; a vehicle that is sent to, a connection or a
socketcand server has not, and would obey two guards in turn. A lock is an abstract Unix socket with the
endpoint's name: it is there for all users of the computer, leaves no file behind, ends with its process
however that ends, and tells who holds it.
"""

from __future__ import annotations

import asyncio
import hashlib
import os
import re
import socket
import struct
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple, Protocol

from lfield.errors import DeviceError

#: Seconds that a guard has to end whose host was killed, and how often to look, before it is told of.
PATIENCE, AGAIN = 5.0, 0.1

_PEER = struct.Struct("3i")  # pid, user, group
_PORT = re.compile(r"(?P<host>.+):(?P<port>[0-9]+)(?P<channel>/.*)?")


class Place(NamedTuple):
    """What an endpoint leads to: a device file, or something at a host's port, or by its name alone."""

    kind: str
    name: str
    port: int = 0
    channel: str = ""


def places(endpoint: str) -> list[Place]:
    """What the links of an endpoint lead to: without baud rates and options, which make no other of it.

    A bus inside one process (`virtual:`) leads nowhere.
    """
    found = []
    for part in endpoint.split(","):
        kind, _, rest = part.strip().partition("?")[0].partition(":")
        if not rest or kind == "virtual":
            continue
        if rest.startswith("/"):
            found.append(Place("device", re.sub("[:@][0-9]+$", "", rest)))
        elif at := _PORT.fullmatch(rest):
            found.append(Place(kind, at["host"].strip("[]"), int(at["port"]), at["channel"] or ""))
        else:
            found.append(Place(kind, rest))
    return found


class Lock(Protocol):
    """What keeps an endpoint for one guard."""

    async def take(self, endpoint: str) -> None:
        """Own all that an endpoint leads to. Raises DeviceError with the process that owns it already."""

    def release(self) -> None:
        """Give everything back."""


class EndpointLock:
    """The locks of one guard."""

    def __init__(self) -> None:
        self._held: list[socket.socket] = []

    async def take(self, endpoint: str) -> None:
        """Own all that an endpoint leads to. Raises DeviceError with the process that owns it already."""
        for place in places(endpoint):
            name = await _name(place)
            try:
                async with asyncio.timeout(PATIENCE):
                    while not self._claim(name):
                        await asyncio.sleep(AGAIN)
            except TimeoutError:
                raise DeviceError(
                    "endpoint",
                    f"{endpoint} is in use by {_holder(name)}; end what runs there, or correct the endpoint",
                ) from None

    def release(self) -> None:
        """Give everything back."""
        for lock in self._held:
            asyncio.get_running_loop().remove_reader(lock)
            lock.close()
        self._held.clear()

    def _claim(self, name: str) -> bool:
        lock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM | socket.SOCK_NONBLOCK)
        try:
            lock.bind(name)
        except OSError:
            lock.close()
            return False
        lock.listen()
        asyncio.get_running_loop().add_reader(lock, _answer, lock)
        self._held.append(lock)
        return True


async def _name(place: Place) -> str:
    """The name of a place's lock: the same for every way to write it."""
    name = place.name
    if place.kind == "device":
        name = os.path.realpath(name)
    elif place.port:
        with suppress(OSError, UnicodeError):
            name = str((await asyncio.get_running_loop().getaddrinfo(name, place.port))[0][4][0])
    told = repr(place._replace(name=name))
    return f"\0lfield/{hashlib.sha256(told.encode()).hexdigest()[:32]}"


def _answer(lock: socket.socket) -> None:
    """Somebody has looked who holds it."""
    with suppress(OSError):
        lock.accept()[0].close()


def _holder(name: str) -> str:
    """Who holds a lock, in words."""
    try:
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM | socket.SOCK_NONBLOCK) as asking:
            asking.connect(name)
            pid, _, _ = _PEER.unpack(asking.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _PEER.size))
        (parent,) = re.findall(r"PPid:\s+([0-9]+)", Path(f"/proc/{pid}/status").read_text())
    except (OSError, ValueError):
        return "another process"
    return f"process {pid}, which process {parent} has started"
