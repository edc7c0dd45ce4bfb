"""A question that only the answer 'yes' confirms."""

from __future__ import annotations

from lfield.text.terminal_escape import escape


def confirm(question: str) -> bool:
    """Ask in the terminal. End of input (Ctrl-D) means no."""
    try:
        return input(escape(question)).strip().lower() == "yes"
    except EOFError:
        print()
        return False
