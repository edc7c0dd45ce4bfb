"""Checks which addresses of an inventory answer, and which host answers there."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable
from typing import TYPE_CHECKING, Literal

from msgspec import Struct

from lfield.address_race import first_connected
from lfield.errors import AddressError, HandshakeError, LfieldError, NoListener
from lfield.net.connections.resolver import ResolvedAddress, resolve
from lfield.net.connections.socket_errors import describe
from lfield.net.transport import is_zenoh, join_address, split_address
from lfield.operator.fleet.service_link import open_service_link

if TYPE_CHECKING:
    from lfield.inventory.inventory import InventoryHost
    from lfield.net.transport import Transport
    from lfield.operator.observer_link import PresentedCrl

#: Seconds for one address, and the maximum number of addresses that are checked at the same time.
TIMEOUT, MAX_AT_ONCE = 5.0, 64
#: Port of ssh without `ssh_port`.
SSH_PORT = 22

#: The program that listens at an address: the service, the mission's host, or the ssh server.
Purpose = Literal["service", "mission", "ssh"]
#: "refused": a program listens, and is no host of this team or does not accept the keys.
Outcome = Literal["answers", "other-host", "refused", "closed", "unreachable"]


class Endpoint(Struct, frozen=True):
    """An address of a host, for one purpose."""

    host: str
    purpose: Purpose
    address: str


class EndpointState(Struct, frozen=True):
    """The result of the check of an address; `name` is the host in the certificate, '' without one."""

    outcome: Outcome
    name: str = ""
    error: LfieldError | None = None


def endpoints_of(host: InventoryHost) -> list[Endpoint]:
    """All addresses of a host."""
    ssh = [join_address(name, host.ssh_port or SSH_PORT) for name in host.ssh_hosts]
    stated: tuple[tuple[Purpose, Iterable[str]], ...] = (
        ("service", host.service_addresses),
        ("mission", host.addresses),
        ("ssh", ssh),
    )
    return [Endpoint(host.name, purpose, address) for purpose, found in stated for address in found]


def is_reached(states: Iterable[EndpointState]) -> bool:
    """Whether a host answers at one of its addresses, and no other host at any."""
    outcomes = {state.outcome for state in states}
    return "answers" in outcomes and "other-host" not in outcomes


async def check_endpoints(
    endpoints: Iterable[Endpoint], transport: Transport | None, crl: PresentedCrl | None
) -> dict[Endpoint, EndpointState]:
    """The state of each address. Without a `transport` (no keys), only whether a connection is accepted."""
    slots = asyncio.Semaphore(MAX_AT_ONCE)

    async def check_one(endpoint: Endpoint) -> EndpointState:
        async with slots:
            try:
                if transport is None or endpoint.purpose == "ssh":
                    return await _connect(endpoint)
                return await _authenticate(endpoint, transport, crl)
            except NoListener as error:
                return EndpointState("closed", error=error)
            except AddressError as error:
                return EndpointState("unreachable", error=error)
            except LfieldError as error:
                return EndpointState("refused", error=error)

    checked = list(endpoints)
    return dict(zip(checked, await asyncio.gather(*map(check_one, checked)), strict=True))


async def _authenticate(endpoint: Endpoint, transport: Transport, crl: PresentedCrl | None) -> EndpointState:
    """Exchange the handshake, which compares the certificate of the host. Raises LfieldError."""
    try:
        link = await open_service_link(transport, endpoint.address, endpoint.host, crl)
    except HandshakeError as error:
        if not error.answered_by:
            raise
        return EndpointState("other-host", error.answered_by)
    link.close()
    return EndpointState("answers", endpoint.host)


async def _connect(endpoint: Endpoint) -> EndpointState:
    """Connect by TCP alone. Raises AddressError."""
    if is_zenoh(endpoint.address):
        raise AddressError(endpoint.address, "an address in Zenoh is checked with keys only")
    failures: dict[ResolvedAddress, Exception] = {}
    try:
        async with asyncio.timeout(TIMEOUT):
            found = await resolve(*split_address(endpoint.address))
            link, _ = await first_connected(found, failures)
    except TimeoutError:
        raise AddressError(endpoint.address, f"no answer within {TIMEOUT:g} s") from None
    except ConnectionRefusedError:
        raise NoListener(endpoint.address) from None
    except (OSError, UnicodeError) as error:
        raise AddressError(endpoint.address, describe(error)) from None
    link.close()
    return EndpointState("answers")
