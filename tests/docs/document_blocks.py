"""The fenced blocks of the documents: their place, their kind, and their content.

The words behind the fence state the kind of a block, visible in the page's source:

    java FILE.L            a whole program; the file's name may be left out; `wrong` behind it: bad
    java statements        of a method; `of TYPE NAME` gives it a device: `java statements of Mavlink fc`
    text FILE.dL           a deployment, `of PROGRAM.L` if it is not that of the same name
    yaml FILE.SUFFIX       a devices file (`.devices.yaml`) or a registry; without a name the keys tell which
    yaml device DRIVER     devices of an agent; `yaml options DRIVER`: keys of one device
    sh                     lines for a shell; each ends with 0, or as its comment says: `# status 65`
    text output            what the lines before it print, or those of its own that begin with `$ `; figures
                           aside; `...` stands for any lines
    text drawing           nothing to run
    python json ebnf mermaid udev    what they say
"""

from __future__ import annotations

import re
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]

_OPENING = re.compile(r"^((?:[ >]|[-*+] |[0-9]+[.)] )*)(`{3,}|~{3,})([^`]*)$")


@dataclass(frozen=True)
class Block:
    """One fenced block; `line` is that of its fence, `text` without the indentation of the fence."""

    page: str
    line: int
    info: str
    text: str

    @property
    def place(self) -> str:
        """The place of the block, for messages."""
        return f"{self.page}:{self.line}"

    @property
    def language(self) -> str:
        """The first word behind the fence."""
        return self.info.partition(" ")[0]

    @property
    def words(self) -> list[str]:
        """The other words."""
        return self.info.split()[1:]

    @property
    def file(self) -> str:
        """The name of the file that the block is, or ''."""
        return self.words[0] if self.words and "." in self.words[0] else ""


def blocks_of(page: str, text: str) -> Iterator[Block]:
    """Every fenced block of a page, in order. An unclosed one ends with the page."""
    lines = iter(enumerate(text.splitlines(), 1))
    for number, line in lines:
        opening = _OPENING.match(line)
        if opening is None:
            continue
        margin, fence, info = opening.groups()
        closing = re.compile(rf"[ >]*{fence[0]}{{{len(fence)},}}\s*")
        found = []
        for _, inside in lines:
            if closing.fullmatch(inside):
                break
            found.append(_without(margin, inside))
        yield Block(page, number, info.strip(), "".join(f"{each}\n" for each in found))


def _without(margin: str, line: str) -> str:
    """A line without the margin of its fence, as far as present."""
    return line[: len(margin)].lstrip(" >") + line[len(margin) :]


def pages() -> list[str]:
    """Every tracked page, from the root of the repository."""
    listed = subprocess.run(
        ["git", "ls-files", "*.md", "*.md.in"], cwd=ROOT, capture_output=True, text=True, check=True
    )
    return [page for page in listed.stdout.splitlines() if (ROOT / page).is_file()]


def blocks_by_page() -> dict[str, list[Block]]:
    """The blocks of every page that has some."""
    found = {page: list(blocks_of(page, (ROOT / page).read_text(encoding="utf-8"))) for page in pages()}
    return {page: blocks for page, blocks in found.items() if blocks}


def shell_lines(text: str) -> list[str]:
    """The command lines of a block: continued ones joined, without comments of their own and prompts."""
    lines = text.replace("\\\n", " ").splitlines()
    return [line.removeprefix("$ ") for line in lines if line.strip() and not line.lstrip().startswith("#")]


def without_comment(line: str) -> str:
    """A command line without its comment."""
    return re.sub(r"\s+#.*", "", line)
