"""Which engine a host runs its program on, and where the machine code is kept that it makes of it."""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import cast

from lfield.bytecode.program import Program
from lfield.errors import NoEngine, OutputFileError, UsageError
from lfield.text.private import read_private, write_private
from lfield.vm.contract import Engine, Engines
from lfield.vm.reference import Engine as Reference
from lfield.vm.wasm.choice import MISSING, has_wasm, wasm_engine

#: Larger than the code of any program.
_MOST = 256 << 20
#: So many programs are kept, the last that were compiled.
KEPT = 64

Note = Callable[[str], None]


def engines_for(choice: str, note: Note) -> Engines:
    """What makes a machine's engine, of `lfield.vm.wasm.choice`; `note` takes lines for the log.

    Raises UsageError where what was asked for cannot be had.
    """
    if choice == "wasm" and not has_wasm():
        raise UsageError(MISSING)
    if choice == "reference" or not has_wasm():
        return Reference

    def make(program: Program, now: Callable[[], float]) -> Engine:
        try:
            with wasm_engine() as wasm:
                return cast(Engine, wasm.Engine(program, now, UserCache(code_folder(), note), note))
        except NoEngine as unusable:
            if choice == "wasm":
                raise UsageError(str(unusable)) from None
            note(f"the reference engine runs the program: {unusable}")
            return Reference(program, now)

    return make


def code_folder() -> Path:
    """The folder for the machine code of programs: in the service's cache, else in the user's own."""
    # systemd names all cache folders of a unit, with colons between.
    service = os.environ.get("CACHE_DIRECTORY", "").partition(":")[0]
    if service:
        return Path(service) / "code"
    base = os.environ.get("XDG_CACHE_HOME") or ""
    return (Path(base) if os.path.isabs(base) else Path.home() / ".cache") / "lfield" / "code"


class UserCache:
    """Machine code in files of this user alone; others' are never read (`lfield.text.private`).

    Without such a folder everything is compiled each time, which is all that is lost.
    """

    def __init__(self, folder: Path, note: Note) -> None:
        self._folder, self._note = folder, note
        self._told = False

    def get(self, name: str) -> bytes | None:
        """The content of the file with that name; None when there is none that could be believed."""
        try:
            return read_private(self._folder / name, _MOST)
        except FileNotFoundError:
            return None
        except OSError as error:
            self.damaged(name, str(error.strerror or error))
            return None

    def put(self, name: str, data: bytes) -> None:
        """Write the file, whole or not at all, and forget the oldest ones."""
        with suppress(OutputFileError):
            write_private(self._folder / name, data)
            self._prune()

    def damaged(self, name: str, reason: str) -> None:
        """Say it in the log, of the first file: it is written again, and what else is damaged is too."""
        if not self._told:
            self._note(f"machine code is made again: {self._folder / name}: {reason}")
        self._told = True

    def _prune(self) -> None:
        with suppress(OSError):
            oldest = sorted(self._folder.iterdir(), key=lambda path: path.stat().st_mtime)[:-KEPT]
            for path in oldest:
                path.unlink(missing_ok=True)
