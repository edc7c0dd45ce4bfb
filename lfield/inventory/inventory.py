"""The hosts of a team with their addresses, as in an inventory file."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Literal, get_args

from msgspec import Struct, field

from lfield.net.transport import is_zenoh, join_address, split_address
from lfield.net.zenoh.config import ZenohConfig

#: Default port of the service of a robot.
SERVICE_PORT = 8182
#: Processor architectures of robots, as `uname -m` prints them.
Architecture = Literal["aarch64", "x86_64", "armv7l"]
ARCHITECTURES: tuple[str, ...] = get_args(Architecture)


class InventoryHost(Struct, frozen=True):
    """A host. `addresses` are "host:port" of the mission's host, in order of preference.

    `user`, `ssh_port` and `ssh_host` are for ssh: '' and 0 leave the choice to it, and to the addresses.
    `arch` and `python` ("3.11") are '' if they are not stated. `groups` are additional groups of the
    service's user, `devices` is the devices file of this robot alone, None without one,
    `files` are those that its devices need (a DBC file, a key), `options` further ones of `lfield up` for the
    mission's host. `zenoh` is its own way into a Zenoh fabric.
    """

    name: str
    addresses: tuple[str, ...]
    user: str = ""
    ssh_port: int = 0
    ssh_host: str = ""
    arch: str = ""
    python: str = ""
    service_port: int = SERVICE_PORT
    groups: tuple[str, ...] = ()
    devices: Path | None = None
    files: tuple[Path, ...] = ()
    options: tuple[str, ...] = ()
    zenoh: ZenohConfig | None = None

    @property
    def address(self) -> str:
        """All addresses as one text (`net.transport.split_addresses`)."""
        return ",".join(self.addresses)

    @property
    def service_addresses(self) -> tuple[str, ...]:
        """The addresses of the service, in order of preference."""
        hosts = dict.fromkeys(split_address(address)[0] for address in self.addresses)
        return tuple(join_address(host, self.service_port) for host in hosts)

    @property
    def service_address(self) -> str:
        """The addresses of the service as one text."""
        return ",".join(self.service_addresses)

    @property
    def ssh_hosts(self) -> tuple[str, ...]:
        """The names or addresses that ssh tries, in order; for a host in a Zenoh fabric its name."""
        if self.ssh_host:
            return (self.ssh_host,)
        stated = [split_address(address)[0] for address in self.addresses if not is_zenoh(address)]
        return tuple(dict.fromkeys(stated)) or (self.name,)


class Inventory(Struct, frozen=True):
    """The hosts of a file `path` by name, in its order; `zenoh` is the team's way into a Zenoh fabric."""

    path: Path
    hosts: Mapping[str, InventoryHost] = field(default_factory=dict)
    zenoh: ZenohConfig | None = None

    @property
    def own_sections(self) -> dict[str, ZenohConfig]:
        """The hosts with a way of their own into a fabric."""
        return {name: host.zenoh for name, host in self.hosts.items() if host.zenoh is not None}
