"""A recording ring in memory, written to files on request."""

from __future__ import annotations

from lfield.recording.segments import MAGIC


class MemoryRing:
    """The files as bytes; a file is full after `limit` bytes, None for never."""

    def __init__(self, limit=None, header=MAGIC):
        self._limit, self._header = limit, header
        self.files, self.closed = [], False

    @property
    def is_full(self):
        return self._limit is not None and len(self.files[-1]) >= self._limit

    def start_file(self, first=b""):
        self.files.append(self._header + first)

    def append(self, data):
        self.files[-1] += data

    def close(self, timeout=2.0):
        self.closed = True

    def stored(self, folder):
        """Writes the files to a folder; returns their paths."""
        paths = [folder / f"guard-{number:06d}.lfrec" for number in range(1, len(self.files) + 1)]
        for path, data in zip(paths, self.files, strict=True):
            path.write_bytes(data)
        return paths
