"""A whole program as one WebAssembly module: a function for each method, the driver, and its tables."""

from __future__ import annotations

from dataclasses import dataclass

from lfield.bytecode.program import Program
from lfield.vm.reference.prepare import Prepared
from lfield.vm.wasm.lower.driver import GLOBALS, driver
from lfield.vm.wasm.lower.maths import maths_name, maths_text
from lfield.vm.wasm.lower.method import NO_NOTES, Method, Notes
from lfield.vm.wasm.lower.routes import Irreducible
from lfield.vm.wasm.lower.slots import GONE
from lfield.vm.wasm.lower.table import MATHS, RUNTIME
from lfield.vm.wasm.lower.tables import Tables
from lfield.vm.wasm.lower.traps import Traps
from lfield.vm.wasm.stack import deepest

#: The longest text of a function: it has two characters at least for each of the 7,654,321 bytes allowed.
LONGEST = 15_000_000
#: Where its tables begin, behind the registers.
TABLES = 1024


@dataclass(frozen=True, slots=True)
class Module:
    """The text, the point of each instruction that has one, and the methods that are not in it, with why."""

    text: str
    points: dict[int, int]
    left: dict[str, str]


def module(prepared: Prepared, notes: Notes = NO_NOTES) -> Module:
    """The module of a program; above the text of instructions stand notes, by number."""
    traps = Traps(prepared)
    count = len(prepared.program.core.methods)
    left: dict[int, str] = {}
    methods = _methods(prepared, traps, left, notes)
    functions = _functions(methods, left)
    points = {pc: number for m in methods.values() for pc, number in m.points.items()}
    tables = Tables(prepared.program, TABLES)
    segments = {name: data for m in methods.values() for name, data in m.segments.items()}
    segments |= traps.segments()
    lines = [
        "(module $program",
        '(import "arena" "memory" (memory 1))',
        *(f'(import "runtime" "{name}" (func ${name} {kind}))' for name, kind in RUNTIME.items()),
        *(
            f"(global ${name} (mut {kind}) ({kind}.const 0))"
            for kind, names in GLOBALS.items()
            for name in names
        ),
        f"(data (i32.const {TABLES}) {_strings(tables.data(prepared, points))})",
        *(f"(data {name} {_strings(data)})" for name, data in segments.items()),
        "(type $entry (func (param i32 i32) (result i64 i32)))",
        f"(table {count} funcref)",
        f"(elem (i32.const 0) func {' '.join(f'$e{i}' if i in methods else '$none' for i in range(count))})",
        "(func $none (type $entry) unreachable)",
        GONE,
        *(_entry(m) for m in methods.values()),
        *functions,
        traps.text(),
        maths_text(name for name in MATHS if any(f" {maths_name(name)} " in text for text in functions)),
        driver(_deepest(methods), tables, catches=not prepared.program.has_limits),
        ")",
    ]
    text = "\n".join(line for line in lines if line) + "\n"
    return Module(text, points, {prepared.program.method_name(i): why for i, why in left.items()})


def low_bytes(program: Program) -> int:
    """How many bytes at the beginning of the memory the module uses."""
    return Tables(program, TABLES).end


def _methods(prepared: Prepared, traps: Traps, left: dict[int, str], notes: Notes) -> dict[int, Method]:
    """The methods that can be lowered, by number; the others are `left`."""
    methods = {}
    for index in range(len(prepared.program.core.methods)):
        try:
            methods[index] = Method(prepared, index, traps, notes)
        except Irreducible:
            left[index] = "control enters a loop of it at two places, which WebAssembly has not"
    return methods


def _functions(methods: dict[int, Method], left: dict[int, str]) -> list[str]:
    """Their texts; a method whose text is too long is `left` as well, and nobody's function calls it."""
    for method in methods.values():
        method.others = methods
    texts = {i: m.text() for i, m in methods.items()}
    long = {i: "its code is too long for WebAssembly" for i, text in texts.items() if len(text) > LONGEST}
    if not long:
        return list(texts.values())
    left |= long
    for index in long:
        del methods[index]
    return _functions(methods, left)


def _deepest(methods: dict[int, Method]) -> int:
    """How many calls fit WebAssembly's own stack; deeper ones begin a new one from the driver."""
    return deepest({i: m.stack for i, m in methods.items()}, {i: m.calls for i, m in methods.items()})


def _strings(data: bytes) -> str:
    """Bytes as strings of the text form: a line of four words each."""
    pieces = ("".join(f"\\{byte:02x}" for byte in data[at : at + 32]) for at in range(0, len(data), 32))
    return "\n".join(f'"{piece}"' for piece in pieces)


def _entry(m: Method) -> str:
    """How the driver calls a method's function: without arguments, its result as a word."""
    nothing = " ".join(m.slots.nothing)
    lines = [
        f"(func $e{m.index} (type $entry) (local $status i32)",
        f"(call $m{m.index} (local.get 0) (local.get 1) {nothing})",
        "local.set $status",
        "i64.reinterpret_f64" if m.result == "f64" else "" if m.result else "i64.const 0",
        "local.get $status)",
    ]
    return "\n".join(lines)
