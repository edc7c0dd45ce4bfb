"""The functions of the runtime over one memory: its text, compiled once, and how it is called."""

from __future__ import annotations

import ctypes
import struct
from collections.abc import Callable
from functools import cache, partial
from importlib.resources import files

import wasmtime
from wasmtime import _bindings as bindings

#: The files of its text.
PARTS = ("words", "collect", "copy", "sound", "strings", "texts")
#: Calls a function: context, function, numbers (16 bytes each, arguments and then results), how many of them,
#: where a trap is put; gives an error. Addresses are sooner handed over than typed pointers.
_ENTER = ctypes.CFUNCTYPE(
    ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_size_t, ctypes.c_void_p
)(ctypes.cast(bindings._wasmtime_func_call_unchecked, ctypes.c_void_p).value or 0)
_ERROR = ctypes.POINTER(bindings.wasmtime_error_t)


@cache
def runtime_text() -> str:
    """The whole module. It has no memory of its own."""
    folder = files(__package__)
    parts = "\n".join(folder.joinpath(f"{part}.wat").read_text(encoding="utf-8") for part in PARTS)
    return f'(module\n(import "arena" "memory" (memory 0))\n\n{parts})\n'


@cache
def runtime_module(engine: wasmtime.Engine) -> wasmtime.Module:
    """The module as machine code, for all memories of an engine."""
    return wasmtime.Module(engine, runtime_text())


class Functions:
    """The runtime over one memory. Addresses are bytes from its beginning; what each is: the .wat files."""

    def __init__(self, engine: wasmtime.Engine, store: wasmtime.Store, memory: wasmtime.Memory) -> None:
        self._store = store
        #: For modules that import its functions.
        self.instance = wasmtime.Instance(store, runtime_module(engine), [memory])
        self.collect = self.function("collect", 4)
        self.deep_copy = self.function("deep_copy", 9)
        self.sound = self.function("sound", 5)

    def function(self, name: str, count: int) -> Callable[..., int]:
        """One of its functions, which takes so many numbers and gives one (of 32 bits: its lower half).

        It raises wasmtime.Trap: the fault is lfield's.
        """
        function = self.instance.exports(self._store)[name]
        assert isinstance(function, wasmtime.Func)
        raw = (ctypes.c_int64 * (2 * count))()
        trap = ctypes.POINTER(bindings.wasm_trap_t)()
        context, own = self._store._context(), function._func
        given = (ctypes.cast(context, ctypes.c_void_p).value, *map(ctypes.addressof, (own, raw)))
        enter = partial(_ENTER, *given, count, ctypes.addressof(trap))
        pack = struct.Struct("<" + count * "q8x").pack_into

        # What is known by its address here must stay.
        def call(*arguments: int, kept: object = (context, own, trap)) -> int:
            pack(raw, 0, *arguments)
            error = enter()
            if error:
                raise wasmtime.WasmtimeError._from_ptr(ctypes.cast(error, _ERROR))
            if trap:
                raise wasmtime.Trap._from_ptr(trap)
            return raw[0]

        return call
