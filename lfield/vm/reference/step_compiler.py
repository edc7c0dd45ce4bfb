"""Compiler from quads to steps, once per program, so that no decoding is needed at run time."""

from __future__ import annotations

from typing import Any

from msgspec import Struct

from lfield.bytecode.opcodes import BY_CODE, BY_NAME, SEQUENCING, Opcode
from lfield.bytecode.program import (
    GROWABLE,
    HELD_DEVICE,
    PROXY,
    REAL,
    VOID,
    DeviceCallRecord,
    MethodRecord,
    Program,
    Quad,
)
from lfield.vm.engine_interface import PLAIN, Group, Trap
from lfield.vm.memory.layout import FRAME_SLOTS, Layouts
from lfield.vm.memory.word_codec import bits_of_real
from lfield.vm.reference import arithmetic, call_steps, memory_steps
from lfield.vm.reference.call_steps import Argument, Registers, Step
from lfield.vm.reference.library_functions import FUNCTIONS, Function, growable_others

_PUSH, _POP, _JMP = BY_NAME["push"].code, BY_NAME["pop"].code, BY_NAME["jmp"].code


class HostCallSite(Struct, frozen=True):
    """A host call group: its own operand, its arguments, and the arguments that must not be null."""

    op: int
    operand: int
    arguments: tuple[Argument, ...]
    checked: tuple[int, ...]


class PreparedProgram(Struct, frozen=True):
    """A program in the form that the engine runs: a step per instruction, and its groups by first
    instruction.

    `host_calls` are the groups that always exit, whether or not there are readings.
    """

    program: Program
    layouts: Layouts
    steps: list[Step]
    groups: dict[int, Group]
    host_calls: dict[int, HostCallSite]
    destinations: dict[int, int]
    class_names: list[str]


def prepare(program: Program) -> PreparedProgram:
    """Prepare a verified program."""
    return _Preparer(program).run()


def _bits(value: bool | int | float | str | None) -> int:
    """The word of a constant in a slot: reals by their bits, null as 0."""
    if isinstance(value, float):
        return bits_of_real(value)
    return int(value) if isinstance(value, int) else 0


def _unreachable(m: Registers) -> int:
    raise AssertionError("the verifier rejects jumps into a group")


