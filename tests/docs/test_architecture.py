"""The architecture page names existing files and functions, and the packages of the diagram."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "lfield" / "docs" / "architecture.md"
PICTURE = PAGE.with_name("packages.svg")

WALKS = (
    "From text to a running mission",
    "A hop",
    "From an instruction to bytes on the wire, and back",
    "From a query to an offer",
)

_STEP = re.compile(r"(\d+)\. \[`([^`]+)`\]\(([^)]+)\) `([^`]+)`: \S")
_PACKAGE = re.compile(r"\| `(\w+)` \|")


#: A row of the table "Where is it implemented?": topic, module with link, class or method, remark.
_PLACE = re.compile(r"\| [^|]+ \| \[`([^`]+)`\]\(([^)]+)\) \| `([^`]+)` \| [^|]+ \|")
#: Topics that the table must contain.
_TOPICS = (
    *("**hop**", "**host call**", "**stop**", "**pause**", "**lease**", "**revocation**"),
    *("**journal write**", "**watchdog**", "**geofence**", "**limits**", "**reservation**", "**vote**"),
)


class Step(NamedTuple):
    """A line of a walk: a file of the project, and the name in it that the line describes."""

    number: int
    path: str
    link: str
    name: str


def section(heading: str, level: int = 2) -> str:
    """The text of a section with its subsections."""
    page = PAGE.read_text(encoding="utf-8")
    mark = "#" * level
    found = re.search(rf"^{mark} {re.escape(heading)}\n(.*?)(?=^#{{1,{level}}} |\Z)", page, re.M | re.S)
    assert found, f"the page has no section '{heading}'"
    return found[1]


def numbered(text: str) -> list[str]:
    """The lines of lists with numbers."""
    return [line for line in text.splitlines() if re.match(r"\s*\d+\.\s", line)]


def steps(walk: str) -> list[Step]:
    """The steps of a walk. Fails if a numbered line is not a step."""
    found = []
    for line in numbered(section(walk, level=3)):
        step = _STEP.match(line)
        assert step, f"no `path`, link, `name` and clause: {line}"
        found.append(Step(int(step[1]), step[2], step[3], step[4]))
    return found


def contains_name(path: Path, name: str) -> bool:
    """Whether a file defines `Class.method`, or contains a name without a dot as a word."""
    text = path.read_text(encoding="utf-8")
    if "." in name:
        return name in set(defined(ast.parse(text).body))
    return re.search(rf"\b{re.escape(name)}\b", text) is not None


def defined(body: list[ast.stmt], prefix: str = "") -> Iterator[str]:
    """The functions and classes of a module with their dotted names."""
    for node in body:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            yield prefix + node.name
        if isinstance(node, ast.ClassDef):
            yield from defined(node.body, f"{prefix}{node.name}.")


@pytest.mark.parametrize("walk", WALKS)
def test_steps_of_a_walk_name_existing_files_and_names(walk: str) -> None:
    path = steps(walk)
    assert path[0].number == 1
    # The numbers of a part of a walk that starts at another module start at 1.
    assert all(after.number in (before.number + 1, 1) for before, after in pairwise(path))
    missing = [step.path for step in path if not (ROOT / step.path).is_file()]
    assert missing == []
    wrong = [step.link for step in path if (PAGE.parent / step.link).resolve() != ROOT / step.path]
    assert wrong == []
    unknown = [f"{step.path}: {step.name}" for step in path if not contains_name(ROOT / step.path, step.name)]
    assert unknown == []


def test_implementation_table_names_existing_code() -> None:
    table = section("Where is it implemented?")
    rows = [row for row in table.splitlines() if row.startswith("| ")][1:]
    places = [_PLACE.fullmatch(row) for row in rows]
    assert [row for row, place in zip(rows, places, strict=True) if place is None] == []
    wrong = [
        place[0]
        for place in places
        if place
        and (
            (PAGE.parent / place[2]).resolve() != ROOT / place[1]
            or not contains_name(ROOT / place[1], place[3])
        )
    ]
    assert wrong == []
    assert [topic for topic in _TOPICS if topic not in table] == []


def test_there_are_no_other_walks() -> None:
    headings = re.findall(r"^### (.+)$", section("Four walks"), re.MULTILINE)
    assert headings == list(WALKS)


def test_package_table_equals_the_diagram() -> None:
    listed = _PACKAGE.findall(section("Packages"))
    drawn = re.findall(r"<text[^>]*>([^<]+)</text>", PICTURE.read_text(encoding="utf-8"))
    assert sorted(listed) == sorted(drawn)


def test_architecture_page_shows_the_diagram() -> None:
    assert f"]({PICTURE.name})" in section("Packages")


def test_names_are_found_where_they_are_defined(tmp_path: Path) -> None:
    code = tmp_path / "code.py"
    code.write_text("class A:\n    def f(self):\n        g()\n\nasync def h(): ...\n", encoding="utf-8")
    assert [
        name for name in ("A", "A.f", "g", "h", "A.g", "B.f", "k", "f.A") if contains_name(code, name)
    ] == [
        "A",
        "A.f",
        "g",
        "h",
    ]
