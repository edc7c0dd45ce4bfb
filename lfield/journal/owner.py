"""Whose a journal is: one process of one computer."""

from __future__ import annotations

import fcntl
import hashlib
import os
import re
from contextlib import suppress
from pathlib import Path

from lfield.errors import JournalError, JournalInUse

#: What tells computers apart, the best first. A number in the board stays behind when a disk is copied, a
#: machine-id does not: but it is all that a PC lets everybody read.
_SOURCES = ("proc/device-tree/serial-number", "etc/machine-id")
#: Of which nothing but the hash is ever written down, as machine-id(5) asks for.
_PURPOSE = b"lfield journal "
#: The file beside a journal that says which process has it.
LOCK_NAME = "host.lock"


def machine_identity(root: Path = Path("/")) -> str:
    """A word for this computer, the same at every start; '' for one that cannot be told from others."""
    for source in _SOURCES:
        with suppress(OSError):
            told = (root / source).read_bytes().strip(b"\0 \n")
            # Boards without a number of their own say 0, and an image that was never started says this.
            if told.strip(b"0") and told != b"uninitialized":
                return hashlib.sha256(_PURPOSE + told).hexdigest()[:32]
    return ""


class Lock:
    """Has a journal for this process alone. It ends with the process however that ends.

    What is locked is the folder: a file in it may be removed and made again.
    """

    def __init__(self, journal: Path) -> None:
        """Take it. Raises JournalInUse with the process that has it, or JournalError."""
        flags = os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK
        try:
            self._folder = os.open(journal.parent, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
            self._descriptor = os.open(journal.with_name(LOCK_NAME), flags, 0o600)
        except OSError as error:
            raise JournalError(str(journal), _words(error)) from None
        try:
            fcntl.flock(self._folder, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            process = self._process()
            self.release()
            raise JournalInUse(str(journal), process) from None
        # On a full disk nobody can be told who has it; that somebody has it is known all the same.
        with suppress(OSError):
            os.pwrite(self._descriptor, b"%-20d\n" % os.getpid(), 0)

    def release(self) -> None:
        """Let others have it."""
        os.close(self._descriptor)
        os.close(self._folder)

    def _process(self) -> int:
        with suppress(OSError):
            found = re.match(rb"[0-9]{1,18}", os.pread(self._descriptor, 20, 0))
            return int(found[0]) if found else 0
        return 0


def _words(error: OSError) -> str:
    return (error.strerror or str(error)).lower()
