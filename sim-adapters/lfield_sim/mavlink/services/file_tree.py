"""A small, bounded file tree in memory.

Paths are absolute and plain: `/a/b`. Every error is one of FTP's (https://mavlink.io/en/services/ftp.html).
"""

from __future__ import annotations

import errno
from collections.abc import Callable, Mapping, Sequence
from enum import IntEnum

from msgspec import Struct

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


class FileTreeError(Exception):
    """A refused operation; `number` is the errno of FAIL_ERRNO."""

    def __init__(self, error: FtpError, number: int = 0) -> None:
        super().__init__(f"{error.name} {number}")
        self.error, self.number = error, number


class GeneratedFile(Struct, frozen=True):
    """A file that is generated when it is read, as ArduPilot's @PARAM/param.pck.

    `reported_size` is the size reported before that. `checks`: its checksum matches the bytes that were read;
    a file generated for each read differs.
    """

    content: Callable[[], bytes]
    reported_size: Callable[[], int]
    checks: bool = True


class FileTree:
    """Folders and files. `generated` are generated files; `listings` lists their folders.

    `dots` are the entries of a folder for itself and its parent.
    """

    def __init__(
        self,
        files: Mapping[str, bytes],
        generated: Mapping[str, GeneratedFile] | None = None,
        listings: Mapping[str, Sequence[str]] | None = None,
        dots: Sequence[str] = (),
    ) -> None:
        self._dots = dots
        self._generated, self._listings = dict(generated or {}), dict(listings or {})
        self._folders: set[str] = {"/"}
        self._files: dict[str, bytearray] = {}
        for path, data in files.items():
            self._add_folders(_parent(path))
            self._files[path] = bytearray(data)

    def read(self, path: str) -> bytes:
        """The whole of a file. Raises FileTreeError."""
        if path in self._generated:
            return self._generated[path].content()
        path = _plain(path)
        if path in self._files:
            return bytes(self._files[path])
        raise FileTreeError(FtpError.FAIL if path in self._folders else FtpError.NOT_FOUND)

    def checked(self, path: str) -> bytes:
        """The content for the checksum of a file. Raises FileTreeError."""
        content = self.read(path)
        checks = path not in self._generated or self._generated[path].checks
        return content if checks else content + b"\0"

    def size(self, path: str) -> int:
        """The reported size of a file. Raises FileTreeError."""
        return self._generated[path].reported_size() if path in self._generated else len(self.read(path))

    def has(self, path: str) -> bool:
        """Whether a file exists. Raises FileTreeError for an invalid path."""
        return path in self._generated or _plain(path) in self._files

    def entries(self, path: str) -> list[str]:
        """The entries of a folder: `D<name>`, `F<name>\\t<size>`, `S`: skipped. Raises FileTreeError."""
        if path.rstrip("/") in self._listings:
            return list(self._listings[path.rstrip("/")])
        path = _plain(path)
        if path not in self._folders:
            raise FileTreeError(FtpError.NOT_FOUND)
        virtual_folders = [f"D{each}" for each in self._listings if path == "/"]
        return [*self._dots, *self._inside(path), *virtual_folders]

    def _inside(self, path: str) -> list[str]:
        """The stored entries of a folder."""
        folders = [f"D{_name(each)}" for each in self._folders if each != "/" and _parent(each) == path]
        files = [f"F{_name(each)}\t{len(self._files[each])}" for each in self._files if _parent(each) == path]
        return sorted(folders) + sorted(files)

    def create(self, path: str) -> None:
        """Creates an empty file, replacing an existing one. Raises FileTreeError."""
        path = self._new(path, existing=self._files)
        if path in self._folders:
            raise FileTreeError(FtpError.FAIL_ERRNO, errno.EISDIR)
        self._files[path] = bytearray()

    def write(self, path: str, offset: int, data: bytes) -> None:
        """Writes bytes into a file; a gap before them reads as zeros. Raises FileTreeError."""
        path = _plain(path)
        if path not in self._files:
            raise FileTreeError(FtpError.NOT_FOUND)
        file = self._files[path]
        if offset + len(data) > MAX_FILE:
            raise FileTreeError(FtpError.FAIL_ERRNO, errno.ENOSPC)
        file.extend(bytes(max(0, offset - len(file))))
        file[offset : offset + len(data)] = data

    def truncate(self, path: str, size: int) -> None:
        """Truncates a file. Raises FileTreeError."""
        path = _plain(path)
        if path not in self._files:
            raise FileTreeError(FtpError.NOT_FOUND)
        del self._files[path][size:]

    def rename(self, old: str, new: str) -> None:
        """Renames a file. Raises FileTreeError."""
        old, new = _plain(old), self._new(new, existing=self._files)
        if old not in self._files:
            raise FileTreeError(FtpError.NOT_FOUND)
        if new in self._folders:
            raise FileTreeError(FtpError.FAIL_ERRNO, errno.EISDIR)
        self._files[new] = self._files.pop(old)

    def remove(self, path: str) -> None:
        """Removes a file. Raises FileTreeError."""
        path = _plain(path)
        if path not in self._files:
            raise FileTreeError(FtpError.FAIL if path in self._folders else FtpError.NOT_FOUND)
        del self._files[path]

    def make_folder(self, path: str) -> None:
        """Creates a folder in an existing one. Raises FileTreeError."""
        path = self._new(path, existing=())
        if path in self._folders or path in self._files:
            raise FileTreeError(FtpError.EXISTS)
        self._folders.add(path)

    def remove_folder(self, path: str) -> None:
        """Removes an empty folder. Raises FileTreeError."""
        path = _plain(path)
        if path not in self._folders or path == "/":
            raise FileTreeError(FtpError.NOT_FOUND if path != "/" else FtpError.PROTECTED)
        if self._inside(path):
            raise FileTreeError(FtpError.FAIL_ERRNO, errno.ENOTEMPTY)
        self._folders.remove(path)

    def _new(self, path: str, existing: Mapping[str, bytearray] | tuple[()]) -> str:
        """The plain path of a new entry, if there is a folder and room for it."""
        path = _plain(path)
        if _parent(path) not in self._folders:
            raise FileTreeError(FtpError.NOT_FOUND)
        if path not in existing and len(self._files) + len(self._folders) >= MAX_ENTRIES:
            raise FileTreeError(FtpError.FAIL_ERRNO, errno.ENOSPC)
        return path

    def _add_folders(self, path: str) -> None:
        while path != "/":
            self._folders.add(path)
            path = _parent(path)


def _plain(path: str) -> str:
    """The path without repeated and trailing slashes. Raises FileTreeError if it leaves the tree, or
    is too long.
    """
    parts = [part for part in path.split("/") if part not in ("", ".")]
    if len(path) > MAX_PATH or ".." in parts or any("\t" in part for part in parts):
        raise FileTreeError(FtpError.NOT_FOUND)
    return "/" + "/".join(parts)


def _parent(path: str) -> str:
    return path.rpartition("/")[0] or "/"


def _name(path: str) -> str:
    return path.rpartition("/")[2]
