"""A whole program as one WebAssembly module: a function for each method, and the *driver* that enters them.

The driver is all that Python calls. It resumes the method of a thread's innermost frame; when that returns it
resumes the caller's, until something leaves. Python and the driver speak by REGISTERS, words at the beginning
of the memory.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

from lfield.bytecode.program import Program
from lfield.vm.memory.layout import FRAME_CALLER, FRAME_DEPTH, FRAME_RETURN, FRAME_SLOTS
from lfield.vm.reference.prepare import Prepared
from lfield.vm.wasm.lower.maths import maths_name, maths_text
from lfield.vm.wasm.lower.method import RETURNED, STEP, Method
from lfield.vm.wasm.lower.routes import Irreducible
from lfield.vm.wasm.lower.table import MATHS, RUNTIME

#: The size of WebAssembly's own stack, in bytes.
STACK = 1 << 20
#: Words at the beginning of the memory. Addresses: of the block, its top, its end, the thread's frame. The
#: point to resume at; the budget that is left; the depth of calls, the thread, the lengths of arrays and of
#: texts that are allowed. The instruction where a run has ended, and the word it has given.
REGISTERS = (
    "base",
    "top",
    "end",
    "frame",
    "point",
    "left",
    "depth",
    "thread",
    "longest",
    "text",
    "pc",
    "word",
)
_AT = {name: 8 * i for i, name in enumerate(REGISTERS)}
#: Where the table of returns is: what is to be done behind each call, by the instruction there.
_RETURNS = 1024


@dataclass(frozen=True, slots=True)
class Module:
    """The text, and the point of each instruction that has one."""

    text: str
    points: dict[int, int]


def module(prepared: Prepared) -> Module:
    """The module of a program."""
    methods = {
        m.index: m for m in (_method(prepared, i) for i in range(len(prepared.program.core.methods))) if m
    }
    for method in methods.values():
        method.others = methods.keys()
    functions = [m.text() for m in methods.values()]
    points = {pc: number for m in methods.values() for pc, number in m.points.items()}
    returns = _returns(prepared, points)
    segments = {name: data for m in methods.values() for name, data in m.segments.items()}
    count = len(prepared.program.core.methods)
    deepest = _deepest(prepared)
    lines = [
        "(module",
        '(import "arena" "memory" (memory 1))',
        *(f'(import "runtime" "{name}" (func ${name} {kind}))' for name, kind in RUNTIME.items()),
        *(f"(global ${name} (mut i32) (i32.const 0))" for name in ("base", "top", "end", "frame", "pc")),
        *(
            f"(global ${name} (mut i64) (i64.const 0))"
            for name in ("left", "deepest", "thread", "longest", "text", "word")
        ),
        f'(data (i32.const {_RETURNS}) "{_escaped(returns)}")',
        *(f'(data {name} "{_escaped(data)}")' for name, data in segments.items()),
        "(type $entry (func (param i32 i32) (result i64 i32)))",
        f"(table {count} funcref)",
        f"(elem (i32.const 0) func {' '.join(f'$e{i}' if i in methods else '$none' for i in range(count))})",
        "(func $none (type $entry) unreachable)",
        *(_entry(m, prepared) for m in methods.values()),
        *functions,
        maths_text(name for name in MATHS if any(f" {maths_name(name)} " in text for text in functions)),
        _driver(deepest),
        ")",
    ]
    return Module("\n".join(line for line in lines if line) + "\n", points)


def low_bytes(program: Program) -> int:
    """How many bytes at the beginning of the memory the module uses."""
    return _RETURNS + 8 * (len(program.quads) + 1)


def _method(prepared: Prepared, index: int) -> Method | None:
    try:
        return Method(prepared, index)
    except Irreducible:
        return None


def _deepest(prepared: Prepared) -> int:
    """How many calls fit WebAssembly's own stack; deeper ones begin a new one from the driver."""
    slots = max((len(m.slots) for m in prepared.program.core.methods), default=1)
    return STACK // 2 // (256 + 24 * slots)