class _Preparer:
    def __init__(self, program: Program) -> None:
        self.program = program
        self.core = program.core
        self.layouts = Layouts(program)
        self.quads = program.quads
        self.steps: list[Step] = [_unreachable] * len(self.quads)
        self.groups: dict[int, Group] = {}
        self.host_calls: dict[int, HostCallSite] = {}
        self.destinations: dict[int, int] = {}
        self.bits = [_bits(c) for c in self.core.constants]

    def run(self) -> PreparedProgram:
        for method in self.core.methods:
            pc = method.entry
            while pc < method.end:
                pc = self.instruction(pc, method)
        names = [c.name for c in self.core.classes]
        return PreparedProgram(
            self.program, self.layouts, self.steps, self.groups, self.host_calls, self.destinations, names
        )

    def instruction(self, pc: int, method: MethodRecord) -> int:
        """Prepare a group or instruction at `pc`; returns the position after it."""
        row = BY_CODE[self.quads[pc].op]
        if row.code == _PUSH or row.argument_kinds is not None:
            return self.group(pc, method)
        self.steps[pc] = self.plain(pc, row, method)
        return pc + 1

    def source(self, operand: int) -> Argument:
        """A source operand: (slot, 0), or (None, the word of the constant)."""
        return (operand, 0) if operand >= 0 else (None, self.bits[-1 - operand])

    def real_constant(self, operand: int) -> float:
        value = self.core.constants[-1 - operand] if operand < 0 else 0.0
        assert isinstance(value, (int, float))
        return float(value)

    # --- one instruction ------------------------------------------------------------------------------

    def plain(self, pc: int, row: Opcode, method: MethodRecord) -> Step:
        _, a, b, c = self.quads[pc]
        name, after = row.name, pc + 1
        if name in ("eqr", "sner") and self.core.types[method.slots[b]].kind == PROXY:
            return arithmetic.proxy_compare(name == "eqr", a, b, c if c >= 0 else None, after)
        if name in arithmetic.INT:
            return arithmetic.int_binary(arithmetic.INT[name], a, b, *self.source(c), after)
        if name in arithmetic.REAL:
            slot = c if c >= 0 else None
            return arithmetic.real_binary(arithmetic.REAL[name], a, b, slot, self.real_constant(c), after)
        if name in arithmetic.REAL_COMPARE:
            slot = c if c >= 0 else None
            return arithmetic.real_compare(
                arithmetic.REAL_COMPARE[name], a, b, slot, self.real_constant(c), after
            )
        if name in arithmetic.STRING_COMPARE:
            return arithmetic.string_compare(
                arithmetic.STRING_COMPARE[name], a, b, c if c >= 0 else None, after
            )
        if name in arithmetic.INT_UNARY:
            return arithmetic.int_unary(arithmetic.INT_UNARY[name], a, *self.source(b), after)
        if name == "negf":
            return arithmetic.real_negate(a, b if b >= 0 else None, self.real_constant(b), after)
        return self.special(name, a, b, c, after, method)

    def special(self, name: str, a: int, b: int, c: int, after: int, method: MethodRecord) -> Step:
        match name:
            case "jmp":
                return memory_steps.jump(a)
            case "bnz" | "bz":
                return memory_steps.branch(a, b, name == "bnz", after)
            case "move":
                return memory_steps.move(a, *self.source(b), after)
            case "getf":
                return memory_steps.get_field(a, b, 1 + c, self.field_name(method, b, c), after)
            case "putf":
                return memory_steps.put_field(a, 1 + b, *self.source(c), self.field_name(method, a, b), after)
            case "gete":
                return memory_steps.get_element(a, b, *self.source(c), after)
            case "pute":
                return memory_steps.put_element(a, b, *self.source(c), after)
            case "lds":
                text = self.core.constants[b]
                assert isinstance(text, str)
                return memory_steps.load_string(a, text, after)
            case "new":
                return memory_steps.new_object(a, b, self.layouts.class_words[b], after)
            case "newarray":
                return memory_steps.new_array(a, b, *self.source(c), after)
            case "frame":
                return call_steps.enter(method.synchronized, after)
            case "return":
                return self._leave(method, self.source(a))
            case "rtn":
                return self._leave(method, None)
            case "throw":
                return _throw(a)
            case _:
                assert name == "noreturn", name
                return self.no_return(method, after - 1)

    def _leave(self, method: MethodRecord, result: Argument | None) -> Step:
        words = FRAME_SLOTS + len(method.slots)
        return call_steps.leave(result, words, method.synchronized, self.destinations)

    def no_return(self, method: MethodRecord, pc: int) -> Step:
        """The trap at the end of a method with a result; a program of 0.3 has no class for this exception."""
        kind = "MissingReturnException"
        known = kind in (record.name for record in self.core.classes[: self.core.builtins])
        file, line = self.program.line(self.quads[method.entry].a, pc)
        where = f" ({file}:{line})" if line else ""
        message = f"'{method.name}' has ended without a return{where}"
        return _trap(kind if known else "Exception", message)

    def field_name(self, method: MethodRecord, slot: int, field: int) -> str:
        record = self.core.types[method.slots[slot]]
        return self.core.classes[record.of].fields[field].name

    # --- a group --------------------------------------------------------------------------------------

    def group(self, first: int, method: MethodRecord) -> int:
        pc = first
        operands: list[int] = []
        while self.quads[pc].op == _PUSH:
            operands.append(self.quads[pc].a)
            pc += 1
        head = self.quads[pc]
        kind = self.result_kind(head)
        after, destination = pc + 1, -1
        if kind != VOID:
            destination = self.quads[after].a
            self.destinations[after] = destination
            after += 1
        follows = self.quads[after] if after < method.end else head
        parks = BY_CODE[head.op].name == "yield" and follows.op == _JMP and follows.a == first
        self.groups[first] = Group(head, destination, after, kind, parks)
        arguments = [self.source(operand) for operand in operands]
        self.steps[first] = self.head(head, arguments, operands, pc + 1, after, destination, method)
        row = BY_CODE[head.op]
        if row.leaves_engine and not self.is_reading(row, head, arguments):
            checked = tuple(self.checked(row, head.a))
            self.host_calls[first] = HostCallSite(head.op, head.a, tuple(arguments), checked)
        return after

    def is_reading(self, row: Opcode, head: Quad, arguments: list[Argument]) -> bool:
        """Whether a head is a query that a reading may answer."""
        return row.name == "device" and not arguments and self.device_result(head.a) in PLAIN

    def head(
        self,
        head: Quad,
        arguments: list[Argument],
        operands: list[int],
        result_fetch: int,
        after: int,
        into: int,
        method: MethodRecord,
    ) -> Step:
        row = BY_CODE[head.op]
        if row.name == "call":
            callee = self.core.methods[head.a]
            entry = callee.entry if callee.synchronized else callee.entry + 1
            words = self.layouts.frame_words[head.a]
            return call_steps.call(arguments, head.a, words, entry, result_fetch, callee.name)
        if row.leaves_engine:
            host_call_step = call_steps.host_call(arguments, head.op, head.a, self.checked(row, head.a))
            if self.is_reading(row, head, arguments):
                return call_steps.reading(host_call_step, head.a, into, after)
            return host_call_step
        reals = [kind == "real" for kind in row.argument_kinds or ()]
        function = FUNCTIONS[row.name]
        if row.name == "exc_others" and self.core.types[method.slots[into]].kind == GROWABLE:
            function = growable_others(method.slots[into])
        return _pure(function, self.getters(operands, reals), into, row.result_kind == "real", after)

    def checked(self, row: Opcode, operand: int) -> dict[int, str]:
        """The arguments of a host call that must not be null, with their purpose."""
        match row.name:
            case "pcall":
                return {0: f"portal '{self.core.methods[operand].name}'"}
            case "begin":
                return {0: "'together'", 3: f"portal '{self.core.methods[operand].name}'"}
            case "hold" | "take" | "drop":
                return {0: "'reserve'"}
            case "start" | "fetch" | "leave" | "settle":
                return {0: "'together'"}
            case "tick_failed":
                return {0: "the end of a tick"}
            case "launch" | "next" | "ended" | "cancel" | "failure":
                return {0: "the futures"}
            case "seq_start" | "seq_stop" | "seq_end" | "seq_alive":
                return {0: f"'{SEQUENCING[row.name]}'"}
            case "write_str" | "print_str" | "find" | "agent" | "host":
                return {0: f"'{row.name.partition('_')[0]}'"}
            case "device" if self.core.device_calls[operand].field == HELD_DEVICE:
                return {0: f"device of '{self.core.device_calls[operand].instruction}'"}
        return {}

    def getters(self, operands: list[int], reals: list[bool]) -> list[tuple[bool, int | None, Any]]:
        """For each argument of a pure function: whether it is real, its slot, or the constant's value."""
        return [
            (
                real,
                operand if operand >= 0 else None,
                self.real_constant(operand) if real else self.source(operand)[1],
            )
            for operand, real in zip(operands, reals, strict=True)
        ]

    def device_result(self, number: int) -> int:
        """The type kind of a device call's result."""
        call: DeviceCallRecord = self.core.device_calls[number]
        return self.core.types[call.result].kind

    def result_kind(self, head: Quad) -> int:
        """The type kind of a head's result, VOID for none."""
        row = BY_CODE[head.op]
        if row.name in ("call", "pcall"):
            return self.core.types[self.core.methods[head.a].result].kind
        if row.name == "device":
            return self.device_result(head.a)
        if not row.result_kind:
            return VOID
        if row.result_kind == "any":
            return self.core.types[self.core.element(head.a)].kind
        return REAL if row.result_kind == "real" else _KINDS[row.result_kind]


