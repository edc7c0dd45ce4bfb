"""Output that never blocks its writer, also when it is not read (Ctrl-S, a stuck ssh, `| sleep 1000`).

`LineBacklog` decides which lines are dropped; a `NonBlockingOutput` is the stream, with a writer thread. A
thread is needed because a terminal or pipe is shared with the user's shell: O_NONBLOCK would also affect the
shell, and reopening /proc/self/fd/N works neither for sockets (the systemd journal) nor after `su`.
"""

from __future__ import annotations

import io
import os
import select
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import TextIO, cast

from lfield.text.terminal_escape import ESCAPES, escaping_stream

#: Bytes that may be pending before the oldest lines are dropped.
MAX_BACKLOG = 4 << 20
#: The size of one write: up to PIPE_BUF bytes are atomic on a pipe, so lines of other writers are not
#: interleaved.
MAX_WRITE = 4096
#: Seconds that an exiting process waits for pending output.
DRAIN_TIMEOUT = 1.0


class LineBacklog:
    """Pending lines, at most `limit` bytes; the oldest are dropped first, and counted."""

    def __init__(self, limit: int = MAX_BACKLOG) -> None:
        self._limit, self._size, self._dropped = limit, 0, 0
        self._lines: deque[bytes] = deque()

    def __len__(self) -> int:
        """The number of pending lines."""
        return len(self._lines)

    def put(self, text: bytes) -> None:
        """Append lines; the next call continues the text after the last newline."""
        for line in io.BytesIO(text):
            if self._lines and not self._lines[-1].endswith(b"\n") and len(self._lines[-1]) < MAX_WRITE:
                self._lines[-1] += line
            else:
                self._lines.append(line)
            self._size += len(line)
        while self._size > self._limit and len(self._lines) > 1:
            self._size -= len(self._lines.popleft())
            self._dropped += 1

    def drain(self) -> tuple[int, bytes]:
        """The number of lines dropped since the last call, and the next whole lines to write."""
        dropped, self._dropped = self._dropped, 0
        lines = [self._lines.popleft()] if self._lines else []
        size = sum(map(len, lines))
        while self._lines and size + len(self._lines[0]) <= MAX_WRITE:
            size += len(self._lines[0])
            lines.append(self._lines.popleft())
        self._size -= size
        return dropped, b"".join(lines)

    def clear(self) -> None:
        """Discard all pending lines."""
        self._size = self._dropped = 0
        self._lines.clear()


class NonBlockingOutput(io.TextIOBase):
    """A text stream on a shared descriptor: no write blocks or fails.

    A notice replaces dropped lines, or `dropped` is called with their number. When writing fails permanently
    (a full disk, a closed pipe) `lost` is called once with the error, and later output is discarded. Both are
    called from another thread.
    """

    encoding = "utf-8"

    def __init__(
        self,
        descriptor: int,
        *,
        dropped: Callable[[int], object] | None = None,
        lost: Callable[[OSError], object] = lambda error: None,
        limit: int = MAX_BACKLOG,
    ) -> None:
        self._descriptor, self._on_dropped, self._on_lost = descriptor, dropped, lost
        self._backlog = LineBacklog(limit)
        self._partial = ""
        self._changed = threading.Condition()
        self._busy = self._broken = False
        threading.Thread(target=self._serve, name=f"outlet {descriptor}", daemon=True).start()

    def fileno(self) -> int:
        """The descriptor."""
        return self._descriptor

    def isatty(self) -> bool:
        """Whether the descriptor is a terminal."""
        return os.isatty(self._descriptor)

    def writable(self) -> bool:
        """Always true."""
        return True

    def write(self, text: str, /) -> int:
        """Queue text; it is written when its line is complete, or at `flush`."""
        if not sys.is_finalizing():
            with self._changed:
                self._partial += text
                if "\n" in text:
                    self._enqueue_partial()
        return len(text)

    def flush(self) -> None:
        """Also write an incomplete line; does not block."""
        # At the end of the process, a thread that Python has stopped may hold the lock.
        if not sys.is_finalizing():
            with self._changed:
                self._enqueue_partial()

    def drain(self, seconds: float | None) -> bool:
        """Wait until all lines are written or discarded; returns whether this was in time. None: without
        limit.
        """
        self.flush()
        with self._changed:
            return self._changed.wait_for(lambda: not (self._busy or self._backlog), seconds)

    def _enqueue_partial(self) -> None:
        text, self._partial = self._partial, ""
        if text and not self._broken:
            self._backlog.put(text.encode(errors=ESCAPES))
            self._changed.notify_all()

    # --- its thread -----------------------------------------------------------------------------------

    def _serve(self) -> None:
        while not self._broken:
            with self._changed:
                self._changed.wait_for(lambda: self._backlog)
                dropped, lines = self._backlog.drain()
                self._busy = True
            try:
                self._write_out(self._dropped_notice(dropped))
                self._write_out(lines)
            except OSError as error:
                self._on_lost(error)
                self._broken = True
            with self._changed:
                if self._broken:
                    self._backlog.clear()
                self._busy = False
                self._changed.notify_all()

    def _dropped_notice(self, dropped: int) -> bytes:
        """The notice that replaces dropped lines."""
        if not dropped:
            return b""
        if self._on_dropped is None:
            return f"... {dropped} line(s) missing: output was not read in time\n".encode()
        self._on_dropped(dropped)
        return b""

    def _write_out(self, data: bytes) -> None:
        while data:
            try:
                data = data[os.write(self._descriptor, data) :]
            except BlockingIOError:
                # Another process that shares the descriptor has set O_NONBLOCK.
                waiting = select.poll()
                waiting.register(self._descriptor, select.POLLOUT)
                waiting.poll()


