"""A small tmpfs as the disk of each host, which can be filled. Its contents survive the host's process."""

from __future__ import annotations

import subprocess
from contextlib import suppress
from pathlib import Path

#: Bytes of a disk: several times the size of the journal.
SIZE = 4 << 20


class Disk:
    """One disk, mounted on a folder; `can_be_full` is false without the right to mount."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        folder.mkdir(parents=True)
        options = f"size={SIZE},mode=700"
        command = ["mount", "-t", "tmpfs", "-o", options, "chaos", str(folder)]
        self.can_be_full = subprocess.run(command, capture_output=True).returncode == 0

    def fill(self) -> None:
        """Fill the disk completely."""
        with suppress(OSError), (self.folder / "ballast").open("ab", buffering=0) as ballast:
            while ballast.write(bytes(4096)):
                pass

    def free(self) -> None:
        """Free the space."""
        (self.folder / "ballast").unlink(missing_ok=True)

    def close(self) -> None:
        """Unmount the disk."""
        if self.can_be_full:
            subprocess.run(["umount", "-l", str(self.folder)], capture_output=True)
