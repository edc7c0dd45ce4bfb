"""Writes a ring of files in a thread: the caller never waits for the disk.

A ring is a sequence of files STEM-000001SUFFIX, STEM-000002SUFFIX, ... of which the oldest are deleted so
that all stay within a limit. Data reaches the kernel within FLUSH_INTERVAL, so a killed process loses at most
the data of this time; data reaches the disk within SYNC_INTERVAL. The first error of the disk, or a disk that
is too slow, ends the ring: `on_failure` gets the reason once, and all further data is dropped.

Files that exist already, as those of a guard that died and was restarted, belong to the ring as its oldest
files.
"""

from __future__ import annotations

import os
import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from lfield.recording.folders import segments_of

#: Seconds between two writes, and between two calls of fdatasync.
FLUSH_INTERVAL, SYNC_INTERVAL = 0.25, 2.0
#: The bytes that may wait for the disk.
MAX_PENDING = 16 << 20
#: Files in a full ring: the deletion of one file loses this share of the recorded time.
FILES = 8
_SLOW = f"the disk is too slow: more than {MAX_PENDING >> 20} MB wait for it"


class RingWriter:
    """One ring in `folder`; all of its files together have at most `limit` bytes.

    `header` is the beginning of each file. `on_failure` is called in the thread of the writer.
    """

    def __init__(
        self,
        folder: Path,
        stem: str,
        suffix: str,
        limit: int,
        on_failure: Callable[[str], None],
        header: bytes = b"",
    ) -> None:
        self._folder, self._stem, self._suffix, self._header = folder, stem, suffix, header
        self._limit, self._on_failure = limit, on_failure
        #: The work of the thread: bytes to append, or None to begin the next file.
        self._queue: deque[bytes | None] = deque()
        #: The bytes of the present file, and the bytes with which it began.
        self._written = self._first = 0
        # The number of bytes that were appended, and of bytes that reached the kernel: each number is changed
        # by one thread only.
        self._appended = self._stored = 0
        self._number, self._file = 0, -1
        #: The files of the ring with their sizes, oldest first.
        self._files: deque[list[int]] = deque()
        self._closing, self._wake, self._failing = False, threading.Event(), threading.Lock()
        #: The reason why the ring has ended, '' while it is written.
        self.failure = ""
        self._thread = threading.Thread(target=self._run, name=f"recorder {stem}", daemon=True)
        self._thread.start()

    @property
    def is_full(self) -> bool:
        """Whether the present file has its share of the limit: `start_file` should follow.

        At most a third of a file is its first data, such as the state of a guard, even if this is more than
        its share.
        """
        return self._written >= max(self._limit // FILES, 3 * self._first) and not self.failure

    def start_file(self, first: bytes = b"") -> None:
        """Begin the next file, with `first` as its first data after the header."""
        if self.failure:
            return
        self._queue.append(None)
        self._written, self._first = 0, len(first)
        self.append(self._header + first)

    def append(self, data: bytes) -> None:
        """Append data to the present file; a file is begun if there is none."""
        if self.failure:
            return
        if self._appended - self._stored > MAX_PENDING:
            self._fail(_SLOW)
            return
        self._appended += len(data)
        self._written += len(data)
        self._queue.append(data)

    def close(self, timeout: float = 2.0) -> None:
        """Write the pending data, for at most `timeout` seconds, and end the thread."""
        self._closing = True
        self._wake.set()
        self._thread.join(timeout)

    def flush(self) -> None:
        """Let the thread write now instead of at the next interval."""
        self._wake.set()

    # --- in the thread --------------------------------------------------------------------------------

    def _run(self) -> None:
        synced = time.monotonic()
        try:
            while True:
                self._wake.wait(FLUSH_INTERVAL)
                self._wake.clear()
                # This is read before the queue is emptied, so that data appended before `close` is written.
                closing = self._closing
                self._drain()
                now = time.monotonic()
                if self._file >= 0 and (closing or now - synced >= SYNC_INTERVAL):
                    os.fdatasync(self._file)
                    synced = now
                if closing or self.failure:
                    break
        except OSError as error:
            self._fail(error.strerror or str(error))
        finally:
            if self._file >= 0:
                # The data is written already; a failing close loses no more data.
                with suppress(OSError):
                    os.close(self._file)

    def _drain(self) -> None:
        parts: list[bytes] = []
        while True:
            try:
                part = self._queue.popleft()
            except IndexError:  # also when the ring has failed in the meantime
                break
            if part is None:
                self._write(b"".join(parts))
                parts = []
                self._open_next()
            else:
                parts.append(part)
        self._write(b"".join(parts))

    def _write(self, data: bytes) -> None:
        if not data:
            return
        if self._file < 0:
            self._open_next()
        view = memoryview(data)
        while view:
            view = view[os.write(self._file, view) :]
        self._stored += len(data)
        self._files[-1][1] += len(data)
        self._delete_oldest()

    def _open_next(self) -> None:
        if self._file >= 0:
            os.close(self._file)
            self._file = -1
        if not self._files:
            self._adopt_files()
        self._number += 1
        self._file = os.open(
            self._path(self._number), os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o600
        )
        self._files.append([self._number, 0])

    def _adopt_files(self) -> None:
        """Find the files that an earlier process has written to this ring."""
        for path in segments_of(self._folder, self._stem, self._suffix):
            number = path.name.removeprefix(f"{self._stem}-").removesuffix(self._suffix)
            self._number = int(number)
            self._files.append([self._number, path.stat().st_size])

    def _delete_oldest(self) -> None:
        while len(self._files) > 1 and sum(size for _, size in self._files) > self._limit:
            number, _ = self._files.popleft()
            with suppress(FileNotFoundError):
                os.unlink(self._path(number))

    def _path(self, number: int) -> Path:
        return self._folder / f"{self._stem}-{number:06d}{self._suffix}"

    def _fail(self, reason: str) -> None:
        with self._failing:
            if self.failure:
                return
            self.failure = reason
        self._queue.clear()
        self._on_failure(reason)
