"""Of what a bundle was made: enough to see later that it would come out the same."""

from __future__ import annotations

import hashlib
import os
import sys
import zlib
from collections.abc import Iterable
from pathlib import Path

import msgspec

#: Files that are code, or no files at all: code is known by its modules, the rest says nothing.
_CODE = (".py", ".pyc", ".so")
_NOWHERE = ("/proc/", "/sys/", "/dev/")


class Inputs(msgspec.Struct, frozen=True, array_like=True):
    """`files` by path with the SHA-256 of their bytes, b"" where there was none.

    `code` are modules, by path with the time of the last change in nanoseconds and the size, and folders of
    modules, by path with a checksum of the names in them and how many those are. Paths are in the bytes of
    the file system, which may be no text.
    """

    files: dict[bytes, bytes]
    code: tuple[tuple[bytes, int, int], ...]

    def unchanged(self) -> bool:
        """Whether all is as it was."""
        return all(_state(os.fsdecode(path)) == (path, *then) for path, *then in self.code) and all(
            _digest(os.fsdecode(path)) == digest for path, digest in self.files.items()
        )


class Watch:
    """Notes every file that this process opens, until it ends: for a process that builds, and no more."""

    def __init__(self) -> None:
        self._opened: set[str] = set()
        sys.addaudithook(self._heard)

    def _heard(self, event: str, args: tuple[object, ...]) -> None:
        if event == "open" and isinstance(args[0], str):
            self._opened.add(args[0])

    def inputs(self, looked_for: Iterable[Path], workshop: Path) -> Inputs:
        """What was read, what was `looked_for` and may not be there, and the code that did it.

        What lies in the `workshop` is made here, and is no input.
        """
        paths = {os.path.abspath(path) for path in (*self._opened, *map(str, looked_for))}
        made = os.path.abspath(workshop)
        files = sorted(path for path in paths if not path.startswith(made) and _counts(path))
        return Inputs(
            {os.fsencode(path): _digest(path) for path in files}, tuple(map(_state, sorted(_code())))
        )


def _counts(path: str) -> bool:
    """Whether a file is read for what it says. What is installed is known by the folders it lies in."""
    return not (path.endswith(_CODE) or path.startswith(_NOWHERE) or ".dist-info/" in path)


def _code() -> set[str]:
    """The modules that are loaded and not Python's own, and the folders where new ones would be found."""
    own = os.path.dirname(os.__file__)
    loaded = {getattr(module, "__file__", None) or "" for module in list(sys.modules.values())}
    modules = {file for file in loaded if file.endswith(_CODE) and os.path.dirname(file) != own}
    return {file for file in modules if f"{own}/lib-dynload" not in file} | {
        folder for folder in searched() if os.path.isdir(folder)
    }


def searched() -> list[str]:
    """The folders where modules are found, without that of whoever called: there anything may come and go."""
    # Python puts that one first, unless it is told not to (-P).
    return sys.path if sys.flags.safe_path else sys.path[1:]


def _state(path: str) -> tuple[bytes, int, int]:
    name = os.fsencode(path)
    try:
        if os.path.isdir(path):
            names = sorted(filter(_is_importable, os.listdir(path)))
            return name, zlib.crc32("\0".join(names).encode("utf-8", "replace")), len(names)
        found = os.stat(path)
    except OSError:
        return name, -1, -1
    return name, found.st_mtime_ns, found.st_size


def _is_importable(name: str) -> bool:
    """Whether it could be a module: tools leave hidden folders, and Python what it compiled."""
    return not name.startswith(".") and name != "__pycache__"


def _digest(path: str) -> bytes:
    try:
        if os.path.isdir(path):
            return hashlib.sha256("\0".join(sorted(os.listdir(path))).encode("utf-8", "replace")).digest()
        with open(path, "rb") as stream:
            return hashlib.sha256(stream.read()).digest()
    except OSError:
        return b""
