"""Calling a WebAssembly function from Python in half a microsecond: wasmtime converts every value."""

from __future__ import annotations

import ctypes
import struct
from collections.abc import Callable
from functools import partial

import wasmtime
from wasmtime import _bindings as bindings
from wasmtime._ffi import dll

#: Calls a function: context, function, numbers (16 bytes each, arguments and then results), how many of them,
#: where a trap is put; gives an error. Addresses are sooner handed over than typed pointers.
_ENTER = ctypes.CFUNCTYPE(
    ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_size_t, ctypes.c_void_p
)(ctypes.cast(dll.wasmtime_func_call_unchecked, ctypes.c_void_p).value or 0)
_TRAP = ctypes.POINTER(bindings.wasm_trap_t)
_ERROR = ctypes.POINTER(bindings.wasmtime_error_t)


def quick(store: wasmtime.Store, instance: wasmtime.Instance, name: str, count: int) -> Callable[..., int]:
    """An exported function that takes so many whole numbers and gives one; for no arguments `count` is 0.

    Of a result of 32 bits only the lower half counts (`unsigned`). Raises wasmtime.Trap and WasmtimeError,
    which are bugs of ours.
    """
    function = instance.exports(store)[name]
    assert isinstance(function, wasmtime.Func)
    room = max(1, count)
    raw = (ctypes.c_int64 * (2 * room))()
    trap = _TRAP()
    context, own = store._context(), function._func
    given = (ctypes.cast(context, ctypes.c_void_p).value, *map(ctypes.addressof, (own, raw)))
    enter = partial(_ENTER, *given, room, ctypes.addressof(trap))
    pack = struct.Struct("<" + count * "q8x").pack_into

    # What is known by its address here must stay.
    def call(*arguments: int, kept: object = (context, own, trap)) -> int:
        pack(raw, 0, *arguments)
        error = enter()
        if error:
            raise wasmtime.WasmtimeError._from_ptr(ctypes.cast(error, _ERROR))
        if trap:
            raised = wasmtime.Trap._from_ptr(ctypes.cast(trap, _TRAP))
            ctypes.memset(ctypes.addressof(trap), 0, ctypes.sizeof(trap))
            raise raised
        return raw[0]

    return call


def unsigned(number: int) -> int:
    """A result of 32 bits as it is meant for addresses and sizes."""
    return number & 0xFFFFFFFF
