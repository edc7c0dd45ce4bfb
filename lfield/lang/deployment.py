"""Deployment files (`mission.dL`): agents with their hosts and arguments (chapter IV).

A line is `//Type:id@host[:port][?argument&argument]`; `pitp:` before the slashes and the slashes themselves
are optional. `startable` before it marks a coordinator that does not start with its host: another coordinator
starts it. `//@host[:port]` is a witness: a host without agents, which only counts when the team decides
that a host is lost (appendix I). A `#` at the start of a line or after a space begins a comment.
"""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Literal

import msgspec

from lfield.errors import ProgramError
from lfield.lang import messages
from lfield.lang.deployment_hosts import check_hosts
from lfield.lang.deployment_line import DeploymentEntry, read_line
from lfield.lang.tree import UnitKind
from lfield.text.input_files import MAX_TEXT, invalid_byte, read_bytes
from lfield.text.source_text import Diagnostic, Diagnostics, Source, Span
from lfield.text.suggestions import did_you_mean, listed

#: The prefix of the type of a startable coordinator in the rows of a team; no type has a space.
STARTABLE = "startable "

#: 'unknown' when the deployment was read without its program.
AgentKind = Literal["resource", "coordinator", "unknown"]


class DeployedAgent(msgspec.Struct, frozen=True):
    """One line: an instance of a resource or coordinator. `port` is the TCP port written there, if any."""

    type: str
    id: str
    kind: AgentKind
    host: str
    port: int | None
    arguments: tuple[str, ...]
    span: Span
    startable: bool = False


class Witness(msgspec.Struct, frozen=True):
    """A host without agents. `port` is the TCP port written there, if any."""

    host: str
    port: int | None


@dataclass(frozen=True)
class Deployment:
    """A whole deployment; `agents` in the order of the file, which is the order proxies count in."""

    name: str
    agents: tuple[DeployedAgent, ...]
    witnesses: tuple[Witness, ...] = ()

    @cached_property
    def hosts(self) -> tuple[str, ...]:
        """The names of the hosts in order of first appearance; witnesses come last."""
        return tuple(dict.fromkeys(line.host for line in self._lines))

    @property
    def _lines(self) -> tuple[DeployedAgent | Witness, ...]:
        return (*self.agents, *self.witnesses)

    @cached_property
    def hash(self) -> str:
        """SHA-256 in hex of types, ids, hosts and arguments in file order, as a bundle has them.

        Ports, comments and spacing do not count: hosts with different ports still run the same deployment.
        """
        return hashlib.sha256(msgspec.msgpack.encode(self.rows)).hexdigest()

    @property
    def rows(self) -> list[tuple[str, str, str, tuple[str, ...]]]:
        """Type (`row_type`), id, host and arguments of each agent; of a witness only the host."""
        agents = [(row_type(a.type, startable=a.startable), a.id, a.host, a.arguments) for a in self.agents]
        return [*agents, *(("", "", witness.host, ()) for witness in self.witnesses)]

    @property
    def kinds(self) -> dict[str, AgentKind]:
        """The kind of each type."""
        return {a.type: a.kind for a in self.agents}

    @property
    def ports(self) -> dict[str, int]:
        """The port of each host that has one written."""
        return {line.host: line.port for line in self._lines if line.port is not None}

    @cached_property
    def _indexes(self) -> dict[str, int]:
        return {agent.id: index for index, agent in enumerate(self.agents)}

    def on(self, host: str) -> tuple[DeployedAgent, ...]:
        """The agents of a host, in file order."""
        return tuple(agent for agent in self.agents if agent.host == host)

    def index(self, id: str) -> int:
        """The position of an agent: the number a proxy carries. KeyError for an unknown id."""
        return self._indexes[id]

    def agent(self, id: str) -> DeployedAgent:
        """The agent of that id. KeyError when there is none."""
        return self.agents[self._indexes[id]]

    def port(self, host: str) -> int | None:
        """The port written for a host on any of its lines, or None."""
        return self.ports.get(host)


def parse_deployment(
    text: str, name: str, units: Mapping[str, UnitKind] | None, inventory: Collection[str] = ()
) -> tuple[Deployment | None, list[Diagnostic]]:
    """The deployment of a text, or None, with all findings.

    `units` are the units of the program with their kinds; None leaves the types unchecked. `inventory` has
    the hosts that are known to have keys.
    """
    source = Source(name, text)
    diagnostics = Diagnostics()
    entries = _read_entries(source, diagnostics)
    _Checks(diagnostics, units).check(entries)
    check_hosts(entries, inventory, diagnostics)
    if all(entry.is_witness for entry in entries) and not diagnostics.found:
        diagnostics.add(messages.DEPLOY_EMPTY.at(Span(source, 0, 0)))
    if diagnostics.errors:
        return None, diagnostics.in_order()
    kinds = units or {}
    agents = [
        DeployedAgent(
            e.type.text,
            e.id.text,
            _kind(kinds, e.type.text),
            e.host.text,
            e.port,
            e.arguments,
            e.span,
            bool(e.startable.text),
        )
        for e in entries
        if not e.is_witness
    ]
    witnesses = tuple(Witness(e.host.text, e.port) for e in entries if e.is_witness)
    return Deployment(name, tuple(agents), witnesses), diagnostics.in_order()


