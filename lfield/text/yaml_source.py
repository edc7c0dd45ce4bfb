"""YAML text to values with source positions: manifests, bindings, registries.

Only this module imports yaml. It reads a safe, small part of the language: mappings with text keys, lists,
and plain scalars (null, true, false, whole and decimal numbers, text) by the rules of YAML 1.2, so that `no`
is text and `010` is ten. Anchors, aliases, tags, duplicate keys, several documents and numbers that are not
finite are rejected, each with a diagnostic. `YAML_CODES` has the codes of all YAML files.
"""

from __future__ import annotations

import math
import re
import sys
from collections.abc import Iterator

import yaml
from msgspec import Struct

from lfield.errors import InputFileError
from lfield.text.input_files import invalid_byte
from lfield.text.source_text import Diagnostic, Diagnostics, Source, Span

#: The meaning of each code of a finding in a YAML file.
YAML_CODES = {
    "Y101": "the text is not YAML",
    "Y102": "the file is too large or nested too deeply",
    "Y103": "an anchor or an alias",
    "Y104": "a tag",
    "Y105": "a key occurs twice in a mapping",
    "Y106": "a key is not text",
    "Y107": "a number is not finite or does not fit into 64 bits",
    "Y108": "the file holds several documents",
    "Y109": "the file is not UTF-8 text",
    "Y110": "a required key is missing",
    "Y111": "an unknown key",
    "Y112": "a value of the wrong type",
    "Y113": "a value that is not allowed here",
    "Y114": "no coordinator can be recovered after the loss of a host: too few members",
    "Y115": "a device can outlive the lease of its coordinator, or the members are not valid",
    "Y116": "a missing option that follows neither from the resource type nor from the id of the agent",
}

MAX_BYTES = 1 << 20
MAX_DEPTH = 32

_INT = re.compile(r"[-+]?[0-9]{1,20}|0x[0-9a-fA-F]{1,16}")
_REAL = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
_NOT_FINITE = re.compile(r"[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)")
_ALIGN = "indent the entries of one mapping equally, with spaces"
_ALIGN_OR_QUOTE = f"put the value into double quotes, or {_ALIGN}"
_ESCAPES = "write \\\\ for a backslash in double quotes; \\x needs 2 hexadecimal digits, \\u 4 and \\U 8"
_LONG_ESCAPE = re.compile(r"\\U([0-9a-fA-F]{8})")
_CONSTANTS: dict[str, bool | None] = {
    "": None,
    "~": None,
    "null": None,
    "true": True,
    "false": False,
}


class YamlScalar(Struct, frozen=True):
    """One value: null, a boolean, a number or text."""

    value: bool | int | float | str | None
    span: Span


class YamlList(Struct, frozen=True):
    """A list of nodes."""

    items: tuple[YamlNode, ...]
    span: Span


class YamlEntry(Struct, frozen=True):
    """One key of a mapping with its value."""

    key: str
    key_span: Span
    value: YamlNode


class YamlMapping(Struct, frozen=True):
    """Entries by key, in the order of the text."""

    entries: dict[str, YamlEntry]
    span: Span


YamlNode = YamlScalar | YamlList | YamlMapping


class _ParseError(Exception):
    """Ends a parse at its first finding: after it, positions would be wrong."""

    def __init__(self, diagnostic: Diagnostic) -> None:
        self.diagnostic = diagnostic


def read(path: str, found: Diagnostics) -> YamlNode | None:
    """The document in a file, or None when `found` got an error. Raises InputFileError."""
    try:
        with open(path, "rb") as file:
            data = file.read(MAX_BYTES + 1)
    except OSError as error:
        raise InputFileError(path, error.strerror or str(error)) from None
    return decode(path, data, found)


def decode(name: str, data: bytes, found: Diagnostics) -> YamlNode | None:
    """The document in some bytes, shown as `name` in diagnostics, or None when `found` got an error."""
    try:
        source = Source(name, data.decode("utf-8"))
    except UnicodeDecodeError as error:
        where, byte = invalid_byte(name, error)
        message = f"the file is not UTF-8 here (byte {byte} at offset {error.start})"
        found.add(Diagnostic("Y109", message, where, "save it as UTF-8 text"))
        return None
    return parse(source, found)


def parse(source: Source, found: Diagnostics) -> YamlNode | None:
    """The one document of a source, or None when `found` got an error; never raises on bad text."""
    if len(source.text.encode("utf-8", "replace")) > MAX_BYTES:
        found.add(Diagnostic("Y102", "the file is larger than 1 MiB", Span(source, 0, 1)))
        return None
    node = _parse_fast(source)
    return node if node is not None else _parse(source, found)


