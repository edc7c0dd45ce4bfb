"""Parses an EDS or DCF file into an object dictionary of `canopen`. Pure.

Only object types are used; values are read from the drive. So default values (including $NODEID), limits and
texts are ignored. Keys and sections are case-insensitive; of duplicates the first counts, as for Windows
tools. An invalid object is omitted with a warning: a drive is refused only for an object that is needed.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

import canopen
from canopen.objectdictionary import ODRecord, ODVariable, datatypes
from msgspec import Struct, field

from lfield.driver import Diagnostic, Diagnostics, FindingTable, Source, Span
from lfield_can.text_files import decode_text

# EDS1xx are errors: the file is not used. EDS9xx are warnings: a part is ignored. Every message by its code,
# ordered by code.
TABLE = FindingTable("EDS", warnings="EDS9")
_message = TABLE.message

NO_OBJECTS = _message(
    "EDS101", "the file describes no objects", "an object has a section of its own, as in [6040]"
)

NOT_A_LINE = _message(
    "EDS901",
    "this line is ignored: it is not a section and has no '='",
    "write KEY=VALUE, or ; for a comment",
)
DUPLICATE = _message("EDS902", "{what} is also in line {line}; the first is used", "remove one of them")
NOT_A_NUMBER = _message(
    "EDS903",
    "object {object} is ignored: its {key} is '{text}', which is not a number",
    "write it like 7 or 0x0007",
)
NO_TYPE = _message(
    "EDS904", "object {object} is ignored: it has no DataType", "add the DataType of the manual"
)
UNKNOWN_TYPE = _message(
    "EDS905",
    "object {object} is ignored: its DataType {type} is not defined in the file",
    "define the type in a section of its own, or use one of CiA 301",
)

#: The last data type of CiA 301; higher ones are defined in the file (CiA 306, 4.6.4).
LAST_TYPE = 0x1B
#: Values of ObjectType: one variable, or an array or record (CiA 301, table 42).
VARIABLE, ARRAY, RECORD = 7, 8, 9
#: Subindexes of an object in one section.
MAX_COMPACT = 0xFE

_SECTION = re.compile(r"\s*\[\s*(?P<name>[^\]]*?)\s*\]\s*(?:;.*)?$")
_ENTRY = re.compile(r"\s*(?P<key>[^=;]+?)\s*=\s*(?P<value>[^;]*?)\s*(?:;.*)?$")
_OBJECT = re.compile(r"(?P<index>[0-9a-f]{4})(?:sub(?P<subindex>[0-9a-f]{1,2}))?")


class EdsError(ValueError):
    """A file that is not an EDS file; the message is a sentence, `findings` are the mistakes."""

    def __init__(self, text: str, findings: Sequence[Diagnostic]) -> None:
        self.findings = tuple(findings)
        super().__init__(text)


class _Section(Struct):
    """One section: its entries by lower-case key, each with the position of its value."""

    span: Span
    entries: dict[str, tuple[str, Span]] = field(default_factory=dict)

    def text(self, key: str) -> str:
        """The value of a key, '' if it is missing."""
        return self.entries.get(key.lower(), ("", self.span))[0]


def parse_eds(path: str, data: bytes) -> tuple[canopen.ObjectDictionary, Sequence[Diagnostic]]:
    """The objects of a file, and its ignored parts. Raises EdsError."""
    source, diagnostics = Source(path, decode_text(data)), Diagnostics()
    sections = _sections(source, diagnostics)
    dictionary = canopen.ObjectDictionary()  # type: ignore[no-untyped-call]  # canopen types a part of itself
    indexes = [match["index"] for name in sections if (match := _OBJECT.fullmatch(name))]
    for index in dict.fromkeys(indexes):
        section = sections.get(index, _Section(Span(source, 0, 0)))
        _add(dictionary, int(index, 16), section, sections, diagnostics)
    if not len(dictionary):
        finding = NO_OBJECTS.at(Span(source, 0, min(1, len(source.text))))
        place = f"{path}:{finding.span.line}:{finding.span.column}"
        raise EdsError(f"{place}: error[{finding.code}]: {finding.message} ({finding.hint})", [finding])
    return dictionary, diagnostics.in_order()


def _sections(source: Source, diagnostics: Diagnostics) -> dict[str, _Section]:
    """The sections by lower-case name."""
    sections: dict[str, _Section] = {}
    current = _Section(Span(source, 0, 0))
    at = 0
    for line in source.text.split("\n"):
        start, at = at, at + len(line) + 1
        text = line.strip().strip("\0")
        span = Span(source, start + len(line) - len(line.lstrip()), start + len(line.rstrip()))
        if not text or text.startswith((";", "#")):
            continue
        if match := _SECTION.match(line):
            current = _Section(span)
            first = sections.setdefault(match["name"].lower(), current)
            if first is not current:
                diagnostics.add(DUPLICATE.at(span, what=f"section [{match['name']}]", line=first.span.line))
        elif match := _ENTRY.match(line):
            value_at = start + match.start("value")
            entry = (match["value"], Span(source, value_at, value_at + max(1, len(match["value"]))))
            existing = current.entries.setdefault(match["key"].lower(), entry)
            if existing is not entry and existing[0] != entry[0]:
                diagnostics.add(DUPLICATE.at(span, what=f"key {match['key']}", line=existing[1].line))
        else:
            diagnostics.add(NOT_A_LINE.at(span))
    return sections


def _add(
    dictionary: canopen.ObjectDictionary,
    index: int,
    section: _Section,
    sections: Mapping[str, _Section],
    diagnostics: Diagnostics,
) -> None:
    """Adds an object with its subindexes."""
    name = section.text("ParameterName") or f"0x{index:04X}"
    kind = _number(section.text("ObjectType")) or VARIABLE
    parts = {
        int(match["subindex"], 16): part
        for key, part in sections.items()
        if (match := _OBJECT.fullmatch(key)) and match["subindex"] and int(match["index"], 16) == index
    }
    compact = min(_number(section.text("CompactSubObj")) or 0, MAX_COMPACT)
    if kind not in (ARRAY, RECORD) and not parts and not compact:
        if variable := _variable(name, index, 0, section, sections, diagnostics):
            dictionary.add_object(variable)
        return
    record = ODRecord(name, index)
    if compact:
        count = ODVariable("number of entries", index, 0)
        count.data_type = datatypes.UNSIGNED8
        record.add_member(count)
        if _variable(name, index, 1, section, sections, diagnostics) is None:
            compact = 0
    for subindex in range(1, compact + 1):
        if subindex not in parts and (
            member := _variable(name, index, subindex, section, sections, diagnostics)
        ):
            record.add_member(member)
    for subindex, part in parts.items():
        part_name = part.text("ParameterName") or f"{name} {subindex}"
        if member := _variable(part_name, index, subindex, part, sections, diagnostics):
            record.add_member(member)
    dictionary.add_object(record)


def _variable(
    name: str,
    index: int,
    subindex: int,
    section: _Section,
    sections: Mapping[str, _Section],
    diagnostics: Diagnostics,
) -> ODVariable | None:
    """One object; None for an unknown type."""
    label = f"0x{index:04X}:{subindex}"
    text, place = section.entries.get("datatype", ("", section.span))
    if not text:
        diagnostics.add(NO_TYPE.at(section.span, object=label))
        return None
    data_type = _number(text)
    if data_type is None:
        diagnostics.add(NOT_A_NUMBER.at(place, object=label, key="DataType", text=text))
        return None
    if data_type > LAST_TYPE and (type_section := sections.get(f"{data_type:x}sub1")):
        # CANFestival's editor describes a type by its first subindex, whose default value is the real one.
        data_type = _number(type_section.text("DefaultValue")) or data_type
    if data_type > LAST_TYPE:
        diagnostics.add(UNKNOWN_TYPE.at(place, object=label, type=text))
        return None
    variable = ODVariable(name, index, subindex)
    variable.data_type = data_type
    return variable


def _number(text: str) -> int | None:
    """A number (CiA 306, 4.3): decimal, hexadecimal with 0x, or octal with a leading 0."""
    digits = text.strip().lower()
    try:
        return int(digits, 0)
    except ValueError:
        pass
    try:
        return int(digits, 8 if set(digits) <= set("01234567") else 10)
    except ValueError:
        return None
