"""Space that a journal keeps in advance: a file beside it that is removed when its disk is full.

What must be written then has room: the verdicts, and that each copy which is here leaves. On a file system
that writes nothing in place (btrfs, ZFS) what is removed may be free only later, or never while a snapshot
has it: there the space is worth less.
"""

from __future__ import annotations

import errno
import os
from contextlib import suppress
from pathlib import Path

#: Bytes for verdicts, endings and SQLite's own files, whatever is held.
LEAST = 256 << 10
#: The file grows by so many bytes at a time, so that it seldom does.
STEP = 64 << 10


class Reserve:
    """The file of one journal. `given_up`: it was removed, so that what it kept could be written into."""

    def __init__(self, path: Path) -> None:
        self.path, self.given_up = path, False
        #: What must be free beside it: what it has just given up is no room for more.
        self._beside = 0
        #: What must be free since it has lacked: who came as somebody went would lack it again.
        self._lacked = 0

    def hold(self, held: int) -> None:
        """Have room for writing over copies of so many bytes in all. Raises OSError when there is none.

        A page is written twice: into SQLite's log, and from there to its place. Once there was none, there is
        some when what has lacked is free, whatever has left meanwhile.
        """
        present, size = self._size(), LEAST + -(-2 * held // STEP) * STEP
        lacking = max(size - present, 0)
        if not lacking and not self._lacked:
            return
        # Nobody else should find the disk full because this was tried.
        found = os.statvfs(self.path.parent)
        if found.f_bavail * found.f_frsize < max(lacking + self._beside, self._lacked):
            self._lacked = max(self._lacked, lacking, LEAST)
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        if lacking:
            self._grow(present, size)
        self._beside, self._lacked, self.given_up = 0, 0, False

    def _grow(self, present: int, size: int) -> None:
        descriptor = os.open(self.path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o600)
        try:
            os.posix_fallocate(descriptor, 0, size)
        except OSError:
            self._lacked = max(self._lacked, size - present, LEAST)
            os.ftruncate(descriptor, present)
            raise
        finally:
            os.close(descriptor)

    def give_up(self) -> None:
        """Make room, if it is not given up yet."""
        with suppress(OSError):
            self.path.unlink()
            self._beside, self.given_up = LEAST, True

    def _size(self) -> int:
        try:
            return self.path.stat().st_size
        except OSError:
            return 0
