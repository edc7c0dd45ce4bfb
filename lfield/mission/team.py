"""The deployed team: the host of each agent, and the addresses of hosts."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import msgspec

from lfield.errors import AddressError, UsageError
from lfield.net.transport import DEFAULT_PORT, split_address, split_addresses
from lfield.text.suggestions import did_you_mean, listed
from lfield.vm.agent import AgentKind, TeamMember

#: The prefix of the type of a coordinator that the program starts (decision 105), in its row.
STARTABLE = "startable "
#: A row of a deployment: type, id, host and arguments of an agent. For a witness, a host without agents, only
#: the host.
TeamRow = tuple[str, str, str, tuple[str, ...]]


class DeployedMember(NamedTuple):
    """An agent with its initial host."""

    id: str
    type: str
    host: str


@dataclass(frozen=True)
class Team:
    """`members` in the order of the deployment; `addresses[n]` is the "host:port" of `hosts[n]`.

    Hosts without members are witnesses: they vote when the team decides that a host is lost.

    `deployment` is the SHA-256 of `encode_rows`: types, ids, hosts and arguments, without addresses.

    Derived tables are built once: every host of a simulated team shares them, and each has as many rows as
    the team.
    """

    members: tuple[TeamMember, ...]
    hosts: tuple[str, ...]
    addresses: tuple[str, ...]
    deployment: bytes

    def number(self, host: str) -> int:
        """The index of a host."""
        return self.numbers[host]

    @cached_property
    def numbers(self) -> Mapping[str, int]:
        """The index of each host."""
        return {host: number for number, host in enumerate(self.hosts)}

    def members_on(self, host: int) -> Sequence[TeamMember]:
        """The agents that start on a host, in order."""
        return self._members_by_host[host]

    @cached_property
    def _members_by_host(self) -> Sequence[Sequence[TeamMember]]:
        found: list[list[TeamMember]] = [[] for _ in self.hosts]
        for member in self.members:
            found[member.host].append(member)
        return tuple(map(tuple, found))

    @cached_property
    def hosts_with_resources(self) -> Sequence[str]:
        """The hosts on which resources are deployed, in order: a restarted coordinator needs such a host."""
        numbers = {member.host for member in self.members if member.kind == "resource"}
        return tuple(self.hosts[number] for number in sorted(numbers))

    @cached_property
    def types(self) -> Mapping[str, str]:
        """The types of all agents, by id."""
        return {member.id: member.type for member in self.members}

    @cached_property
    def homes(self) -> Mapping[str, str]:
        """The hosts of all agents, by id."""
        return {member.id: self.hosts[member.host] for member in self.members}

    @cached_property
    def member_numbers(self) -> Mapping[str, int]:
        """The numbers of all agents, by id."""
        return {member.id: member.number for member in self.members}

    @cached_property
    def coordinators(self) -> Sequence[TeamMember]:
        return tuple(m for m in self.members if m.kind == "coordinator")

    @cached_property
    def initial_coordinators(self) -> Sequence[TeamMember]:
        """The coordinators that start with their hosts. A mission lasts until they, and all that were started
        by others, have ended."""
        return tuple(m for m in self.coordinators if not m.is_startable)

    @cached_property
    def startable(self) -> Mapping[str, TeamMember]:
        """The coordinators that the program starts, by id."""
        return {m.id: m for m in self.coordinators if m.is_startable}

    @cached_property
    def deployed(self) -> Sequence[DeployedMember]:
        """All agents with the names of their hosts."""
        return tuple(DeployedMember(m.id, m.type, self.hosts[m.host]) for m in self.members)

    @property
    def rows(self) -> list[TeamRow]:
        """The rows of the deployment, in order: agents and witnesses."""
        agents = [
            (f"{STARTABLE}{m.type}" if m.is_startable else m.type, m.id, self.hosts[m.host], m.arguments)
            for m in self.members
        ]
        homes = {member.host for member in self.members}
        return [*agents, *(("", "", host, ()) for n, host in enumerate(self.hosts) if n not in homes)]

    @property
    def addresses_by_host(self) -> dict[str, str]:
        """The addresses of all hosts, by name."""
        return dict(zip(self.hosts, self.addresses, strict=True))

    def at(self, addresses: Mapping[str, str]) -> Team:
        """The same team with other addresses of some hosts."""
        found = self.addresses_by_host | {
            host: address for host, address in addresses.items() if host in self.hosts
        }
        return replace(self, addresses=tuple(found.values()))

    def find_host(self, host: str) -> str:
        """The host with that name; an IPv6 address may lack its brackets. Raises UsageError."""
        if host in self.hosts:
            return host
        if f"[{host}]" in self.hosts:
            return f"[{host}]"
        hint = did_you_mean(host, self.hosts)
        raise UsageError(
            f"the deployment has no host '{host}': it has {listed(self.hosts)}{f'; {hint}' if hint else ''}"
        )


def team_of(rows: Iterable[TeamRow], kinds: Mapping[str, AgentKind], ports: Mapping[str, int]) -> Team:
    """The team of some rows. `kinds` has for each type whether it is a resource or a coordinator.

    A host without a port gets the default one.
    """
    row_list = list(rows)
    numbers = {host: i for i, host in enumerate(dict.fromkeys(host for _, _, host, _ in row_list))}
    members = tuple(
        _member(i, kinds, numbers[host], row)
        for i, (host, row) in enumerate((row[2], row) for row in row_list if row[0])
    )
    addresses = tuple(f"{host}:{ports.get(host, DEFAULT_PORT)}" for host in numbers)
    return Team(members, tuple(numbers), addresses, hashlib.sha256(encode_rows(row_list)).digest())


def _member(number: int, kinds: Mapping[str, AgentKind], host: int, row: TeamRow) -> TeamMember:
    type, id, _, arguments = row
    name = type.removeprefix(STARTABLE)
    return TeamMember(number, id, name, kinds[name], host, arguments, is_startable=type != name)


def encode_rows(rows: Iterable[TeamRow]) -> bytes:
    """The bytes by which deployments are compared; `lfield.lang.deployment` hashes the same."""
    return msgspec.msgpack.encode(list(rows))


def parse_maps(arguments: Sequence[str], team: Team) -> dict[str, str]:
    """`NAME=ADDR:PORT` from the command line, by host; raises UsageError."""
    maps: dict[str, str] = {}
    for argument in arguments:
        name, equals, address = argument.partition("=")
        if not equals or not _has_port(address):
            raise UsageError(
                f"--map {argument}: write it as NAME=ADDR:PORT, as in --map alpha=10.0.0.5:8181 or "
                "--map alpha=[fd00::5]:8181"
            )
        maps[team.find_host(name)] = address
    return maps


def _has_port(address: str) -> bool:
    """Whether each address has a valid port, IPv6 in brackets."""
    for each in split_addresses(address):
        try:
            _, port = split_address(each)
        except AddressError:
            return False
        _, colon, written = each.rpartition(":")
        if not (colon and written.isdigit() and port > 0):
            return False
    return True
