"""Which engine a host runs its program on, and its machine code: kept in files of its user, and compiled by a
process of its own.

Whatever compiling needs is given back when that process ends, and what it dies of (a limit of addresses, no
memory) leaves the host as it was. Only what that very process has written into its pipe is believed.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from itertools import accumulate, pairwise
from pathlib import Path
from typing import cast

from lfield.bytecode.program import Program
from lfield.errors import NoEngine, NoHome, OutputFileError, UsageError
from lfield.text.own_folders import cache_folder
from lfield.text.private import read_private, write_private
from lfield.vm.contract import Engine, Engines
from lfield.vm.reference import Engine as Reference
from lfield.vm.wasm.choice import MISSING, has_wasm, wasm_engine

#: Larger than the code of any program.
_MOST = 256 << 20
#: So many programs are kept, the last that were compiled.
KEPT = 64
#: Seconds that compiling may take. 5,000 `else if` in a method, on a computer ten times as slow, take 20.
PATIENCE = 120.0
_COMPILER = "lfield.vm.wasm.compiling"

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


def code_folder() -> Path | None:
    """The folder for the machine code of programs: in the service's cache, else in the user's own, if any."""
    # systemd names all cache folders of a unit, with colons between.
    service = os.environ.get("CACHE_DIRECTORY", "").partition(":")[0]
    if service:
        return Path(service) / "code"
    with suppress(NoHome, OutputFileError):
        return cache_folder() / "code"
    return None


class UserCache:
    """Machine code of a program in files of this user alone; others' are never read (`lfield.text.private`).

    Without such a folder everything is compiled each time, which is all that is lost.
    """

    def __init__(self, folder: Path | None, note: Note) -> None:
        self._folder, self._note = folder, note
        self._told = False

    def get(self, name: str) -> bytes | None:
        """The content of the file with that name; None when there is none that could be believed."""
        if self._folder is None:
            return None
        try:
            return read_private(self._folder / name, _MOST)
        except FileNotFoundError:
            return None
        except OSError as error:
            self.damaged(name, str(error.strerror or error))
            return None

    def put(self, name: str, data: bytes) -> None:
        """Write the file, whole or not at all, and forget the oldest ones."""
        if self._folder is None:
            return
        with suppress(OutputFileError):
            write_private(self._folder / name, data)
            _prune(self._folder)

    def damaged(self, name: str, reason: str) -> None:
        """Say it in the log, of the first file: it is written again, and what else is damaged is too."""
        if not self._told:
            self._note(f"machine code is made again: {self._folder}/{name}: {reason}")
        self._told = True

    def compiled(self, texts: Sequence[str], reservation: int) -> Sequence[bytes]:
        """The machine code of each module, made by a process of its own. Raises NoEngine."""
        return compiled(texts, reservation)


def compiled(texts: Sequence[str], reservation: int, patience: float = PATIENCE) -> list[bytes]:
    """The machine code of some modules, made by a process of its own, which ends with this one at the latest.

    Raises NoEngine.
    """
    # The modules of this host, and nothing that lies in the working folder: this host runs what is made.
    command = (sys.executable, "-P", "-m", _COMPILER, str(reservation), str(os.getpid()))
    modules = os.pathsep.join(folder for folder in sys.path if folder)
    # Its last words are to be the reason, not where in its libraries that was.
    environment = {**os.environ, "PYTHONPATH": modules, "RUST_BACKTRACE": "0"}
    try:
        ended = subprocess.run(
            command,
            input="\0".join(texts).encode(),
            capture_output=True,
            timeout=patience,
            check=False,
            env=environment,
        )
    except subprocess.TimeoutExpired:
        raise _not_compiled(f"took longer than {patience:g} s") from None
    except (OSError, MemoryError) as error:
        raise _not_compiled(f"could not begin: {error or 'there is no memory for it'}") from None
    if ended.returncode:
        raise _not_compiled(_why(ended.returncode, ended.stderr))
    codes = _parts(ended.stdout)
    if len(codes) != len(texts):
        raise _not_compiled("gave no machine code")
    return codes


def _parts(data: bytes) -> list[bytes]:
    """A line of sizes, then as many bytes of each; nothing where it is not that."""
    line, _, rest = data.partition(b"\n")
    with suppress(ValueError):
        ends = list(accumulate(map(int, line.split()), initial=0))
        if ends[-1] == len(rest):
            return [rest[start:end] for start, end in pairwise(ends)]
    return []


def _not_compiled(why: str) -> NoEngine:
    return NoEngine(ChildProcessError(f"its process that compiles {why}"))


def _why(status: int, said: bytes) -> str:
    """What a process has died of, in its own last words."""
    last = said.decode(errors="replace").strip().rpartition("\n")[2]
    how = f"was ended by signal {-status}" if status < 0 else f"ended with status {status}"
    return how + (f": {last}" if last else "")


def _prune(folder: Path) -> None:
    with suppress(OSError):
        oldest = sorted(folder.iterdir(), key=lambda path: path.stat().st_mtime)[:-KEPT]
        for path in oldest:
            path.unlink(missing_ok=True)
