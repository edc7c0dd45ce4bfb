"""Checks which addresses of hosts answer, and that the answering host is the right one."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

from lfield.address_race import first_connected
from lfield.errors import AddressError, LfieldError, NoListener
from lfield.net.connections.resolver import ResolvedAddress, resolve
from lfield.net.connections.socket_errors import describe
from lfield.net.transport import Link, Transport, split_address
from lfield.operator.observer_link import ObserverLink
from lfield.wire.messages import Message

#: "answers" is the right host, "unverified" one that was not authenticated since there are no keys.
PortState = Literal["answers", "unverified", "other-host", "rejected", "no-listener", "unreachable"]
#: States of a port at which the host can be used.
USABLE: tuple[PortState, ...] = ("answers", "unverified")


@dataclass(frozen=True, slots=True)
class PortCheck:
    """What answers at an address; `text` is the reason if it is not the host."""

    address: str
    state: PortState
    text: str = ""

    @property
    def is_usable(self) -> bool:
        """Whether the host can be reached there."""
        return self.state in USABLE


@dataclass(frozen=True, slots=True)
class HostCheck:
    """The ports of a host: those of the mission's host, of the service and of ssh."""

    mission: tuple[PortCheck, ...]
    service: tuple[PortCheck, ...]
    ssh: tuple[PortCheck, ...]

    @property
    def answers(self) -> bool:
        """Whether at least one port answers."""
        return any(port.is_usable for port in (*self.mission, *self.service, *self.ssh))


async def check_tls(transport: Transport, addresses: Iterable[str], host: str) -> tuple[PortCheck, ...]:
    """The state of ports at which a host authenticates itself by its certificate."""
    return tuple(await asyncio.gather(*(_check_certificate(transport, each, host) for each in addresses)))


async def _check_certificate(transport: Transport, address: str, host: str) -> PortCheck:
    try:
        link = await transport.connect(address, _ProbeLink())
    except NoListener as error:
        return PortCheck(address, "no-listener", error.reason)
    except AddressError as error:
        return PortCheck(address, "unreachable", error.reason)
    except LfieldError as error:
        return PortCheck(address, "rejected", str(error))
    who = link.who
    link.close()
    if who.kind == "stranger":
        return PortCheck(address, "unverified")
    if (who.kind, who.name) != ("host", host):
        return PortCheck(address, "other-host", f"is {who}, not {host}")
    return PortCheck(address, "answers")


async def check_tcp(addresses: Iterable[str], timeout: float) -> tuple[PortCheck, ...]:
    """The state of ports that accept connections; `timeout` in seconds."""
    return tuple(await asyncio.gather(*(_check_connection(each, timeout) for each in addresses)))


async def _check_connection(address: str, timeout: float) -> PortCheck:
    failures: dict[ResolvedAddress, Exception] = {}
    try:
        async with asyncio.timeout(timeout):
            made, _ = await first_connected(await resolve(*split_address(address)), failures)
    except TimeoutError:
        return PortCheck(address, "unreachable", f"no answer within {timeout:g} s")
    except ConnectionRefusedError as error:
        return PortCheck(address, "no-listener", describe(error))
    except (OSError, UnicodeError) as error:
        return PortCheck(address, "unreachable", describe(error))
    made.close()
    return PortCheck(address, "answers")


class _ProbeLink(ObserverLink):
    """The handler of a link that is closed after the authentication."""

    def on_message(self, link: Link, message: Message) -> None:
        """Nothing is asked."""

    def on_closed(self, link: Link, error: LfieldError | None) -> None:
        """Closed by this side, or by the host."""
