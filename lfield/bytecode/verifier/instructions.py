"""Verifies instructions: one pass over each method, then its jumps and handlers."""

from __future__ import annotations

from lfield.bytecode.opcodes import BY_CODE, BY_NAME
from lfield.bytecode.program import (
    ANY,
    ARRAY,
    BUILTIN_CLASSES,
    CATCH,
    FINALLY,
    INT,
    LANDING,
    LIMIT,
    OBJECT,
    RESERVED,
    Handler,
    Program,
    Quad,
    TypeRecord,
)
from lfield.bytecode.verifier.groups import check_group
from lfield.bytecode.verifier.operand_rules import RULES
from lfield.bytecode.verifier.operands import MethodView
from lfield.bytecode.verifier.type_table import TypeTable

_FRAME, _PUSH, _POP = (BY_NAME[name].code for name in ("frame", "push", "pop"))
_JUMPS = frozenset(row.code for row in BY_CODE.values() if row.operands and row.operands[0].role == "L")
#: Instructions that never continue at the next one.
_TERMINALS = frozenset(BY_NAME[name].code for name in ("jmp", "return", "rtn", "throw", "noreturn"))


def check_code(program: Program) -> None:
    """Check the instructions of every method; all records have been checked already."""
    types = TypeTable(program.core)
    for index in range(len(program.core.methods)):
        check_method(MethodView(program.core, types, index), program.quads)


def check_method(view: MethodView, quads: tuple[Quad, ...]) -> None:
    """Check the instructions and the handlers of one method."""
    entry, end = view.method.entry, view.method.end
    if quads[entry] != Quad(_FRAME, view.index, 0, 0):
        raise view.refused(entry, "it does not start with its frame")
    starts: set[int] = set()
    pc = entry + 1
    while pc < end:
        starts.add(pc)
        pc = _check_step(view, quads, pc)
    if quads[end - 1].op not in _TERMINALS:
        raise view.refused(end - 1, "control can run off its end")
    for pc in starts:
        if quads[pc].op in _JUMPS and quads[pc].a not in starts:
            raise view.refused(pc, "a jump leads into a group")
    for handler in view.method.handlers:
        _check_handler(view, handler, starts)


def _check_step(view: MethodView, quads: tuple[Quad, ...], pc: int) -> int:
    """Check the instruction or group at `pc`; returns the start of the next one."""
    quad = quads[pc]
    row = BY_CODE.get(quad.op)
    if row is None:
        raise view.refused(pc, f"there is no instruction {quad.op}")
    if quad.op == _PUSH or row.argument_kinds is not None:
        return check_group(view, quads, pc)
    if quad.op in (_POP, _FRAME):
        raise view.refused(pc, f"{row.name} is out of place")
    view.check_operands(pc, row, quad)
    rule = RULES.get(row.name)
    if rule is not None and not rule[0](view, pc, quad):
        raise view.refused(pc, rule[1])
    return pc + 1


def _check_handler(view: MethodView, handler: Handler, starts: set[int]) -> None:
    is_aligned = handler.start in starts and (handler.end in starts or handler.end == view.method.end)
    if not is_aligned or handler.start >= handler.end:
        raise view.refused(handler.start, "a handler does not protect a range of whole instructions")
    if handler.kind in (LIMIT, LANDING, RESERVED):
        _check_region(view, handler)
        return
    if handler.kind not in (CATCH, FINALLY):
        raise view.refused(handler.start, f"there are no handlers of kind {handler.kind}")
    if handler.target not in starts or handler.start <= handler.target < handler.end:
        raise view.refused(handler.start, "the target of a handler does not exist, or is in its own range")
    if not 0 <= handler.catches < len(view.core.classes):
        raise view.refused(handler.start, "a handler catches a class that does not exist")
    if view.core.classes[handler.catches].kind != "class":
        raise view.refused(handler.start, "a handler catches something that is not a class")
    if handler.kind == FINALLY and handler.catches:
        raise view.refused(handler.start, "a handler that catches everything names a class")
    # Class 0, Exception, catches any object, so only a slot of any class can hold it.
    caught_type = TypeRecord(ANY) if handler.catches == 0 else TypeRecord(OBJECT, handler.catches)
    if view.types.record(view.target(handler.slot, handler.target)) not in (caught_type, TypeRecord(ANY)):
        raise view.refused(handler.target, "the class of a handler does not fit its slot")


def _check_region(view: MethodView, handler: Handler) -> None:
    """Check a row without target, which marks its instructions."""
    if handler.target or handler.catches or (handler.kind == LANDING and handler.slot):
        raise view.refused(handler.start, "a row that catches nothing has a target")
    if handler.kind == LANDING:
        return
    if view.scope != "coordinator" or view.core.builtins < len(BUILTIN_CLASSES):
        raise view.refused(handler.start, "only coordinators have a time limit, or reserve")
    slot = view.types.record(view.target(handler.slot, handler.start))
    if handler.kind == LIMIT and slot != TypeRecord(INT):
        raise view.refused(handler.start, "the end of a time limit is not an int")
    if handler.kind == RESERVED and slot != TypeRecord(ARRAY, INT):
        raise view.refused(handler.start, "the resources of a reserve are not an int[]")
