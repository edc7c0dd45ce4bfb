"""Trampoline, called by Python: enters methods, returns to callers, and finds handlers.

It resumes the method of a thread's innermost frame. When this method returns, it resumes the caller; when it
throws, the handler; until a method exits. Python passes data in REGISTERS, words at the beginning of the
memory.
"""

from __future__ import annotations

from lfield.vm.memory.layout import (
    FRAME_CALLER,
    FRAME_DEPTH,
    FRAME_RETURN,
    OBJECT,
    W_ENTRIES,
    W_OWNER,
)
from lfield.vm.wasm.lowering.lookup_tables import ANYTHING, METHOD, RETURN, ROW, LookupTables
from lfield.vm.wasm.lowering.method_lowering import RETURNED, STEP, THROWN, TRAPPED

#: Words at the beginning of the memory: address of the block and of its end; the point to resume at; the
#: limits of call depth, array and text length; the thread.
INPUT_REGISTERS = ("base", "end", "point", "depth", "longest", "text", "thread")
#: In and out: addresses of the heap's top and of the frame, and the remaining budget.
INOUT_REGISTERS = ("top", "frame", "left")
#: The instruction at which a run has ended, and its result word.
OUTPUT_REGISTERS = ("pc", "word")
REGISTERS = (*INPUT_REGISTERS, *INOUT_REGISTERS, *OUTPUT_REGISTERS)
AT = {name: 8 * i for i, name in enumerate(REGISTERS)}
#: The globals of a module, by type.
GLOBALS = {
    "i32": ("base", "top", "end", "frame", "point", "pc", "trap", "status", "resume"),
    "i64": ("left", "deepest", "thread", "longest", "text", "word", "length"),
}


def trampoline_text(deepest: int, tables: LookupTables, *, catches: bool) -> str:
    """`run`: from the registers until an exit; returns a status as methods do.

    `deepest` calls fit the WebAssembly stack: deeper calls exit, and restart from here. If a time limit may
    skip a catch, `catches` is false, and the reference engine finds the handler.
    """
    small = [f"(global.set ${name} (i32.load (i32.const {AT[name]})))" for name in ("base", "top", "end")]
    large = [
        f"(global.set ${name} (i64.load (i32.const {AT[name]})))"
        for name in ("left", "thread", "longest", "text")
    ]
    out = [
        f"(i64.store (i32.const {AT[name]}) (i64.extend_i32_u (global.get ${name})))"
        for name in ("top", "frame", "pc")
    ]
    return f"""
(func (export "run") (result i32)
  (local $frame i32) (local $point i32) (local $status i32) (local $word i64) (local $back i32)
  (local $depth i64) (local $top i32)
  {" ".join(small)}
  {" ".join(large)}
  (local.set $frame (i32.load (i32.const {AT["frame"]})))
  (local.set $point (i32.load (i32.const {AT["point"]})))
  loop $on
    (local.set $depth (i64.add (i64.load offset={8 * FRAME_DEPTH} (local.get $frame)) (i64.const {deepest})))
    (global.set $deepest (select (local.get $depth) (i64.load (i32.const {AT["depth"]}))
      (i64.lt_s (local.get $depth) (i64.load (i32.const {AT["depth"]})))))
    (call_indirect (type $entry) (local.get $frame) (local.get $point)
      (i32.shr_u (i32.load (local.get $frame)) (i32.const 8)))
    local.set $status
    local.set $word
    (if (i32.eq (local.get $status) (i32.const {RETURNED})) (then
      (local.set $back (i32.add (i32.const {tables.returns})
        (i32.mul (i32.load offset={8 * FRAME_RETURN} (local.get $frame)) (i32.const {RETURN}))))
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
    {_thrown("(call $caught)" if catches else "(i32.const 0)")}
  end
  {" ".join(out)}
  (i64.store (i32.const {AT["left"]}) (global.get $left))
  (i64.store (i32.const {AT["word"]}) (global.get $word))
  (local.get $status))
{_caught(tables) + _unwind(tables) if catches else ""}
"""


def _thrown(caught: str) -> str:
    """The code after a method that has thrown: goes to the handler, or to the reference engine, with the
    charge of the method.
    """
    return f"""(if (i32.ge_u (local.get $status) (i32.const {THROWN})) (then
      (local.set $top (global.get $top))
      (if (if (result i32) (i32.eq (local.get $status) (i32.const {TRAPPED}))
            (then (call $thrown)) (else (i32.const 1))) (then
        (if {caught} (then
          (local.set $frame (global.get $frame))
          (local.set $point (global.get $point))
          (br $on)))))
      (global.set $top (local.get $top))
      (global.set $left (i64.add (global.get $left) (i64.const 1)))
      (local.set $status (i32.const {STEP}))))"""


