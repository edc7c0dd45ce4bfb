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
    """The file of one journal."""

    def __init__(self, path: Path) -> None:
        self.path = path
        #: What must be free beside it: what it has just given up is no room for more.
        self._beside = 0

    def hold(self, held: int) -> None:
        """Have room for writing over copies of so many bytes in all. Raises OSError when there is none.

        A page is written twice: into SQLite's log, and from there to its place.
        """
        size = LEAST + -(-2 * held // STEP) * STEP
        if self._size() >= size:
            return
        # Nobody else should find the disk full because this was tried.
        found = os.statvfs(self.path.parent)
        if found.f_bavail * found.f_frsize < size + self._beside:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        descriptor = os.open(self.path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o600)
        try:
            os.posix_fallocate(descriptor, 0, size)
        except OSError:
            self.give_up()
            raise
        finally:
            os.close(descriptor)
        self._beside = 0

    def give_up(self) -> None:
        """Make room, if it is not given up yet."""
        with suppress(OSError):
            self.path.unlink()
            self._beside = LEAST

    def _size(self) -> int:
        try:
            return self.path.stat().st_size
        except OSError:
            return 0