_KINDS = {"int": 2, "string": 4, "ref": 5, "boolean": 1}


def _pure(
    function: Function, getters: list[tuple[bool, int | None, Any]], into: int, real: bool, after: int
) -> Step:
    """A head that the engine executes itself; `into` is below 0 without a result."""
    if len(getters) == 1 and getters[0][1] is not None and not getters[0][0] and not real:
        slot = getters[0][1]

        def simple(m: Registers) -> int:
            word = function(m, m.w[m.slots + slot])
            m.w[m.slots + into] = word
            return after

        return simple

    def step(m: Registers) -> int:
        slots = m.slots
        values = [
            constant if slot is None else (m.r if is_real else m.w)[slots + slot]
            for is_real, slot, constant in getters
        ]
        result = function(m, *values)
        if into < 0:
            return after
        if real:
            m.r[slots + into] = result
        else:
            m.w[slots + into] = result
        return after

    return step


def _throw(slot: int) -> Step:
    def step(m: Registers) -> int:
        place = m.w[m.slots + slot]
        if not place:
            raise Trap("NullException", "throw of null")
        raise RaisedObject(place)

    return step


def _trap(kind: str, message: str) -> Step:
    def step(m: Registers) -> int:
        raise Trap(kind, message)

    return step


class RaisedObject(Exception):
    """An L object thrown by the running instruction."""

    def __init__(self, place: int) -> None:
        self.place = place
        super().__init__(place)
