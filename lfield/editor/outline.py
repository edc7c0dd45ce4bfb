"""The outline of a program: its units with their members, its constants, enums and functions."""

from __future__ import annotations

from msgspec import Struct
from msgspec.structs import replace

from lfield.editor.program_parts import ProgramFile, ProgramPart, file_offsets
from lfield.lang import syntax
from lfield.lang.deployment_line import DeploymentEntry

_TopLevel = syntax.Constant | syntax.Enumeration | syntax.Method


class OutlineEntry(Struct, frozen=True):
    """A symbol with its name and its whole extent, as offsets in the file."""

    name: str
    detail: str
    kind: str
    start: int
    end: int
    name_start: int
    name_end: int
    children: tuple[OutlineEntry, ...] = ()


def program_outline(file: ProgramFile) -> list[OutlineEntry]:
    """The units, constants, enums and functions of a file."""
    found = []
    for part in file.parts:
        others: list[_TopLevel] = [*part.file.constants, *part.file.enums, *part.file.functions]
        starts = sorted(unit.span.start for unit in (*part.file.units, *others))
        for unit in part.file.units:
            following = next((start for start in starts if start > unit.span.start), None)
            found.append(_unit(part, unit, following))
        found += map(_top_level, others)
    return sorted(found, key=lambda entry: entry.start)


def deployment_outline(entries: list[DeploymentEntry]) -> list[OutlineEntry]:
    """The agents and witnesses of a deployment."""
    found = []
    for entry in entries:
        name, host = (entry.host, "witness") if entry.is_witness else (entry.id, entry.host.text)
        head = " ".join(filter(None, (entry.startable.text, entry.type.text)))
        detail = host if entry.is_witness else f"{head} on {host}"
        kind = "witness" if entry.is_witness else "agent"
        span = entry.span
        found.append(OutlineEntry(name.text, detail, kind, span.start, span.end, name.start, name.end))
    return found


def _top_level(declaration: _TopLevel) -> OutlineEntry:
    start, end = file_offsets(declaration.span)
    match declaration:
        case syntax.Constant(value=value):
            last = file_offsets(value.span)[1]
            return OutlineEntry(declaration.name, str(declaration.type), "constant", start, last, start, end)
        case syntax.Enumeration(members=members):
            children = tuple(_member(member) for member in members)
            last = max((child.end for child in children), default=end)
            return OutlineEntry(declaration.name, "enum", "enum", start, last, start, end, children)
    return replace(_method(declaration), kind="function")


def _member(member: syntax.EnumMember) -> OutlineEntry:
    start, end = file_offsets(member.span)
    return OutlineEntry(member.name, "", "member", start, end, start, end)


def _unit(part: ProgramPart, unit: syntax.Unit, following: int | None) -> OutlineEntry:
    start, end = file_offsets(unit.span)
    last = part.source.place.offset + (following or len(part.source.text.rstrip()))
    children = [_field(member) for member in unit.fields] + [_method(member) for member in unit.methods]
    ordered = tuple(sorted(children, key=lambda entry: entry.start))
    return OutlineEntry(unit.name, unit.kind, unit.kind, start, max(last, end), start, end, ordered)


def _field(field: syntax.Field) -> OutlineEntry:
    start, end = file_offsets(field.span)
    return OutlineEntry(field.name, str(field.type), "field", start, end, start, end)


def _method(method: syntax.Method) -> OutlineEntry:
    start, end = file_offsets(method.span)
    last = max(file_offsets(method.end)[1], end)
    parameters = ", ".join(f"{parameter.type} {parameter.name}" for parameter in method.parameters)
    detail = f"({parameters})" + (f" {method.result}" if method.result is not None else "")
    return OutlineEntry(method.name, detail, method.kind, start, last, start, end)
