"""The lock of a journal: only one process on one computer may open it."""

from __future__ import annotations

import fcntl
import hashlib
import os
import re
from contextlib import suppress
from pathlib import Path

from lfield.errors import JournalError, JournalInUse

#: Sources of a computer's id, best first. The serial number of a board is not copied with a disk image. A
#: machine-id is copied, but on a PC unprivileged users can read no other id.
_SOURCES = ("proc/device-tree/serial-number", "etc/machine-id")
#: The key of the hash: only a hash is stored, as machine-id(5) requires.
_PURPOSE = b"lfield journal "
#: The lock file of a journal, with the process id of its owner.
LOCK_NAME = "host.lock"


def machine_id(root: Path = Path("/")) -> str:
    """The id of this computer, constant across restarts; '' if there is none."""
    for source in _SOURCES:
        with suppress(OSError):
            content = (root / source).read_bytes().strip(b"\0 \n")
            # Boards without a serial number report 0; an image that was never started reports
            # "uninitialized".
            if content.strip(b"0") and content != b"uninitialized":
                return hashlib.sha256(_PURPOSE + content).hexdigest()[:32]
    return ""


class JournalLock:
    """Locks a journal for this process. The kernel releases it when the process ends.

    The folder is locked, because a file in it may be deleted and created again.
    """

    def __init__(self, journal: Path) -> None:
        """Acquire the lock. Raises JournalInUse with the owning process, or JournalError."""
        flags = os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK
        try:
            self._folder = os.open(journal.parent, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
            self._descriptor = os.open(journal.with_name(LOCK_NAME), flags, 0o600)
        except OSError as error:
            raise JournalError(str(journal), _lock_error(error)) from None
        try:
            fcntl.flock(self._folder, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            process = self._owner_process()
            self.release()
            raise JournalInUse(str(journal), process) from None
        # On a full disk the process id is missing; the lock is valid nevertheless.
        with suppress(OSError):
            os.pwrite(self._descriptor, b"%-20d\n" % os.getpid(), 0)

    def release(self) -> None:
        os.close(self._descriptor)
        os.close(self._folder)

    def _owner_process(self) -> int:
        with suppress(OSError):
            found = re.match(rb"[0-9]{1,18}", os.pread(self._descriptor, 20, 0))
            return int(found[0]) if found else 0
        return 0


def _lock_error(error: OSError) -> str:
    return (error.strerror or str(error)).lower()
