"""Every relative link of every Markdown file has a target."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import unquote

import pytest

ROOT = Path(__file__).resolve().parents[2]

#: Folders that contain no files of the project.
_FOREIGN = {"node_modules", "build", "dist"}

_FENCE = re.compile(r"^(```|~~~).*?^\1\s*$", re.MULTILINE | re.DOTALL)
_CODE = re.compile(r"`[^`\n]*`")
_LINK = re.compile(r"(?<!\\)\]\(\s*<?([^)\s>]+)>?(?:\s+\"[^\"]*\")?\s*\)")
_HEADING = re.compile(r"^#{1,6}\s+(.+?)\s*#*$", re.MULTILINE)
_ELSEWHERE = re.compile(r"[a-z][a-z0-9+.-]*:|//", re.IGNORECASE)


def markdown_files(root: Path) -> list[Path]:
    """All Markdown files of the project."""
    return sorted(
        path
        for path in root.rglob("*.md")
        if not any(part in _FOREIGN or part.startswith(".") for part in path.relative_to(root).parts[:-1])
    )


def links(text: str) -> Iterator[str]:
    """The targets of the inline links that are not in code."""
    prose = _FENCE.sub("", text)
    # The text of a link may be code, so code is replaced, not removed.
    yield from _LINK.findall(_CODE.sub("`code`", prose))


def anchors(text: str) -> set[str]:
    """The anchors that GitHub creates for the headings."""
    found: set[str] = set()
    for heading in _HEADING.findall(_FENCE.sub("", text)):
        plain = re.sub(r"[^\w\- ]", "", heading.replace("`", "").lower()).replace(" ", "-")
        number = 0
        while plain + (f"-{number}" if number else "") in found:
            number += 1
        found.add(plain + (f"-{number}" if number else ""))
    return found


def dead_links(path: Path) -> list[str]:
    """The relative links of a file without a target."""
    dead = []
    for link in links(path.read_text(encoding="utf-8")):
        if _ELSEWHERE.match(link):
            continue
        place, _, anchor = unquote(link).partition("#")
        target = path.parent / place if place else path
        if not target.exists():
            dead.append(f"{link}: there is no such file")
        elif anchor and target.suffix == ".md" and anchor not in anchors(target.read_text(encoding="utf-8")):
            dead.append(f"{link}: there is no such heading")
    return dead


@pytest.mark.parametrize("path", markdown_files(ROOT), ids=lambda p: str(p.relative_to(ROOT)))
def test_relative_links_have_targets(path: Path) -> None:
    assert dead_links(path) == []


def test_index_links_to_every_page() -> None:
    index = ROOT / "lfield/docs/README.md"
    found = set(links(index.read_text(encoding="utf-8")))
    assert {path.name for path in index.parent.glob("*.md")} - found == {index.name}


def test_dead_links_are_found(tmp_path: Path) -> None:
    (tmp_path / "other.md").write_text("# One `two`, three\n## Again\n## Again\n", encoding="utf-8")
    page = tmp_path / "page.md"
    page.write_text(
        "[a](other.md) [b](other.md#one-two-three) [c](other.md#again-1) [d](https://example.org/x)\n"
        "[`e`](#top)\n"
        "# Top\n"
        "```\n[in code](nowhere.md)\n```\n"
        "[f](nowhere.md) [g](other.md#four) [h](#bottom)\n",
        encoding="utf-8",
    )
    assert dead_links(page) == [
        "nowhere.md: there is no such file",
        "other.md#four: there is no such heading",
        "#bottom: there is no such heading",
    ]
