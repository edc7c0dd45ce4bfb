"""The page of all commands, from their argument parsers: `python tests/docs/cli_page.py --write`.

This module formats the text itself, because the layout of argparse differs between versions of Python.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path

from lfield.cli.main import COMMANDS, MODULES

PAGE = Path(__file__).resolve().parents[2] / "lfield" / "docs" / "cli.md"

_HEAD = """\
# Commands

`lfield COMMAND --help` prints the same. The most frequent exit statuses are 0 (done), 64 (wrong
command line), 65 (unusable file) and 69 (no mission is running, or a port, device or host is
unavailable); [one table](exit-statuses.md) has all, and
[operations](operations.md) explains how the commands are used. This page is generated:
`python tests/docs/cli_page.py --write`.

"""


def page() -> str:
    """The whole page: a table of the commands, then a section for each."""
    table = "\n".join(
        f"| [`{name}`](#lfield-{name}) | {_cell(purpose)} |" for name, purpose in COMMANDS.items()
    )
    sections = "".join(_section(f"lfield {name}", parser(name), 2) for name in COMMANDS)
    return f"{_HEAD}| command | purpose |\n|---|---|\n{table}\n{sections}"


def parser(name: str) -> argparse.ArgumentParser:
    """The parser of one command, as `lfield` makes it."""
    purpose = COMMANDS[name]
    made = argparse.ArgumentParser(prog=f"lfield {name}", description=f"{purpose[0].upper()}{purpose[1:]}.")
    import_module(MODULES[name]).add_arguments(made)
    return made


def _section(title: str, command: argparse.ArgumentParser, level: int) -> str:
    rows = "".join(
        f"| {_cell(_name(action))} | {_meaning(action)} |\n"
        for action in command._actions
        if not isinstance(action, argparse._HelpAction | argparse._SubParsersAction)
        and action.help != argparse.SUPPRESS
    )
    options = f"\n| argument | meaning |\n|---|---|\n{rows}" if rows else ""
    text = f"\n{'#' * level} {title}\n\n{_sentence(command.description)}\n{options}"
    below = "".join(_section(f"{title} {name}", each, level + 1) for name, each in _actions_of(command))
    return text + below


def _actions_of(command: argparse.ArgumentParser) -> Iterator[tuple[str, argparse.ArgumentParser]]:
    """The subcommands of a command, such as `keys init`. Without a description they get their help."""
    for action in command._actions:
        if isinstance(action, argparse._SubParsersAction):
            helps = {each.dest: each.help for each in action._choices_actions}
            for name, below in action.choices.items():
                below.description = below.description or helps.get(name)
                yield name, below


def _name(action: argparse.Action) -> str:
    values = _values(action)
    if not action.option_strings:
        return f"`{values}`"
    names = ", ".join(f"`{each}`" for each in action.option_strings)
    return names if action.nargs == 0 else f"{names} `{values}`"


def _values(action: argparse.Action) -> str:
    if action.metavar is not None:
        return action.metavar if isinstance(action.metavar, str) else " ".join(action.metavar)
    if action.choices is not None:
        return ",".join(map(str, action.choices))
    return action.dest if not action.option_strings else action.dest.upper()


def _meaning(action: argparse.Action) -> str:
    return _cell((action.help or "") % {**vars(action), "prog": "lfield"})


def _sentence(text: str | None) -> str:
    sentence = " ".join((text or "").split())
    return sentence if sentence.endswith(".") or not sentence else f"{sentence[0].upper()}{sentence[1:]}."


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|")


if __name__ == "__main__":
    if sys.argv[1:] == ["--write"]:
        PAGE.write_text(page(), encoding="utf-8")
    else:
        print(page(), end="")
