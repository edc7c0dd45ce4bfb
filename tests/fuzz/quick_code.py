"""Cheap machine code for the fuzzer, which compares the lowering of L, not the optimiser of wasmtime.

Code without optimisation compiles in less than half of the time. In a mutant, some unchanged methods are left
to the reference engine, like methods that WebAssembly does not support: then the engines also take over from
each other at calls, returns and exceptions.
"""

from __future__ import annotations

import random
from collections import OrderedDict
from collections.abc import Collection, Iterator
from contextlib import ExitStack, contextmanager
from functools import cache, lru_cache
from unittest.mock import patch

import wasmtime

from lfield.bytecode.program import Program
from lfield.vm.reference import reference_engine
from lfield.vm.reference.step_compiler import prepare
from lfield.vm.wasm import arena, machine_code
from lfield.vm.wasm.lowering import module_lowering
from lfield.vm.wasm.lowering.module_lowering import called_methods
from lfield.vm.wasm.stack_depth import STACK
from lfield.vm.wasm.wasm_compiler import settings

#: Differences from the settings of the product; values outside registers need more stack.
_SETTINGS = {"cranelift_opt_level": "none", "max_wasm_stack": 2 * STACK}
#: Share of the unchanged methods of a mutant that are compiled.
_COMPILED = 0.3
_recent: OrderedDict[object, object] = OrderedDict()
#: A program is prepared once for both engines.
_prepared = lru_cache(maxsize=2)(prepare)


@cache
def _quick_compiler(reservation: int) -> wasmtime.Engine:
    config = wasmtime.Config()
    for name, value in {**settings(reservation), **_SETTINGS}.items():
        setattr(config, name, value)
    config.cranelift_flag_set("regalloc_algorithm", "single_pass")
    return wasmtime.Engine(config)


@contextmanager
def quick_code() -> Iterator[None]:
    """Compile without optimisation in this context."""
    with ExitStack() as stack:
        for module in (arena, machine_code):
            stack.enter_context(patch.object(module, "compiler", _quick_compiler))
        stack.enter_context(patch.object(machine_code, "_recent", _recent))
        yield


@contextmanager
def prepared_once() -> Iterator[None]:
    """Engines that are created in this context share the prepared program."""
    with patch.object(reference_engine, "prepare", _prepared):
        yield


@contextmanager
def partly_compiled(changed: Collection[int]) -> Iterator[None]:
    """In this context, methods that are not `changed` may be left to the reference engine."""

    def some_methods(program: Program) -> list[int]:
        rng = random.Random(program.digest)
        return [i for i in called_methods(program) if rng.random() < _COMPILED or i in changed]

    with patch.object(module_lowering, "called_methods", some_methods):
        yield
