"""One function for each method: its slots go to its frame at the latest when somebody may look at it.

The parameters are the address of the frame, the point where to resume (0: at the beginning) and the
arguments where slots are locals; the results are the method's and whether it has returned (RETURNED). If it
has not, every function on WebAssembly's stack writes its slots to its frame and gives up in turn: the block
is whole then, and each of them can be resumed behind its call. The words of a frame before its slots are
written by the caller.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from typing import Any

from lfield.bytecode.program import REAL, VOID
from lfield.vm.memory.layout import (
    ARRAY,
    FRAME,
    FRAME_CALLER,
    FRAME_DEPTH,
    FRAME_RETURN,
    W_ENTRIES,
    W_OWNER,
    header,
)
from lfield.vm.reference.prepare import Prepared
from lfield.vm.wasm.lower.graph import Branch, Call, Graph, Instruction, Jump, Leave, Return, Run, Throw
from lfield.vm.wasm.lower.operands import address_of, filled, image_of, real_constant, reference_to, row_name
from lfield.vm.wasm.lower.routes import ROOT, Routes, Switch, Test
from lfield.vm.wasm.lower.shape import Go, Item, Shape
from lfield.vm.wasm.lower.slots import slots_of
from lfield.vm.wasm.lower.table import ROWS, no_room
from lfield.vm.wasm.lower.traps import INDEX, Traps
from lfield.vm.wasm.stack import most_bytes

#: What a function says besides its result: it has returned; it stands where the reference engine must go on;
#: its budget does not suffice for what comes next; the thread's first method has returned; it has thrown
#: an object, or what the machine itself throws.
RETURNED, STEP, SHORT, DONE, THROWN, TRAPPED = range(6)
#: Comments by instruction: for people only, a host's text has none.
Notes = Mapping[int, Sequence[str]]
NO_NOTES: Notes = {}
#: Longer things are copied from the module; shorter ones are made word by word up to here.
_UNROLLED = 12


class Method:
    """The text of one method's function, and the numbers of its points."""

    def __init__(self, prepared: Prepared, index: int, traps: Traps, notes: Notes) -> None:
        self.index, self._traps, self._notes = index, traps, notes
        #: The methods that have functions that can be called; those that are too tangled have none.
        self.others: Mapping[int, Method] = {}
        self._prepared = prepared
        self._core = prepared.program.core
        self._method = method = self._core.methods[index]
        graph = Graph(prepared, method, lambda i: bool(row_name(prepared, method.slots, i)))
        self._routes = Routes(graph)
        #: The numbers of its points by instruction.
        self.points = self._routes.numbers
        #: What it copies to the heap, by the name of the segment.
        self.segments: dict[str, bytes] = {}
        types = [self._type(t) for t in method.slots]
        instructions = graph.instructions.values()
        #: The methods it calls, and how many bytes of WebAssembly's own stack its function takes at most.
        self.calls = {i.quad.a for i in instructions if i.row.name == "call"}
        passed = max(len(i.arguments) for i in instructions)
        self.result = "" if self._kind(method.result) == VOID else self._type(method.result)
        self.slots = slots_of(types, method.parameters + 1, self.result, long=graph.long)
        self.stack = most_bytes(len(instructions), passed, self.slots.stacked)
        self.words = prepared.layouts.frame_words[index]

    def _kind(self, index: int) -> int:
        return self._core.types[index].kind

    def _type(self, index: int) -> str:
        return "f64" if self._kind(index) == REAL else "i64"

    # --- the function ---------------------------------------------------------------------------------

    def text(self) -> str:
        """The function as WebAssembly text."""
        labelled = {
            to
            for node in self._routes.nodes.values()
            if isinstance(node, Switch)
            for to in node.ways.values()
        }
        self._shape = Shape(ROOT.test, self._routes.leads_to, labelled)
        return "\n".join([*self._head(), *self._shape.lines(self._node), "unreachable", *self._tail(), ")"])

    def _head(self) -> list[str]:
        slots = self.slots
        return [
            f";; {self._prepared.program.method_name(self.index)}",
            f"(func $m{self.index} (param $frame i32) (param $resume i32) {' '.join(slots.parameters)}",
            f"(result {self.result} i32)",
            " ".join(slots.locals),
            "(local $base i32) (local $left i64) (local $status i32) (local $p i32)",
            f"(local $x i64) (local $y i64) (local $u f64) (local $value {self.result or 'i64'})",
            "(local.set $base (global.get $base))",
            *slots.entered,
            "block $spill",
            "block $exit",
            "block $return",
        ]

    def _tail(self) -> list[str]:
        """Where all ways out end: return, leaving with the place noted, and writing the slots."""
        release = f"""
            (i64.store offset={8 * W_ENTRIES} (local.get $base)
                (i64.sub (i64.load offset={8 * W_ENTRIES} (local.get $base)) (i64.const 1)))
            (if (i64.eqz (i64.load offset={8 * W_ENTRIES} (local.get $base)))
                (then (i64.store offset={8 * W_OWNER} (local.get $base) (i64.const 0))))
        """
        slots = self.slots
        value = "(local.get $value)" if self.result else ""
        as_word = value if self.result != "f64" else f"(i64.reinterpret_f64 {value})"
        return [
            "end ;; return",
            release if self._method.synchronized else "",
            slots.handed,
            *slots.returned(self.result),
            f"(if (i64.eqz (i64.load offset={8 * FRAME_CALLER} (local.get $frame))) (then",
            f"(global.set $word {as_word or '(i64.const 0)'})",
            f"(global.set $status (i32.const {DONE}))",
            "(br $exit)))",
            ";; A frame on the top of the heap is given back; another one stays as garbage, and is written.",
            f"(if (i32.eq (i32.add (local.get $frame) (i32.const {8 * self.words})) (global.get $top)) (then",
            "(global.set $top (local.get $frame))",
            f"(return {value} (i32.const {RETURNED}))))",
            f"(global.set $status (i32.const {RETURNED}))",
            "(br $spill)",
            "end ;; exit",
            "(global.set $frame (local.get $frame))",
            "end ;; spill",
            *slots.written,
            f"{value} (global.get $status)",
        ]

    # --- nodes ----------------------------------------------------------------------------------------

    def _node(self, number: int, go: Go) -> list[Item]:
        match self._routes.nodes[number]:
            case Test(switch, on):
                return [f"{self.slots.scope}.get $resume", "if", *go(switch), "end", *go(on)]
            case Switch(ways):
                return list(self._switch(number, ways))
            case run:
                return self._run(run, go)

    def _switch(self, number: int, ways: dict[int, int]) -> list[str]:
        first, last = min(ways), max(ways)
        labels = [self._shape.label(number, ways[k]) if k in ways else "$no" for k in range(first, last + 1)]
        where = f"(i32.sub ({self.slots.scope}.get $resume) (i32.const {first}))"
        return ["block $no", where, f"br_table {' '.join(labels)} $no", "end", "unreachable"]

    def _run(self, run: Run, go: Go) -> list[Item]:
        lines: list[Item] = []
        scope = self.slots.scope
        if run.pc in self.points:
            lines.append(f"({scope}.set $resume (i32.const 0))")
        cost = run.cost
        if cost:
            lines += [
                f"({scope}.set $left (i64.sub ({scope}.get $left) (i64.const {cost})))",
                *self._leave(f"(i64.lt_s ({scope}.get $left) (i64.const 0))", run.pc, cost, SHORT),
            ]
        for done, i in enumerate(run.work):
            lines += [*self._noted(i.pc, i.after), *self._lowered(i, cost - done)]
        return [*lines, *self._noted(*run.last), *self._end(run, go)]

    def _noted(self, pc: int, after: int) -> list[str]:
        return [line for number in range(pc, after) for line in self._notes.get(number, ())]

    def _end(self, run: Run, go: Go) -> list[Item]:
        first = self._routes.first
        match run.end:
            case Jump(to):
                return go(first(to))
            case Branch(slot, yes, no):
                condition = f"(i64.ne {self.slots.value(slot)} (i64.const 0))"
                return [condition, "if", *go(first(yes)), "end", *go(first(no))]
            case Call(what, to):
                if not self._calls(what):
                    return list(self.slots.gone(what.pc, 1, STEP))
                return [*self._call(what), *go(first(to))]
            case Return(what):
                value = ""
                if self.result:
                    value = self.slots.given(self.result, self._value(what.quad.a, self.result))
                return [f"(global.set $pc (i32.const {what.pc}))", value, "br $return"]
            case Throw(what):
                thrown = self._value(what.quad.a, "i64")
                null = self._leave(f"(i64.eqz {thrown})", what.pc, 1)
                return [*null, f"(global.set $word {thrown})", *self.slots.gone(what.pc, 0, THROWN)]
            case end:
                assert isinstance(end, Leave)
                return list(self.slots.gone(end.what.pc, 0, STEP))

    def _leave(self, condition: str, pc: int, refund: int, status: int = STEP) -> list[str]:
        return [condition, "if", *self.slots.gone(pc, refund, status), "end"]

    # --- instructions ---------------------------------------------------------------------------------

    def _value(self, operand: int, kind: str) -> str:
        """A source operand of a type of WebAssembly."""
        if operand >= 0:
            return self.slots.value(operand)
        value = self._core.constants[-1 - operand]
        if kind == "f64":
            assert isinstance(value, (int, float))
            return f"(f64.const {real_constant(float(value))})"
        return f"(i64.const {int(value) if isinstance(value, int) else 0})"

    def _lowered(self, i: Instruction, refund: int) -> list[str]:
        """The lines of the instruction's row, with its operands."""
        given = self._operands(i)
        lines = []
        for line in ROWS[row_name(self._prepared, self._method.slots, i)].strip().splitlines():
            word, _, rest = line.strip().partition(" ")
            if word == "leave":
                lines += self._leave(filled(rest, given), i.pc, refund)
            elif word == "null":
                lines += self._null(given["slots"][rest], i, refund)
            elif word == "zero":
                trap = self._traps.number("ArithmeticException", "division by zero")
                lines += self._trap(filled(rest, given), trap, i.pc, refund)
            elif word == "over":
                trap = self._traps.number("ArithmeticException", "the result does not fit an int")
                lines += self._trap(filled(rest, given), trap, i.pc, refund)
            elif word == "index":
                lines += self._index(filled(rest, given), i.pc, refund)
            else:
                lines.append(filled(line.strip(), given))
        if "into" in given:
            lines.append(self.slots.kept(given["into"]))
        return lines

    def _null(self, operand: int, i: Instruction, refund: int) -> list[str]:
        # The object that the method runs on is never null.
        if not operand:
            return []
        trap = self._traps.number("NullException", f"{self._use(i)} of null")
        return self._trap(f"(i64.eqz {self._value(operand, 'i64')})", trap, i.pc, refund)

    def _use(self, i: Instruction) -> str:
        """What an instruction needs an object for, as its exception says it."""
        match i.row.name:
            case "getf" | "putf":
                slot, field = (i.quad.b, i.quad.c) if i.row.name == "getf" else (i.quad.a, i.quad.b)
                record = self._core.types[self._method.slots[slot]]
                return f"field '{self._core.classes[record.of].fields[field].name}'"
            case "call":
                return f"call of '{self._core.methods[i.quad.a].name}'"
            case "array_len":
                return "length"
        return "element"

    def _index(self, index: str, pc: int, refund: int) -> list[str]:
        """Throws where an index is outside of the array at $p."""
        length = "(i64.sub (i64.load32_u offset=4 (local.get $p)) (i64.const 1))"
        told = f"(global.set $word {index}) (global.set $length {length})"
        return self._trap(f"(i64.ge_u {index} {length})", INDEX, pc, refund, told)

    def _trap(self, condition: str, number: int, pc: int, refund: int, told: str = "") -> list[str]:
        """Throws, where a condition holds, what the machine itself throws; the instruction is paid for."""
        trap = f"{told} (global.set $trap (i32.const {number}))"
        return [condition, "if", trap, *self.slots.gone(pc, refund - 1, TRAPPED), "end"]

    def _operands(self, i: Instruction) -> dict[str, Any]:
        """What the braces of a row stand for."""
        slots: dict[str, int] = {}
        given: dict[str, Any] = {"slots": slots}
        for number, (pushed, takes) in enumerate(zip(i.arguments, i.row.takes or (), strict=False)):
            slots[str(number)] = pushed
            given[str(number)] = self._value(pushed, "f64" if takes == "real" else "i64")
        if i.into >= 0:
            given["a"], given["into"] = self.slots.target(i.into), i.into
        elif i.row.takes is None:
            for letter, operand, value in zip("abc", i.row.operands, i.quad[1:], strict=False):
                slots[letter] = value
                if operand.role == "D":
                    given[letter], given["into"] = self.slots.target(value), value
                    given["t"] = self.slots.types[value]
                elif operand.role in "SV":
                    real = operand.kind == "real" or (operand.kind in ("same", "any") and self._is_real(i))
                    given[letter] = self._value(value, "f64" if real else "i64")
                elif operand.role == "F":
                    given["field"] = 8 * (1 + value)
        for letter in [k for k in given if k in slots and isinstance(given[k], str)]:
            given[f"{letter}_at"] = address_of(given[letter])
        if i.row.name in ("putf", "pute"):
            given["t"] = "f64" if self._is_real(i) else "i64"
        return {**given, **self._made(i)}

    def _is_real(self, i: Instruction) -> bool:
        """Whether the value that is moved is a real."""
        a, b = i.quad.a, i.quad.b
        types = self._core.types
        match i.row.name:
            case "putf":
                return self._kind(self._core.classes[types[self._method.slots[a]].of].fields[b].type) == REAL
            case "pute":
                return self._kind(types[self._method.slots[a]].of) == REAL
        return self.slots.types[a] == "f64"

    def _made(self, i: Instruction) -> dict[str, str]:
        """Of instructions that make things: their size, and how they are written at $p."""
        made = {"made": reference_to("$p"), "head": str(ARRAY | i.quad.b << 8)}
        if i.row.name not in ("lds", "new"):
            return made
        words = image_of(self._prepared, i)
        size = 8 * len(words)
        if len(words) <= _UNROLLED:
            stores = (
                f"(i64.store offset={8 * n} (local.get $p) (i64.const {word}))"
                for n, word in enumerate(words)
            )
            return {**made, "size": str(size), "no_room": no_room(size), "image": " ".join(stores)}
        name = f"$made{i.quad.b}{i.row.name}"
        self.segments[name] = struct.pack(f"<{len(words)}q", *words)
        image = f"(memory.init {name} (local.get $p) (i32.const 0) (i32.const {size}))"
        return {**made, "size": str(size), "no_room": no_room(size), "image": image}

    def _calls(self, i: Instruction) -> bool:
        return i.quad.a in self.others and i.arguments[0] >= 0

    def _call(self, i: Instruction) -> list[str]:
        """A frame on the top of the heap, and the callee's function on it."""
        callee = self.others[i.quad.a].slots
        size = 8 * self._prepared.layouts.frame_words[i.quad.a]
        head = header(FRAME, i.quad.a, size // 8)
        back = i.after - (i.into >= 0)
        values = [self._value(o, t) for o, t in zip(i.arguments, callee.types, strict=False)]
        stores, arguments = callee.passed(values)
        result = kept = ""
        if i.into >= 0:
            result = "$u" if self.slots.types[i.into] == "f64" else "$x"
            kept = f"(local.set {self.slots.target(i.into)} (local.get {result})) {self.slots.kept(i.into)}"
        return [
            *self._null(i.arguments[0], i, 1),
            f"(local.set $x (i64.add (i64.load offset={8 * FRAME_DEPTH} (local.get $frame)) (i64.const 1)))",
            *self._leave("(i64.gt_s (local.get $x) (global.get $deepest))", i.pc, 1),
            "(local.set $p (global.get $top))",
            *self._leave(no_room(size), i.pc, 1),
            f"(global.set $top (i32.add (local.get $p) (i32.const {size})))",
            f"(i64.store (local.get $p) (i64.const {head}))",
            f"(i64.store offset={8 * FRAME_CALLER} (local.get $p) {reference_to('$frame')})",
            f"(i64.store offset={8 * FRAME_RETURN} (local.get $p) (i64.const {back}))",
            f"(i64.store offset={8 * FRAME_DEPTH} (local.get $p) (local.get $x))",
            *stores,
            self.slots.handed,
            f"(call $m{i.quad.a} (local.get $p) (i32.const 0) {' '.join(arguments)})",
            "local.set $status",
            f"local.set {result}" if result else "",
            self.slots.followed,
            self.slots.taken,
            kept,
        ]
