"""The team as every host sees it: who is deployed where, and at which address a host is reached."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import msgspec

from lfield.errors import AddressError, UsageError
from lfield.net.transport import DEFAULT_PORT, split_address
from lfield.text.suggest import did_you_mean, listed
from lfield.vm.agent import AgentKind, Member

#: What is said of an agent in a deployment: type, id, host, and arguments. Of a witness, a host without
#: agents, there is only the host.
Row = tuple[str, str, str, tuple[str, ...]]


class Deployed(NamedTuple):
    """An agent where it starts."""

    id: str
    type: str
    host: str


@dataclass(frozen=True, slots=True)
class Team:
    """`members` in the order of the deployment; `addresses[n]` is the "host:port" of `hosts[n]`.

    Hosts without members are witnesses: they take part when the team decides that a host is lost.

    `deployment` is the SHA-256 of `encode_rows`: types, ids, hosts and arguments. Addresses do not count.
    """

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
    def types(self) -> dict[str, str]:
        """The types of all agents, by their ids."""
        return {member.id: member.type for member in self.members}

    @property
    def homes(self) -> dict[str, str]:
        """The hosts of all agents, by their ids."""
        return {member.id: self.hosts[member.host] for member in self.members}

    @property
    def coordinators(self) -> list[Member]:
        """All coordinators."""
        return [m for m in self.members if m.kind == "coordinator"]

    @property
    def deployed(self) -> list[Deployed]:
        """All agents with the names of their hosts."""
        return [Deployed(m.id, m.type, self.hosts[m.host]) for m in self.members]

    @property
    def rows(self) -> list[Row]:
        """What the deployment says of its agents, in order, and of witnesses."""
        agents = [(m.type, m.id, self.hosts[m.host], m.arguments) for m in self.members]
        homes = {member.host for member in self.members}
        return [*agents, *(("", "", host, ()) for n, host in enumerate(self.hosts) if n not in homes)]

    @property
    def reached(self) -> dict[str, str]:
        """The address of every host by its name."""
        return dict(zip(self.hosts, self.addresses, strict=True))

    def at(self, addresses: Mapping[str, str]) -> Team:
        """The same team, some of its hosts at other addresses."""
        found = self.reached | {host: address for host, address in addresses.items() if host in self.hosts}
        return replace(self, addresses=tuple(found.values()))

    def lookup(self, host: str) -> str:
        """The host of that name. Raises UsageError with those there are, and the one probably meant."""
        if host in self.hosts:
            return host
        hint = did_you_mean(host, self.hosts)
        raise UsageError(
            f"the deployment has no host '{host}': it has {listed(self.hosts)}{f'; {hint}' if hint else ''}"
        )


def team_of(rows: Iterable[Row], kinds: Mapping[str, AgentKind], ports: Mapping[str, int]) -> Team:
    """The team of some rows. `kinds` says of each type whether it is a resource or a coordinator.

    A host without a port has the default one.
    """
    said = list(rows)
    numbers = {host: i for i, host in enumerate(dict.fromkeys(host for _, _, host, _ in said))}
    members = tuple(
        Member(i, id, type, kinds[type], numbers[host], arguments)
        for i, (type, id, host, arguments) in enumerate(row for row in said if row[0])
    )
    addresses = tuple(f"{host}:{ports.get(host, DEFAULT_PORT)}" for host in numbers)
    return Team(members, tuple(numbers), addresses, hashlib.sha256(encode_rows(said)).digest())


def encode_rows(rows: Iterable[Row]) -> bytes:
    """The bytes by which deployments are compared; `lfield.lang.deployment` hashes the same."""
    return msgspec.msgpack.encode(list(rows))


def parse_maps(words: Sequence[str], team: Team) -> dict[str, str]:
    """`NAME=ADDR:PORT` from the command line, by host; raises UsageError."""
    maps: dict[str, str] = {}
    for word in words:
        name, equals, address = word.partition("=")
        if not equals or not _has_port(address):
            raise UsageError(
                f"--map {word}: write it as NAME=ADDR:PORT, as in --map alpha=10.0.0.5:8181 or "
                "--map alpha=[fd00::5]:8181"
            )
        maps[team.lookup(name)] = address
    return maps


def _has_port(address: str) -> bool:
    """Whether it is an address with a port that can be called, IPv6 in brackets."""
    try:
        _, port = split_address(address)
    except AddressError:
        return False
    _, colon, written = address.rpartition(":")
    return bool(colon) and written.isdigit() and port > 0