def _caught(tables: LookupTables) -> str:
    """The code that finds the handler for $word, thrown at $pc in $frame, and goes there; 0 without effect if
    there is none.

    As `lfield.vm.reference.unwinder` without time limits; a `finally` is also left to the unwinder.
    """
    return f"""
(func $caught (result i32)
  (local $frame i32) (local $pc i32) (local $row i32) (local $last i32) (local $class i32) (local $takes i32)
  (local.set $row (i32.load
    (i32.add (global.get $base) (i32.shl (i32.wrap_i64 (global.get $word)) (i32.const 3)))))
  (if (i32.eq (i32.and (local.get $row) (i32.const 255)) (i32.const {OBJECT}))
    (then (local.set $class (i32.shr_u (local.get $row) (i32.const 8)))))
  (local.set $class (i32.add (i32.const {tables.catches})
    (i32.mul (local.get $class) (i32.const {len(tables.columns)}))))
  (local.set $frame (global.get $frame))
  (local.set $pc (global.get $pc))
  block $catch
  loop $frames
    (local.set $row (i32.load {_method(tables)}))
    (local.set $last (i32.load offset=4 {_method(tables)}))
    block $none
    loop $rows
      (br_if $none (i32.eq (local.get $row) (local.get $last)))
      (if (i32.and (i32.le_u (i32.load (local.get $row)) (local.get $pc))
                   (i32.lt_u (local.get $pc) (i32.load offset=4 (local.get $row)))) (then
        (local.set $takes (i32.load offset=8 (local.get $row)))
        (if (i32.eq (local.get $takes) (i32.const {ANYTHING})) (then (return (i32.const 0))))
        (if (i32.ge_s (local.get $takes) (i32.const 0)) (then
          (br_if $catch (i32.load8_u (i32.add (local.get $class) (local.get $takes))))))))
      (local.set $row (i32.add (local.get $row) (i32.const {ROW})))
      br $rows
    end
    end
    {_OUTWARDS}
    (if (i32.eqz (local.get $frame)) (then (return (i32.const 0))))
    (local.set $frame (i32.add (global.get $base) (local.get $frame)))
    br $frames
  end
  end
  (if (i32.eqz (i32.load offset=12 (local.get $row))) (then (return (i32.const 0))))
  (call $unwind (local.get $frame))
  (i64.store (i32.add (local.get $frame) (i32.load offset=16 (local.get $row))) (global.get $word))
  (global.set $frame (local.get $frame))
  (global.set $point (i32.load offset=12 (local.get $row)))
  (i32.const 1))"""


def _unwind(tables: LookupTables) -> str:
    """The code that leaves all frames from $frame down to another one, and releases their monitors."""
    return f"""
(func $unwind (param $to i32) (local $frame i32) (local $pc i32) (local $method i32)
  (local.set $frame (global.get $frame))
  (local.set $pc (global.get $pc))
  block $left
  loop $on
    (br_if $left (i32.eq (local.get $frame) (local.get $to)))
    (local.set $method {_method(tables)})
    (if (i32.and (i32.load offset=12 (local.get $method))
                 (i32.ne (i32.load offset=8 (local.get $method)) (local.get $pc))) (then
      (i64.store offset={8 * W_ENTRIES} (global.get $base)
        (i64.sub (i64.load offset={8 * W_ENTRIES} (global.get $base)) (i64.const 1)))
      (if (i64.eqz (i64.load offset={8 * W_ENTRIES} (global.get $base)))
        (then (i64.store offset={8 * W_OWNER} (global.get $base) (i64.const 0))))))
    {_OUTWARDS}
    (local.set $frame (i32.add (global.get $base) (local.get $frame)))
    br $on
  end
  end)"""


def _method(tables: LookupTables) -> str:
    """The address of the record of a frame's method."""
    number = "(i32.shr_u (i32.load (local.get $frame)) (i32.const 8))"
    return f"(i32.add (i32.const {tables.methods}) (i32.mul {number} (i32.const {METHOD})))"


#: The code that goes to the caller of a frame, at its call; the frame is then a word index of the block, 0
#: for none.
_OUTWARDS = f"""
    (local.set $pc (i32.sub (i32.load offset={8 * FRAME_RETURN} (local.get $frame)) (i32.const 1)))
    (local.set $frame (i32.shl (i32.load offset={8 * FRAME_CALLER} (local.get $frame)) (i32.const 3)))"""
