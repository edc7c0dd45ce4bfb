"""Linux control groups: the kernel's limits on processes."""

from __future__ import annotations

import time
import uuid
from pathlib import Path

import pytest

#: The folder of a controller's groups, and the file of its limit, for versions 1 and 2.
PLACES = {
    "memory": (("memory", "memory.limit_in_bytes"), ("", "memory.max")),
    "pids": (("pids", "pids.max"), ("", "pids.max")),
}


class Group:
    """A control group for processes of a test; without the right to create one the test is skipped."""

    def __init__(self, controller: str) -> None:
        self._folder, self._limit = Path(), ""
        name, reason = f"lfield-test-{uuid.uuid4().hex[:12]}", f"there are no {controller} groups here"
        for mount, limit in PLACES[controller]:
            folder = Path("/sys/fs/cgroup") / mount / name
            try:
                folder.mkdir()
            except OSError as error:
                reason = f"no {controller} group may be made: {error}"
                continue
            self._folder, self._limit = folder, limit
            if (folder / limit).exists():
                return
            self.remove()
        pytest.skip(reason)

    def bound(self, limit: int, *pids: int) -> None:
        """Add processes and set their common limit; a memory limit is in addition to their current use."""
        for pid in pids:
            (self._folder / "cgroup.procs").write_text(str(pid))
        (self._folder / self._limit).write_text(str(limit))

    def remove(self) -> None:
        """Remove the group after its killed processes have ended."""
        end = time.monotonic() + 60
        while self._folder.is_dir():
            try:
                self._folder.rmdir()
            except OSError:
                if time.monotonic() > end:
                    raise
                time.sleep(0.05)
