"""The functions of the runtime over one memory: its text, compiled once, and how it is called."""

from __future__ import annotations

from functools import cache
from importlib.resources import files

import wasmtime

from lfield.vm.wasm.calls import quick

#: The files of its text: what all use, what is done with whole heaps, what compiled methods call.
PARTS = ("words", "collect", "copy", "sound", "travels", "strings", "texts")


@cache
def runtime_text() -> str:
    """The whole module. It has no memory of its own."""
    folder = files(__package__)
    parts = "\n".join(folder.joinpath(f"{part}.wat").read_text(encoding="utf-8") for part in PARTS)
    return f'(module $runtime\n(import "arena" "memory" (memory 0))\n\n{parts})\n'


class Functions:
    """The runtime over one memory.

    Each takes and gives whole numbers, which the .wat files explain; addresses are in bytes from the
    beginning of the memory. Any trap in them is a bug of ours.
    """

    def __init__(self, code: wasmtime.Module, store: wasmtime.Store, memory: wasmtime.Memory) -> None:
        #: For modules that import its functions.
        self.instance = wasmtime.Instance(store, code, [memory])
        self.collect = quick(store, self.instance, "collect", 6)
        self.deep_copy = quick(store, self.instance, "deep_copy", 10)
        self.sound = quick(store, self.instance, "sound", 6)
        self.travels = quick(store, self.instance, "travels", 6)
