"""WebAssembly compiler, in this process or as `python -m lfield.vm.wasm.wasm_compiler RESERVATION PARENT`.

Input: texts separated by NUL. Output: a line with the size of each machine code, then all of them. The
process ends with its PARENT (a process id). The process loads no large module except wasmtime: loading the
lowering would take longer than compiling.
"""

from __future__ import annotations

import ctypes
import os
import sys
from functools import cache

import wasmtime

from lfield.vm.wasm.stack_depth import STACK

PAGE = 1 << 16
#: The maximum memory. With this reservation, code needs no bounds checks.
ADDRESS_SPACE = 1 << 32
#: The wasmtime version required by pyproject.toml.
VERSION = 50
#: The option of prctl for the signal that this process gets when its parent ends.
_PARENT_DEATH, _SIGKILL = 1, 9


@cache
def compiler(reservation: int) -> wasmtime.Engine:
    """The compiler for memories with that reservation; one per process, so its hosts share modules.

    Raises ImportError if this wasmtime lacks a setting.
    """
    config = wasmtime.Config()
    for name, value in settings(reservation).items():
        # An unknown setting would be accepted without effect.
        if not hasattr(wasmtime.Config, name):
            raise ImportError(f"it has no setting {name}; lfield needs version {VERSION}")
        setattr(config, name, value)
    return wasmtime.Engine(config)


def settings(reservation: int) -> dict[str, int | bool]:
    """wasmtime settings for memories with that reservation."""
    return {
        "memory_reservation": reservation,
        "memory_reservation_for_growth": 0,
        "memory_may_move": False,
        "wasm_wide_arithmetic": True,
        "cranelift_nan_canonicalization": True,
        "parallel_compilation": False,
        "max_wasm_stack": STACK,
        **({"memory_guard_size": PAGE} if reservation < ADDRESS_SPACE else {}),
    }


def main(reservation: int, parent: int) -> None:
    """Compile the input."""
    _end_with(parent)
    texts = sys.stdin.buffer.read().decode().split("\0")
    codes = [bytes(wasmtime.Module(compiler(reservation), text).serialize()) for text in texts]
    sys.stdout.buffer.write(f"{' '.join(str(len(code)) for code in codes)}\n".encode() + b"".join(codes))
    sys.stdout.buffer.flush()


def _end_with(parent: int) -> None:
    ctypes.CDLL(None).prctl(_PARENT_DEATH, _SIGKILL, 0, 0, 0)
    # The parent may have ended before this call.
    if os.getppid() != parent:
        sys.exit(1)


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
