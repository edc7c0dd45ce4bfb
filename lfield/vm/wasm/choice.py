"""What may be chosen to run a program: `reference`, `wasm`, or `auto`, WebAssembly where it can be had.

Nothing of wasmtime is loaded by asking.
"""

from __future__ import annotations

from importlib.util import find_spec

CHOICES = ("auto", "wasm", "reference")
#: What is missing for the fast engine, and its cure.
MISSING = "the engine in WebAssembly needs wasmtime: pip install 'lfield[wasm]'"


def has_wasm() -> bool:
    """Whether wasmtime is installed."""
    return find_spec("wasmtime") is not None
