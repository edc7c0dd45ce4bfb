"""Frequent machine exceptions: null, invalid index, division by zero, overflow.

Each is created as by the reference engine: message, empty source, object. If the heap cannot hold all three,
no object is created, and the reference engine executes the instruction.
"""

from __future__ import annotations

import struct

from lfield.bytecode.program import BUILTIN_CLASSES, MESSAGE, SOURCE
from lfield.vm.memory.layout import OBJECT, STRING, header
from lfield.vm.memory.word_codec import MESSAGE_LENGTH
from lfield.vm.reference.step_compiler import PreparedProgram
from lfield.vm.wasm.lowering.instruction_table import exceeds_heap
from lfield.vm.wasm.lowering.operand_lowering import text_words

#: The number of the trap of an index; traps with a constant message are numbered from 1.
INDEX = 0
_BETWEEN = " of an array of length "
#: A number above the bytes of an index message, and a multiple of 8.
_MOST = 96


class TrapTable:
    """The traps of one program: requested by its methods, then written as one function."""

    def __init__(self, prepared: PreparedProgram) -> None:
        self._layouts = prepared.layouts
        self._numbers: dict[tuple[str, str], int] = {}

    def number(self, kind: str, message: str) -> int:
        """The number of a trap, by class name and message."""
        return self._numbers.setdefault((kind, message), 1 + len(self._numbers))

    def _object(self, kind: str) -> list[int]:
        record = BUILTIN_CLASSES.index(kind)
        words = self._layouts.class_words[record]
        return [header(OBJECT, record, words), *[0] * (words - 1)]

    def segments(self) -> dict[str, bytes]:
        """The data of each trap on the heap, by name of the segment."""
        found = {}
        for (kind, message), number in self._numbers.items():
            words = [*text_words(message[:MESSAGE_LENGTH]), *text_words(""), *self._object(kind)]
            found[f"$trap{number}"] = struct.pack(f"<{len(words)}q", *words)
        return found

    def text(self) -> str:
        """`$thrown`: creates the exception of trap $trap in $word; 0 without effect if the heap is full."""
        segments = self.segments()
        labels = [f"$b{n}" for n in range(1 + len(self._numbers))]
        cases = [self._index()]
        for (kind, _), number in self._numbers.items():
            size = len(segments[f"$trap{number}"])
            cases.append(
                f"""(local.set $size (i32.const {size}))
    (local.set $object (i32.const {size - 8 * len(self._object(kind))}))
    (if {exceeds_heap(size, "(local.get $top)")}
      (then (return (i32.const 0))))
    (memory.init $trap{number} (local.get $top) (i32.const 0) (local.get $size))
    br $made"""
            )
        blocks = "\n".join(f"block {label}" for label in reversed(labels))
        bodies = "\n".join(f"end\n{case}" for case in cases)
        return f"""
{_DECIMAL}
(func $thrown (result i32) (local $top i32) (local $size i32) (local $object i32) (local $at i32)
  (local.set $top (global.get $top))
  block $made
    {blocks}
    (br_table {" ".join(labels)} (global.get $trap))
    {bodies}
  end
  (local.set $at (i32.add (local.get $top) (local.get $object)))
  (global.set $word {_reference("$at")})
  (i64.store offset={8 + 8 * MESSAGE} (local.get $at) {_reference("$top")})
  (i64.store offset={8 + 8 * SOURCE} (local.get $at) (i64.sub (global.get $word) (i64.const 2)))
  (global.set $top (i32.add (local.get $top) (local.get $size)))
  (i32.const 1))"""

    def _index(self) -> str:
        """The code of the trap of an index: $word is the index of an array of $length."""
        words = self._object("IndexException")
        maximum = _MOST + 16 + 8 * len(words)
        before = _stores("index ", "(i32.add (local.get $top) (i32.const 16))")
        stores = " ".join(
            f"(i64.store offset={8 * n} (local.get $at) (i64.const {word}))"
            for n, word in enumerate([*text_words(""), *words])
        )
        return f"""(if {exceeds_heap(maximum, "(local.get $top)")}
      (then (return (i32.const 0))))
    (memory.fill (local.get $top) (i32.const 0) (i32.const {_MOST}))
    {before}
    (local.set $at (call $decimal (i32.add (local.get $top) (i32.const 22)) (global.get $word)))
    {_stores(_BETWEEN, "(local.get $at)")}
    (local.set $at (call $decimal
      (i32.add (local.get $at) (i32.const {len(_BETWEEN)})) (global.get $length)))
    (local.set $size (i32.sub (i32.sub (local.get $at) (local.get $top)) (i32.const 16)))
    (i64.store offset=8 (local.get $top) (i64.extend_i32_u (local.get $size)))
    (local.set $object (i32.add (i32.const 2)
      (i32.shr_u (i32.add (local.get $size) (i32.const 7)) (i32.const 3))))
    (i64.store (local.get $top)
      (i64.or (i64.const {STRING}) (i64.shl (i64.extend_i32_u (local.get $object)) (i64.const 32))))
    (local.set $at (i32.add (local.get $top) (i32.shl (local.get $object) (i32.const 3))))
    {stores}
    (local.set $object (i32.sub (i32.add (local.get $at) (i32.const 16)) (local.get $top)))
    (local.set $size (i32.add (local.get $object) (i32.const {8 * len(words)})))
    br $made"""


#: Writes a number in decimal digits; returns the address after them.
_DECIMAL = """
(func $decimal (param $at i32) (param $value i64) (result i32) (local $rest i64) (local $last i32)
  (if (i64.lt_s (local.get $value) (i64.const 0)) (then
    (i32.store8 (local.get $at) (i32.const 45))
    (local.set $at (i32.add (local.get $at) (i32.const 1)))
    (local.set $value (i64.sub (i64.const 0) (local.get $value)))))
  (local.set $rest (local.get $value))
  loop $count
    (local.set $at (i32.add (local.get $at) (i32.const 1)))
    (local.set $rest (i64.div_u (local.get $rest) (i64.const 10)))
    (br_if $count (i64.ne (local.get $rest) (i64.const 0)))
  end
  (local.set $last (local.get $at))
  loop $write
    (local.set $last (i32.sub (local.get $last) (i32.const 1)))
    (i32.store8 (local.get $last)
      (i32.add (i32.const 48) (i32.wrap_i64 (i64.rem_u (local.get $value) (i64.const 10)))))
    (local.set $value (i64.div_u (local.get $value) (i64.const 10)))
    (br_if $write (i64.ne (local.get $value) (i64.const 0)))
  end
  (local.get $at))"""


def _stores(text: str, at: str) -> str:
    """The code that writes an ASCII text, byte by byte."""
    return " ".join(
        f"(i32.store8 offset={n} {at} (i32.const {byte}))" for n, byte in enumerate(text.encode())
    )


def _reference(address: str) -> str:
    return f"(i64.extend_i32_u (i32.shr_u (i32.sub (local.get {address}) (global.get $base)) (i32.const 3)))"
