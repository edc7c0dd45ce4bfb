"""What an import has made so far: entries of a registry with names of their own, and what was left behind."""

from __future__ import annotations

import re
from collections.abc import Collection
from dataclasses import dataclass, field
from typing import Any

from lfield.capability.model import Registry
from lfield.capability.reading.draft import MAX_NAME
from lfield.capability.reading.signatures import RESERVED, RESERVED_TYPES
from lfield.lang.scanner import KEYWORDS

#: Most notes that are kept of one file, and most characters of a foreign text in any of them.
MAX_NOTES, MAX_TEXT = 200, 300

#: Most characters of a name that is made, before a number may follow.
_LONGEST = 30

_WORD = re.compile(r"[A-Za-z0-9]+")


@dataclass(slots=True)
class Draft:
    """Sections of a registry as plain data, beside the `registry` they shall be added to.

    `notes` say, file by file, what could not be carried over.
    """

    registry: Registry
    taxonomy: dict[str, dict[str, Any]] = field(default_factory=dict)
    primitives: dict[str, dict[str, Any]] = field(default_factory=dict)
    providers: dict[str, dict[str, Any]] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    _counts: dict[str, int] = field(default_factory=dict)

    def note(self, file: str, text: str) -> None:
        """Say what of a file could not be carried over."""
        count = self._counts[file] = self._counts.get(file, 0) + 1
        if count < MAX_NOTES:
            self.notes.append(f"{clean(file)}: {text}")
        elif count == MAX_NOTES:
            self.notes.append(f"{clean(file)}: and more that is not listed")

    def new_term(self, parent: str, name: str, qualifier: str = "") -> str:
        """An id below `parent` that no term has yet; below its root, where it would become too long."""
        taken = {*self.registry.terms, *self.taxonomy}
        taken.update(alias for term in self.registry.terms.values() for alias in term.aliases)
        above = parent if len(parent) + _LONGEST < MAX_NAME else parent.partition(".")[0]
        return _free(f"{above}.{snake(name)}", taken, f"{above}.{snake(f'{qualifier} {name}')}", "_")

    def new_type(self, name: str, qualifier: str = "") -> str:
        """A type in L that neither a primitive nor a provider has yet."""
        known = self.registry
        taken = {*known.primitives, *known.providers, *self.primitives, *self.providers, *RESERVED_TYPES}
        return _free(camel(name), taken, camel(f"{qualifier} {name}"), "")


def _free(wish: str, taken: Collection[str], second: str, joint: str) -> str:
    """The wish, or the second wish, or that with the least number behind it that makes it new."""
    for name in (wish, second):
        if name not in taken:
            return name
    number = 2
    while f"{second}{joint}{number}" in taken:
        number += 1
    return f"{second}{joint}{number}"


def clean(text: str) -> str:
    """A foreign text on one line, without characters that a terminal or YAML would obey."""
    words = "".join(ch if ch.isprintable() else " " for ch in text).split()
    line = " ".join(words)
    return line if len(line) <= MAX_TEXT else f"{line[: MAX_TEXT - 3]}..."


def words_of(name: str) -> list[str]:
    """The words in a name, however it joins them: `set_info`, `FrontRGBCamera`, `Agilox ONE 2.0`."""
    parted = re.sub(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", " ", name[:MAX_TEXT])
    return _WORD.findall(parted)[:8]


def snake(name: str) -> str:
    """As a part of a dotted id: `front_rgb_camera`."""
    text = "_".join(words_of(name)).lower()[:_LONGEST]
    return text if text[:1].isalpha() else f"x_{text}".rstrip("_")


def camel(name: str) -> str:
    """As a type in L: `FrontRgbCamera`."""
    text = "".join(word.capitalize() for word in words_of(name))[:_LONGEST]
    return text if text[:1].isalpha() else f"X{text}"


def portal_name(name: str, taken: Collection[str] = ()) -> str:
    """As a portal in L: `setInfo`."""
    upper = camel(name)
    text = upper[0].lower() + upper[1:]
    if text in KEYWORDS or text in RESERVED:
        text = f"do{upper}"
    return _free(text, taken, text, "")
