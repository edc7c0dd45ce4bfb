"""The team as every host sees it: who is deployed where, and at which address a host is reached."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from lfield.errors import UsageError
from lfield.lang.deployment import Deployment, lookup_host
from lfield.net.transport import DEFAULT_PORT
from lfield.vm.agent import Member


@dataclass(frozen=True, slots=True)
class Team:
    """`members` in the order of the deployment; `addresses[n]` is the "host:port" of `hosts[n]`."""

    members: tuple[Member, ...]
    hosts: tuple[str, ...]
    addresses: tuple[str, ...]
    deployment: bytes

    def number(self, host: str) -> int:
        """A host's number."""
        return self.hosts.index(host)

    def on(self, host: int) -> list[Member]:
        """The agents that start on a host, in order."""
        return [m for m in self.members if m.host == host]

    @property
    def coordinators(self) -> list[Member]:
        """All coordinators."""
        return [m for m in self.members if m.kind == "coordinator"]


def make_team(deployment: Deployment, maps: Mapping[str, str]) -> Team:
    """The team of a deployment; `maps` are addresses from the command line, by host name."""
    hosts = tuple(deployment.hosts)
    numbers = {host: i for i, host in enumerate(hosts)}
    ports = {a.host: a.port for a in deployment.agents if a.port is not None}
    members = tuple(
        Member(i, a.id, a.type, a.kind, numbers[a.host], tuple(a.arguments))
        for i, a in enumerate(deployment.agents)
    )
    addresses = tuple(maps.get(host) or f"{host}:{ports.get(host) or DEFAULT_PORT}" for host in hosts)
    return Team(members, hosts, addresses, bytes.fromhex(deployment.hash))


def parse_maps(words: Sequence[str], deployment: Deployment) -> dict[str, str]:
    """`NAME=ADDR:PORT` from the command line; raises UsageError."""
    maps: dict[str, str] = {}
    for word in words:
        name, equals, address = word.partition("=")
        host, colon, port = address.rpartition(":")
        if not (equals and colon and host and port.isascii() and port.isdigit() and 0 < int(port) < 65536):
            raise UsageError(f"--map {word}: write it as NAME=ADDR:PORT, as in --map alpha=10.0.0.5:8181")
        lookup_host(deployment, name)
        maps[name] = address
    return maps
