"""The desk of an operator: the services of the robots of an inventory, and requests to all of them."""

from __future__ import annotations

import asyncio
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from lfield.errors import HandshakeError, KeysError, LfieldError, UsageError
from lfield.text.suggestions import did_you_mean, listed

if TYPE_CHECKING:
    from lfield.authority.key_material import Keys
    from lfield.inventory.inventory import Inventory
    from lfield.operator.fleet.service_link import ServiceLinks
    from lfield.operator.observer_link import PresentedCrl
    from lfield.wire.service_messages import ServiceMessage, ServiceStatus

A = TypeVar("A", bound="ServiceMessage")
S = TypeVar("S")

#: Seconds for an answer of a service.
TIMEOUT = 8.0


@dataclass(frozen=True, slots=True)
class FleetDesk:
    """The inventory of a desk, and the keys of its user. `is_assistant`: an AI assistant acts for them."""

    inventory: Inventory
    keys: Keys
    crl: PresentedCrl | None
    is_assistant: bool = False

    @property
    def hosts(self) -> list[str]:
        """All hosts, in the order of the inventory."""
        return list(self.inventory.hosts)

    def addresses(self, hosts: Sequence[str]) -> dict[str, str]:
        """The addresses of the services of some hosts. Raises UsageError for an unknown host."""
        require_hosts(self.inventory, hosts)
        return {host: self.inventory.hosts[host].service_address for host in hosts}

    @property
    def user(self) -> str:
        """The owner of the keys."""
        from lfield.authority.certificate_reader import verify_keys

        return str(verify_keys(self.keys))

    def links(self, hosts: Sequence[str]) -> ServiceLinks:
        """Links to the services of some hosts, in the running loop. Raises UsageError for an unknown host."""
        from lfield.operator.client import observer_transport
        from lfield.operator.fleet.service_link import ServiceLinks

        transport = observer_transport(self.keys, connect_timeout=TIMEOUT)
        return ServiceLinks(transport, self.addresses(hosts), self.crl)

    def statuses(self, hosts: Sequence[str]) -> dict[str, ServiceStatus | LfieldError]:
        """The state of the services of some hosts."""
        from lfield.wire.service_messages import ServiceQuery, ServiceStatus

        return self.ask(hosts, ServiceQuery(), ServiceStatus, TIMEOUT)

    def command(
        self, hosts: Sequence[str], message: ServiceMessage, kind: type[A], timeout: float
    ) -> dict[str, A | LfieldError]:
        """Like `ask`; a service that does not listen may be restarting, and its request is repeated."""
        from lfield.operator.fleet.service_link import RESTART_TIME

        return self.ask(hosts, message, kind, timeout, restart=RESTART_TIME)

    def ask(
        self,
        hosts: Sequence[str],
        message: ServiceMessage,
        kind: type[A],
        timeout: float,
        *,
        restart: float = 0.0,
    ) -> dict[str, A | LfieldError]:
        """Like `request`, in an event loop of its own."""
        return asyncio.run(self.request(hosts, message, kind, timeout, restart=restart))

    async def request(
        self,
        hosts: Sequence[str],
        message: ServiceMessage,
        kind: type[A],
        timeout: float,
        *,
        restart: float = 0.0,
    ) -> dict[str, A | LfieldError]:
        """The answers of the services of some hosts, or their errors."""
        links = self.links(hosts)
        try:
            return await ask_all_services(links, message, kind, timeout, restart=restart)
        finally:
            links.close()

    async def current_statuses(self, hosts: Sequence[str]) -> dict[str, ServiceStatus | LfieldError]:
        """Like `statuses`, in the running loop."""
        from lfield.wire.service_messages import ServiceQuery, ServiceStatus

        return await self.request(hosts, ServiceQuery(), ServiceStatus, TIMEOUT)

    async def order(
        self, hosts: Sequence[str], message: ServiceMessage, kind: type[A], timeout: float
    ) -> dict[str, A | LfieldError]:
        """Like `command`, in the running loop."""
        from lfield.operator.fleet.service_link import RESTART_TIME

        return await self.request(hosts, message, kind, timeout, restart=RESTART_TIME)


async def ask_all_services(
    links: ServiceLinks,
    message: ServiceMessage,
    kind: type[A],
    timeout: float,
    hosts: Sequence[str] | None = None,
    *,
    restart: float = 0.0,
) -> dict[str, A | LfieldError]:
    """The answers of the services of some hosts, by default of all, or their errors.

    The request to a service that does not listen is repeated for `restart` seconds.
    """
    queried_hosts = list(links.addresses if hosts is None else hosts)

    async def ask_host(host: str) -> A | LfieldError:
        try:
            return await links.ask(host, message, kind, timeout, timeout, restart=restart)
        except LfieldError as error:
            return error

    return dict(zip(queried_hosts, await asyncio.gather(*map(ask_host, queried_hosts)), strict=True))


def require_hosts(inventory: Inventory, hosts: Sequence[str]) -> None:
    """Check that the inventory has some hosts. Raises UsageError."""
    known = list(inventory.hosts)
    for host in hosts:
        if host not in known:
            hint = did_you_mean(host, known) or f"it has {listed(known)}"
            raise UsageError(f"the inventory {inventory.path} has no host '{host}': {hint}")


def is_refusal(error: LfieldError) -> bool:
    """Whether the host was reached, and has refused the peer or its request."""
    return isinstance(error, HandshakeError) and not error.answered_by


def split_answers(answers: Mapping[str, S | LfieldError]) -> tuple[dict[str, S], dict[str, LfieldError]]:
    """The answers, and the errors of the hosts that did not answer."""
    reached = {host: answer for host, answer in answers.items() if not isinstance(answer, LfieldError)}
    failed = {host: answer for host, answer in answers.items() if isinstance(answer, LfieldError)}
    return reached, failed


def find_required_inventory(path: Path | None) -> Inventory:
    """The inventory at a path, or the default one.

    Raises UsageError without one, ProgramError, InputFileError.
    """
    from lfield.inventory.location import find_inventory

    inventory = find_inventory(path, os.environ)
    if inventory is None:
        raise UsageError(
            "no inventory: write the hosts and their addresses into ~/.config/lfield/inventory.yaml, or name "
            "the file with --inventory (lfield/docs/operations.md has an example)"
        )
    return inventory


def find_person_keys(path: Path | None) -> Keys | None:
    """The keys of the user in a folder, or in the default one; None without any. Raises KeysError."""
    from lfield.authority import keystore

    folder = keystore.find_keys("person", keystore.OWN, path, os.environ)
    return None if folder is None else keystore.read_keys(folder, "person")


def open_service_desk(
    inventory: Path | None, folder: Path | None, *, is_assistant: bool = False
) -> FleetDesk:
    """The desk of an inventory and a folder of keys, or of the default ones.

    Raises UsageError without an inventory, KeysError without keys.
    """
    from lfield.operator.client import presented_crl

    found = find_required_inventory(inventory)
    keys = find_person_keys(folder)
    if keys is None:
        raise KeysError(
            "no keys of yours on this computer: create them with 'lfield keys init --person NAME', or name "
            "their directory with --keys"
        )
    return FleetDesk(found, keys, presented_crl(keys), is_assistant)
