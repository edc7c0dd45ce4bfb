"""Output that never makes its writer wait, also when nobody reads it (Ctrl-S, a stuck ssh, `| sleep 1000`).

`Backlog` decides what is kept and what is dropped; an `Outlet` is the stream on top, with a thread that
writes. A thread, since a terminal or pipe is shared with the user's shell: O_NONBLOCK would be set for the
shell as well, and opening /proc/self/fd/N anew works neither for sockets (the journal) nor after `su`.
"""

from __future__ import annotations

import io
import os
import select
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import TextIO, cast

from lfield.text.visible import ESCAPES, on_terminal

#: So many bytes wait for a reader, at most, before the oldest lines are dropped.
LIMIT = 4 << 20
#: What is written at once: on a pipe nobody else's line comes into the middle of so many bytes (PIPE_BUF).
AT_ONCE = 4096
#: Seconds that a process which ends waits for its reader.
LAST_WORDS = 1.0


class Backlog:
    """Lines on their way to a reader, `limit` bytes of them; the oldest are dropped first, and counted."""

    def __init__(self, limit: int = LIMIT) -> None:
        self._limit, self._size, self._dropped = limit, 0, 0
        self._lines: deque[bytes] = deque()

    def __len__(self) -> int:
        """How many lines wait."""
        return len(self._lines)

    def put(self, text: bytes) -> None:
        """Append lines; what comes after the last newline is continued by what is put next."""
        for line in io.BytesIO(text):
            if self._lines and not self._lines[-1].endswith(b"\n") and len(self._lines[-1]) < AT_ONCE:
                self._lines[-1] += line
            else:
                self._lines.append(line)
            self._size += len(line)
        while self._size > self._limit and len(self._lines) > 1:
            self._size -= len(self._lines.popleft())
            self._dropped += 1

    def take(self) -> tuple[int, bytes]:
        """How many lines were dropped since the last time, and those to write next, whole ones."""
        dropped, self._dropped = self._dropped, 0
        taken = [self._lines.popleft()] if self._lines else []
        size = sum(map(len, taken))
        while self._lines and size + len(self._lines[0]) <= AT_ONCE:
            size += len(self._lines[0])
            taken.append(self._lines.popleft())
        self._size -= size
        return dropped, b"".join(taken)

    def clear(self) -> None:
        """Forget everything."""
        self._size = self._dropped = 0
        self._lines.clear()


class Outlet(io.TextIOBase):
    """A text stream on a descriptor that stays somebody else's: no write waits, and none fails.

    What was dropped is said in its place, or by `dropped` (a number of lines). When it cannot be written any
    more (a full disk, a reader that left) `lost` hears why, once, and the rest goes nowhere. Both are called
    from another thread.
    """

    encoding = "utf-8"

    def __init__(
        self,
        descriptor: int,
        *,
        dropped: Callable[[int], object] | None = None,
        lost: Callable[[OSError], object] = lambda error: None,
        limit: int = LIMIT,
    ) -> None:
        self._descriptor, self._on_dropped, self._on_lost = descriptor, dropped, lost
        self._backlog = Backlog(limit)
        self._begun = ""
        self._changed = threading.Condition()
        self._busy = self._broken = False
        threading.Thread(target=self._serve, name=f"outlet {descriptor}", daemon=True).start()

    def fileno(self) -> int:
        """The descriptor."""
        return self._descriptor

    def isatty(self) -> bool:
        """Whether it is a terminal."""
        return os.isatty(self._descriptor)

    def writable(self) -> bool:
        """It is."""
        return True

    def write(self, text: str, /) -> int:
        """Take text; it goes out when its line is complete, or at `flush`."""
        if not sys.is_finalizing():
            with self._changed:
                self._begun += text
                if "\n" in text:
                    self._pass_on()
        return len(text)

    def flush(self) -> None:
        """Let an incomplete line go out too; waits for nothing."""
        # A thread that Python has stopped for good, at the end of the process, may hold the lock.
        if not sys.is_finalizing():
            with self._changed:
                self._pass_on()

    def drain(self, seconds: float) -> bool:
        """Wait until all is written, or will never be; whether that was in time."""
        self.flush()
        with self._changed:
            return self._changed.wait_for(lambda: not (self._busy or self._backlog), seconds)

    def _pass_on(self) -> None:
        text, self._begun = self._begun, ""
        if text and not self._broken:
            self._backlog.put(text.encode(errors=ESCAPES))
            self._changed.notify_all()

    # --- its thread -----------------------------------------------------------------------------------

    def _serve(self) -> None:
        while not self._broken:
            with self._changed:
                self._changed.wait_for(lambda: self._backlog)
                dropped, lines = self._backlog.take()
                self._busy = True
            try:
                self._put_out(self._told(dropped))
                self._put_out(lines)
            except OSError as error:
                self._on_lost(error)
                self._broken = True
            with self._changed:
                if self._broken:
                    self._backlog.clear()
                self._busy = False
                self._changed.notify_all()

    def _told(self, dropped: int) -> bytes:
        """The sentence on lines that are missing, where it is to stand among them."""
        if not dropped:
            return b""
        if self._on_dropped is None:
            return f"... {dropped} line(s) are missing here: nobody read them in time\n".encode()
        self._on_dropped(dropped)
        return b""

    def _put_out(self, data: bytes) -> None:
        while data:
            try:
                data = data[os.write(self._descriptor, data) :]
            except BlockingIOError:
                # Somebody who shares it has made it so.
                waiting = select.poll()
                waiting.register(self._descriptor, select.POLLOUT)
                waiting.poll()


@contextmanager
def never_waiting(who: str = "") -> Iterator[None]:
    """Let stdout and stderr be outlets for the duration, and give a reader LAST_WORDS at its end.

    What is wrong with stdout is said on stderr, `who` before it. Streams that are stuck at the end stay
    outlets: the last sentences of the process must not wait for ever either.
    """
    before = sys.stdout, sys.stderr

    def say(text: str) -> None:
        if sys.stderr is not None:
            sys.stderr.write(f"{who}{text}\n")

    log = _outlet_of(sys.stderr)
    out = _outlet_of(
        sys.stdout,
        dropped=lambda lines: say(f"{lines} line(s) of program output are missing: nobody read them in time"),
        lost=lambda error: say(f"program output is lost from here on: {error.strerror or error}"),
    )
    sys.stdout = on_terminal(cast("TextIO", out)) if out else sys.stdout
    sys.stderr = on_terminal(cast("TextIO", log)) if log else sys.stderr
    try:
        yield
    finally:
        end = time.monotonic() + LAST_WORDS
        if all(outlet.drain(max(0.0, end - time.monotonic())) for outlet in (out, log) if outlet):
            sys.stdout, sys.stderr = before


def _outlet_of(
    stream: TextIO | None,
    *,
    dropped: Callable[[int], object] | None = None,
    lost: Callable[[OSError], object] = lambda error: None,
) -> Outlet | None:
    """An outlet in a stream's place; None where it has no descriptor, as in tests.

    A process that was started without the stream has None there, and the number may be any file's by now.
    """
    if stream is None:
        return None
    try:
        stream.flush()
        return Outlet(stream.fileno(), dropped=dropped, lost=lost)
    except (OSError, ValueError):
        return None


def silence(stream: TextIO) -> None:
    """Let what is still to come out of a stream go nowhere; at exit Python would stumble over it again."""
    with suppress(OSError, ValueError):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, stream.fileno())
        os.close(nowhere)
