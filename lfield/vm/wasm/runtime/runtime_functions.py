"""The runtime's functions over one memory: text, compiled once, and calls."""

from __future__ import annotations

from functools import cache
from importlib.resources import files

import wasmtime

from lfield.vm.wasm.native_calls import bind_function

#: The files of the runtime: common functions, whole-heap operations, functions of compiled methods.
PARTS = ("memory", "collect", "copy", "verify_heap", "can_migrate", "strings", "conversions")


@cache
def runtime_text() -> str:
    """The whole module, without a memory of its own."""
    folder = files(__package__)
    parts = "\n".join(folder.joinpath(f"{part}.wat").read_text(encoding="utf-8") for part in PARTS)
    return f'(module $runtime\n(import "arena" "memory" (memory 0))\n\n{parts})\n'


class RuntimeFunctions:
    """The runtime over one memory.

    Functions take and return integers, explained in the .wat files; addresses are in bytes from the beginning
    of the memory. Any trap in a function is a bug of lfield.
    """

    def __init__(self, code: wasmtime.Module, store: wasmtime.Store, memory: wasmtime.Memory) -> None:
        #: The instance, for modules that import its functions.
        self.instance = wasmtime.Instance(store, code, [memory])
        self.collect = bind_function(store, self.instance, "collect", 6)
        self.deep_copy = bind_function(store, self.instance, "deep_copy", 10)
        self.verify_heap = bind_function(store, self.instance, "verify_heap", 6)
        self.can_migrate = bind_function(store, self.instance, "can_migrate", 6)
