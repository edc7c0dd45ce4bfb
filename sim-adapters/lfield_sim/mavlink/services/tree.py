"""A small tree of files in memory, bounded in what it holds.

Paths are absolute and plain: `/a/b`. Every error is one of FTP's own (https://mavlink.io/en/services/ftp.html).
"""

from __future__ import annotations

import errno
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum

#: Bytes of one file, entries of the tree, characters of a path.
MAX_FILE, MAX_ENTRIES, MAX_PATH = 1 << 20, 500, 200


class FtpError(IntEnum):
    """MAV_FTP_ERR."""

    NONE = 0
    FAIL = 1
    FAIL_ERRNO = 2
    INVALID_DATA_SIZE = 3
    INVALID_SESSION = 4
    NO_SESSIONS = 5
    EOF = 6
    UNKNOWN_COMMAND = 7
    EXISTS = 8
    PROTECTED = 9
    NOT_FOUND = 10


class TreeError(Exception):
    """An operation that the tree refuses; `number` is the errno of FAIL_ERRNO."""

    def __init__(self, error: FtpError, number: int = 0) -> None:
        super().__init__(f"{error.name} {number}")
        self.error, self.number = error, number


@dataclass(frozen=True, slots=True)
class Made:
    """A file that is made when it is read, as ArduPilot's @PARAM/param.pck.

    `told` is the size that is told before anybody knows it. Whether its checksum is that of what was read is
    `checks`: one that is made anew for each reading has another.
    """

    content: Callable[[], bytes]
    told: Callable[[], int]
    checks: bool = True


class Tree:
    """Folders and files. `made` are files made when they are read; in `shown` is what their folders list.

    `dots` are the entries of a folder for itself and the one around it.
    """

    def __init__(
        self,
        files: Mapping[str, bytes],
        made: Mapping[str, Made] | None = None,
        shown: Mapping[str, Sequence[str]] | None = None,
        dots: Sequence[str] = (),
    ) -> None:
        self._dots = dots
        self._made, self._shown = dict(made or {}), dict(shown or {})
        self._folders: set[str] = {"/"}
        self._files: dict[str, bytearray] = {}
        for path, data in files.items():
            self._add_folders(_parent(path))
            self._files[path] = bytearray(data)

    def read(self, path: str) -> bytes:
        """The whole of a file. Raises TreeError."""
        if path in self._made:
            return self._made[path].content()
        path = _plain(path)
        if path in self._files:
            return bytes(self._files[path])
        raise TreeError(FtpError.FAIL if path in self._folders else FtpError.NOT_FOUND)

    def checked(self, path: str) -> bytes:
        """What the checksum of a file is made of. Raises TreeError."""
        content = self.read(path)
        checks = path not in self._made or self._made[path].checks
        return content if checks else content + b"\0"

    def size(self, path: str) -> int:
        """The size that is told of a file. Raises TreeError."""
        return self._made[path].told() if path in self._made else len(self.read(path))

    def has(self, path: str) -> bool:
        """Whether there is such a file. Raises TreeError for what is no path."""
        return path in self._made or _plain(path) in self._files

    def entries(self, path: str) -> list[str]:
        """What is in a folder: `D<name>`, `F<name>\\t<size>`, `S`: skipped. Raises TreeError."""
        if path.rstrip("/") in self._shown:
            return list(self._shown[path.rstrip("/")])
        path = _plain(path)
        if path not in self._folders:
            raise TreeError(FtpError.NOT_FOUND)
        shown = [f"D{each}" for each in self._shown if path == "/"]
        return [*self._dots, *self._inside(path), *shown]

    def _inside(self, path: str) -> list[str]:
        """What was put into a folder."""
        folders = [f"D{_name(each)}" for each in self._folders if each != "/" and _parent(each) == path]
        files = [f"F{_name(each)}\t{len(self._files[each])}" for each in self._files if _parent(each) == path]
        return sorted(folders) + sorted(files)

    def create(self, path: str) -> None:
        """An empty file, instead of one that was there. Raises TreeError."""
        path = self._new(path, there=self._files)
        if path in self._folders:
            raise TreeError(FtpError.FAIL_ERRNO, errno.EISDIR)
        self._files[path] = bytearray()

    def write(self, path: str, offset: int, data: bytes) -> None:
        """Put bytes into a file; a hole before them reads as zeros. Raises TreeError."""
        path = _plain(path)
        if path not in self._files:
            raise TreeError(FtpError.NOT_FOUND)
        file = self._files[path]
        if offset + len(data) > MAX_FILE:
            raise TreeError(FtpError.FAIL_ERRNO, errno.ENOSPC)
        file.extend(bytes(max(0, offset - len(file))))
        file[offset : offset + len(data)] = data

    def truncate(self, path: str, size: int) -> None:
        """Cut a file to a size. Raises TreeError."""
        path = _plain(path)
        if path not in self._files:
            raise TreeError(FtpError.NOT_FOUND)
        del self._files[path][size:]

    def rename(self, old: str, new: str) -> None:
        """Give a file another path. Raises TreeError."""
        old, new = _plain(old), self._new(new, there=self._files)
        if old not in self._files:
            raise TreeError(FtpError.NOT_FOUND)
        if new in self._folders:
            raise TreeError(FtpError.FAIL_ERRNO, errno.EISDIR)
        self._files[new] = self._files.pop(old)

    def remove(self, path: str) -> None:
        """Remove a file. Raises TreeError."""
        path = _plain(path)
        if path not in self._files:
            raise TreeError(FtpError.FAIL if path in self._folders else FtpError.NOT_FOUND)
        del self._files[path]

    def make_folder(self, path: str) -> None:
        """A new folder in one that is there. Raises TreeError."""
        path = self._new(path, there=())
        if path in self._folders or path in self._files:
            raise TreeError(FtpError.EXISTS)
        self._folders.add(path)

    def remove_folder(self, path: str) -> None:
        """Remove an empty folder. Raises TreeError."""
        path = _plain(path)
        if path not in self._folders or path == "/":
            raise TreeError(FtpError.NOT_FOUND if path != "/" else FtpError.PROTECTED)
        if self._inside(path):
            raise TreeError(FtpError.FAIL_ERRNO, errno.ENOTEMPTY)
        self._folders.remove(path)

    def _new(self, path: str, there: Mapping[str, bytearray] | tuple[()]) -> str:
        """The plain path of what is to be made, when there is a folder and room for it."""
        path = _plain(path)
        if _parent(path) not in self._folders:
            raise TreeError(FtpError.NOT_FOUND)
        if path not in there and len(self._files) + len(self._folders) >= MAX_ENTRIES:
            raise TreeError(FtpError.FAIL_ERRNO, errno.ENOSPC)
        return path

    def _add_folders(self, path: str) -> None:
        while path != "/":
            self._folders.add(path)
            path = _parent(path)


def _plain(path: str) -> str:
    """Without doubled and trailing slashes. Raises TreeError for what leads out, or is too long."""
    parts = [part for part in path.split("/") if part not in ("", ".")]
    if len(path) > MAX_PATH or ".." in parts or any("\t" in part for part in parts):
        raise TreeError(FtpError.NOT_FOUND)
    return "/" + "/".join(parts)


def _parent(path: str) -> str:
    return path.rpartition("/")[0] or "/"


def _name(path: str) -> str:
    return path.rpartition("/")[2]
