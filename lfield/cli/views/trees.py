"""Trees on standard output: drawn with lines in a terminal, indented in a file or pipe."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING

from lfield.operator.registry.taxonomy import TreeBranch
from lfield.text.terminal_escape import unescaped_stream

if TYPE_CHECKING:
    from rich.console import Console
    from rich.text import Text
    from rich.tree import Tree

#: Columns of output that no terminal shows: more than any line has.
UNFOLDED = 10_000


def plain_console() -> Console:
    """Standard output without markup, with control characters escaped.

    Lines are folded to the width of a terminal; in a file or pipe each row is one line.
    """
    from lfield.cli.views.console import PlainConsole

    console = PlainConsole(file=unescaped_stream(sys.stdout), markup=False, highlight=False, emoji=False)
    if not console.is_terminal:
        console.width = UNFOLDED
    return console


def print_tree(branches: Iterable[TreeBranch]) -> None:
    """Print trees, one below the other."""
    console = plain_console()
    for branch in branches:
        if console.is_terminal:
            console.print(_drawn(branch))
        else:
            print("\n".join(_indented(branch, "")))


def _indented(branch: TreeBranch, indent: str) -> Iterator[str]:
    mark = f" [{branch.mark}]" if branch.mark else ""
    yield f"{indent}{branch.text}{mark}"
    for child in branch.children:
        yield from _indented(child, f"{indent}  ")


def _drawn(branch: TreeBranch) -> Tree:
    from rich.tree import Tree

    tree = Tree(_label(branch))
    for child in branch.children:
        tree.children.append(_drawn(child))
    return tree


def _label(branch: TreeBranch) -> Text:
    from rich.text import Text

    name, colon, description = branch.text.partition(": ")
    label = Text(name, style="bold" if branch.mark else "")
    label.append(colon + description, style="dim")
    if branch.mark:
        label.append(f" [{branch.mark}]", style="cyan")
    return label
