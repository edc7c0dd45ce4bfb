"""Control groups of Linux: the limits of a kernel on processes."""

from __future__ import annotations

import time
import uuid
from pathlib import Path

import pytest

#: Where a controller's groups are, and the file with its limit: in version 1 and in version 2.
PLACES = {
    "memory": (("memory", "memory.limit_in_bytes"), ("", "memory.max")),
    "pids": (("pids", "pids.max"), ("", "pids.max")),
}


class Group:
    """A group of a test's own, for processes that it has started; where none may be made it is skipped."""

    def __init__(self, controller: str) -> None:
        self._folder, self._limit = Path(), ""
        name, why = f"lfield-test-{uuid.uuid4().hex[:12]}", f"there are no {controller} groups here"
        for mount, limit in PLACES[controller]:
            folder = Path("/sys/fs/cgroup") / mount / name
            try:
                folder.mkdir()
            except OSError as error:
                why = f"no {controller} group may be made: {error}"
                continue
            self._folder, self._limit = folder, limit
            if (folder / limit).exists():
                return
            self.remove()
        pytest.skip(why)

    def bound(self, limit: int, *pids: int) -> None:
        """Put processes into it, and allow them so much, together; of memory, beyond what they have."""
        for pid in pids:
            (self._folder / "cgroup.procs").write_text(str(pid))
        (self._folder / self._limit).write_text(str(limit))

    def remove(self) -> None:
        """Remove it, as soon as the processes in it that were killed have gone."""
        end = time.monotonic() + 60
        while self._folder.is_dir():
            try:
                self._folder.rmdir()
            except OSError:
                if time.monotonic() > end:
                    raise
                time.sleep(0.05)
