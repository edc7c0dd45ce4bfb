"""Inputs of a build: enough to detect later that the same bundle would result."""

from __future__ import annotations

import hashlib
import os
import sys
import zlib
from collections.abc import Iterable
from pathlib import Path

import msgspec

#: Code files are covered by their modules.
_CODE = (".py", ".pyc", ".so")
_VIRTUAL_ROOTS = ("/proc/", "/sys/", "/dev/")


class BuildInputs(msgspec.Struct, frozen=True, array_like=True):
    """`files` by path with the SHA-256 of their bytes, b"" for a missing one.

    `code` are modules, by path with the modification time in nanoseconds and the size, and folders of
    modules, by path with a checksum and the number of the names in them. Paths are bytes of the file system,
    which need not be valid UTF-8.
    """

    files: dict[bytes, bytes]
    code: tuple[tuple[bytes, int, int], ...]

    def is_up_to_date(self) -> bool:
        """Whether all inputs are unchanged."""
        return all(_state(os.fsdecode(path)) == (path, *state) for path, *state in self.code) and all(
            _digest(os.fsdecode(path)) == digest for path, digest in self.files.items()
        )


class InputRecorder:
    """Records every file that this process opens, until it exits; only for a build process."""

    def __init__(self) -> None:
        self._opened: set[str] = set()
        sys.addaudithook(self._on_audit_event)

    def _on_audit_event(self, event: str, args: tuple[object, ...]) -> None:
        if event == "open" and isinstance(args[0], str):
            self._opened.add(args[0])

    def inputs(self, searched: Iterable[Path], workshop: Path) -> BuildInputs:
        """The files that were read or `searched` (they may be missing), and the code of the builder.

        Files in the `workshop` are outputs, not inputs.
        """
        paths = {os.path.abspath(path) for path in (*self._opened, *map(str, searched))}
        prefix = os.path.abspath(workshop)
        files = sorted(path for path in paths if not path.startswith(prefix) and _counts(path))
        return BuildInputs(
            {os.fsencode(path): _digest(path) for path in files}, tuple(map(_state, sorted(_code())))
        )


def _counts(path: str) -> bool:
    """Whether a file is an input. Installed files are covered by their folders."""
    return not (path.endswith(_CODE) or path.startswith(_VIRTUAL_ROOTS) or ".dist-info/" in path)


def _code() -> set[str]:
    """The loaded modules outside Python's standard library, and the folders that are searched for modules."""
    own = os.path.dirname(os.__file__)
    loaded = {getattr(module, "__file__", None) or "" for module in list(sys.modules.values())}
    modules = {file for file in loaded if file.endswith(_CODE) and os.path.dirname(file) != own}
    return {file for file in modules if f"{own}/lib-dynload" not in file} | {
        folder for folder in module_search_paths() if os.path.isdir(folder)
    }


def module_search_paths() -> list[str]:
    """The folders that are searched for modules, without the caller's folder, whose content may change."""
    # Python puts that folder first, except with -P.
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
    """Whether a name could be a module: skips hidden folders of tools, and compiled files of Python."""
    return not name.startswith(".") and name != "__pycache__"


def _digest(path: str) -> bytes:
    try:
        if os.path.isdir(path):
            return hashlib.sha256("\0".join(sorted(os.listdir(path))).encode("utf-8", "replace")).digest()
        with open(path, "rb") as stream:
            return hashlib.sha256(stream.read()).digest()
    except OSError:
        return b""
