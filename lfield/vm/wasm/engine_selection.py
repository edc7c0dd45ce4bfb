"""Engine selection: `reference`, `wasm`, or `auto` (WebAssembly if available).

The module loads wasmtime only when it is used.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from importlib.util import find_spec
from types import ModuleType

from lfield.errors import EngineUnavailable

CHOICES = ("auto", "wasm", "reference")
#: The message for a missing wasmtime.
MISSING = "the WebAssembly engine needs wasmtime: pip install 'lfield[wasm]'"


def has_wasm() -> bool:
    """Whether wasmtime is installed."""
    return find_spec("wasmtime") is not None


@contextmanager
def wasm_engine() -> Iterator[ModuleType]:
    """The module `lfield.vm.wasm.wasm_engine`, as a context manager. Raises EngineUnavailable.

    The error is raised if wasmtime cannot be loaded, and for a lack of memory inside the context.
    """
    try:
        module = import_module("lfield.vm.wasm.wasm_engine")
    except (ImportError, OSError, RuntimeError, AttributeError, MemoryError) as error:
        # The cause is a wheel for another system or processor (RuntimeError), or another version.
        raise EngineUnavailable(error) from None
    try:
        yield module
    except module.UNUSABLE as error:
        raise EngineUnavailable(error) from None