def read_deployment(path: Path, units: Mapping[str, UnitKind] | None) -> Deployment:
    """The deployment of a file. Raises InputFileError, or ProgramError with all findings."""
    return read_with_warnings(path, units)[0]


def read_with_warnings(
    path: Path, units: Mapping[str, UnitKind] | None, inventory: Collection[str] = ()
) -> tuple[Deployment, list[Diagnostic]]:
    """The deployment of a file and its warnings. Raises as `read_deployment`."""
    data = read_bytes(path, MAX_TEXT)
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        where, byte = invalid_byte(str(path), error)
        raise ProgramError([messages.DEPLOY_NOT_TEXT.at(where, byte=byte)]) from None
    deployment, found = parse_deployment(text, str(path), units, inventory)
    if deployment is None:
        raise ProgramError(found)
    return deployment, found


def row_type(type: str, *, startable: bool) -> str:
    """The type of an agent in the rows of a team: with a prefix for a startable one."""
    return f"{STARTABLE}{type}" if startable else type


def _kind(units: Mapping[str, UnitKind], name: str) -> AgentKind:
    kind = units.get(name)
    return kind if kind in ("resource", "coordinator") else "unknown"


def _read_entries(source: Source, found: Diagnostics) -> list[DeploymentEntry]:
    """All lines that can be read."""
    entries = []
    start = 0
    for line in source.text.split("\n"):
        entry = read_line(Span(source, start, start + len(line)), found)
        if entry is not None:
            entries.append(entry)
        start += len(line) + 1
    return entries


class _Checks:
    """Rules across lines: types against the program, ids and hosts against one another."""

    def __init__(self, found: Diagnostics, units: Mapping[str, UnitKind] | None) -> None:
        self.found, self.units = found, units
        self.deployable = [name for name, kind in (units or {}).items() if kind != "class"]
        self.ids: dict[str, Span] = {}
        self.spellings: dict[str, Span] = {}
        self.ports: dict[str, tuple[int, Span]] = {}

    def check(self, entries: list[DeploymentEntry]) -> None:
        """Check all lines; if the program has nothing to deploy, only the first one is reported."""
        agents = [entry for entry in entries if not entry.is_witness]
        if self.units is not None and not self.deployable and agents:
            self.found.add(messages.DEPLOY_NO_PROGRAM.at(agents[0].type, name=agents[0].type.text))
        for entry in agents:
            if self.deployable:
                self.type(entry.type)
            if (
                entry.startable.text
                and self.units is not None
                and self.units.get(entry.type.text) == "resource"
            ):
                self.found.add(messages.DEPLOY_STARTABLE.at(entry.startable, id=entry.id.text))
            self.id(entry.id)
        for entry in entries:
            self.host(entry.host)
            self.port(entry)
        self.witnesses(entries)

    def type(self, span: Span) -> None:
        name = span.text
        known = listed(self.deployable)
        assert self.units is not None
        if self.units.get(name) == "class":
            self.found.add(messages.DEPLOY_CLASS.at(span, name=name, known=known))
        elif name not in self.units:
            hint = did_you_mean(name, self.deployable)
            self.found.add(messages.DEPLOY_TYPE.at(span, hint=hint, name=name, known=known))

    def id(self, span: Span) -> None:
        earlier = self.ids.setdefault(span.text, span)
        if earlier is not span:
            self.found.add(messages.DEPLOY_DUPLICATE.at(span, id=span.text, line=earlier.line))

    def host(self, span: Span) -> None:
        first = self.spellings.setdefault(span.text.lower(), span)
        if first.text != span.text:
            self.found.add(
                messages.DEPLOY_HOST_CASE.at(span, host=span.text, first=first.text, line=first.line)
            )

    def witnesses(self, entries: list[DeploymentEntry]) -> None:
        """Report a witness with more than one line."""
        lines: dict[str, DeploymentEntry] = {}
        for entry in sorted(entries, key=lambda entry: entry.is_witness):
            first = lines.setdefault(entry.host.text.lower(), entry)
            if entry.is_witness and first is not entry:
                host, line = entry.host.text, first.host.line
                self.found.add(messages.DEPLOY_WITNESS.at(entry.host, host=host, line=line))

    def port(self, entry: DeploymentEntry) -> None:
        if entry.port is None:
            return
        host = entry.host.text
        port, where = self.ports.setdefault(host.lower(), (entry.port, entry.host))
        if port != entry.port:
            self.found.add(
                messages.DEPLOY_TWO_PORTS.at(
                    entry.port_span, host=host, first=port, line=where.line, port=entry.port
                )
            )
