"""Disassembler for `lfield disasm`: similar to the listings of appendix B, with names for numbers.

    ; first.L:7          i = i + 1;
       12  addi, ^2, ^2, 1

Slots are `^n`, jumps go to `Ln`, constants are written as in L, and the source line is above its code.
"""

from __future__ import annotations

import json
from collections.abc import Iterator

from lfield.bytecode.opcodes import BY_CODE, Operand
from lfield.bytecode.program import (
    ARRAYS,
    CATCH,
    FINALLY,
    LANDING,
    LIMIT,
    RESERVED,
    TICKET,
    Handler,
    MethodDebug,
    MethodRecord,
    Program,
    Quad,
    TypeRecord,
)

_SIMPLE_TYPES = ("void", "boolean", "int", "real", "string", "Exception", "null", "device")


def disassemble(program: Program) -> str:
    """The whole program as a listing; it ends with a newline."""
    core = program.core
    lines = [
        f"; program {program.digest.hex()}",
        f"; {len(core.classes) - core.builtins} classes, {len(core.methods)} methods, "
        f"{len(program.quads)} instructions, {len(core.constants)} constants",
    ]
    for index in range(core.builtins, len(core.classes)):
        lines += ["", *_class_lines(program, index)]
    texts = [source.text.split("\n") for source in program.debug.sources]
    for index in range(len(core.methods)):
        lines += ["", *_MethodListing(program, index, texts).lines()]
    return "\n".join(map(_printed_line, lines)) + "\n"


def instructions(program: Program, method: int) -> dict[int, tuple[str, str]]:
    """The instructions of a method as in the listing, by number, each with its line of L ('' if unknown)."""
    texts = [source.text.split("\n") for source in program.debug.sources]
    found = _MethodListing(program, method, texts).instructions()
    return {pc: (_printed_line(line), _printed_line(text)) for pc, line, text in found}


