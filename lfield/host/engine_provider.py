"""Selects the engine of a host, and provides machine code: cached in the user's files, compiled in a child
process.

The memory for compiling is freed when that process ends, and a failure of the process (address-space limit,
no memory) does not affect the host. The host uses only the output that it reads from the pipe of this
process.
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
from lfield.errors import EngineUnavailable, NoHomeFolder, OutputFileError, UsageError
from lfield.text import log_messages
from lfield.text.log_messages import LogLine
from lfield.text.secure_files import read_private, write_private
from lfield.text.user_dirs import cache_dir
from lfield.vm.engine_interface import Engine, Engines
from lfield.vm.reference import ReferenceEngine as Reference
from lfield.vm.wasm.engine_selection import MISSING, has_wasm, wasm_engine

#: A limit that is larger than the code of any program.
_MAX_BYTES = 256 << 20
#: The number of cached programs, most recently compiled.
MAX_PROGRAMS = 64
#: Time limit for compiling in seconds. 5,000 `else if` in a method, on a computer ten times as slow, take 20.
COMPILE_TIMEOUT = 120.0
_COMPILER = "lfield.vm.wasm.wasm_compiler"

LogSink = Callable[[LogLine], None]


def select_engine(choice: str, note: LogSink, stopwatch: Callable[[], float] | None = None) -> Engines:
    """Create the engine factory of a machine (`lfield.vm.wasm.engine_selection`); `note` receives log lines.

    `stopwatch` measures the duration of runs, by default the clock of the engine.

    Raises UsageError if the requested engine is not available.
    """
    if choice == "wasm" and not has_wasm():
        raise UsageError(MISSING)
    if choice == "reference" or not has_wasm():
        return Reference

    def make(program: Program, now: Callable[[], float]) -> Engine:
        try:
            with wasm_engine() as wasm:
                cache = UserCodeCache(code_folder(), note)
                return cast(Engine, wasm.WasmEngine(program, now, cache, note, stopwatch))
        except EngineUnavailable as unusable:
            if choice == "wasm":
                raise UsageError(str(unusable)) from None
            note(log_messages.ENGINE_FALLBACK.line(reason=unusable))
            return Reference(program, now)

    return make


def code_folder() -> Path | None:
    """The folder for machine code: in the service's cache directory, else in the user's own; None for
    none."""
    # systemd lists all cache directories of a unit, separated by colons.
    service = os.environ.get("CACHE_DIRECTORY", "").partition(":")[0]
    if service:
        return Path(service) / "code"
    with suppress(NoHomeFolder, OutputFileError):
        return cache_dir() / "code"
    return None


class UserCodeCache:
    """Machine code of programs in files that only this user can write (`lfield.text.secure_files`).

    Without such a folder every program is compiled at each start.
    """

    def __init__(self, folder: Path | None, note: LogSink) -> None:
        self._folder, self._note = folder, note
        self._has_logged = False

    def get(self, name: str) -> bytes | None:
        """The contents of the file with that name; None if there is no trusted file."""
        if self._folder is None:
            return None
        try:
            return read_private(self._folder / name, _MAX_BYTES)
        except FileNotFoundError:
            return None
        except OSError as error:
            self.damaged(name, str(error.strerror or error))
            return None

    def put(self, name: str, data: bytes) -> None:
        """Write the file atomically, and delete the oldest ones."""
        if self._folder is None:
            return
        with suppress(OutputFileError):
            write_private(self._folder / name, data)
            _prune(self._folder)

    def damaged(self, name: str, reason: str) -> None:
        """Log the damage of the first file only: the files are written again."""
        if not self._has_logged:
            line = log_messages.CODE_CACHE_IGNORED.line(file=f"{self._folder}/{name}", reason=reason)
            self._note(line)
        self._has_logged = True

    def compiled(self, texts: Sequence[str], reservation: int) -> Sequence[bytes]:
        """The machine code of each module, compiled in a child process. Raises EngineUnavailable."""
        return compile_in_process(texts, reservation)


def compile_in_process(
    texts: Sequence[str], reservation: int, timeout: float = COMPILE_TIMEOUT
) -> list[bytes]:
    """Compile modules in a child process, which ends with this one at the latest.

    Raises EngineUnavailable.
    """
    # Import the modules of this host and nothing from the working directory: the host executes the output.
    command = (sys.executable, "-P", "-m", _COMPILER, str(reservation), str(os.getpid()))
    modules = os.pathsep.join(folder for folder in sys.path if folder)
    # The last line of the output is the reason; a traceback would hide it.
    environment = {**os.environ, "PYTHONPATH": modules, "RUST_BACKTRACE": "0"}
    try:
        ended = subprocess.run(
            command,
            input="\0".join(texts).encode(),
            capture_output=True,
            timeout=timeout,
            check=False,
            env=environment,
        )
    except subprocess.TimeoutExpired:
        raise _compile_failure(f"took longer than {timeout:g} s") from None
    except (OSError, MemoryError) as error:
        raise _compile_failure(f"could not start: {error or 'not enough memory'}") from None
    if ended.returncode:
        raise _compile_failure(_exit_reason(ended.returncode, ended.stderr))
    codes = _split_modules(ended.stdout)
    if len(codes) != len(texts):
        raise _compile_failure("gave no machine code")
    return codes


def _split_modules(data: bytes) -> list[bytes]:
    """Parse a line of sizes, followed by the bytes of each size; empty if malformed."""
    line, _, modules = data.partition(b"\n")
    with suppress(ValueError):
        ends = list(accumulate(map(int, line.split()), initial=0))
        if ends[-1] == len(modules):
            return [modules[start:end] for start, end in pairwise(ends)]
    return []


def _compile_failure(failure: str) -> EngineUnavailable:
    return EngineUnavailable(ChildProcessError(f"its process that compiles {failure}"))


def _exit_reason(status: int, output: bytes) -> str:
    """The reason why a process has ended, from the last line of its output."""
    last = output.decode(errors="replace").strip().rpartition("\n")[2]
    how = f"was ended by signal {-status}" if status < 0 else f"ended with status {status}"
    return how + (f": {last}" if last else "")


def _prune(folder: Path) -> None:
    with suppress(OSError):
        oldest = sorted(folder.iterdir(), key=lambda path: path.stat().st_mtime)[:-MAX_PROGRAMS]
        for path in oldest:
            path.unlink(missing_ok=True)
