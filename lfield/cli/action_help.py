"""Help of a command such as `lfield keys`, and of the actions below it, such as `lfield keys init`."""

from __future__ import annotations

from typing import TypedDict


class ActionHelp(TypedDict):
    """Keyword arguments of `add_parser`: the line in the list, and the first line of `--help`."""

    help: str
    description: str


def action_help(purpose: str) -> ActionHelp:
    """Both texts of a command or action from its purpose, which starts with a verb in lower case."""
    return ActionHelp(help=purpose, description=f"{purpose[0].upper()}{purpose[1:]}.")