def _printed_line(line: str) -> str:
    """A line without control characters of terminals: a program may be untrusted."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in line)


def type_name(program: Program, index: int) -> str:
    """The name of a type in L."""
    dimensions = 0
    record = program.core.types[index]
    while record.kind in ARRAYS:
        dimensions += 1
        index = program.core.element(index)
        record = program.core.types[index]
    return _plain_name(program, record) + "[]" * dimensions


def _plain_name(program: Program, record: TypeRecord) -> str:
    if record.kind == TICKET:
        return "ticket"
    if record.kind < len(_SIMPLE_TYPES) and not record.of:
        return _SIMPLE_TYPES[record.kind]
    return program.core.classes[record.of].name


def _class_lines(program: Program, index: int) -> Iterator[str]:
    record = program.core.classes[index]
    if index in program.core.enum_classes:
        yield f"enum {record.name}"
        yield from (f"  {number:>3}  {field.name}" for number, field in enumerate(record.fields))
        return
    usage = f" {record.usage} specific" if record.kind == "class" and record.usage != "global" else ""
    label = "capability" if record.capability else record.kind
    yield f"{label} {record.name}{usage}"
    devices = {device.name: device.type for device in record.devices}
    for number, field in enumerate(record.fields):
        kind = devices.get(field.name) or type_name(program, field.type)
        yield f"  {number:>3}  {kind} {field.name or '(others)'}"


class _MethodListing:
    """The listing of one method."""

    def __init__(self, program: Program, index: int, texts: list[list[str]]) -> None:
        self._program = program
        self._method: MethodRecord = program.core.methods[index]
        self._index = index
        debug = program.debug
        self._info: MethodDebug | None = debug.methods[index] if debug.methods else None
        self._text = texts[self._info.source] if self._info else []
        self._quads = program.quads[self._method.entry : self._method.end]
        self._labels = {quad.a for quad in self._quads if self._jumps(quad)}
        takers = (handler for handler in self._method.handlers if handler.kind in (CATCH, FINALLY))
        self._labels.update(handler.target for handler in takers)

    def lines(self) -> Iterator[str]:
        """Header, slots, handlers, instructions."""
        method = self._method
        result = type_name(self._program, method.result)
        synchronized = " synchronized" if method.synchronized else ""
        yield f"{method.kind}{synchronized} {self._name(self._index)} {result}"
        names = dict(self._info.names) if self._info else {}
        for slot, kind in enumerate(method.slots):
            yield f"  ^{slot:<3} {type_name(self._program, kind)} {names.get(slot, '')}".rstrip()
        for handler in method.handlers:
            yield f"  {handler.start}-{handler.end - 1} {self._handling(handler)}"
        yield from self._code()

    def _handling(self, handler: Handler) -> str:
        if handler.kind == LIMIT:
            return f"limit ^{handler.slot}"
        if handler.kind == RESERVED:
            return f"reserved ^{handler.slot}"
        if handler.kind == LANDING:
            return "landing"
        class_name = self._program.core.classes[handler.catches].name
        label = "finally" if handler.kind == FINALLY else f"catch {class_name}"
        return f"{label} ^{handler.slot} at L{handler.target}"

    def _code(self) -> Iterator[str]:
        starts = dict(self._info.lines) if self._info else {}
        for pc, quad in enumerate(self._quads, self._method.entry):
            if pc in starts:
                yield self._source_line(starts[pc])
            yield self._numbered(pc, quad)

    def instructions(self) -> Iterator[tuple[int, str, str]]:
        """For each instruction its number, its line of L, and its text."""
        starts = dict(self._info.lines) if self._info else {}
        line = ""
        for pc, quad in enumerate(self._quads, self._method.entry):
            if pc in starts:
                line = self._source_line(starts[pc])
            yield pc, line, self._numbered(pc, quad)

    def _numbered(self, pc: int, quad: Quad) -> str:
        label = f"L{pc}" if pc in self._labels else str(pc)
        return f"{label:>6}  {self._instruction(quad)}"

    def _source_line(self, line: int) -> str:
        assert self._info is not None
        text = self._text[line - 1].strip() if line <= len(self._text) else ""
        return f"; {self._program.debug.sources[self._info.source].name}:{line}  {text}".rstrip()

    def _instruction(self, quad: Quad) -> str:
        row = BY_CODE[quad.op]
        operands = (self._operand(quad, i, operand) for i, operand in enumerate(row.operands))
        return ", ".join((row.name, *operands))

    def _operand(self, quad: Quad, position: int, operand: Operand) -> str:
        number = quad[1 + position]
        core = self._program.core
        match operand.role:
            case "L":
                return f"L{number}"
            case "C":
                return core.classes[number].name
            case "T":
                return type_name(self._program, number)
            case "M":
                return self._name(number)
            case "F":
                return "." + self._field(quad, number)
            case "K":
                return self._constant(number)
            case "I":
                return f"{core.device_calls[number].field}.{core.device_calls[number].instruction}"
        return f"^{number}" if number >= 0 else self._constant(-1 - number)

    def _field(self, quad: Quad, number: int) -> str:
        """The name of a field; the object is the slot operand before the field, which is the last or the
        first one.
        """
        holder = quad.b if BY_CODE[quad.op].name == "getf" else quad.a
        owner = self._program.core.types[self._method.slots[holder]].of
        return self._program.core.classes[owner].fields[number].name

    def _constant(self, number: int) -> str:
        return json.dumps(self._program.core.constants[number], ensure_ascii=False)

    def _name(self, index: int) -> str:
        """`Owner.method(types)`; without debug information, `Owner.method`."""
        debug = self._program.debug.methods
        name = self._program.method_name(index)
        return name.rpartition(".")[0] + "." + debug[index].signature if debug else name

    @staticmethod
    def _jumps(quad: Quad) -> bool:
        operands = BY_CODE[quad.op].operands
        return bool(operands) and operands[0].role == "L"
