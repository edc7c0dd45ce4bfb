"""Imports some texts as files would be, and reads what comes of it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path

from lfield.capability.importers import Imported, import_files
from lfield.capability.model import Registry
from lfield.capability.reading.reader import check_files, read_registry
from lfield.capability.reading.shipped import shipped


@cache
def ours() -> Registry:
    """The registry that comes with lfield."""
    return read_registry()


@dataclass(frozen=True)
class Imports:
    """A folder with files to be imported."""

    folder: Path

    def write(self, name: str, text: str | bytes) -> Path:
        path = self.folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return path

    def run(self, files: dict[str, str | bytes]) -> Imported:
        """Write some files and import them."""
        return import_files([self.write(name, text) for name, text in files.items()], ours())

    def registry(self, imported: Imported) -> Registry:
        """Ours together with what was imported; fails when it has any mistake."""
        out = self.write("out.yaml", imported.text)
        registry, found = check_files([*shipped(), out])
        assert registry is not None, "\n".join(d.render() for d in found) + imported.text
        assert found == []
        return registry
