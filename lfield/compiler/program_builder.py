"""Checked syntax tree to program, in two passes (chapter IV, Execution Model).

The first pass (tables.py) numbers types, classes and methods; the second compiles one method after another.
"""

from __future__ import annotations

from pathlib import PurePath

from lfield.bytecode.encoding import assemble
from lfield.bytecode.program import (
    LIBRARY_SOURCE,
    Core,
    Debug,
    MethodDebug,
    MethodRecord,
    Program,
    Quad,
    SourceText,
    encode_quads,
)
from lfield.bytecode.verifier.methods import MAX_SLOTS
from lfield.compiler.method_frame import CodeBuffer, MethodFrame
from lfield.compiler.slots import Slots
from lfield.compiler.statements import StatementEmitter
from lfield.compiler.tables import ProgramTables
from lfield.errors import ProgramError
from lfield.lang import types
from lfield.lang.standard_library.instances import LIBRARY_FILE
from lfield.lang.tree import CheckedProgram, Method
from lfield.text.source_text import Diagnostic, Source
from lfield.text.terminal_escape import printable_argument


def compile_program(checked: CheckedProgram) -> Program:
    """The program of a checked tree, verified.

    Raises ProgramError (L499) for methods that exceed a limit of the machine.
    """
    tables = ProgramTables(checked.units, checked.growing, checked.enums)
    frames: list[MethodFrame] = []
    problems: list[Diagnostic] = []
    quads: list[Quad] = []
    for method in tables.methods:
        compiled = _compiled(method, tables, len(quads))
        if isinstance(compiled, Diagnostic):
            problems.append(compiled)
        else:
            frames.append(compiled)
            quads.extend(compiled.code.quads)
    if problems:
        raise ProgramError(problems)
    records = tuple(map(_record, frames))
    core = Core(
        tuple(tables.types),
        tuple(tables.pool.values),
        tuple(tables.classes),
        records,
        tuple(tables.device_calls),
        encode_quads(quads),
    )
    return assemble(core, _debug(checked.sources, frames))


def _compiled(method: Method, tables: ProgramTables, entry: int) -> MethodFrame | Diagnostic:
    """The code of a method whose first instruction is number `entry`; L499 when it exceeds a limit."""
    frame = MethodFrame(method, tables, Slots(tables.object_type(method.unit.name)), CodeBuffer(entry))
    for parameter in method.parameters:
        frame.slots.parameter(parameter, tables.type_index(parameter.type))
    frame.code.set_line(method.span.line)
    frame.code.emit("frame", tables.method_index(method))
    StatementEmitter(frame).block(method.body)
    frame.code.set_line(method.end.line)
    frame.code.emit("rtn" if method.result == types.VOID else "noreturn")
    if len(frame.slots.types) > MAX_SLOTS:
        message = f"{method.signature} needs more than {MAX_SLOTS} variables and intermediate values"
        return Diagnostic("L499", message, method.span, "split it into several methods")
    return frame


def _record(frame: MethodFrame) -> MethodRecord:
    """The record of a compiled method."""
    method, tables = frame.method, frame.tables
    return MethodRecord(
        method.name,
        tables.class_index(method.unit.name),
        method.kind,
        len(method.parameters),
        tables.type_index(method.result),
        tuple(frame.slots.types),
        frame.code.position - len(frame.code.quads),
        frame.code.position,
        method.synchronized,
        tuple(frame.handlers),
    )


def _debug(sources: list[Source], frames: list[MethodFrame]) -> Debug:
    """Debug information for debuggers, tracebacks and listings.

    Sources have their base names: paths of the ground computer are private.
    """
    number = {id(source): i for i, source in enumerate(sources)}
    return Debug(
        tuple(
            MethodDebug(
                number[id(frame.method.span.source)],
                tuple(frame.code.lines),
                tuple(frame.slots.names),
                frame.method.signature,
            )
            for frame in frames
        ),
        tuple(SourceText(_shown_name(source), source.text) for source in sources),
    )


def _shown_name(source: Source) -> str:
    return LIBRARY_SOURCE if source.name == LIBRARY_FILE else printable_argument(PurePath(source.name).name)
