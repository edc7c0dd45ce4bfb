"""Single faults in the text of the WebAssembly engine: random programs must find every one.

`spoiled_rows.py` generates many more.
"""

from __future__ import annotations

import random
from collections import OrderedDict
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from unittest.mock import patch

from engine_fuzzer.engine_trial import compiled, run_trial
from engine_fuzzer.program_generator import random_program
from lfield.vm.wasm import machine_code
from lfield.vm.wasm.lowering.instruction_table import ROWS
from lfield.vm.wasm.lowering.module_lowering import WasmModule, lower_program
from lfield.vm.wasm.runtime.runtime_functions import runtime_text
from lfield.vm.wasm.wasm_engine import EagerWasmEngine
from quick_code import quick_code

#: Places of faults outside the table: the functions of the runtime, and the lowered program.
RUNTIME, PROGRAM = "runtime", "program"


@dataclass(frozen=True)
class Fault:
    """`wrong` instead of the first `right`, in a row, the runtime or a program."""

    place: str
    right: str
    wrong: str
    #: Text of the programs that can show the fault.
    needs: str
    #: The wrong function of the runtime or of a program.
    function: str = ""

    @property
    def name(self) -> str:
        """The place and the change, for the catalogue."""
        return f"{self.function or self.place}: {self.wrong}"

    @property
    def broken(self) -> str:
        """A description of the fault: the replaced text, its place, and the programs that can show it."""
        place = self.function or self.place
        return f"`{self.wrong}` for `{self.right}` in `{place}`; programs with `{self.needs.strip()}`"

    def __str__(self) -> str:
        return self.name

    def spoiled(self, text: str) -> str:
        """The text with the fault."""
        at = text.index(self.right, text.index(f"(func {self.function}") if self.function else 0)
        return text[:at] + self.wrong + text[at + len(self.right) :]


def _runtime(function: str, right: str, wrong: str, needs: str) -> Fault:
    return Fault(RUNTIME, right, wrong, needs, function)


FAULTS = (
    # characters of several bytes
    _runtime("$skip", "0xC0", "0xC3", ".substring("),
    _runtime("$skip", "0xE0", "0xE1", ".substring("),
    _runtime("$skip", "0xF0", "0xF1", ".substring("),
    _runtime("$characters", "0x8080808080808080", "0x8080808080808000", ".length("),
    _runtime("$characters", "(i32.const 0xC0)", "(i32.const 0xE0)", ".length("),
    _runtime("$compare_strings", "i64.load8_u", "i64.load8_s", " < "),
    _runtime("$substring", "(i32.eq (local.get $count)", "(i32.le_u (local.get $count)", ".substring("),
    _runtime("$index_of", "i32.le_u", "i32.lt_u", ".indexOf("),
    # text and numbers
    _runtime("$i2s", "i64.div_u", "i64.div_s", "i2s("),
    _runtime("$i2s", "i64.rem_u", "i64.rem_s", "i2s("),
    _runtime("$s2i", "(i32.const 18)", "(i32.const 19)", "s2i("),
    # limits of numbers
    Fault("ceil", "(f64.add (f64.ceil {0}) (f64.const 0))", "(f64.ceil {0})", "ceil("),
    Fault("floor", "(f64.add (f64.floor {0}) (f64.const 0))", "(f64.floor {0})", "floor("),
    Fault("round", "f64.ge", "f64.gt", "round("),
    Fault("round", "0.5", "0.4999999999999999", "round("),
    Fault("f2i", "f64.lt", "f64.le", "f2i("),
    Fault("f2i", "i64.trunc_f64_s {0}", "i64.trunc_f64_s (f64.nearest {0})", "f2i("),
    Fault("i2f", "(f64.convert_i64_s {0})", "(f64.promote_f32 (f32.convert_i64_s {0}))", "i2f("),
    Fault("abs_int", "i64.ge_s", "i64.gt_u", "abs("),
    Fault("abs_float", "(f64.abs {0})", "(select {0} (f64.neg {0}) (f64.ge {0} (f64.const 0)))", "abs("),
    Fault("negf", "(f64.neg {b})", "(f64.sub (f64.const 0) {b})", "(-"),
    Fault("min_float", "(f64.min {0} {1})", "(select {0} {1} (f64.le {0} {1}))", "min("),
    Fault("max_float", "(f64.max {0} {1})", "(select {0} {1} (f64.gt {0} {1}))", "max("),
    Fault("sqrt", "f64.const 0", "f64.const -1", "sqrt("),
    Fault("sin", "{a} (local.get $u)", "{a} (f64.add (local.get $u) (f64.const 0))", "sin("),
    Fault("atan2", "{a} (local.get $u)", "{a} (f64.add (local.get $u) (f64.const 0))", "atan2("),
    Fault("modf", "{a} (local.get $u)", "{a} (f64.add (local.get $u) (f64.const 0))", " % "),
    # growing arrays, and keys of maps
    Fault("append", "(i64.const 1)", "(i64.const 2)", ".append("),
    Fault("remove", "(i64.const 0))", "(i64.const 1))", ".remove("),
    Fault("remove_last", "(i64.store (local.get $p) (i64.const 0))", "", ".pop("),
    _runtime("$grow", "(i64.const 4)", "(i64.const 3)", ".append("),
    _runtime("$str_hash", "0xCBF29CE484222325", "0xCBF29CE484222326", "m0"),
    # monitors across calls, and exceptions through them or through a finally
    Fault("frame", "i64.ne (local.get $x) (global.get $thread)", "i32.const 0", "synchronized"),
    Fault(PROGRAM, "i64.sub", "i64.add", "synchronized", "$unwind"),
    Fault(PROGRAM, "(i64.eqz (i64.load", "(i64.eq (i64.const -1) (i64.load", "synchronized", "$unwind"),
    Fault(PROGRAM, "i32.eq (local.get $takes)", "i32.eq (i32.const 1234567)", "finally", "$caught"),
)


@contextmanager
def planted(fault: Fault) -> Iterator[None]:
    """Plant the fault in all code that is compiled in this context."""

    def program(prepared: object) -> WasmModule:
        made = lower_program(prepared)
        return (
            replace(made, text=fault.spoiled(made.text)) if f"(func {fault.function}" in made.text else made
        )

    with patch.object(machine_code, "_recent", OrderedDict()):
        if fault.place == RUNTIME:
            with patch.object(machine_code, "runtime_text", lambda: fault.spoiled(runtime_text())):
                yield
        elif fault.place == PROGRAM:
            with patch.object(machine_code, "lower_program", program):
                yield
        else:
            with patch.dict(ROWS, {fault.place: fault.spoiled(ROWS[fault.place])}):
                yield


def finder(fault: Fault, count: int) -> int | None:
    """The first of `count` seeds whose program shows the fault, or None."""
    with quick_code(), planted(fault):
        for seed in range(count):
            text = random_program(random.Random(seed)).text()
            if fault.needs in text and run_trial(compiled(text), text, seed, EagerWasmEngine).differences:
                return seed
    return None
