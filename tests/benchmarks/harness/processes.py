"""Child processes of a figure, which end with it however it ends, and the folders they work in."""

from __future__ import annotations

import ctypes
import os
import select
import signal
import socket
import subprocess
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack
from pathlib import Path
from typing import IO, TypeVar

T = TypeVar("T")

#: Seconds a child may take to say something before it is given up.
PATIENCE = 30.0

_PR_SET_PDEATHSIG = 1
_prctl = ctypes.CDLL(None).prctl


class ChildError(Exception):
    """A child process that ended or stayed silent; one sentence, with the last that it wrote."""


class Child:
    """A process that is read line by line. The kernel kills it when this process ends, however it ends.

    Its stderr goes to a file, so that it never waits for a reader; with `merged` it is read with stdout.
    """

    def __init__(
        self, arguments: Sequence[str], environment: Mapping[str, str], folder: Path, merged: bool
    ) -> None:
        self._arguments, self._unread = arguments, b""
        self._stderr: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115  # open as long as the child
        self.started = time.perf_counter()
        self._process = subprocess.Popen(
            arguments,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT if merged else self._stderr,
            cwd=folder,
            env=environment,
            preexec_fn=_die_with_parent,
        )

    @property
    def pid(self) -> int:
        """The process id of the child."""
        return self._process.pid

    def line(self, patience: float = PATIENCE) -> str:
        """The next line of its stdout. Raises ChildError when none comes."""
        end = time.monotonic() + patience
        while b"\n" not in self._unread:
            if not self._read(max(0.0, end - time.monotonic())):
                late = time.monotonic() >= end
                raise ChildError(self._obituary(f"said nothing for {patience:g} s" if late else "ended"))
        line, _, self._unread = self._unread.partition(b"\n")
        return line.decode()

    def lines(self) -> list[str]:
        """The lines of its stdout that are there already; does not wait."""
        while self._read(0.0):
            pass
        *lines, self._unread = self._unread.split(b"\n")
        return [line.decode() for line in lines]

    def pause(self) -> None:
        """Stop it where it stands, so that it costs nothing while others are measured; returns when it is."""
        os.kill(self.pid, signal.SIGSTOP)
        os.waitid(os.P_PID, self.pid, os.WSTOPPED | os.WEXITED | os.WNOWAIT)

    def go_on(self) -> None:
        """Let it run again."""
        os.kill(self.pid, signal.SIGCONT)

    def wait(self) -> None:
        """Until its end. Raises ChildError when it has not ended well."""
        try:
            status = self._process.wait(PATIENCE)
        except subprocess.TimeoutExpired:
            raise ChildError(self._obituary(f"did not end within {PATIENCE:g} s"))
        if status:
            raise ChildError(self._obituary(f"ended with status {status}"))

    def ask_to_end(self) -> None:
        """Let it end in order, as `kill` does."""
        self._process.terminate()

    def ended(self, patience: float) -> bool:
        """Whether the child ends within `patience` seconds; its output is read meanwhile and discarded."""
        end = time.monotonic() + patience
        while self._process.poll() is None and time.monotonic() < end:
            self._read(0.02)
            self._unread = b""
            time.sleep(0.005)
        return self._process.poll() is not None

    def end(self) -> None:
        """Kill it and wait for it."""
        self._process.kill()
        self._process.wait()
        assert self._process.stdout is not None
        self._process.stdout.close()
        self._stderr.close()

    def _read(self, patience: float) -> bool:
        """Take in what there is; False when there is nothing."""
        assert self._process.stdout is not None
        descriptor = self._process.stdout.fileno()
        ready, _, _ = select.select([descriptor], [], [], patience)
        data = os.read(descriptor, 1 << 16) if ready else b""
        self._unread += data
        return bool(data)

    def _obituary(self, what: str) -> str:
        self._stderr.seek(0)
        told = (self._stderr.read() + self._unread).decode(errors="replace").split("\n")
        lines = [line.strip() for line in told if line.strip()] or ["without a word"]
        # A refusal begins with what is wrong; a traceback or a log ends with it.
        refused = "error" in lines[0]
        command = " ".join(Path(word).name for word in self._arguments[:6])
        return f"{command} {what}: {lines[0 if refused else -1]}"


class Processes:
    """The children and folders of a figure; they end with a `with` statement."""

    def __init__(self) -> None:
        self._open = ExitStack()

    def __enter__(self) -> Processes:
        return self

    def __exit__(self, *_: object) -> None:
        self._open.close()

    def start(
        self,
        *words: str,
        environment: Mapping[str, str] = os.environ,
        folder: Path | None = None,
        merged: bool = False,
    ) -> Child:
        """Start a command, in a folder (default: where this process is)."""
        child = Child(words, environment, folder or Path.cwd(), merged)
        self._open.callback(child.end)
        return child

    def at_end(self, does: Callable[[], object]) -> None:
        """Call something at the end, before what was started earlier ends."""
        self._open.callback(does)

    def keep(self, kept: AbstractContextManager[T]) -> T:
        """Enter a context, and leave it at the end."""
        return self._open.enter_context(kept)

    def folder(self) -> Path:
        """A new folder."""
        return Path(self._open.enter_context(tempfile.TemporaryDirectory(prefix="lfield-bench-")))


def _die_with_parent() -> None:
    _prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)


def free_port() -> int:
    """A loopback port that no program listens on now."""
    with socket.create_server(("127.0.0.1", 0)) as probe:
        return int(probe.getsockname()[1])
