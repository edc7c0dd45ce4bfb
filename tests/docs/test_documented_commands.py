"""Every `lfield ...` line in a code block of the documentation is one that the command understands."""

from __future__ import annotations

import argparse
import re
import shlex
from importlib import import_module
from pathlib import Path
from typing import NoReturn

import pytest

from lfield.cli.main import COMMANDS, MODULES

ROOT = Path(__file__).resolve().parents[2]

#: The pages that a user copies commands from.
PAGES = [
    ROOT / "README.md",
    ROOT / "deploy/README.md",
    ROOT / "lfield/docs/operations.md",
    *sorted((ROOT / "examples").rglob("README.md")),
]

_BLOCK = re.compile(r"^```[^\n]*\n(.*?)^```", re.MULTILINE | re.DOTALL)
_LINE = re.compile(r"^(?:\$ )?(?:\.venv/bin/)?lfield (.+)$", re.MULTILINE)


class Strict(argparse.ArgumentParser):
    """A parser that raises instead of ending the process, and takes no abbreviated options."""

    def __init__(self, **options: object) -> None:
        super().__init__(**{"prog": "lfield", **options, "allow_abbrev": False})  # type: ignore[arg-type]

    def error(self, message: str) -> NoReturn:
        raise ValueError(message)


def command_lines(text: str) -> list[str]:
    """The command lines of the code blocks of a page, without `lfield`."""
    return [line for block in _BLOCK.findall(text) for line in _LINE.findall(block.replace("\\\n", " "))]


def understand(line: str) -> None:
    """Parse a command line as the command would; raises ValueError."""
    name, *words = shlex.split(line, comments=True)
    if name not in COMMANDS:
        raise ValueError(f"there is no subcommand '{name}'")
    parser = Strict()
    import_module(MODULES[name]).add_arguments(parser)
    parser.parse_args(words)


def documented() -> list[tuple[str, str]]:
    """Every command line of every page."""
    return [
        (str(page.relative_to(ROOT)), line)
        for page in PAGES
        for line in command_lines(page.read_text(encoding="utf-8"))
    ]


@pytest.mark.parametrize(("page", "line"), documented())
def test_documented_commands_parse(page: str, line: str) -> None:
    understand(line)


def test_the_readme_has_commands() -> None:
    used = {line.split()[0] for page, line in documented() if page == "README.md"}
    assert {"check", "up", "ps", "disasm", "sim"} <= used


@pytest.mark.parametrize(
    "line", ["fly --deploy m.dL", "up --deploy m.dL --everything", "up --all", "ps m.dL n.dL"]
)
def test_wrong_commands_are_noticed(line: str) -> None:
    with pytest.raises(ValueError, match=r"."):
        understand(line)


def test_only_code_blocks_are_read() -> None:
    page = "lfield up --now\n```sh\n# a comment\nlfield up \\\n --all\n$ lfield ps\nmake demo\n```\n"
    assert [line.split() for line in command_lines(page)] == [["up", "--all"], ["ps"]]
