"""Descriptions of robots in other formats, as files of a registry.

Known are the specs of the ROS package `capabilities` (ros.py) and factsheets of VDA 5050 (vda5050.py); which
one a file is, its content tells. What cannot be carried over is said, never dropped silently.
"""

from __future__ import annotations

from collections.abc import Mapping as AnyMapping
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from lfield.capability.importers import json_source, ros, vda5050
from lfield.capability.importers.draft import Draft
from lfield.capability.importers.messages import UNKNOWN_FILE
from lfield.capability.importers.writing import written
from lfield.capability.model import Registry
from lfield.errors import ProgramError
from lfield.text.files import read_bytes
from lfield.text.source import Diagnostics, Source, Span
from lfield.text.yaml_source import MAX_BYTES, Mapping, decode

#: What may stand before the first brace: a byte order mark, and space.
_BEFORE = b"\xef\xbb\xbf \t\r\n"


@dataclass(frozen=True, slots=True)
class Imported:
    """The text of a registry file, and what it could not carry over, a sentence each."""

    text: str
    notes: tuple[str, ...]


def import_files(paths: Sequence[Path], registry: Registry) -> Imported:
    """All files as one, to be used together with `registry`, from which its attributes are.

    Raises InputFileError, and ProgramError with everything that is no such file.
    """
    draft, found = Draft(registry), Diagnostics()
    specs: list[ros.Spec] = []
    for path in paths:
        data = read_bytes(path, MAX_BYTES)
        if data.lstrip(_BEFORE)[:1] == b"{":
            _add_json(path, data, draft, found)
        elif (spec := _spec(path, data, found)) is not None:
            specs.append(spec)
    if found.errors:
        raise ProgramError(found.errors)
    ros.add_specs(specs, draft)
    return Imported(written(draft, [path.name for path in paths]), tuple(draft.notes))


def _spec(path: Path, data: bytes, found: Diagnostics) -> ros.Spec | None:
    node = decode(str(path), data, found)
    if node is None:
        return None
    kind = ros.kind_of(node)
    if kind is None or not isinstance(node, Mapping):
        found.add(UNKNOWN_FILE.at(node.span))
        return None
    return ros.read_spec(path, kind, node, found)


def _add_json(path: Path, data: bytes, draft: Draft, found: Diagnostics) -> None:
    sheet = json_source.decode(str(path), data, found)
    if isinstance(sheet, AnyMapping) and vda5050.SIGN in sheet:
        vda5050.add_factsheet(str(path), sheet, draft)
    elif sheet is not None:
        text = Source(str(path), data.decode("utf-8", "replace"))
        found.add(UNKNOWN_FILE.at(Span(text, 0, 1)))
