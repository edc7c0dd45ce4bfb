"""Child processes of a figure and their folders; they end with the figure, also after a failure."""

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

#: Seconds without output after which a child has failed.
TIMEOUT = 30.0

_PR_SET_PDEATHSIG = 1
_prctl = ctypes.CDLL(None).prctl


class ChildError(Exception):
    """A child process that ended or wrote nothing; one sentence with its last output."""


class Child:
    """A process that is read line by line. The kernel kills it at any end of this process.

    Stderr goes to a file, so that the child never blocks on it; with `merged` it is read with stdout.
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
            preexec_fn=_end_with_parent,
        )

    @property
    def pid(self) -> int:
        """The process id of the child."""
        return self._process.pid

    def line(self, timeout: float = TIMEOUT) -> str:
        """The next line of stdout. Raises ChildError after `timeout` seconds without one."""
        end = time.monotonic() + timeout
        while b"\n" not in self._unread:
            if not self._read(max(0.0, end - time.monotonic())):
                late = time.monotonic() >= end
                raise ChildError(self._failure_text(f"said nothing for {timeout:g} s" if late else "ended"))
        line, _, self._unread = self._unread.partition(b"\n")
        return line.decode()

    def lines(self) -> list[str]:
        """The lines of stdout that are available; action not wait."""
        while self._read(0.0):
            pass
        *lines, self._unread = self._unread.split(b"\n")
        return [line.decode() for line in lines]

    def pause(self) -> None:
        """Stop the child, so that others can be measured; returns when it is stopped."""
        os.kill(self.pid, signal.SIGSTOP)
        os.waitid(os.P_PID, self.pid, os.WSTOPPED | os.WEXITED | os.WNOWAIT)

    def resume(self) -> None:
        """Continue a stopped child."""
        os.kill(self.pid, signal.SIGCONT)

    def wait(self) -> None:
        """Wait for the end of the child. Raises ChildError for a status other than 0."""
        try:
            status = self._process.wait(TIMEOUT)
        except subprocess.TimeoutExpired:
            raise ChildError(self._failure_text(f"did not end within {TIMEOUT:g} s"))
        if status:
            raise ChildError(self._failure_text(f"ended with status {status}"))

    def ask_to_end(self) -> None:
        """Send SIGTERM for an orderly end."""
        self._process.terminate()

    def ended(self, timeout: float) -> bool:
        """Return true if the child ends within `timeout` seconds; its output is read and discarded."""
        end = time.monotonic() + timeout
        while self._process.poll() is None and time.monotonic() < end:
            self._read(0.02)
            self._unread = b""
            time.sleep(0.005)
        return self._process.poll() is not None

    def end(self) -> None:
        """Kill the child and wait for its end."""
        self._process.kill()
        self._process.wait()
        assert self._process.stdout is not None
        self._process.stdout.close()
        self._stderr.close()

    def _read(self, timeout: float) -> bool:
        """Read the available output; returns False without any."""
        assert self._process.stdout is not None
        descriptor = self._process.stdout.fileno()
        ready, _, _ = select.select([descriptor], [], [], timeout)
        data = os.read(descriptor, 1 << 16) if ready else b""
        self._unread += data
        return bool(data)

    def _failure_text(self, what: str) -> str:
        self._stderr.seek(0)
        output = (self._stderr.read() + self._unread).decode(errors="replace").split("\n")
        lines = [line.strip() for line in output if line.strip()] or ["without a word"]
        # An error message has its reason in the first line, a traceback or a log in the last one.
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
        *arguments: str,
        environment: Mapping[str, str] = os.environ,
        folder: Path | None = None,
        merged: bool = False,
    ) -> Child:
        """Start a command in a folder (default: the current one)."""
        child = Child(arguments, environment, folder or Path.cwd(), merged)
        self._open.callback(child.end)
        return child

    def at_end(self, action: Callable[[], object]) -> None:
        """Register a call for the end, before the processes that were started earlier end."""
        self._open.callback(action)

    def keep(self, kept: AbstractContextManager[T]) -> T:
        """Enter a context that is left at the end."""
        return self._open.enter_context(kept)

    def folder(self) -> Path:
        """A new folder."""
        return Path(self._open.enter_context(tempfile.TemporaryDirectory(prefix="lfield-bench-")))


def _end_with_parent() -> None:
    _prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)


def free_port() -> int:
    """A loopback port without a listener."""
    with socket.create_server(("127.0.0.1", 0)) as probe:
        return int(probe.getsockname()[1])
