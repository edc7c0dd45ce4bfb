"""Bytes of a terminal, a pipe or a file as lines of input."""

from __future__ import annotations

import asyncio
import os
import sys
from functools import partial

import pytest

from lfield.host.process.operator_terminal import LineSplitter, read_standard_input
from lfield.host.process.parent_pipe import ParentPipe, exit_line, typed_line
from lfield.text import log_messages
from lfield.vm.waits.operator_input import MAX_LINE

LONG = "x" * MAX_LINE
WIDE = "\N{ROBOT FACE}" * MAX_LINE


@pytest.mark.parametrize(
    ("chunks", "lines", "cuts"),
    [
        ([b"yes\n"], ["yes"], 0),
        ([b"y", b"es\r\n", b"no"], ["yes", "no"], 0),
        ([b"\n\n"], ["", ""], 0),
        ([b"caf\xc3", b"\xa9\n"], ["caf\u00e9"], 0),
        ([b"\xff\xfe go\n"], ["\ufffd\ufffd go"], 0),
        ([LONG.encode() + b"\n"], [LONG], 0),
        ([LONG.encode() + b"y\nz\n"], [LONG, "z"], 1),
        ([WIDE.encode(), b"\n"], [WIDE], 0),
        ([WIDE.encode(), b"more", b"more\nno\n"], [WIDE, "no"], 1),
        ([b""], [], 0),
    ],
    ids=range(10),
)
def test_bytes_are_split_into_lines(chunks: list[bytes], lines: list[str], cuts: int) -> None:
    found, cut = list[str](), list[int]()
    splitter = LineSplitter(found.append, lambda: cut.append(1))
    for chunk in chunks:
        splitter.feed(chunk)
    splitter.close()
    assert (found, len(cut)) == (lines, cuts)


@pytest.mark.parametrize("data", [b"yes\nno\n", b"x" * (4 * MAX_LINE + 1)])
def test_standard_input_is_read_to_its_end(data: bytes, monkeypatch, tmp_path) -> None:
    """A regular file, which has no readiness."""
    (tmp_path / "answers").write_bytes(data)
    found, said, over = list[str](), list[str](), asyncio.Event()

    def on_line(text: str) -> None:
        found.append(text)
        if len(found) == max(1, data.count(b"\n")):
            over.set()

    async def reading() -> None:
        read_standard_input("alpha", on_line, said.append)
        await over.wait()

    with open(tmp_path / "answers") as answers:
        monkeypatch.setattr(sys, "stdin", answers)
        asyncio.run(reading())
    assert found == [line[:MAX_LINE] for line in data.decode().splitlines()]
    cut = log_messages.INPUT_CUT.line(host="alpha", length=MAX_LINE)
    assert said == ([] if b"\n" in data else [cut])


def test_a_process_without_standard_input_reads_nothing(monkeypatch) -> None:
    monkeypatch.setattr(sys, "stdin", None)
    read_standard_input("alpha", print, print)


def test_lines_are_read_from_the_parent_pipe() -> None:
    found = list[tuple[str, str]]()

    async def piped() -> None:
        over, (reading, writing) = asyncio.Event(), os.pipe()
        on_exited, on_typed = (partial(_note, found, kind) for kind in ("exited", "typed"))
        ParentPipe(reading, on_exited, over.set, on_typed)
        os.write(writing, typed_line(WIDE) + exit_line("bravo") + typed_line("reaped: no") + b"other\n")
        os.close(writing)
        await over.wait()
        os.close(reading)

    asyncio.run(piped())
    assert found == [("typed", WIDE), ("exited", "bravo"), ("typed", "reaped: no")]


def _note(found: list[tuple[str, str]], kind: str, text: str) -> None:
    found.append((kind, text))
