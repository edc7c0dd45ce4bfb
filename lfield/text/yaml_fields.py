"""The entries of a YAML mapping, read one by one with their types."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterable, Iterator
from difflib import get_close_matches

from lfield.text.source_text import Diagnostic, Diagnostics, Span
from lfield.text.yaml_source import YamlEntry, YamlList, YamlMapping, YamlNode, YamlScalar, describe


class YamlFields:
    """The entries of a mapping, read one by one with their types; unread keys are reported.

    Findings go to `found`: Y110 a required key is missing, Y111 an unknown key, Y112 a value of the wrong
    type, Y113 a value out of range. A method that finds an error returns its default.
    """

    def __init__(self, node: YamlNode, found: Diagnostics, subject: str) -> None:
        self.span, self.subject, self._found = node.span, subject, found
        self._known: set[str] = set()
        self._entries = node.entries if isinstance(node, YamlMapping) else {}
        # An empty section (`devices:` without contents) is read as an empty mapping.
        if not isinstance(node, YamlMapping) and not (isinstance(node, YamlScalar) and node.value is None):
            self.report("Y112", f"{subject} must be a mapping, not {describe(node)}", node.span)

    def report(self, code: str, message: str, span: Span, hint: str = "") -> None:
        """Add an error."""
        self._found.add(Diagnostic(code, message, span, hint))

    def add(self, findings: Iterable[Diagnostic]) -> None:
        """Add the findings of a file that is named here."""
        for finding in findings:
            self._found.add(finding)

    def node(self, key: str, *, required: bool = False) -> YamlNode | None:
        """The value of a key, of any kind."""
        self._known.add(key)
        if key in self._entries:
            return self._entries[key].value
        if required:
            joined = next((found for found in self._entries if found.startswith(f"{key}:")), "")
            hint = f"write a space after the colon: {joined.replace(':', ': ', 1)}" if joined else ""
            span = self.key_span(joined) if joined else self.span
            self.report("Y110", f"{self.subject} needs '{key}'", span, hint)
        return None

    def text(
        self, key: str, default: str = "", *, required: bool = False, choices: tuple[str, ...] = ()
    ) -> str:
        """Text; one of `choices` if there are any."""
        node = self.node(key, required=required)
        if node is None:
            return default
        if not isinstance(node, YamlScalar) or not isinstance(node.value, str):
            self._report_type(key, "text", node)
            return default
        if choices and node.value not in choices:
            hint = _did_you_mean(node.value, choices)
            self.report("Y113", f"'{key}' must be one of {', '.join(choices)}", node.span, hint)
            return default
        return node.value

    def flag(self, key: str, default: bool = False) -> bool:
        """A boolean: true or false."""
        node = self.node(key)
        if node is None:
            return default
        if isinstance(node, YamlScalar) and isinstance(node.value, bool):
            return node.value
        self._report_type(key, "true or false", node)
        return default

    def number(
        self,
        key: str,
        default: float = 0.0,
        *,
        required: bool = False,
        minimum: float = -math.inf,
        maximum: float = math.inf,
    ) -> float:
        """A number from `minimum` to `maximum`; whole numbers are valid."""
        node = self.node(key, required=required)
        if node is None:
            return default
        if not isinstance(node, YamlScalar) or isinstance(node.value, bool | str | None):
            self._report_type(key, "a number", node)
            return default
        if not minimum <= node.value <= maximum:
            self.report("Y113", f"'{key}' must be {_range(minimum, maximum)}, not {node.value}", node.span)
            return default
        return float(node.value)

    def integer(self, key: str, default: int = 0, *, minimum: int = 0, maximum: int = (1 << 63) - 1) -> int:
        """A whole number from `minimum` to `maximum`."""
        node = self.node(key)
        if node is None:
            return default
        if (
            not isinstance(node, YamlScalar)
            or not isinstance(node.value, int)
            or isinstance(node.value, bool)
        ):
            self._report_type(key, "a whole number", node)
            return default
        if not minimum <= node.value <= maximum:
            self.report("Y113", f"'{key}' must be {_range(minimum, maximum)}, not {node.value}", node.span)
            return default
        return node.value

    def texts(self, key: str) -> tuple[str, ...]:
        """A list of texts."""
        values = []
        for node in self.items(key):
            if isinstance(node, YamlScalar) and isinstance(node.value, str):
                values.append(node.value)
            else:
                self._report_type(key, "a list of texts", node)
        return tuple(values)

    def names_with_reasons(self, key: str) -> dict[str, str]:
        """Names, each with a reason or '': `[name]`, `{name: reason}`, or a list with both."""
        node, values = self.node(key), dict[str, str]()
        for item in node.items if isinstance(node, YamlList) else (node,) if node is not None else ():
            if isinstance(item, YamlMapping):
                section = YamlFields(item, self._found, f"'{key}'")
                values |= {entry.key: section.text(entry.key) for entry in section.named()}
            elif isinstance(item, YamlScalar) and isinstance(item.value, str) and item is not node:
                values[item.value] = ""
            elif not (isinstance(item, YamlScalar) and item.value is None and item is node):
                self._report_type(key, "names, or names with a reason each", item)
        return values

    def integers(self, key: str) -> tuple[int, ...]:
        """A list of whole numbers."""
        values = []
        for node in self.items(key):
            if (
                isinstance(node, YamlScalar)
                and isinstance(node.value, int)
                and not isinstance(node.value, bool)
            ):
                values.append(node.value)
            else:
                self._report_type(key, "a list of whole numbers", node)
        return tuple(values)

    def numbers(self, key: str) -> tuple[float, ...]:
        """A list of numbers, or one number."""
        node = self.node(key)
        values = []
        for item in (node,) if isinstance(node, YamlScalar) and node.value is not None else self.items(key):
            if (
                isinstance(item, YamlScalar)
                and isinstance(item.value, int | float)
                and not isinstance(item.value, bool)
            ):
                values.append(float(item.value))
            else:
                self._report_type(key, "a number, or a list of numbers", item)
        return tuple(values)

    def items(self, key: str) -> tuple[YamlNode, ...]:
        """The nodes of a list."""
        node = self.node(key)
        if node is None or (isinstance(node, YamlScalar) and node.value is None):
            return ()
        if isinstance(node, YamlList):
            return node.items
        example = f"write {key}: [{_quoted(node.value)}]" if isinstance(node, YamlScalar) else ""
        self.report("Y112", f"'{key}' must be a list, not {describe(node)}", node.span, example)
        return ()

    def section(self, key: str) -> YamlFields:
        """The mapping under a key; an empty one when the key is missing."""
        node = self.node(key)
        return YamlFields(node or YamlMapping({}, self.span), self._found, f"'{key}'")

    def entries(self) -> Iterator[tuple[YamlEntry, YamlFields]]:
        """Every entry with its value read as a mapping, for mappings whose keys are names."""
        for entry in self._entries.values():
            self._known.add(entry.key)
            yield entry, YamlFields(entry.value, self._found, f"'{entry.key}'")

    def named(self) -> Iterator[YamlEntry]:
        """Every entry, for mappings whose keys are names and whose values are read by key."""
        yield from self._entries.values()

    def __len__(self) -> int:
        """The number of keys."""
        return len(self._entries)

    def __contains__(self, key: str) -> bool:
        """Whether the text has the key."""
        return key in self._entries

    def key_span(self, key: str) -> Span:
        """The position of a key; the position of the mapping if the key is missing."""
        return self._entries[key].key_span if key in self._entries else self.span

    def value_span(self, key: str) -> Span:
        """The position of the value of a key; the position of the mapping if the key is missing."""
        return self._entries[key].value.span if key in self._entries else self.span

    def report_unread(self) -> None:
        """Report every key that was not read."""
        for entry in self._entries.values():
            if entry.key not in self._known:
                hint = _did_you_mean(entry.key, sorted(self._known))
                hint = hint or (f"known keys: {', '.join(sorted(self._known))}" if self._known else "")
                self.report("Y111", f"{self.subject} has no key '{entry.key}'", entry.key_span, hint)

    def _report_type(self, key: str, expected: str, node: YamlNode) -> None:
        self.report("Y112", f"'{key}' must be {expected}, not {describe(node)}", node.span)


def _quoted(value: object) -> str:
    """A scalar as an entry of a list in brackets; in quotes if it has a character with a meaning."""
    text = str(value)
    return text if re.fullmatch(r"[A-Za-z0-9._/-]+", text) else json.dumps(text)


def _did_you_mean(name: str, known: list[str] | tuple[str, ...]) -> str:
    close = get_close_matches(name, known, n=1)
    return f"did you mean '{close[0]}'?" if close else ""


def _range(minimum: float, maximum: float) -> str:
    if math.isinf(maximum) or maximum == (1 << 63) - 1:
        return f"at least {minimum:g}"
    if math.isinf(minimum):
        return f"at most {maximum:g}"
    return f"from {minimum:g} to {maximum:g}"
