"""Plain data as the YAML of a registry."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from lfield.capability.importers.draft import Draft, clean

_BARE = re.compile(r"[A-Za-z][A-Za-z0-9_.]*")
_WORDS = ("true", "false", "null")


def written(draft: Draft, files: Iterable[str]) -> str:
    """The file of a draft: where it comes from, what it leaves out, and its sections."""
    lines = [f"# Imported from {', '.join(map(clean, files))}.", "# Look it over before you use it."]
    if draft.notes:
        lines += ["#", "# Not carried over:", *(f"#   {note}" for note in draft.notes)]
    lines += ["registry: 1"]
    sections = {
        "taxonomy": draft.taxonomy,
        "primitives": draft.primitives,
        "providers": draft.providers,
    }
    for name, section in sections.items():
        if section:
            lines += ["", *_entry(name, section, "")]
    return "\n".join([*lines, ""])


def _entry(key: str, value: Any, indent: str) -> Iterator[str]:
    if isinstance(value, Mapping) and value:
        yield f"{indent}{_text(key)}:"
        for below, inner in value.items():
            yield from _entry(below, inner, f"{indent}  ")
    else:
        yield f"{indent}{_text(key)}: {_value(value)}"


def _value(value: Any) -> str:
    match value:
        case str():
            return _text(value)
        case list():
            return f"[{', '.join(map(_value, value))}]"
        case Mapping():
            return "{}"
        case _:
            return json.dumps(value)


def _text(text: str) -> str:
    """Bare where it cannot be mistaken, else in double quotes, whose escapes YAML shares with JSON."""
    text = clean(text)
    bare = _BARE.fullmatch(text) and text.lower() not in _WORDS
    return text if bare else json.dumps(text, ensure_ascii=False)
