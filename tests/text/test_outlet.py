"""Output to a slow, stuck or closed reader: kept lines, counted losses, and writers that never wait."""

from __future__ import annotations

import fcntl
import os
import pty
import random
import socket
import subprocess
import sys
import termios
import threading
import time
from pathlib import Path

import pytest

from lfield.text.nonblocking_output import MAX_WRITE, LineBacklog, NonBlockingOutput, nonblocking_output

TIMEOUT = 30.0


def all_of(backlog: LineBacklog) -> list[tuple[int, bytes]]:
    written = []
    while backlog:
        written.append(backlog.drain())
    return written


# --- kept and dropped lines -----------------------------------------------------------------------------


def test_lines_are_returned_unchanged():
    backlog = LineBacklog()
    backlog.put(b"a\nb\n")
    backlog.put(b"c")
    backlog.put(b"d\ne")
    assert backlog.drain() == (0, b"a\nb\ncd\ne")
    assert not backlog


def test_oldest_lines_are_dropped_and_counted():
    backlog = LineBacklog(limit=8)
    backlog.put(b"".join(b"%03d\n" % number for number in range(10)))
    assert backlog.drain() == (8, b"008\n009\n")
    backlog.put(b"010\n")
    assert backlog.drain() == (0, b"010\n")


def test_one_line_over_the_limit_is_kept_whole():
    backlog = LineBacklog(limit=8)
    backlog.put(b"short\n")
    backlog.put(b"a line that is longer\n")
    assert backlog.drain() == (1, b"a line that is longer\n")


def test_each_write_has_whole_lines_within_an_atomic_pipe_write():
    rng = random.Random(7)
    lines = [b"%d " % number * rng.randrange(1, 400) + b"\n" for number in range(500)]
    backlog = LineBacklog()
    for line in lines:
        cut = rng.randrange(len(line))
        backlog.put(line[:cut])
        backlog.put(line[cut:])
    written = [data for _, data in all_of(backlog)]
    assert b"".join(written) == b"".join(lines)
    assert all(
        data.endswith(b"\n") and (len(data) <= MAX_WRITE or data.count(b"\n") == 1) for data in written
    )


def test_every_line_is_kept_or_counted():
    rng, backlog, written_lines, lost, sent = random.Random(3), LineBacklog(limit=200), 0, 0, 0
    for _ in range(2000):
        if rng.random() < 0.8:
            backlog.put(b"x" * rng.randrange(40) + b"\n")
            sent += 1
        else:
            dropped, data = backlog.drain()
            written_lines, lost = written_lines + data.count(b"\n"), lost + dropped
    for dropped, data in all_of(backlog):
        written_lines, lost = written_lines + data.count(b"\n"), lost + dropped
    assert lost > 100
    assert written_lines + lost == sent


# --- writers never wait ---------------------------------------------------------------------------------


def a_pipe():
    """A pipe with a small buffer, which fills even if the writing thread runs rarely."""
    reading, writing = os.pipe()
    fcntl.fcntl(writing, fcntl.F_SETPIPE_SZ, 4096)
    return reading, writing


def a_socket():
    """A socket with a small buffer, for the same reason."""
    near, far = socket.socketpair()
    far.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 4096)
    return near.detach(), far.detach()


def a_terminal():
    """A pseudo-terminal like that of ssh, without conversion of line ends."""
    near, far = pty.openpty()
    attributes = termios.tcgetattr(far)
    attributes[1] &= ~termios.OPOST
    termios.tcsetattr(far, termios.TCSANOW, attributes)
    return near, far


@pytest.fixture(params=[a_pipe, a_socket, a_terminal], ids=["pipe", "socket", "terminal"])
def ends(request):
    """The reading and the writing end; both blocking, as a shell opens them."""
    reading, writing = request.param()
    yield reading, writing
    os.close(reading)
    os.close(writing)


class Reader:
    """A reader that starts late."""

    def __init__(self, descriptor: int) -> None:
        self.data = b""
        self._descriptor = descriptor
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        try:
            while piece := os.read(self._descriptor, 1 << 16):
                self.data += piece
        except OSError:
            pass

    def lines_when(self, end: bytes) -> list[bytes]:
        until = time.monotonic() + TIMEOUT
        while not self.data.endswith(end):
            assert time.monotonic() < until, self.data[-200:]
            time.sleep(0.01)
        return self.data.splitlines()


