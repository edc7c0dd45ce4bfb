"""Checked tree to program, in two passes (chapter IV, Execution Model)."""

from __future__ import annotations

from lfield.bytecode.encoding import assemble
from lfield.bytecode.program import Core, Program, Quad, encode_quads
from lfield.compiler.collect import Tables
from lfield.compiler.debug import debug_information
from lfield.compiler.frame import Frame
from lfield.compiler.methods import compile_method, method_record
from lfield.errors import ProgramError
from lfield.lang.tree import CheckedProgram
from lfield.text.source import Diagnostic


def compile_program(checked: CheckedProgram) -> Program:
    """The program of a checked tree, verified.

    Raises ProgramError (L499) for methods that are beyond what the machine can hold.
    """
    tables = Tables(checked.units)
    frames: list[Frame] = []
    problems: list[Diagnostic] = []
    quads: list[Quad] = []
    for method in tables.methods:
        compiled = compile_method(method, tables, len(quads))
        if isinstance(compiled, Diagnostic):
            problems.append(compiled)
        else:
            frames.append(compiled)
            quads.extend(compiled.code.quads)
    if problems:
        raise ProgramError(problems)
    records = tuple(map(method_record, frames))
    core = Core(
        tuple(tables.types),
        tuple(tables.pool.values),
        tuple(tables.classes),
        records,
        tuple(tables.device_calls),
        encode_quads(quads),
    )
    return assemble(core, debug_information(checked.sources, frames))
