"""A deployment in an editor: the meanings of its names, and completions."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Literal

from msgspec import Struct

from lfield.editor.completion import CompletionProposal
from lfield.editor.program_model import ProgramModel
from lfield.lang.checker.argument_check import argument_findings
from lfield.lang.deployment import parse_deployment
from lfield.lang.deployment_line import DeploymentEntry, read_line
from lfield.text.source_text import Diagnostic, Diagnostics, Source, Span
from lfield.text.yaml_source import YamlMapping, YamlNode, parse

NameKind = Literal["type", "id", "host", "argument"]
_ARGUMENT = re.compile(r"[^&]+")


class DeploymentName(Struct, frozen=True):
    """A name in a deployment, with its line."""

    kind: NameKind
    span: Span
    entry: DeploymentEntry


def deployment_entries(text: str) -> list[DeploymentEntry]:
    """The lines that can be read."""
    source, discarded, start = Source("", text), Diagnostics(), 0
    found = []
    for line in text.split("\n"):
        entry = read_line(Span(source, start, start + len(line)), discarded)
        if entry is not None:
            found.append(entry)
        start += len(line) + 1
    return found


def names_in(text: str) -> Iterator[DeploymentName]:
    """All names of a deployment."""
    for entry in deployment_entries(text):
        if not entry.is_witness:
            yield DeploymentName("type", entry.type, entry)
            yield DeploymentName("id", entry.id, entry)
        yield DeploymentName("host", entry.host, entry)
        _, mark, arguments = entry.span.text.partition("?")
        first = entry.span.end - len(arguments)
        for match in _ARGUMENT.finditer(arguments) if mark else ():
            span = Span(entry.span.source, first + match.start(), first + match.end())
            yield DeploymentName("argument", span, entry)


def name_at(text: str, offset: int) -> DeploymentName | None:
    """The name at an offset."""
    return next((name for name in names_in(text) if name.span.start <= offset <= name.span.end), None)


def deployment_findings(text: str, name: str, model: ProgramModel | None) -> list[Diagnostic]:
    """The findings of a deployment, with its types and arguments if the program has no errors."""
    program = model.complete_program() if model is not None else None
    units = None
    if program is not None:
        units = {unit.name: unit.kind for unit in program.units if not unit.capability}
    deployment, found = parse_deployment(text, name, units)
    if deployment is not None and program is not None:
        in_program = argument_findings(program.units, deployment)
        found = [*found, *(finding for finding in in_program if finding.span.source.name == name)]
    return found


def hover_of_name(name: DeploymentName, text: str) -> str:
    """The meaning of a host, an id or an argument; types are explained by the program."""
    entries = deployment_entries(text)
    if name.kind == "host":
        agents = [
            f"`{entry.id.text}` ({entry.type.text})" for entry in entries if _has_host(entry, name.span.text)
        ]
        return f"host `{name.span.text}`: {', '.join(agents) or 'a witness, without agents'}"
    agent = next(
        (entry for entry in entries if entry.id.text == name.span.text and not entry.is_witness), None
    )
    if agent is None:
        return ""
    head = " ".join(filter(None, (agent.startable.text, agent.type.text)))
    return f"agent `{agent.id.text}`: {head} on host `{agent.host.text}`"


def _has_host(entry: DeploymentEntry, host: str) -> bool:
    return entry.host.text == host and not entry.is_witness


def deployment_completions(text: str, offset: int, model: ProgramModel | None) -> list[CompletionProposal]:
    """Types, hosts and ids that fit at an offset."""
    line = text[:offset].rpartition("\n")[2]
    entries = deployment_entries(text)
    if "?" in line:
        ids = dict.fromkeys(entry.id.text for entry in entries if not entry.is_witness)
        return [CompletionProposal(id, "agent") for id in ids]
    if "@" in line:
        return [
            CompletionProposal(host, "host") for host in dict.fromkeys(entry.host.text for entry in entries)
        ]
    if ":" in line.removeprefix("pitp:") or model is None:
        return []
    units = (unit for unit in model.symbols.units.values() if unit.kind != "class")
    return [CompletionProposal(unit.name, unit.kind, f"{unit.kind} {unit.name}") for unit in units]


def device_keys(text: str, agent: str, device: str = "") -> Iterator[Span]:
    """The keys of an agent, or of one of its devices, in a devices file."""
    agents = _entries(parse(Source("", text), Diagnostics()), "agents")
    entry = agents.entries.get(agent) if agents is not None else None
    if entry is None:
        return
    if not device:
        yield entry.key_span
        return
    devices = _entries(entry.value, "devices")
    found = devices.entries.get(device) if devices is not None else None
    if found is not None:
        yield found.key_span


def _entries(node: YamlNode | None, key: str) -> YamlMapping | None:
    entry = node.entries.get(key) if isinstance(node, YamlMapping) else None
    return entry.value if entry is not None and isinstance(entry.value, YamlMapping) else None
