"""Lowering of a program to one WebAssembly module: a function per method, the trampoline, and tables."""

from __future__ import annotations

from msgspec import Struct

from lfield.bytecode.opcodes import BY_NAME
from lfield.bytecode.program import Program
from lfield.vm.reference.step_compiler import PreparedProgram
from lfield.vm.wasm.lowering.instruction_table import MATHS, RUNTIME
from lfield.vm.wasm.lowering.lookup_tables import LookupTables
from lfield.vm.wasm.lowering.maths_lowering import maths_name, maths_text
from lfield.vm.wasm.lowering.method_lowering import NO_NOTES, MethodLowering, Notes
from lfield.vm.wasm.lowering.resume_graph import Irreducible
from lfield.vm.wasm.lowering.slot_storage import EXIT_FUNCTION
from lfield.vm.wasm.lowering.trampoline import GLOBALS, trampoline_text
from lfield.vm.wasm.lowering.trap_table import TrapTable
from lfield.vm.wasm.stack_depth import deepest

#: Maximum text of a function: at least two characters for each of the 7,654,321 bytes allowed.
MAX_FUNCTION_TEXT = 15_000_000
#: The start of the tables, after the registers.
TABLES = 1024
_CALL = BY_NAME["call"].code


class WasmModule(Struct, frozen=True):
    """The text, the point of each instruction that has one, and the omitted methods with reasons."""

    text: str
    points: dict[int, int]
    unsupported: dict[str, str]


def lower_program(prepared: PreparedProgram, notes: Notes = NO_NOTES) -> WasmModule:
    """The module of a program; with notes, by number, above the text of instructions."""
    traps = TrapTable(prepared)
    count = len(prepared.program.core.methods)
    unsupported: dict[int, str] = {}
    methods = _methods(prepared, traps, unsupported, notes)
    functions = _functions(methods, unsupported)
    points = {pc: number for m in methods.values() for pc, number in m.points.items()}
    tables = LookupTables(prepared.program, TABLES)
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
        EXIT_FUNCTION,
        *(_entry(m) for m in methods.values()),
        *functions,
        traps.text(),
        maths_text(name for name in MATHS if any(f" {maths_name(name)} " in text for text in functions)),
        trampoline_text(_deepest(methods), tables, catches=not prepared.program.has_limits),
        ")",
    ]
    text = "\n".join(line for line in lines if line) + "\n"
    return WasmModule(
        text, points, {prepared.program.method_name(i): reason for i, reason in unsupported.items()}
    )


def low_bytes(program: Program) -> int:
    """Bytes at the start of the memory that the module uses."""
    return LookupTables(program, TABLES).end


def called_methods(program: Program) -> list[int]:
    """All methods except those of classes that no method calls, such as most methods of a map."""
    core, quads = program.core, program.quads
    pending = [i for i, method in enumerate(core.methods) if core.classes[method.owner].kind != "class"]
    found = set(pending)
    while pending:
        method = core.methods[pending.pop()]
        callees = {quad.a for quad in quads[method.entry : method.end] if quad.op == _CALL} - found
        found |= callees
        pending += callees
    return sorted(found)


def _methods(
    prepared: PreparedProgram, traps: TrapTable, unsupported: dict[int, str], notes: Notes
) -> dict[int, MethodLowering]:
    """The methods that can be lowered, by number; the other called methods are added to `unsupported`."""
    methods: dict[int, MethodLowering] = {}
    for index in called_methods(prepared.program):
        try:
            methods[index] = MethodLowering(prepared, index, traps, notes, methods)
        except Irreducible:
            unsupported[index] = "it has a loop with two entries, which WebAssembly does not support"
    return methods


def _functions(methods: dict[int, MethodLowering], unsupported: dict[int, str]) -> list[str]:
    """The functions of methods; a method whose text is too long is also `unsupported`, and other functions do
    not call it.
    """
    texts = {i: m.text() for i, m in methods.items()}
    long = {
        i: "its code is too long for WebAssembly"
        for i, text in texts.items()
        if len(text) > MAX_FUNCTION_TEXT
    }
    if not long:
        return list(texts.values())
    unsupported |= long
    for index in long:
        del methods[index]
    return _functions(methods, unsupported)


def _deepest(methods: dict[int, MethodLowering]) -> int:
    """The maximum call depth on the WebAssembly stack; deeper calls restart from the trampoline."""
    return deepest({i: m.stack for i, m in methods.items()}, {i: m.calls for i, m in methods.items()})


def _strings(data: bytes) -> str:
    """Bytes as strings of the text format, four words per line."""
    pieces = (data[at : at + 32].hex("\\") for at in range(0, len(data), 32))
    return "\n".join(f'"\\{piece}"' for piece in pieces)


def _entry(m: MethodLowering) -> str:
    """The code with which the trampoline calls a method: without arguments, with the result as a word."""
    nothing = " ".join(m.slots.nothing)
    lines = [
        f"(func $e{m.index} (type $entry) (local $status i32)",
        f"(call $m{m.index} (local.get 0) (local.get 1) {nothing})",
        "local.set $status",
        "i64.reinterpret_f64" if m.result == "f64" else "" if m.result else "i64.const 0",
        "local.get $status)",
    ]
    return "\n".join(lines)
