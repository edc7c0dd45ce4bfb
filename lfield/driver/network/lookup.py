"""Addresses of a host: literals unchanged, names resolved at each call."""

from __future__ import annotations

import asyncio
import ipaddress
import re
import socket
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar

from lfield.address_race import first_connected
from lfield.event_loop import SimulatedLoop

#: A socket address: host and port, and with IPv6 flow and scope.
Address = tuple[Any, ...]

P = TypeVar("P", bound=asyncio.BaseProtocol)

#: TCP keep-alive: seconds of silence before the first probe, seconds between probes, number of probes;
#: milliseconds that sent bytes may stay unacknowledged.
_IDLE, _INTERVAL, _COUNT, _UNACKNOWLEDGED = 2, 1, 3, 5000


_LABEL = re.compile(r"[A-Za-z0-9_]([A-Za-z0-9_-]{0,61}[A-Za-z0-9_])?")


def unbracketed(host: str) -> str:
    """`::1` of `[::1]`."""
    return host[1:-1] if host.startswith("[") and host.endswith("]") else host


def is_host(host: str) -> bool:
    """Whether a text without brackets can be a host name or an address: `192.168.1..5` cannot."""
    if _is_address(host):
        return True
    labels = host.removesuffix(".").split(".")
    is_name = len(host) <= 253 and all(_LABEL.fullmatch(label) for label in labels)
    return is_name and not labels[-1].isdecimal()


def _is_address(host: str) -> bool:
    try:
        ipaddress.ip_address(host.partition("%")[0])
    except ValueError:
        return False
    return True


class Lookup:
    """The addresses of one host. Only one resolution runs at a time, so that a resolver that hangs uses one
    thread.
    """

    def __init__(self, host: str, port: int, kind: socket.SocketKind) -> None:
        self.host, self.port, self._kind = unbracketed(host), port, kind
        self._pending: asyncio.Future[Any] | None = None

    async def addresses(self, within: float) -> list[tuple[int, Address]]:
        """Families and addresses, in order of preference. Raises OSError, and TimeoutError after
        `within` s.
        """
        loop = asyncio.get_running_loop()
        if isinstance(loop, SimulatedLoop):
            return [(socket.AF_INET, (self.host, self.port))]
        if self._pending is None or self._pending.done():
            self._pending = asyncio.ensure_future(loop.getaddrinfo(self.host, self.port, type=self._kind))
        pending = self._pending
        await asyncio.wait([pending], timeout=within)
        if not pending.done():
            raise TimeoutError(f"its name was not resolved within {within:g} s")
        self._pending = None
        return list(dict.fromkeys((family, tuple(address)) for family, _, _, _, address in pending.result()))


async def connected(lookup: Lookup, within: float, make: Callable[[], P]) -> tuple[P, str]:
    """Connects by TCP to the first address that answers; returns the protocol from `make` and that address.

    The next address is tried ATTEMPT_DELAY seconds after the last one (happy eyeballs). Name resolution may
    take `within` seconds, and all connection attempts together also `within` seconds. The kernel ends a
    connection whose path is dead within 5 s. Raises OSError.
    """
    loop = asyncio.get_running_loop()
    if isinstance(loop, SimulatedLoop):
        async with asyncio.timeout(within):
            _, protocol = await loop.create_connection(make, lookup.host, lookup.port)
        return protocol, lookup.host
    found = await lookup.addresses(within)
    failures: dict[tuple[int, Address], Exception] = {}
    try:
        async with asyncio.timeout(within):
            connection, (_, address) = await first_connected(found, failures)
    except TimeoutError:
        raise TimeoutError(_failures(found, failures, f"no answer within {within:g} s")) from None
    except OSError:
        raise OSError(_failures(found, failures, "")) from None
    _keep_alive(connection)
    _, protocol = await loop.create_connection(make, sock=connection)
    return protocol, _numeric(address)


def _failures(found: Sequence[tuple[int, Address]], failures: Mapping[Any, Exception], silent: str) -> str:
    """The result of each address."""
    reasons = {at: getattr(error, "strerror", None) or str(error) for at, error in failures.items()}
    return "; ".join(f"{_numeric(at[1])}: {reasons.get(at, silent)}" for at in found)


def _numeric(address: Address) -> str:
    """An address with its zone, such as `fe80::1%eth0`."""
    return socket.getnameinfo(address, socket.NI_NUMERICHOST | socket.NI_NUMERICSERV)[0]


def _keep_alive(connection: socket.socket) -> None:
    for option, value in (
        (socket.TCP_KEEPIDLE, _IDLE),
        (socket.TCP_KEEPINTVL, _INTERVAL),
        (socket.TCP_KEEPCNT, _COUNT),
        (socket.TCP_USER_TIMEOUT, _UNACKNOWLEDGED),
    ):
        connection.setsockopt(socket.IPPROTO_TCP, option, value)
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
