"""The editor files in deploy/editors are valid and complete, and contain the keywords of the language."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from lfield import __version__
from lfield.cli.main import COMMANDS
from lfield.lang.scanner import KEYWORDS

FOLDER = Path(__file__).resolve().parents[2] / "deploy/editors/vscode"
PACKAGE: dict[str, Any] = json.loads((FOLDER / "package.json").read_text(encoding="utf-8"))
GRAMMARS = sorted((FOLDER / "syntaxes").glob("*.json"))


def patterns(node: object) -> Iterator[str]:
    """The regular expressions of a grammar."""
    if isinstance(node, list):
        for one in node:
            yield from patterns(one)
    elif isinstance(node, dict):
        for key, value in node.items():
            if key in ("match", "begin", "end"):
                yield value
            else:
                yield from patterns(value)


def grammar(path: Path) -> str:
    """All patterns of a grammar. Fails if a pattern is not a regular expression."""
    found = list(patterns(json.loads(path.read_text(encoding="utf-8"))))
    for one in found:
        re.compile(one)
    return "\n".join(found)


def test_every_keyword_is_in_the_grammar() -> None:
    text = grammar(FOLDER / "syntaxes/l.tmLanguage.json")
    soft = {"together", "within", "reserve", "finally", "specific", "loop", "every", "priority", "when"}
    assert {name for name in KEYWORDS | soft if not re.search(rf"\b{name}\b", text)} == set()


@pytest.mark.parametrize(
    ("line", "groups"),
    [
        ("//Copter:lead@alpha:8181?x&y", (None, "//", "Copter", ":", "lead", "@", "alpha", ":8181", "?x&y")),
        ("Copter:lead@[::1]", (None, None, "Copter", ":", "lead", "@", "[::1]", None, None)),
        ("startable Copter:a@b?x", ("startable", None, "Copter", ":", "a", "@", "b", None, "?x")),
    ],
)
def test_deployment_line_is_split_by_the_grammar(line: str, groups: tuple[str | None, ...]) -> None:
    entry = grammar(FOLDER / "syntaxes/l-deployment.tmLanguage.json").split("\n")[1]
    found = re.match(entry, line)
    assert found is not None
    assert found.groups() == groups


def test_every_file_named_by_the_extension_exists() -> None:
    contributed = PACKAGE["contributes"]
    named = [PACKAGE["main"], *(one["configuration"] for one in contributed["languages"])]
    named += [one["path"] for one in contributed["grammars"]]
    assert [name for name in named if not (FOLDER / name).is_file()] == []
    assert {FOLDER / one["path"] for one in contributed["grammars"]} == set(GRAMMARS)
    for name in named[1:]:
        json.loads((FOLDER / name).read_text(encoding="utf-8"))
    assert [one["extensions"] for one in contributed["languages"]] == [[".L"], [".dL"]]
    assert PACKAGE["version"] == __version__
    assert {"lsp", "debug"} <= COMMANDS.keys()
