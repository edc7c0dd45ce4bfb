"""Verifying debug information: it may be absent, but what is there must lead somewhere."""

from __future__ import annotations

from lfield.bytecode.program import MethodDebug, MethodRecord, Program
from lfield.errors import ProgramFileError


def check_debug(program: Program) -> None:
    """One sound entry per method, or none at all."""
    debug, methods = program.debug, program.core.methods
    if debug.methods and len(debug.methods) != len(methods):
        raise ProgramFileError("its debug information is not that of its methods")
    for info, method in zip(debug.methods, methods, strict=False):
        if not 0 <= info.source < len(debug.sources):
            raise ProgramFileError("a method comes from no source", method=method.name, pc=method.entry)
        _check_entry(info, method)


def _check_entry(info: MethodDebug, method: MethodRecord) -> None:
    before = method.entry - 1
    for pc, line in info.lines:
        if not before < pc < method.end or line < 1:
            raise ProgramFileError("its lines are out of order", method=method.name, pc=method.entry)
        before = pc
    if not all(0 <= slot < len(method.slots) for slot, _ in info.names):
        raise ProgramFileError("it names a slot that it has not", method=method.name, pc=method.entry)
