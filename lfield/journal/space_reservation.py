"""Reserved disk space of a journal: a file in its folder that is deleted when the disk is full.

This leaves space for records that must be written: verdicts, and the departure of each copy. On a
copy-on-write file system (btrfs, ZFS) the space may become free later, or never while a snapshot holds it.
"""

from __future__ import annotations

import errno
import os
from contextlib import suppress
from pathlib import Path

#: Bytes for verdicts, endings and SQLite's own files, in addition to the stored copies.
MIN_BYTES = 256 << 10
#: The file grows in steps of this many bytes, so that it grows rarely.
STEP_BYTES = 64 << 10


class SpaceReservation:
    """The file of one journal. `is_released`: the file was deleted to free its space."""

    def __init__(self, path: Path) -> None:
        self.path, self.is_released = path, False
        #: The bytes that must be free in addition: released space is not available for new copies.
        self._extra_free_bytes = 0
        #: The bytes that must be free after a shortage of space: otherwise an arrival after a departure would
        #: fail again.
        self._missing_bytes = 0

    def grow_to(self, record_bytes: int) -> None:
        """Reserve space for overwriting copies of `record_bytes` bytes in total. Raises OSError if there is
        none.

        A record is written twice: into SQLite's log, and from there into the database. After a failure the
        reservation succeeds only when all missing bytes are free.
        """
        present, size = self._size(), MIN_BYTES + -(-2 * record_bytes // STEP_BYTES) * STEP_BYTES
        lacking = max(size - present, 0)
        if not lacking and not self._missing_bytes:
            return
        # A failed attempt must not leave the disk full for other programs.
        found = os.statvfs(self.path.parent)
        if found.f_bavail * found.f_frsize < max(lacking + self._extra_free_bytes, self._missing_bytes):
            self._missing_bytes = max(self._missing_bytes, lacking, MIN_BYTES)
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        if lacking:
            self._grow(present, size)
        self._extra_free_bytes, self._missing_bytes, self.is_released = 0, 0, False

    def _grow(self, present: int, size: int) -> None:
        descriptor = os.open(self.path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o600)
        try:
            os.posix_fallocate(descriptor, 0, size)
        except OSError:
            self._missing_bytes = max(self._missing_bytes, size - present, MIN_BYTES)
            os.ftruncate(descriptor, present)
            raise
        finally:
            os.close(descriptor)

    def release(self) -> None:
        """Free the space, if it has not been freed."""
        with suppress(OSError):
            self.path.unlink()
            self._extra_free_bytes, self.is_released = MIN_BYTES, True

    def _size(self) -> int:
        try:
            return self.path.stat().st_size
        except OSError:
            return 0
