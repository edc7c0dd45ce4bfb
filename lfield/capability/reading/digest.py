"""The digest of a registry: the same on every host whose registry gives the same answers.

SHA-256 over what was read and checked, written canonically. Comments, meanings, places, paths and the order
of files do not count.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any

from lfield.capability.model import Composition, Expression, Registry, Term

_IGNORED = frozenset({"span", "meaning", "digest"})
#: Of a term the name is for people; where the source of a class lies differs between hosts.
_IGNORED_OF = {Term: _IGNORED | {"name"}, Composition: _IGNORED | {"source"}}


def digest(registry: Registry) -> bytes:
    """32 bytes that differ between registries that could give different answers."""
    text = json.dumps(_canonical(registry), sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).digest()


def _canonical(value: object) -> object:
    """A value as JSON has it. Mappings are sorted later; of needs the order counts, as in arguments."""
    if isinstance(value, Expression):
        return value.text
    if isinstance(value, Composition):
        return [list(value.needs), _record(value)]
    if is_dataclass(value):
        return _record(value)
    if isinstance(value, Mapping):
        return {key: _canonical(item) for key, item in value.items()}
    if isinstance(value, frozenset):
        return sorted(value)
    return [_canonical(item) for item in value] if isinstance(value, tuple) else value


def _record(value: Any) -> dict[str, object]:
    ignored = _IGNORED_OF.get(type(value), _IGNORED)
    names = (field.name for field in fields(value) if field.name not in ignored)
    return {name: _canonical(getattr(value, name)) for name in names}