def _parse_fast(source: Source) -> YamlNode | None:
    """The document parsed by the C library, if PyYAML was built with it: twenty times as fast.

    None for any error, which the parser in Python then reports, so that findings have the same text and
    position everywhere. The parser in Python also handles byte order marks, which libyaml does not count in
    positions.
    """
    if not yaml.__with_libyaml__ or "\ufeff" in source.text:
        return None
    try:
        return _Parser(source, yaml.CSafeLoader).document()
    except (_ParseError, yaml.YAMLError, ValueError):
        return None


def _parse(source: Source, diagnostics: Diagnostics) -> YamlNode | None:
    try:
        return _Parser(source, yaml.SafeLoader).document()
    except _ParseError as refused:
        diagnostics.add(refused.diagnostic)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        start = min(mark.index, len(source.text)) if mark is not None else 0
        diagnostics.add(_syntax_error(source, start, error))
    except yaml.reader.ReaderError as error:
        sentence = f"the character U+{ord(source.text[error.position]):04X} is not allowed in YAML"
        diagnostics.add(Diagnostic("Y101", sentence, _at(source, error.position), "remove this character"))
    except (ValueError, OverflowError):
        # PyYAML passes an escape such as "\UFFFFFFFF" to chr() unchecked.
        escape = next((m for m in _LONG_ESCAPE.finditer(source.text) if int(m[1], 16) > sys.maxunicode), None)
        span = _at(source, 0) if escape is None else Span(source, *escape.span())
        diagnostics.add(Diagnostic("Y101", "this escape is not a character", span, _ESCAPES))
    return None


#: Parts of PyYAML's messages, each with the sentence and hint that replace it.
_PROBLEMS = (
    ("found a tab", "a tab where YAML requires spaces", "indent with spaces"),
    ("'\\t' that cannot start", "a tab where YAML requires spaces", "indent with spaces"),
    (
        "could not find expected ':'",
        "a key without a ':'",
        "write 'key: value', with a space behind the colon",
    ),
    ("mapping values are not allowed", "a second ':' in this value, or a wrong indentation", _ALIGN_OR_QUOTE),
    ("expected <block end>", "the indentation does not match the lines above", _ALIGN),
    (
        "expected ',' or ']'",
        "this [ ... ] list is not closed or lacks a comma",
        "close it with ], or add the comma",
    ),
    (
        "expected ',' or '}'",
        "this { ... } mapping is not closed or lacks a comma",
        "close it with }, or add the comma",
    ),
    ("unexpected end of stream", "a quoted text is not closed", "close it with the same quote"),
    ("sequence entries are not allowed", "a '-' is not allowed here", "start a new line with it"),
    ("expected the node content", "a value is missing, or a [ or { is not closed", "close it with ] or }"),
    ("expected '<document start>'", "the indentation does not match the lines above", _ALIGN),
    ("cannot start any token", "this character cannot start a value", "put the value into double quotes"),
    ("unknown escape", "an escape that YAML does not have", _ESCAPES),
    ("expected escape sequence", "an escape lacks hexadecimal digits", _ESCAPES),
    (
        "directive",
        "a line that starts with % is a YAML directive, which is not allowed here",
        "remove the line",
    ),
    ("block scalar", "a | or > must be the last character of its line", "write the text on the next lines"),
    ("mapping keys are not allowed", "a '?' is not allowed here", "put the value into double quotes"),
    ("document separator", "a quoted text is not closed", "close it with the same quote"),
    ("scanning an a", "anchors and aliases are not allowed", "put the value into double quotes"),
    (" tag", "tags are not allowed", "put the value into double quotes"),
)


#: PyYAML's message for an unexpected closing bracket.
_FOUND_BRACKET = re.compile(r"but found '([]}])'")
_OPENING = {"}": "{", "]": "["}


def _syntax_error(source: Source, start: int, error: yaml.MarkedYAMLError) -> Diagnostic:
    """The finding for an error of PyYAML, with a text of lfield if there is one."""
    reported = f"{error.context or ''}; {error.problem or ''}"
    line, _ = source.line_column(min(start, max(len(source.text) - 1, 0)))
    text = source.line_text(line)
    if "\t" in text[: len(text) - len(text.lstrip())]:
        position = source.line_ends(line)[0] + text.index("\t")
        return Diagnostic(
            "Y101", "a tab in the indentation of this line", _at(source, position), "indent with spaces"
        )
    unmatched = _FOUND_BRACKET.search(reported)
    # Inside { ... } or [ ... ] the cause may be a bracket of the wrong kind.
    if unmatched and "parsing a flow" not in reported:
        closing = unmatched[1]
        hint = f"remove it, or add the {_OPENING[closing]} that it closes"
        return Diagnostic("Y101", f"one {closing} too many", _at(source, start), hint)
    for part, sentence, hint in _PROBLEMS:
        if part in reported:
            return Diagnostic("Y101", sentence, _at(source, start), hint)
    return Diagnostic(
        "Y101", "this is not YAML", _at(source, start), "check indentation, quotes and brackets"
    )


