"""Direct calls of WebAssembly functions in half a microsecond, without wasmtime's value conversion."""

from __future__ import annotations

import ctypes
import struct
from collections.abc import Callable
from functools import partial

import wasmtime
from wasmtime import _bindings as bindings
from wasmtime._ffi import dll

#: Calls a function: context, function, numbers (16 bytes each, arguments and then results), their count,
#: address for a trap; returns an error. Addresses convert faster than typed pointers.
_ENTER = ctypes.CFUNCTYPE(
    ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_size_t, ctypes.c_void_p
)(ctypes.cast(dll.wasmtime_func_call_unchecked, ctypes.c_void_p).value or 0)
_TRAP = ctypes.POINTER(bindings.wasm_trap_t)
_ERROR = ctypes.POINTER(bindings.wasmtime_error_t)


def bind_function(
    store: wasmtime.Store, instance: wasmtime.Instance, name: str, count: int
) -> Callable[..., int]:
    """An exported function with `count` integer arguments and one result.

    Of a 32-bit result only the lower half is valid (`unsigned`). Raises wasmtime.Trap and WasmtimeError,
    which are bugs of lfield.
    """
    function = instance.exports(store)[name]
    assert isinstance(function, wasmtime.Func)
    capacity = max(1, count)
    raw = (ctypes.c_int64 * (2 * capacity))()
    trap = _TRAP()
    context, own = store._context(), function._func
    addresses = (ctypes.cast(context, ctypes.c_void_p).value, *map(ctypes.addressof, (own, raw)))
    enter = partial(_ENTER, *addresses, capacity, ctypes.addressof(trap))
    pack = struct.Struct("<" + count * "q8x").pack_into

    # Objects known by address must stay alive.
    def call(*arguments: int, referenced: object = (context, own, trap)) -> int:
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
    """A 32-bit result as an address or size."""
    return number & 0xFFFFFFFF
