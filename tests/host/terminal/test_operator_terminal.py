"""Bytes of a terminal, a pipe or a file as lines of input."""

from __future__ import annotations

import asyncio
import os
import sys
import threading
from functools import partial

import pytest

from lfield.host.process.operator_terminal import LineSplitter, read_standard_input
from lfield.host.process.parent_pipe import ParentPipe, exit_line, typed_line
from lfield.vm.waits.operator_input import MAX_LINE

LONG = "x" * MAX_LINE
WIDE = "\N{ROBOT FACE}" * MAX_LINE


@pytest.mark.parametrize(
    ("chunks", "lines"),
    [
        ([b"yes\n"], ["yes"]),
        ([b"y", b"es\r\n", b"no"], ["yes", "no"]),
        ([b"\n\n"], ["", ""]),
        ([b"caf\xc3", b"\xa9\n"], ["caf\u00e9"]),
        ([b"\xff\xfe go\n"], ["\ufffd\ufffd go"]),
        ([LONG.encode() + b"\n"], [LONG]),
        ([LONG.encode() + b"y\nz\n"], [f"{LONG}y", "z"]),
        ([WIDE.encode(), b"\n"], [WIDE]),
        ([WIDE.encode(), b"more", WIDE.encode(), b"more\nno\n"], [f"{WIDE}more{WIDE[1:]}", "no"]),
        ([b""], []),
    ],
    ids=range(10),
)
def test_bytes_are_split_into_lines(chunks: list[bytes], lines: list[str]) -> None:
    found = list[str]()
    splitter = LineSplitter(found.append)
    for chunk in chunks:
        splitter.feed(chunk)
    splitter.close()
    assert found == lines


@pytest.mark.parametrize("data", [b"yes\nno\n", b"x" * (8 * MAX_LINE + 1)])
def test_standard_input_is_read_to_its_end(data: bytes, monkeypatch, tmp_path) -> None:
    """A regular file, which has no readiness."""
    (tmp_path / "answers").write_bytes(data)
    found, over = list[str](), asyncio.Event()

    def on_line(text: str) -> None:
        found.append(text)
        if len(found) == max(1, data.count(b"\n")):
            over.set()

    async def reading() -> None:
        read_standard_input(on_line)
        await over.wait()

    with open(tmp_path / "answers") as answers:
        monkeypatch.setattr(sys, "stdin", answers)
        asyncio.run(reading())
        # The file stays open until the reader has ended: a later file can get the same descriptor.
        for thread in threading.enumerate():
            if thread.name == "operator input":
                thread.join()
    assert found == [line[: 8 * MAX_LINE] for line in data.decode().splitlines()]


def test_a_process_without_standard_input_reads_nothing(monkeypatch) -> None:
    monkeypatch.setattr(sys, "stdin", None)
    read_standard_input(print)


def test_lines_are_read_from_the_parent_pipe() -> None:
    found = list[tuple[str, str]]()

    async def piped() -> None:
        over, (reading, writing) = asyncio.Event(), os.pipe()
        on_exited, on_typed = (partial(_note, found, kind) for kind in ("exited", "typed"))
        ParentPipe(reading, on_exited, over.set, on_typed)
        os.write(writing, typed_line(WIDE * 9) + exit_line("bravo") + typed_line("reaped: no") + b"other\n")
        os.close(writing)
        await over.wait()
        os.close(reading)

    asyncio.run(piped())
    assert found == [("typed", f"{WIDE}{WIDE[0]}"), ("exited", "bravo"), ("typed", "reaped: no")]


def _note(found: list[tuple[str, str]], kind: str, text: str) -> None:
    found.append((kind, text))
