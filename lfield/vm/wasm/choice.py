"""What may be chosen to run a program: `reference`, `wasm`, or `auto`, WebAssembly where it can be had.

Nothing of wasmtime is loaded by asking.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from importlib.util import find_spec
from types import ModuleType

from lfield.errors import NoEngine

CHOICES = ("auto", "wasm", "reference")
#: What is missing for the fast engine, and its cure.
MISSING = "the engine in WebAssembly needs wasmtime: pip install 'lfield[wasm]'"


def has_wasm() -> bool:
    """Whether wasmtime is installed."""
    return find_spec("wasmtime") is not None


@contextmanager
def wasm_engine() -> Iterator[ModuleType]:
    """The module `lfield.vm.wasm.engine`, to use within; raises NoEngine.

    Where wasmtime cannot be loaded, and where what is made within has no room.
    """
    try:
        module = import_module("lfield.vm.wasm.engine")
    except (ImportError, OSError, RuntimeError, AttributeError, MemoryError) as error:
        # A wheel of another system, of another processor (RuntimeError), or another version.
        raise NoEngine(error) from None
    try:
        yield module
    except module.UNUSABLE as error:
        raise NoEngine(error) from None
