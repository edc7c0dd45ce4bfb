"""Control characters are escaped before text reaches a terminal."""

import io
import re

import pytest
import rich.table
from hypothesis import given
from hypothesis import strategies as st
from rich.text import Text

from lfield.cli.views.console import PlainConsole
from lfield.text.message_tables import FindingTable
from lfield.text.source_text import Diagnostic, Source, Span
from lfield.text.terminal_escape import (
    ESCAPES,
    escape,
    escape_indented,
    escape_line,
    escaping_stream,
    printable_argument,
    truncate,
    unescaped_stream,
)


@pytest.mark.parametrize(
    ("text", "escaped"),
    [
        ("plain", "plain"),
        ("ü 日本 🤖 \u00a0", "ü 日本 🤖 \u00a0"),
        ("a\x1b[2Jb", "a\\u{1b}[2Jb"),
        ("\x9b31m", "\\u{9b}31m"),
        ("over\rwritten", "over\\rwritten"),
        ("bell\a\b", "bell\\u{7}\\u{8}"),
        ("\u202egnp.exe", "\\u{202e}gnp.exe"),
        ("a\ud800", "a\\u{d800}"),
        ("two\n\tlines\0", "two\n\tlines\\0"),
    ],
)
def test_control_characters_are_escaped(text: str, escaped: str) -> None:
    assert escape(text) == escaped


@pytest.mark.parametrize(
    ("word", "text"),
    [("grün\n\x1b", "grün\n\x1b"), ("gr\udcf6\udcdfe", r"gr\u{dcf6}\u{dcdf}e"), ("\ud83e", r"\u{d83e}")],
)
def test_undecodable_bytes_are_escaped(word: str, text: str) -> None:
    assert printable_argument(word) == text
    text.encode()


def test_characters_outside_an_encoding_are_escaped() -> None:
    assert "ü\udcff日".encode("latin-1", ESCAPES) == b"\xfc\\u{dcff}\\u{65e5}"
    with pytest.raises(UnicodeDecodeError):
        b"\xff".decode("ascii", ESCAPES)


@given(st.text())
def test_escaped_line_is_one_line(text: str) -> None:
    escaped = escape_line(text)
    assert len(escaped.splitlines()) <= 1
    assert not any(ord(ch) < 32 or 127 <= ord(ch) < 160 for ch in escaped)
    assert escape_line(escaped) == escaped


@pytest.mark.parametrize(
    ("text", "escaped"),
    [
        ("one", "one"),
        ("died\n    at fly:3", "died\n    at fly:3"),
        ("fire\nbravo is safe\n  so\n", "fire\n    bravo is safe\n      so\n"),
        ("two\n\x1b[2J", "two\n    \\u{1b}[2J"),
    ],
)
def test_text_with_lines_is_indented(text: str, escaped: str) -> None:
    assert escape_indented(text) == escaped


def test_long_text_is_truncated() -> None:
    assert (truncate("abcd", 4), truncate("abcde", 4)) == ("abcd", "abc…")


def test_finding_is_bounded_and_escaped() -> None:
    source = Source("a\x1bb.L", "x" * 7000)
    found = FindingTable("L3", warnings="L9").message("L301", "no '{name}' here", "declare {name}")
    output = found.at(Span(source, 0, 7000), name="x" * 7000).render()
    assert max(map(len, output.splitlines())) <= 260
    assert Diagnostic("L1", "an \x1b[31mid", Span(source, 0, 1), "say \a").render().splitlines() == [
        "a\\u{1b}b.L:1:1: error[L1]: an \\u{1b}[31mid",
        "    " + "x" * 160,
        "    ^",
        "    hint: say \\u{7}",
    ]


class TerminalStream(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_terminal_gets_escaped_text_and_a_file_all_bytes() -> None:
    text = "\x1b[31mred\x9b2J\ttab\r\n"
    terminal, file = TerminalStream(), io.StringIO()
    print(text, end="", file=escaping_stream(terminal))
    print(text, end="", file=escaping_stream(file))
    assert terminal.getvalue() == "\\u{1b}[31mred\\u{9b}2J\ttab\\r\n"
    assert file.getvalue() == text
    wrapped_twice = escaping_stream(escaping_stream(terminal))
    wrapped_twice.flush()
    assert (wrapped_twice.isatty(), unescaped_stream(wrapped_twice), unescaped_stream(file)) == (
        True,
        terminal,
        file,
    )


def test_table_on_a_terminal_has_control_sequences_of_rich_only() -> None:
    terminal = TerminalStream()
    table = rich.table.Table("NOW")
    table.add_row(Text("\x1b]0;title\x07", style="bold"))
    table.add_row("\x1b[2J")
    PlainConsole(file=terminal, markup=False, width=40).print(table)
    output = re.sub("\x1b\\[[0-9;]*m", "", terminal.getvalue())
    assert "\x1b" not in output
    assert "\x07" not in output
    assert "\\u{1b}]0" in output
    assert "\\u{1b}[2" in output