def _at(source: Source, start: int) -> Span:
    return Span(source, start, start + 1)


def _parse_error(code: str, message: str, span: Span, hint: str = "") -> _ParseError:
    return _ParseError(Diagnostic(code, message, span, hint))


class _Parser:
    """Events of one source to nodes; recursion is bounded by MAX_DEPTH."""

    def __init__(self, source: Source, loader: type[yaml.SafeLoader | yaml.CSafeLoader]) -> None:
        self._source = source
        self._events: Iterator[yaml.Event] = yaml.parse(source.text, Loader=loader)

    def document(self) -> YamlNode:
        node: YamlNode = YamlScalar(None, Span(self._source, 0, 0))
        has_document = False
        for event in self._events:
            if isinstance(event, yaml.DocumentStartEvent):
                if has_document:
                    raise _parse_error("Y108", "one file holds one document", self._span(event))
                has_document = True
                node = self._node(next(self._events), 1)
        return node

    def _span(self, event: yaml.Event) -> Span:
        # PyYAML ends a block collection at the next token: without this correction the caret would span
        # several lines.
        assert event.start_mark is not None
        assert event.end_mark is not None
        start, end = event.start_mark.index, event.end_mark.index
        return Span(self._source, start, max(end, start + 1))

    def _node(self, event: yaml.Event, depth: int) -> YamlNode:
        span = self._span(event)
        if isinstance(event, yaml.AliasEvent) or getattr(event, "anchor", None) is not None:
            raise _parse_error("Y103", "anchors and aliases are not allowed", span, "write out the value")
        tag = getattr(event, "tag", None)
        if tag is not None:
            raise _parse_error("Y104", f"tags are not allowed: '{tag}'", span)
        if isinstance(event, yaml.ScalarEvent):
            if not event.value.isascii() and any("\ud800" <= ch <= "\udfff" for ch in event.value):
                raise _parse_error("Y109", "half of a surrogate pair: not a character of UTF-8", span)
            # A plain scalar has the style None in Python, '' in C.
            return YamlScalar(event.value if event.style else _resolve(event.value, span), span)
        if depth > MAX_DEPTH:
            raise _parse_error("Y102", f"more than {MAX_DEPTH} levels deep", span)
        if isinstance(event, yaml.SequenceStartEvent):
            return self._listing(span, depth)
        return self._mapping(span, depth)

    def _listing(self, span: Span, depth: int) -> YamlList:
        items: list[YamlNode] = []
        while not isinstance(event := next(self._events), yaml.SequenceEndEvent):
            items.append(self._node(event, depth + 1))
        return YamlList(tuple(items), span)

    def _mapping(self, span: Span, depth: int) -> YamlMapping:
        entries: dict[str, YamlEntry] = {}
        while not isinstance(event := next(self._events), yaml.MappingEndEvent):
            key_span = self._span(event)
            if not isinstance(event, yaml.ScalarEvent):
                self._node(event, depth + 1)
                raise _parse_error("Y106", "a key must be plain text", key_span)
            self._node(event, depth + 1)
            if event.value in entries:
                first = entries[event.value].key_span.line
                raise _parse_error(
                    "Y105", f"the key '{event.value}' occurs twice; first on line {first}", key_span
                )
            entries[event.value] = YamlEntry(event.value, key_span, self._node(next(self._events), depth + 1))
        return YamlMapping(entries, span)


def _resolve(text: str, span: Span) -> bool | int | float | str | None:
    """The value of a plain scalar."""
    if text in _CONSTANTS:
        return _CONSTANTS[text]
    if _NOT_FINITE.fullmatch(text):
        raise _parse_error("Y107", f"'{text}' is not a finite number", span)
    if _INT.fullmatch(text):
        number = int(text, 16) if text.startswith("0x") else int(text)
        if not -(1 << 63) <= number < 1 << 63:
            raise _parse_error("Y107", f"{text} does not fit into 64 bits", span)
        return number
    if _REAL.fullmatch(text):
        real = float(text)
        if not math.isfinite(real):
            raise _parse_error("Y107", f"{text} is larger than any real number", span)
        return real
    return text


def describe(node: YamlNode) -> str:
    """The kind of a node, for a diagnostic: 'a list', 'the text "x"', 'the number 3'."""
    if isinstance(node, YamlMapping):
        return "a mapping"
    if isinstance(node, YamlList):
        return "a list"
    if node.value is None:
        return "nothing"
    if isinstance(node.value, bool):
        return "true" if node.value else "false"
    if isinstance(node.value, str):
        return f"the text '{node.value}'"
    return f"the number {node.value}"
