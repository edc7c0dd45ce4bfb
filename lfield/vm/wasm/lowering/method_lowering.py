"""Lowering of methods to functions that spill their slots to the frame before other code can observe it.

Parameters: address of the frame, point to resume at (0: the start), and arguments where slots are locals.
Results: the result of the method, and whether the method has returned (RETURNED). If not, every function on
the WebAssembly stack writes its slots to its frame and returns in turn: the block is then complete, and each
function can be resumed after its call. The frame's words before the slots are written by the caller.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from typing import Any

from lfield.bytecode.program import GROWABLE as GROWABLE_TYPE
from lfield.bytecode.program import REAL, VOID
from lfield.vm.memory.layout import (
    ARRAY,
    FRAME,
    FRAME_CALLER,
    FRAME_DEPTH,
    FRAME_RETURN,
    GROWABLE,
    GROWABLE_LENGTH,
    GROWABLE_WORDS,
    W_ENTRIES,
    W_OWNER,
    header,
)
from lfield.vm.reference.step_compiler import PreparedProgram
from lfield.vm.wasm.lowering.control_flow_graph import (
    BasicBlock,
    BranchExit,
    CallExit,
    ControlFlowGraph,
    EngineCallExit,
    JumpExit,
    LoweredInstruction,
    ReturnExit,
    ThrowExit,
)
from lfield.vm.wasm.lowering.instruction_table import ROWS, exceeds_heap
from lfield.vm.wasm.lowering.operand_lowering import (
    address_of,
    element_address,
    filled,
    image_of,
    null_purpose,
    real_constant,
    reference_to,
    row_lines,
    row_name,
)
from lfield.vm.wasm.lowering.resume_graph import ROOT, ResumeGraph, ResumeSwitch, ResumeTest
from lfield.vm.wasm.lowering.slot_storage import slots_of
from lfield.vm.wasm.lowering.structured_control import Go, Item, StructuredControl
from lfield.vm.wasm.lowering.trap_table import INDEX, TrapTable
from lfield.vm.wasm.stack_depth import most_bytes

#: Status of a function: returned; the reference engine must continue; the budget is too small for the next
#: block; the thread's first method has returned; an object, or a machine exception, was thrown.
RETURNED, STEP, SHORT, DONE, THROWN, TRAPPED = range(6)
#: Comments by instruction, for listings only.
Notes = Mapping[int, Sequence[str]]
NO_NOTES: Notes = {}
#: The maximum size of an object that is written word by word; longer objects are copied from the module.
_UNROLLED = 12
#: The lengths of the two kinds of arrays, at $p.
_ARRAY_LENGTH = "(i64.sub (i64.load32_u offset=4 (local.get $p)) (i64.const 1))"
_GROWABLE_LENGTH = f"(i64.load offset={8 * GROWABLE_LENGTH} (local.get $p))"


class MethodLowering:
    """The text of one method's function, and the numbers of its points."""

    def __init__(
        self,
        prepared: PreparedProgram,
        index: int,
        traps: TrapTable,
        notes: Notes,
        others: Mapping[int, MethodLowering],
    ) -> None:
        self.index, self._traps, self._notes = index, traps, notes
        # Methods with callable functions, complete when the text is made; irreducible methods have none.
        self._others = others
        self._prepared = prepared
        self._core = prepared.program.core
        self._method = method = self._core.methods[index]
        graph = ControlFlowGraph(prepared, method, lambda i: bool(row_name(prepared, method.slots, i)))
        self._routes = ResumeGraph(graph)
        #: The numbers of the points, by instruction.
        self.points = self._routes.numbers
        #: The data that the function copies to the heap, by name of the segment.
        self.segments: dict[str, bytes] = {}
        types = [self._type(t) for t in method.slots]
        instructions = graph.instructions.values()
        #: The called methods, and the maximum WebAssembly stack of the function in bytes.
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
            target
            for node in self._routes.nodes.values()
            if isinstance(node, ResumeSwitch)
            for target in node.targets.values()
        }
        self._shape = StructuredControl(ROOT.test, self._routes.leads_to, labelled)
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
        """The common exits: return, exit with its position, and the spilling of slots."""
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
            slots.sent,
            *slots.returned(self.result),
            f"(if (i64.eqz (i64.load offset={8 * FRAME_CALLER} (local.get $frame))) (then",
            f"(global.set $word {as_word or '(i64.const 0)'})",
            f"(global.set $status (i32.const {DONE}))",
            "(br $exit)))",
            ";; A frame on the top of the heap is freed; another one remains as garbage, and is written.",
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
            case ResumeTest(switch, entry):
                return [f"{self.slots.scope}.get $resume", "if", *go(switch), "end", *go(entry)]
            case ResumeSwitch(targets):
                return list(self._switch(number, targets))
            case run:
                return self._run(run, go)

    def _switch(self, number: int, targets: dict[int, int]) -> list[str]:
        first, last = min(targets), max(targets)
        labels = [
            self._shape.label(number, targets[k]) if k in targets else "$no" for k in range(first, last + 1)
        ]
        where = f"(i32.sub ({self.slots.scope}.get $resume) (i32.const {first}))"
        return ["block $no", where, f"br_table {' '.join(labels)} $no", "end", "unreachable"]

    def _run(self, run: BasicBlock, go: Go) -> list[Item]:
        lines: list[str] = []
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
        lines += self._noted(*run.last)
        return ["\n".join(lines), *self._end(run, go)]

    def _noted(self, pc: int, after: int) -> list[str]:
        return [line for number in range(pc, after) for line in self._notes.get(number, ())]

    def _end(self, run: BasicBlock, go: Go) -> list[Item]:
        first = self._routes.first
        match run.end:
            case JumpExit(target):
                return go(first(target))
            case BranchExit(slot, yes, no):
                condition = f"(i64.ne {self.slots.value(slot)} (i64.const 0))"
                return [condition, "if", *go(first(yes)), "end", *go(first(no))]
            case CallExit(instruction, target):
                if not self._calls(instruction):
                    return list(self.slots.exit_lines(instruction.pc, 1, STEP))
                return [*self._call(instruction), *go(first(target))]
            case ReturnExit(instruction):
                value = ""
                if self.result:
                    value = self.slots.return_text(self.result, self._value(instruction.quad.a, self.result))
                return [f"(global.set $pc (i32.const {instruction.pc}))", value, "br $return"]
            case ThrowExit(instruction):
                thrown = self._value(instruction.quad.a, "i64")
                null = self._leave(f"(i64.eqz {thrown})", instruction.pc, 1)
                lines = self.slots.exit_lines(instruction.pc, 0, THROWN)
                return [*null, f"(global.set $word {thrown})", *lines]
            case end:
                assert isinstance(end, EngineCallExit)
                return list(self.slots.exit_lines(end.instruction.pc, 0, STEP))

    def _leave(self, condition: str, pc: int, refund: int, status: int = STEP) -> list[str]:
        return [condition, "if", *self.slots.exit_lines(pc, refund, status), "end"]

    # --- instructions ---------------------------------------------------------------------------------

    def _value(self, operand: int, kind: str) -> str:
        """The text of a source operand of a WebAssembly type."""
        if operand >= 0:
            return self.slots.value(operand)
        value = self._core.constants[-1 - operand]
        if kind == "f64":
            assert isinstance(value, (int, float))
            return f"(f64.const {real_constant(float(value))})"
        return f"(i64.const {int(value) if isinstance(value, int) else 0})"

    def _lowered(self, i: LoweredInstruction, refund: int) -> list[str]:
        """The lines of the instruction's row, with its operands."""
        operands = self._operands(i)
        lines = []
        for keyword, rest, line in row_lines(ROWS[row_name(self._prepared, self._method.slots, i)]):
            if keyword == "leave":
                lines += self._leave(filled(rest, operands), i.pc, refund)
            elif keyword == "null":
                lines += self._null(operands["slots"][rest], i, refund)
            elif keyword == "zero":
                trap = self._traps.number("ArithmeticException", "division by zero")
                lines += self._trap(filled(rest, operands), trap, i.pc, refund)
            elif keyword == "over":
                trap = self._traps.number("ArithmeticException", "the result does not fit an int")
                lines += self._trap(filled(rest, operands), trap, i.pc, refund)
            elif keyword == "index":
                lines += self._index(filled(rest, operands), _ARRAY_LENGTH, i.pc, refund)
            elif keyword == "place":
                index = filled(rest, operands)
                lines += [*self._index(index, _GROWABLE_LENGTH, i.pc, refund), element_address(index)]
            else:
                lines.append(filled(line, operands))
        if "into" in operands:
            lines.append(self.slots.store_text(operands["into"]))
        return lines

    def _null(self, operand: int, i: LoweredInstruction, refund: int) -> list[str]:
        # The object of the method is never null.
        if not operand:
            return []
        trap = self._traps.number(
            "NullException", f"{null_purpose(self._core, self._method.slots, i)} of null"
        )
        return self._trap(f"(i64.eqz {self._value(operand, 'i64')})", trap, i.pc, refund)

    def _index(self, index: str, length: str, pc: int, refund: int) -> list[str]:
        """The code that throws if an index is outside the array of this length."""
        operands_code = f"(global.set $word {index}) (global.set $length {length})"
        return self._trap(f"(i64.ge_u {index} {length})", INDEX, pc, refund, operands_code)

    def _trap(self, condition: str, number: int, pc: int, refund: int, extra: str = "") -> list[str]:
        """The code that throws a machine exception if a condition holds; the instruction is charged."""
        trap = f"{extra} (global.set $trap (i32.const {number}))"
        return [condition, "if", trap, *self.slots.exit_lines(pc, refund - 1, TRAPPED), "end"]

    def _operands(self, i: LoweredInstruction) -> dict[str, Any]:
        """The values of a row's braces."""
        slots: dict[str, int] = {}
        operands: dict[str, Any] = {"slots": slots}
        for number, (pushed, expected_kind) in enumerate(
            zip(i.arguments, i.row.argument_kinds or (), strict=False)
        ):
            slots[str(number)] = pushed
            real = expected_kind == "real" or (expected_kind == "any" and self._is_real(i))
            operands[str(number)] = self._value(pushed, "f64" if real else "i64")
        if i.into >= 0:
            operands["a"], operands["into"] = self.slots.target(i.into), i.into
            operands["t"] = self.slots.types[i.into]
        elif i.row.argument_kinds is None:
            for letter, operand, value in zip("abc", i.row.operands, i.quad[1:], strict=False):
                slots[letter] = value
                if operand.role == "D":
                    operands[letter], operands["into"] = self.slots.target(value), value
                    operands["t"] = self.slots.types[value]
                elif operand.role in "SV":
                    real = operand.kind == "real" or (operand.kind in ("same", "any") and self._is_real(i))
                    operands[letter] = self._value(value, "f64" if real else "i64")
                elif operand.role == "F":
                    operands["field"] = 8 * (1 + value)
        for letter in [k for k in operands if k in slots and isinstance(operands[k], str)]:
            operands[f"{letter}_at"] = address_of(operands[letter])
        if i.row.name in ("putf", "pute", "append", "insert"):
            operands["t"] = "f64" if self._is_real(i) else "i64"
        return {**operands, **self._creation_operands(i)}

    def _is_real(self, i: LoweredInstruction) -> bool:
        """Whether the moved value is a real."""
        a, b = i.quad.a, i.quad.b
        types = self._core.types
        match i.row.name:
            case "putf":
                return self._kind(self._core.classes[types[self._method.slots[a]].of].fields[b].type) == REAL
            case "pute":
                return self._kind(self._core.element(self._method.slots[a])) == REAL
            case "append" | "insert":
                return self._kind(self._core.element(a)) == REAL
        return self.slots.types[a] == "f64"

    def _creation_operands(self, i: LoweredInstruction) -> dict[str, str]:
        """For an instruction that creates an object: the size, and the code that writes the object at $p."""
        operands = {"made": reference_to("$p"), "head": str(ARRAY | i.quad.b << 8)}
        if i.row.name == "newarray" and self._kind(i.quad.b) == GROWABLE_TYPE:
            operands["head"] = str(header(GROWABLE, i.quad.b, GROWABLE_WORDS))
            operands["plain_head"] = str(ARRAY | self._core.plain_array(i.quad.b) << 8)
        if i.row.name not in ("lds", "new"):
            return operands
        words = image_of(self._prepared, i)
        size = 8 * len(words)
        if len(words) <= _UNROLLED:
            stores = (
                f"(i64.store offset={8 * n} (local.get $p) (i64.const {word}))"
                for n, word in enumerate(words)
            )
            return {**operands, "size": str(size), "no_room": exceeds_heap(size), "image": " ".join(stores)}
        name = f"$made{i.quad.b}{i.row.name}"
        self.segments[name] = struct.pack(f"<{len(words)}q", *words)
        image = f"(memory.init {name} (local.get $p) (i32.const 0) (i32.const {size}))"
        return {**operands, "size": str(size), "no_room": exceeds_heap(size), "image": image}

    def _calls(self, i: LoweredInstruction) -> bool:
        return i.quad.a in self._others and i.arguments[0] >= 0

    def _call(self, i: LoweredInstruction) -> list[str]:
        """A frame on the top of the heap, and a call of the callee's function on it."""
        callee = self._others[i.quad.a].slots
        size = 8 * self._prepared.layouts.frame_words[i.quad.a]
        head = header(FRAME, i.quad.a, size // 8)
        return_pc = i.after - (i.into >= 0)
        values = [self._value(o, t) for o, t in zip(i.arguments, callee.types, strict=False)]
        stores, arguments = callee.passed(values)
        result = store = ""
        if i.into >= 0:
            result = "$u" if self.slots.types[i.into] == "f64" else "$x"
            store = (
                f"(local.set {self.slots.target(i.into)} (local.get {result})) "
                f"{self.slots.store_text(i.into)}"
            )
        return [
            *self._null(i.arguments[0], i, 1),
            f"(local.set $x (i64.add (i64.load offset={8 * FRAME_DEPTH} (local.get $frame)) (i64.const 1)))",
            *self._leave("(i64.gt_s (local.get $x) (global.get $deepest))", i.pc, 1),
            "(local.set $p (global.get $top))",
            *self._leave(exceeds_heap(size), i.pc, 1),
            f"(global.set $top (i32.add (local.get $p) (i32.const {size})))",
            f"(i64.store (local.get $p) (i64.const {head}))",
            f"(i64.store offset={8 * FRAME_CALLER} (local.get $p) {reference_to('$frame')})",
            f"(i64.store offset={8 * FRAME_RETURN} (local.get $p) (i64.const {return_pc}))",
            f"(i64.store offset={8 * FRAME_DEPTH} (local.get $p) (local.get $x))",
            *stores,
            self.slots.sent,
            f"(call $m{i.quad.a} (local.get $p) (i32.const 0) {' '.join(arguments)})",
            "local.set $status",
            f"local.set {result}" if result else "",
            self.slots.followed,
            self.slots.received,
            store,
        ]
