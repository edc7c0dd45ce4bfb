"""The page of all commands is generated from their argument parsers and describes every argument."""

from __future__ import annotations

from cli_page import PAGE, page


def test_command_page_is_current() -> None:
    assert PAGE.read_text(encoding="utf-8") == page(), "python tests/docs/cli_page.py --write"


def test_every_argument_has_a_help_text() -> None:
    assert [line for line in page().splitlines() if line.endswith("|  |")] == []
