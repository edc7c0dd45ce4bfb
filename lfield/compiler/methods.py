"""The second pass, one method at a time."""

from __future__ import annotations

from lfield.bytecode.program import MethodRecord
from lfield.bytecode.verify.methods import MAX_SLOTS
from lfield.compiler.code import Code
from lfield.compiler.collect import Tables
from lfield.compiler.frame import Frame
from lfield.compiler.slots import Slots
from lfield.compiler.statements import Statements
from lfield.lang import types
from lfield.lang.tree import Method
from lfield.text.source import Diagnostic


def compile_method(method: Method, tables: Tables, entry: int) -> Frame | Diagnostic:
    """The code of a method whose first instruction is number `entry`; L499 when it is beyond a limit."""
    frame = Frame(method, tables, Slots(tables.object_type(method.unit.name)), Code(entry))
    for parameter in method.parameters:
        frame.slots.parameter(parameter, tables.type_index(parameter.type))
    _compile_body(frame)
    if len(frame.slots.types) > MAX_SLOTS:
        message = f"{method.signature} needs more than {MAX_SLOTS} variables and intermediate values"
        return Diagnostic("L499", message, method.span, "split it into several methods")
    return frame


def _compile_body(frame: Frame) -> None:
    method, code = frame.method, frame.code
    code.line = method.span.line
    code.emit("frame", frame.tables.method_index(method))
    Statements(frame).block(method.body)
    code.line = method.end.line
    code.emit("rtn" if method.result == types.VOID else "noreturn")


def method_record(frame: Frame) -> MethodRecord:
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
