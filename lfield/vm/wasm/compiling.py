"""From text to machine code, here or in a process: `python -m lfield.vm.wasm.compiling RESERVATION PARENT`.

Texts come in, with a NUL between; out goes a line with the size of each one's machine code, then all of it.
The process ends with its PARENT, which has that number. It loads wasmtime and nothing else that is large: to
load what writes the texts would take longer than to compile them.
"""

from __future__ import annotations

import ctypes
import os
import sys
from functools import cache

import wasmtime

from lfield.vm.wasm.stack import STACK

PAGE = 1 << 16
#: The most a memory can have. With so many addresses reserved, code needs no checks that it stays within.
WHOLE = 1 << 32
#: The version of wasmtime that pyproject.toml asks for.
VERSION = 50
#: Of prctl: which signal this process gets when its parent ends.
_PARENT_DEATH, _SIGKILL = 1, 9


@cache
def compiler(reservation: int) -> wasmtime.Engine:
    """What compiles for memories with so many addresses; one for a process, so its hosts share modules.

    Raises ImportError where this wasmtime lacks a setting.
    """
    config = wasmtime.Config()
    for name, value in settings(reservation).items():
        # One that it does not know would be taken as well, and do nothing.
        if not hasattr(wasmtime.Config, name):
            raise ImportError(f"it has no setting {name}; lfield needs version {VERSION}")
        setattr(config, name, value)
    return wasmtime.Engine(config)


def settings(reservation: int) -> dict[str, int | bool]:
    """The settings of what compiles for memories with so many addresses, by their names in wasmtime."""
    return {
        "memory_reservation": reservation,
        "memory_reservation_for_growth": 0,
        "memory_may_move": False,
        "wasm_wide_arithmetic": True,
        "cranelift_nan_canonicalization": True,
        "parallel_compilation": False,
        "max_wasm_stack": STACK,
        **({"memory_guard_size": PAGE} if reservation < WHOLE else {}),
    }


def main(reservation: int, parent: int) -> None:
    """Compile what comes in."""
    _end_with(parent)
    texts = sys.stdin.buffer.read().decode().split("\0")
    codes = [bytes(wasmtime.Module(compiler(reservation), text).serialize()) for text in texts]
    sys.stdout.buffer.write(f"{' '.join(str(len(code)) for code in codes)}\n".encode() + b"".join(codes))
    sys.stdout.buffer.flush()


def _end_with(parent: int) -> None:
    ctypes.CDLL(None).prctl(_PARENT_DEATH, _SIGKILL, 0, 0, 0)
    # It may have ended before.
    if os.getppid() != parent:
        sys.exit(1)


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
