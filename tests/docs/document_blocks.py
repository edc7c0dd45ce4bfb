"""The fenced blocks of the documents: their place, their kind, and their content.

The words after the opening fence state the kind of a block. Only the source of the page shows them:

    java FILE.L            a whole program; the file name is optional; `wrong` after it: an error is expected
    java statements        statements of a method; `of TYPE NAME` adds a device: `statements of Mavlink fc`
    text FILE.dL           a deployment, with `of PROGRAM.L` if its program has another name
    yaml FILE.SUFFIX       a devices file (`.devices.yaml`) or a registry; without a name, its keys decide
    yaml device DRIVER     devices of an agent
    yaml options DRIVER    keys of one device
    sh                     shell commands; the exit status is 0, or the one in the comment: `# status 65`
    text output            the output of the commands before it, or of its own lines that begin with `$ `;
                           figures may differ, and `...` stands for any lines
    text drawing           a drawing in characters
    python json ebnf mermaid udev    text in this language
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
    """One fenced block: `line` is the line of its fence, `text` has no indentation of the fence."""

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
        """The first word after the fence."""
        return self.info.partition(" ")[0]

    @property
    def words(self) -> list[str]:
        """The words after the first one."""
        return self.info.split()[1:]

    @property
    def file(self) -> str:
        """The file name of the block, or ''."""
        return self.words[0] if self.words and "." in self.words[0] else ""


def blocks_of(page: str, text: str) -> Iterator[Block]:
    """Every fenced block of a page, in order. A block without a closing fence ends at the end of the page."""
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
    """A line without the margin of its fence, or without the part of the margin that it has."""
    return line[: len(margin)].lstrip(" >") + line[len(margin) :]


def pages() -> list[str]:
    """The paths of all tracked pages, relative to the root of the repository."""
    listed = subprocess.run(
        ["git", "ls-files", "*.md", "*.md.in"], cwd=ROOT, capture_output=True, text=True, check=True
    )
    return [page for page in listed.stdout.splitlines() if (ROOT / page).is_file()]


def blocks_by_page() -> dict[str, list[Block]]:
    """The blocks of each page that has at least one block."""
    found = {page: list(blocks_of(page, (ROOT / page).read_text(encoding="utf-8"))) for page in pages()}
    return {page: blocks for page, blocks in found.items() if blocks}


def shell_lines(text: str) -> list[str]:
    """The command lines of a block: continued lines are joined, comment lines and prompts are removed."""
    lines = text.replace("\\\n", " ").splitlines()
    return [line.removeprefix("$ ") for line in lines if line.strip() and not line.lstrip().startswith("#")]


def without_comment(line: str) -> str:
    """A command line without its comment."""
    return re.sub(r"\s+#.*", "", line)