def _returns(prepared: Prepared, points: dict[int, int]) -> bytes:
    """Two 32-bit numbers for each instruction behind a call: its point, and where in the frame a result goes.

    0 for no point, 0 for no result.
    """
    rows = [(0, 0)] * (len(prepared.program.quads) + 1)
    for group in prepared.groups.values():
        back = group.after - (group.destination >= 0)
        into = 8 * (FRAME_SLOTS + group.destination) if group.destination >= 0 else 0
        rows[back] = (points.get(group.after, 0), into)
    return b"".join(struct.pack("<2i", *row) for row in rows)


def _escaped(data: bytes) -> str:
    return "".join(f"\\{byte:02x}" for byte in data)


def _entry(m: Method, prepared: Prepared) -> str:
    """How the driver calls a method's function: without arguments, its result as a word."""
    parameters = prepared.program.core.methods[m.index].parameters + 1
    nothing = " ".join(f"({t}.const 0)" for t in m.slots[:parameters])
    lines = [
        f"(func $e{m.index} (type $entry) (local $status i32)",
        f"(call $m{m.index} (local.get 0) (local.get 1) {nothing})",
        "local.set $status",
        "i64.reinterpret_f64" if m.result == "f64" else "" if m.result else "i64.const 0",
        "local.get $status)",
    ]
    return "\n".join(lines)


def _driver(deepest: int) -> str:
    """`run`: from the registers, until something leaves; the result says how, as that of a method does."""
    into = {name: f"(i32.load (i32.const {_AT[name]}))" for name in ("base", "top", "end")}
    return f"""
(func (export "run") (result i32)
  (local $frame i32) (local $point i32) (local $status i32) (local $word i64) (local $back i32)
  (local $depth i64)
  {" ".join(f"(global.set ${name} {value})" for name, value in into.items())}
  (global.set $left (i64.load (i32.const {_AT["left"]})))
  (global.set $thread (i64.load (i32.const {_AT["thread"]})))
  (global.set $text (i64.load (i32.const {_AT["text"]})))
  (global.set $longest (i64.load (i32.const {_AT["longest"]})))
  (local.set $frame (i32.load (i32.const {_AT["frame"]})))
  (local.set $point (i32.load (i32.const {_AT["point"]})))
  loop $on
    (local.set $depth (i64.add (i64.load offset={8 * FRAME_DEPTH} (local.get $frame)) (i64.const {deepest})))
    (global.set $deepest (select (local.get $depth) (i64.load (i32.const {_AT["depth"]}))
      (i64.lt_s (local.get $depth) (i64.load (i32.const {_AT["depth"]})))))
    (call_indirect (type $entry) (local.get $frame) (local.get $point)
      (i32.shr_u (i32.load (local.get $frame)) (i32.const 8)))
    local.set $status
    local.set $word
    (if (i32.eq (local.get $status) (i32.const {RETURNED})) (then
      (local.set $back (i32.add (i32.const {_RETURNS})
        (i32.shl (i32.load offset={8 * FRAME_RETURN} (local.get $frame)) (i32.const 3))))
      (global.set $pc (i32.load offset={8 * FRAME_RETURN} (local.get $frame)))
      (local.set $frame (i32.add (global.get $base)
        (i32.shl (i32.load offset={8 * FRAME_CALLER} (local.get $frame)) (i32.const 3))))
      (if (i32.load offset=4 (local.get $back)) (then
        (i64.store (i32.add (local.get $frame) (i32.load offset=4 (local.get $back))) (local.get $word))
        (global.set $pc (i32.add (global.get $pc) (i32.const 1)))))
      (local.set $point (i32.load (local.get $back)))
      (br_if $on (local.get $point))
      (global.set $frame (local.get $frame))
      (local.set $status (i32.const {STEP}))))
  end
  (i64.store (i32.const {_AT["top"]}) (i64.extend_i32_u (global.get $top)))
  (i64.store (i32.const {_AT["frame"]}) (i64.extend_i32_u (global.get $frame)))
  (i64.store (i32.const {_AT["pc"]}) (i64.extend_i32_u (global.get $pc)))
  (i64.store (i32.const {_AT["left"]}) (global.get $left))
  (i64.store (i32.const {_AT["word"]}) (global.get $word))
  (local.get $status))
"""