def test_writer_does_not_wait_and_dropped_lines_are_reported_in_place(ends):
    reading, writing = ends
    outlet = NonBlockingOutput(writing, limit=20_000)
    before = time.monotonic()
    for number in range(100_000):
        outlet.write(f"line {number:6} of the log\n")
    assert time.monotonic() - before < TIMEOUT
    assert not outlet.drain(0.1)
    assert not fcntl.fcntl(writing, fcntl.F_GETFL) & os.O_NONBLOCK, "the shell shares this descriptor"
    reader = Reader(reading)
    assert outlet.drain(TIMEOUT)
    outlet.write("end\n")
    lines = reader.lines_when(b"end\n")
    reports = [number for number, line in enumerate(lines) if b"missing: output" in line]
    missing = sum(int(lines[number].split()[1]) for number in reports)
    assert missing > 50_000
    assert missing + len(lines) - len(reports) - 1 == 100_000
    assert lines[-2] == b"line  99999 of the log"
    assert {len(line) for line in lines[:-1]} - {len(lines[number]) for number in reports} == {22}


def test_nonblocking_descriptor_gets_all_lines():
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    outlet = NonBlockingOutput(writing)
    for number in range(20_000):
        outlet.write(f"line {number:6}\n")
    assert Reader(reading).lines_when(b"line  19999\n") == [b"line %6d" % n for n in range(20_000)]


def test_incomplete_line_waits_for_its_end_or_flush():
    reading, writing = os.pipe()
    outlet = NonBlockingOutput(writing)
    outlet.write("a prompt: ")
    outlet.flush()
    assert os.read(reading, 100) == b"a prompt: "
    print("one", "line", file=outlet)
    assert os.read(reading, 100) == b"one line\n"
    outlet.write("no UTF-8: \ud800\n")
    assert os.read(reading, 100) == b"no UTF-8: \\u{d800}\n"


@pytest.mark.parametrize(("gone", "why"), [(False, "No space left on device"), (True, "Broken pipe")])
def test_failed_write_is_reported_once(gone, why):
    if gone:
        reading, target = os.pipe()
        os.close(reading)
    else:
        target = os.open("/dev/full", os.O_WRONLY)
    reports: list[str | None] = []
    outlet = NonBlockingOutput(target, lost=lambda error: reports.append(error.strerror))
    for _ in range(3):
        outlet.write("a line\n")
        assert outlet.drain(TIMEOUT)
    assert reports == [why]
    os.close(target)


# --- streams of a process -------------------------------------------------------------------------------


def test_process_streams_are_nonblocking_within_the_block(capfd):
    before = sys.stdout, sys.stderr
    with nonblocking_output():
        print("output")
        print("log", file=sys.stderr)
        assert isinstance(sys.stdout, NonBlockingOutput)
    assert (sys.stdout, sys.stderr) == before
    assert capfd.readouterr() == ("output\n", "log\n")


def test_lost_program_output_is_reported_in_the_log(capfd, monkeypatch):
    with Path("/dev/full").open("w") as full:
        monkeypatch.setattr(sys, "stdout", full)
        with nonblocking_output("somebody: "):
            print("output")
    assert capfd.readouterr().err == (
        "somebody: program output discarded from here on: No space left on device\n"
    )


def test_stuck_streams_stay_nonblocking_and_the_block_ends(monkeypatch):
    reading, writing = os.pipe()
    with os.fdopen(writing, "w") as stuck, monkeypatch.context() as patch:
        patch.setattr(sys, "stdout", stuck)
        before = time.monotonic()
        with nonblocking_output():
            print("x" * 100_000)
        print("a last sentence")
        assert time.monotonic() - before < TIMEOUT
        reader = Reader(reading)
        assert reader.lines_when(b"a last sentence\n") == [b"x" * 100_000, b"a last sentence"]


def test_process_without_streams(monkeypatch):
    monkeypatch.setattr(sys, "stdout", None)
    monkeypatch.setattr(sys, "stderr", None)
    with nonblocking_output():
        assert (sys.stdout, sys.stderr) == (None, None)


@pytest.mark.parametrize("process", ["lfield.guard.process", "lfield.driver.sims"])
def test_printing_library_does_not_block_a_process_with_an_unread_log(tmp_path, process):
    (tmp_path / "chatty.py").write_text("print('x\\n' * 200_000)\nTHING = None\n")
    command = [sys.executable, "-m", process, "chatty:THING"]
    reading, writing = os.pipe()
    with os.fdopen(reading), os.fdopen(writing, "w") as unread:
        environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
        done = subprocess.run(
            command, env=environment, stdin=subprocess.DEVNULL, stdout=unread, stderr=unread, timeout=TIMEOUT
        )
    assert done.returncode == 69
