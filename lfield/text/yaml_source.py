"""YAML text to values that remember where they stand: manifests, bindings, registries.

The only module that imports yaml. It reads a safe, small part of the language: mappings with text keys,
lists, and plain scalars (null, true, false, whole and decimal numbers, text) by the rules of YAML 1.2,
so that `no` is text and `010` is ten. Anchors, aliases, tags, duplicate keys, several documents and
numbers that are not finite are refused, each with a diagnostic:

    Y101 not YAML               Y104 a tag                  Y107 a number nobody can hold
    Y102 too large or too deep  Y105 a key twice            Y108 several documents
    Y103 an anchor or alias     Y106 a key that is not text Y109 not UTF-8

yaml_fields.py reads the entries of a mapping with their types; its findings are Y110 to Y113.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass

import yaml

from lfield.errors import InputFileError
from lfield.text.source import Diagnostic, Diagnostics, Source, Span

MAX_BYTES = 1 << 20
MAX_DEPTH = 32

_INT = re.compile(r"[-+]?[0-9]{1,20}|0x[0-9a-fA-F]{1,16}")
_REAL = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
_NOT_FINITE = re.compile(r"[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)")
_WORDS: dict[str, bool | None] = {
    "": None,
    "~": None,
    "null": None,
    "true": True,
    "false": False,
}


@dataclass(frozen=True, slots=True)
class Scalar:
    """One value: null, a boolean, a number or text."""

    value: bool | int | float | str | None
    span: Span


@dataclass(frozen=True, slots=True)
class Listing:
    """A list of nodes."""

    items: tuple[Node, ...]
    span: Span


@dataclass(frozen=True, slots=True)
class Entry:
    """One key of a mapping with its value."""

    key: str
    key_span: Span
    value: Node


@dataclass(frozen=True, slots=True)
class Mapping:
    """Entries by key, in the order of the text."""

    entries: dict[str, Entry]
    span: Span


Node = Scalar | Listing | Mapping


class _Refused(Exception):
    """Ends a parse at its first finding: after it, positions would mislead."""

    def __init__(self, diagnostic: Diagnostic) -> None:
        self.diagnostic = diagnostic


def read(path: str, found: Diagnostics) -> Node | None:
    """The document in a file, or None when `found` got an error. Raises InputFileError."""
    try:
        with open(path, "rb") as file:
            data = file.read(MAX_BYTES + 1)
    except OSError as error:
        raise InputFileError(path, error.strerror or str(error)) from None
    return decode(path, data, found)


def decode(name: str, data: bytes, found: Diagnostics) -> Node | None:
    """The document in some bytes, shown as `name` in diagnostics, or None when `found` got an error."""
    try:
        source = Source(name, data.decode("utf-8"))
    except UnicodeDecodeError as error:
        source = Source(name, data[: error.start].decode("utf-8") + "\N{REPLACEMENT CHARACTER}")
        end = len(source.text)
        found.add(Diagnostic("Y109", "this is not UTF-8 text", Span(source, end - 1, end)))
        return None
    return parse(source, found)


def parse(source: Source, found: Diagnostics) -> Node | None:
    """The one document of a source, or None when `found` got an error; never raises on bad text."""
    if len(source.text.encode("utf-8", "replace")) > MAX_BYTES:
        found.add(Diagnostic("Y102", "the file is larger than 1 MiB", Span(source, 0, 1)))
        return None
    node = _parse_fast(source)
    return node if node is not None else _parse(source, found)


def _parse_fast(source: Source) -> Node | None:
    """The document by the C library, where PyYAML was built with it: twenty times as fast.

    None for whatever is wrong. The parser in Python then says what, so that findings are worded and placed
    the same everywhere. Byte order marks are left to it too: libyaml does not count them in positions.
    """
    if not yaml.__with_libyaml__ or "\ufeff" in source.text:
        return None
    try:
        return _Parser(source, yaml.CSafeLoader).document()
    except (_Refused, yaml.YAMLError, ValueError):
        return None


def _parse(source: Source, found: Diagnostics) -> Node | None:
    try:
        return _Parser(source, yaml.SafeLoader).document()
    except _Refused as refused:
        found.add(refused.diagnostic)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        start = min(mark.index, len(source.text)) if mark is not None else 0
        found.add(Diagnostic("Y101", f"not YAML: {error.problem or error.context}", _at(source, start)))
    except yaml.reader.ReaderError as error:
        found.add(Diagnostic("Y101", f"not YAML: {error.reason}", _at(source, error.position)))
    except (ValueError, OverflowError) as error:
        # An escape such as "\UFFFFFFFF" is passed to chr() unchecked by PyYAML.
        found.add(Diagnostic("Y101", f"not YAML: {error}", _at(source, 0)))
    return None


def _at(source: Source, start: int) -> Span:
    return Span(source, start, start + 1)


def _refusal(code: str, message: str, span: Span, hint: str = "") -> _Refused:
    return _Refused(Diagnostic(code, message, span, hint))


class _Parser:
    """Events of one source to nodes; recursion is bounded by MAX_DEPTH."""

    def __init__(self, source: Source, loader: type[yaml.SafeLoader | yaml.CSafeLoader]) -> None:
        self._source = source
        self._events: Iterator[yaml.Event] = yaml.parse(source.text, Loader=loader)

    def document(self) -> Node:
        node: Node = Scalar(None, Span(self._source, 0, 0))
        seen = False
        for event in self._events:
            if isinstance(event, yaml.DocumentStartEvent):
                if seen:
                    raise _refusal("Y108", "one file holds one document", self._span(event))
                seen = True
                node = self._node(next(self._events), 1)
        return node

    def _span(self, event: yaml.Event) -> Span:
        # PyYAML ends a block collection where the next thing starts: without this the caret runs over lines.
        assert event.start_mark is not None
        assert event.end_mark is not None
        start, end = event.start_mark.index, event.end_mark.index
        return Span(self._source, start, max(end, start + 1))

    def _node(self, event: yaml.Event, depth: int) -> Node:
        span = self._span(event)
        if isinstance(event, yaml.AliasEvent) or getattr(event, "anchor", None) is not None:
            raise _refusal("Y103", "anchors and aliases are not allowed", span, "write the value out")
        tag = getattr(event, "tag", None)
        if tag is not None:
            raise _refusal("Y104", f"tags are not allowed: '{tag}'", span)
        if isinstance(event, yaml.ScalarEvent):
            if not event.value.isascii() and any("\ud800" <= ch <= "\udfff" for ch in event.value):
                raise _refusal("Y109", "half a character: no UTF-8 text has it", span)
            # A plain scalar has the style None in Python, '' in C.
            return Scalar(event.value if event.style else _resolve(event.value, span), span)
        if depth > MAX_DEPTH:
            raise _refusal("Y102", f"more than {MAX_DEPTH} levels deep", span)
        if isinstance(event, yaml.SequenceStartEvent):
            return self._listing(span, depth)
        return self._mapping(span, depth)

    def _listing(self, span: Span, depth: int) -> Listing:
        items: list[Node] = []
        while not isinstance(event := next(self._events), yaml.SequenceEndEvent):
            items.append(self._node(event, depth + 1))
        return Listing(tuple(items), span)

    def _mapping(self, span: Span, depth: int) -> Mapping:
        entries: dict[str, Entry] = {}
        while not isinstance(event := next(self._events), yaml.MappingEndEvent):
            key_span = self._span(event)
            if not isinstance(event, yaml.ScalarEvent):
                self._node(event, depth + 1)
                raise _refusal("Y106", "a key must be plain text", key_span)
            self._node(event, depth + 1)
            if event.value in entries:
                first = entries[event.value].key_span.line
                raise _refusal("Y105", f"'{event.value}' is here twice; first in line {first}", key_span)
            entries[event.value] = Entry(event.value, key_span, self._node(next(self._events), depth + 1))
        return Mapping(entries, span)


def _resolve(text: str, span: Span) -> bool | int | float | str | None:
    """What a plain scalar means."""
    if text in _WORDS:
        return _WORDS[text]
    if _NOT_FINITE.fullmatch(text):
        raise _refusal("Y107", f"'{text}' is not a finite number", span)
    if _INT.fullmatch(text):
        number = int(text, 16) if text.startswith("0x") else int(text)
        if not -(1 << 63) <= number < 1 << 63:
            raise _refusal("Y107", f"{text} does not fit into 64 bits", span)
        return number
    if _REAL.fullmatch(text):
        real = float(text)
        if not math.isfinite(real):
            raise _refusal("Y107", f"{text} is larger than any real number", span)
        return real
    return text


def describe(node: Node) -> str:
    """What a node is, in words for a diagnostic: 'a list', 'the text "x"', 'the number 3'."""
    if isinstance(node, Mapping):
        return "a mapping"
    if isinstance(node, Listing):
        return "a list"
    if node.value is None:
        return "nothing"
    if isinstance(node.value, bool):
        return "true" if node.value else "false"
    if isinstance(node.value, str):
        return f"the text '{node.value}'"
    return f"the number {node.value}"
