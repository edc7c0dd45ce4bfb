"""Exclusive ownership of an endpoint on this computer.

A serial port or a bound UDP port is exclusive by itself. A vehicle reached by outgoing UDP, a TCP connection
or a socketcand server is not exclusive, and two guards could command it. A lock is an abstract Unix socket
named after the endpoint: it is visible to all users, needs no file, is released when its process ends, and
identifies its owner.
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

#: Seconds to wait for the guard of a killed host to end; seconds between two attempts.
LOCK_TIMEOUT, RETRY_AFTER = 5.0, 0.1

_PEER = struct.Struct("3i")  # pid, user, group
_PORT = re.compile(r"(?P<host>.+):(?P<port>[0-9]+)(?P<channel>/.*)?")


class EndpointTarget(NamedTuple):
    """The target of an endpoint: a device file, a host and port, or only a name."""

    kind: str
    name: str
    port: int = 0
    channel: str = ""


def endpoint_targets(endpoint: str) -> list[EndpointTarget]:
    """The targets of an endpoint's links, without baud rates and options, which do not distinguish targets.

    A bus inside one process (`virtual:`) has none.
    """
    targets = []
    for part in endpoint.split(","):
        kind, _, target = part.strip().partition("?")[0].partition(":")
        if not target or kind == "virtual":
            continue
        if target.startswith("/"):
            targets.append(EndpointTarget("device", re.sub("[:@][0-9]+$", "", target)))
        elif at := _PORT.fullmatch(target):
            targets.append(EndpointTarget(kind, at["host"].strip("[]"), int(at["port"]), at["channel"] or ""))
        else:
            targets.append(EndpointTarget(kind, target))
    return targets


class EndpointGuard(Protocol):
    """Reserves an endpoint for one guard."""

    async def acquire(self, endpoint: str) -> None:
        """Locks all targets of an endpoint. Raises DeviceError with the process that owns it."""

    def release(self) -> None:
        """Releases all locks."""


class EndpointLock:
    """The locks of one guard."""

    def __init__(self) -> None:
        self._held: list[socket.socket] = []

    async def acquire(self, endpoint: str) -> None:
        """Locks all targets of an endpoint. Raises DeviceError with the process that owns it."""
        for place in endpoint_targets(endpoint):
            name = await _lock_name(place)
            try:
                async with asyncio.timeout(LOCK_TIMEOUT):
                    while not self._claim(name):
                        await asyncio.sleep(RETRY_AFTER)
            except TimeoutError:
                raise DeviceError(
                    "endpoint",
                    f"{endpoint} is in use by {_holder(name)}; end that process, or correct the endpoint",
                ) from None

    def release(self) -> None:
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
        asyncio.get_running_loop().add_reader(lock, _answer_holder_query, lock)
        self._held.append(lock)
        return True


async def _lock_name(place: EndpointTarget) -> str:
    """The name of a target's lock, independent of how the target is written."""
    name = place.name
    if place.kind == "device":
        name = os.path.realpath(name)
    elif place.port:
        with suppress(OSError, UnicodeError):
            name = str((await asyncio.get_running_loop().getaddrinfo(name, place.port))[0][4][0])
    text = repr(place._replace(name=name))
    return f"\0lfield/{hashlib.sha256(text.encode()).hexdigest()[:32]}"


def _answer_holder_query(lock: socket.socket) -> None:
    """Answers another process that has queried the owner."""
    with suppress(OSError):
        lock.accept()[0].close()


def _holder(name: str) -> str:
    """The owner of a lock, in words."""
    try:
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM | socket.SOCK_NONBLOCK) as asking:
            asking.connect(name)
            pid, _, _ = _PEER.unpack(asking.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _PEER.size))
        (parent,) = re.findall(r"PPid:\s+([0-9]+)", Path(f"/proc/{pid}/status").read_text())
    except (OSError, ValueError):
        return "another process"
    return f"process {pid}, started by process {parent}"
