"""Which engine a host runs its program on."""

from __future__ import annotations

from collections.abc import Callable
from typing import cast

from lfield.bytecode.program import Program
from lfield.errors import NoEngine, UsageError
from lfield.host.engines.machine_code import Note, UserCache, code_folder
from lfield.vm.contract import Engine, Engines
from lfield.vm.reference import Engine as Reference
from lfield.vm.wasm.choice import MISSING, has_wasm, wasm_engine


def engines_for(choice: str, note: Note) -> Engines:
    """What makes a machine's engine, of `lfield.vm.wasm.choice`; `note` takes lines for the log.

    Raises UsageError where what was asked for cannot be had.
    """
    if choice == "wasm" and not has_wasm():
        raise UsageError(MISSING)
    if choice == "reference" or not has_wasm():
        return Reference

    def make(program: Program, now: Callable[[], float]) -> Engine:
        try:
            with wasm_engine() as wasm:
                return cast(Engine, wasm.Engine(program, now, UserCache(code_folder(), note), note))
        except NoEngine as unusable:
            if choice == "wasm":
                raise UsageError(str(unusable)) from None
            note(f"the reference engine runs the program: {unusable}")
            return Reference(program, now)

    return make