@contextmanager
def nonblocking_output(
    prefix: str = "", *, content: str = "program output", drain_timeout: float | None = DRAIN_TIMEOUT
) -> Iterator[None]:
    """Make stdout and stderr non-blocking in this context, and wait for pending output at its end.

    The wait is at most `drain_timeout` seconds; with None, until all output is read, or Ctrl-C. Errors of
    stdout, which carries `content`, are written to stderr after the `prefix`. Streams that are not read at
    the end stay non-blocking, so that the last lines of the process do not block it.
    """
    before = sys.stdout, sys.stderr

    def report(text: str) -> None:
        if sys.stderr is not None:
            sys.stderr.write(f"{prefix}{text}\n")

    log = _nonblocking_for(sys.stderr)
    out = _nonblocking_for(
        sys.stdout,
        dropped=lambda lines: report(f"{lines} line(s) of {content} missing: output was not read in time"),
        lost=lambda error: report(f"{content} discarded from here on: {error.strerror or error}"),
    )
    sys.stdout = escaping_stream(cast("TextIO", out)) if out else sys.stdout
    sys.stderr = escaping_stream(cast("TextIO", log)) if log else sys.stderr
    try:
        yield
    finally:
        if _all_drained([output for output in (out, log) if output], drain_timeout):
            sys.stdout, sys.stderr = before


def _all_drained(outputs: Sequence[NonBlockingOutput], seconds: float | None) -> bool:
    end = None if seconds is None else time.monotonic() + seconds
    return all(output.drain(None if end is None else max(0.0, end - time.monotonic())) for output in outputs)


def _nonblocking_for(
    stream: TextIO | None,
    *,
    dropped: Callable[[int], object] | None = None,
    lost: Callable[[OSError], object] = lambda error: None,
) -> NonBlockingOutput | None:
    """A non-blocking replacement of a stream; None if it has no descriptor, as in tests.

    In a process that was started without the stream, `stream` is None, and its number may belong to another
    file.
    """
    if stream is None:
        return None
    try:
        stream.flush()
        return NonBlockingOutput(stream.fileno(), dropped=dropped, lost=lost)
    except (OSError, ValueError):
        return None


def discard_output(stream: TextIO) -> None:
    """Discard the remaining output of a stream; otherwise Python would fail on it again at exit."""
    with suppress(OSError, ValueError):
        null_device = os.open(os.devnull, os.O_WRONLY)
        os.dup2(null_device, stream.fileno())
        os.close(null_device)
