"""Golden files: one per command, with a section per case, written by `pytest --rewrite tests/oracles`.

    === NAME OF THE CASE
    $ lfield check mission.dL
    | a line of stdout
    ! a line of stderr
    = 0

A long text is stored as its number of lines and its SHA-256.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Collection
from pathlib import Path

FOLDER = Path(__file__).parent / "golden"
#: The most characters of an output that are stored completely.
MOST = 12_000
_SECTION = re.compile(r"^=== (.*)\n", re.MULTILINE)


class GoldenFile:
    """The sections of one file. With `rewrite` a section that differs is replaced, otherwise a test fails."""

    def __init__(self, name: str, *, rewrite: bool = False, folder: Path = FOLDER) -> None:
        self.path, self._rewrite = folder / f"{name}.txt", rewrite

    @property
    def sections(self) -> dict[str, str]:
        """The texts by section."""
        text = self.path.read_text(encoding="utf-8") if self.path.exists() else ""
        _, *parts = _SECTION.split(text)
        return dict(zip(parts[::2], parts[1::2], strict=True))

    def check(self, section: str, text: str) -> None:
        """Compare a section with the current text, which ends with a line feed."""
        sections = self.sections
        if self._rewrite and sections.get(section) != text:
            self._write(sections | {section: text})
            return
        assert section in sections, f"{self.path.name} has no section '{section}': run pytest with --rewrite"
        assert text == sections[section], f"'{section}' of {self.path.name} has changed"

    def has_only(self, sections: Collection[str]) -> None:
        """Compare the names of the sections with those of the cases; `--rewrite` removes the others."""
        found = self.sections
        if self._rewrite:
            self._write({section: found[section] for section in sections if section in found})
            return
        assert sorted(found) == sorted(sections)

    def _write(self, sections: dict[str, str]) -> None:
        self.path.parent.mkdir(exist_ok=True)
        texts = (f"=== {section}\n{text}" for section, text in sections.items())
        self.path.write_text("".join(texts), encoding="utf-8")


def shortened(text: str, most: int = MOST) -> str:
    """The text, or a digest of a text longer than the limit."""
    if len(text) <= most:
        return text
    return f"({text.count(chr(10))} lines, SHA-256 {digest(text)})\n"


def digest(data: str | bytes) -> str:
    """The first half of the SHA-256 of a text or of bytes."""
    return hashlib.sha256(data.encode() if isinstance(data, str) else data).hexdigest()[:32]
