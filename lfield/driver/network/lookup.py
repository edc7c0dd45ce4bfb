"""The addresses of a host: literals as they are, names resolved anew each time they are asked for."""

from __future__ import annotations

import asyncio
import ipaddress
import socket
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar

from lfield.connecting import first_connected
from lfield.loop import Simulated

#: An address as sockets have it: host and port, and with IPv6 a flow and a scope.
Address = tuple[Any, ...]

P = TypeVar("P", bound=asyncio.BaseProtocol)

#: Seconds of silence after which the kernel probes the other end, between two probes, and how many of them;
#: and milliseconds for which sent bytes may stay unacknowledged.
_IDLE, _INTERVAL, _COUNT, _UNACKNOWLEDGED = 2, 1, 3, 5000


def unbracketed(host: str) -> str:
    """`::1` of `[::1]`."""
    return host[1:-1] if host.startswith("[") and host.endswith("]") else host


class Lookup:
    """One host's addresses. One question at a time: a resolver that hangs takes no second thread."""

    def __init__(self, host: str, port: int, kind: socket.SocketKind) -> None:
        self.host, self.port, self._kind = unbracketed(host), port, kind
        self._asking: asyncio.Future[Any] | None = None

    @property
    def is_literal(self) -> bool:
        """Whether it is an address already."""
        try:
            ipaddress.ip_address(self.host.partition("%")[0])
        except ValueError:
            return False
        return True

    async def addresses(self, within: float) -> list[tuple[int, Address]]:
        """Families and addresses, the preferred first. Raises OSError, a TimeoutError after `within` s."""
        loop = asyncio.get_running_loop()
        if isinstance(loop, Simulated):
            return [(socket.AF_INET, (self.host, self.port))]
        if self._asking is None or self._asking.done():
            self._asking = asyncio.ensure_future(loop.getaddrinfo(self.host, self.port, type=self._kind))
        asking = self._asking
        await asyncio.wait([asking], timeout=within)
        if not asking.done():
            raise TimeoutError(f"its name was not resolved within {within:g} s")
        self._asking = None
        return list(dict.fromkeys((family, tuple(address)) for family, _, _, _, address in asking.result()))


async def connected(lookup: Lookup, within: float, make: Callable[[], P]) -> tuple[P, str]:
    """A TCP connection to the first address that answers, and that address. `make` makes the protocol.

    The next address is tried STAGGER s after the last. The name may take `within` seconds, and all of its
    addresses together as long again. The kernel ends a connection whose path is dead within 5 s. Raises
    OSError.
    """
    loop = asyncio.get_running_loop()
    if isinstance(loop, Simulated):
        async with asyncio.timeout(within):
            _, protocol = await loop.create_connection(make, lookup.host, lookup.port)
        return protocol, lookup.host
    found = await lookup.addresses(within)
    failures: dict[tuple[int, Address], Exception] = {}
    try:
        async with asyncio.timeout(within):
            made, (_, address) = await first_connected(found, failures)
    except TimeoutError:
        raise TimeoutError(_why(found, failures, f"no answer within {within:g} s")) from None
    except OSError:
        raise OSError(_why(found, failures, "")) from None
    _keep_alive(made)
    _, protocol = await loop.create_connection(make, sock=made)
    return protocol, _numeric(address)


def _why(found: Sequence[tuple[int, Address]], failures: Mapping[Any, Exception], silent: str) -> str:
    """What came of each address."""
    reasons = {at: getattr(error, "strerror", None) or str(error) for at, error in failures.items()}
    return "; ".join(f"{_numeric(at[1])}: {reasons.get(at, silent)}" for at in found)


def _numeric(address: Address) -> str:
    """`fe80::1%eth0`: an address with its zone."""
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
