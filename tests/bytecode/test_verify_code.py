"""Invalid operands, control flow, groups of instructions and handlers are refused."""

from __future__ import annotations

import pytest
from program_draft import (
    ARM,
    ARM_INIT,
    ARM_LIFT,
    BOX,
    BOX_NEW,
    BOX_SUM,
    EXCEPTION,
    GUIDE_INIT,
    HALF,
    NOTHING,
    ONE,
    T_INTS,
    T_STRINGS,
    TOOL,
    TOOL_NEW,
    TOOL_SHOW,
    TRUE,
    WORD,
    Draft,
    DraftChange,
    handler,
    put,
    refused,
)

from lfield.bytecode.program import INT, Core
from lfield.bytecode.verifier import verify
from lfield.errors import ProgramFileError


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (put(BOX_NEW, 1, "addi", 1, 1, -99), "no constant 98"),
        (put(BOX_NEW, 1, "addi", 1, 7, ONE), "no slot 7"),
        (put(BOX_NEW, 1, "addi", 1, ONE, 1), "no slot -1"),
        (put(BOX_NEW, 1, "addi", 9, 1, ONE), "no slot 9"),
        (put(BOX_NEW, 1, "move", 0, NOTHING), "slot 0 cannot be written"),
        (put(BOX_NEW, 1, "addi", -1, 1, 1), "no slot -1"),
        (put(BOX_NEW, 1, "addi", 1, 1, HALF), "wrong type"),
        (put(BOX_NEW, 1, "addi", 1, 1, TRUE), "wrong type"),
        (put(BOX_NEW, 1, "addi", 1, 1, NOTHING), "wrong type"),
        (put(BOX_NEW, 1, "addi", 1, 1, WORD), "string constant"),
        (put(BOX_NEW, 1, "addi", 1, 0, 1), "wrong type"),
        (put(BOX_NEW, 1, "slti", 1, 1, 1), "wrong type"),
        (put(BOX_NEW, 1, "rtn", 0, 0, 1), "operand too many"),
        (put(BOX_NEW, 1, "pute", 0, 1, 1), "wrong type"),
        (put(BOX_NEW, 1, "pute", 0, ONE, 1), "wrong type|no slot"),
        (put(BOX_NEW, 1, "putf", 1, 0, 1), "wrong type"),
        (put(BOX_SUM, 10, "eqnull", 3, 2), "wrong type"),
        (put(BOX_SUM, 9, "bnz", 5, 2), "wrong type"),
        (put(BOX_SUM, 5, "gete", 3, 4, ONE), "element does not fit"),
        (put(BOX_SUM, 3, "pute", 4, 2, TRUE), "value does not fit the element"),
        (put(BOX_SUM, 6, "getf", 2, 0, 1), "field does not fit"),
        (put(BOX_SUM, 6, "getf", 5, 0, 2), "no field 2"),
        (put(BOX_SUM, 6, "getf", 5, 0, -1), "no field -1"),
        (put(BOX_SUM, 6, "getf", 5, 6, 1), "wrong type"),
        (put(ARM_INIT, 2, "putf", 0, 1, 2), "does not fit the field"),
        (put(ARM_INIT, 2, "putf", 0, 0, 3), "does not fit the field"),
        (put(BOX_SUM, 2, "move", 2, TRUE), "does not fit the slot"),
        (put(BOX_SUM, 2, "move", 5, 6), "does not fit the slot"),
        (put(BOX_SUM, 2, "move", 6, 4), "does not fit the slot"),
        (put(BOX_SUM, 1, "newarray", 4, INT, ONE), "not an array"),
        (put(BOX_SUM, 1, "newarray", 4, T_STRINGS, ONE), "not an array"),
        (put(BOX_SUM, 1, "newarray", 4, 99, ONE), "does not exist"),
        (put(BOX_SUM, 1, "newarray", 4, T_INTS, HALF), "wrong type"),
        (put(ARM_INIT, 1, "lds", 2, 0), "not a string"),
        (put(ARM_INIT, 1, "lds", 2, 5), "does not exist"),
        (put(ARM_INIT, 1, "lds", 3, 4), "wrong type"),
        (put(ARM_INIT, 5, "new", 3, BOX), "cannot be created"),
        (put(ARM_INIT, 5, "new", 3, ARM), "cannot be created"),
        (put(ARM_INIT, 5, "new", 3, -1), "does not exist"),
        (put(ARM_INIT, 5, "new", 3, TOOL + 1), "does not exist"),
        (put(BOX_SUM, 2, "new", 6, TOOL), "cannot be created"),
        (put(BOX_SUM, 12, "return", 3), "not the result"),
        (put(BOX_SUM, 12, "rtn"), "must return"),
        (put(BOX_NEW, 2, "return", 1), "not the result"),
        (put(BOX_SUM, 13, "throw", 4), "only objects"),
        (put(BOX_SUM, 13, "throw", 1), "wrong type"),
        (put(ARM_INIT, 1, "throw", 0), "only objects"),
    ],
)
def test_invalid_operands_are_refused(change: DraftChange, reason: str) -> None:
    refused(change, reason)


def _append(method: int, *quad: str | int) -> DraftChange:
    def change(draft: Draft) -> None:
        draft.code[method].append(("rtn", 0, 0, 0))
        draft.put(method, -1, *quad)

    return change


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (put(BOX_NEW, 0, "rtn"), "start with its frame"),
        (put(BOX_NEW, 0, "frame", BOX_SUM), "start with its frame"),
        (put(BOX_NEW, 1, "frame", BOX_NEW), "frame is out of place"),
        (put(BOX_NEW, 1, "pop", 1), "pop is out of place"),
        (put(BOX_NEW, 2, "putf", 0, 0, 1), "run off its end"),
        (put(BOX_SUM, 14, "bz", 5, 3), "run off its end"),
        (_append(BOX_NEW, "yield"), "run off its end"),
        (put(BOX_SUM, 4, "jmp", 0), "does not exist"),
        (put(BOX_SUM, 4, "jmp", -1), "does not exist"),
        (put(BOX_SUM, 4, "jmp", 15), "does not exist"),
        (put(ARM_INIT, 12, "jmp", 4), "into a group"),
        (put(ARM_INIT, 12, "jmp", 9), "into a group"),
        (put(GUIDE_INIT, 18, "jmp", 15), "into a group"),
    ],
)
def test_invalid_control_flow_is_refused(change: DraftChange, reason: str) -> None:
    refused(change, reason)


def test_unknown_instructions_are_refused() -> None:
    draft = Draft()
    core = draft.core()
    code = core.code[:16] + b"\xff\xff\0\0" + core.code[20:]
    with pytest.raises(ProgramFileError, match="no instruction 65535"):
        verify(draft.program(Core(*core_parts(core)[:-1], code)))


def core_parts(core: Core) -> list[object]:
    return [getattr(core, name) for name in Core.__struct_fields__]


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (put(ARM_INIT, 4, "yield"), "1 values are pushed, 0 expected"),
        (put(ARM_INIT, 4, "rtn"), "not used by an instruction"),
        (put(ARM_INIT, 3, "yield"), "0 values are pushed, 1 expected"),
        (_append(BOX_NEW, "push", 1), "not used by an instruction"),
        (put(ARM_INIT, 3, "push", 1), "wrong type"),
        (put(ARM_INIT, 3, "push", WORD), "string constant"),
        (put(ARM_INIT, 3, "push", 99), "no slot 99"),
        (put(ARM_INIT, 4, "str_len"), "result must be popped"),
        (put(ARM_LIFT, 3, "yield"), "result must be popped"),
        (put(ARM_INIT, 5, "pop", 2), "result must be popped"),
        (put(ARM_LIFT, 3, "pop", 2), "result does not fit"),
        (put(ARM_LIFT, 3, "pop", 0), "slot 0"),
        (put(ARM_INIT, 7, "call", ARM_LIFT), "only methods and constructors"),
        (put(ARM_INIT, 7, "call", GUIDE_INIT), "only methods and constructors"),
        (put(ARM_INIT, 7, "call", 7), "does not exist"),
        (put(ARM_INIT, 6, "push", 2), "wrong type"),
        (put(ARM_INIT, 9, "push", ONE), "wrong type"),
        (put(GUIDE_INIT, 10, "call", TOOL_NEW), "out of scope"),
        (put(GUIDE_INIT, 14, "pcall", BOX_SUM), "needs a portal"),
        (put(GUIDE_INIT, 11, "push", 0), "wrong type"),
        (put(GUIDE_INIT, 13, "push", ONE), "wrong type"),
        (put(ARM_INIT, 7, "pcall", ARM_LIFT), "only coordinators call portals"),
        (put(BOX_SUM, 2, "pcall", ARM_LIFT), "only coordinators call portals"),
        (put(GUIDE_INIT, 3, "find", BOX), "only resources are found"),
        (put(GUIDE_INIT, 3, "find", 99), "does not exist"),
        (put(GUIDE_INIT, 2, "push", 4), "wrong type"),
        (put(GUIDE_INIT, 4, "pop", 4), "result does not fit"),
        (put(GUIDE_INIT, 6, "pop", 2), "result does not fit"),
        (put(GUIDE_INIT, 5, "findall", BOX), "only resources are found"),
        (put(ARM_INIT, 4, "find", ARM), "only coordinators find"),
        (put(ARM_INIT, 11, "findall", ARM), "only coordinators find"),
        (put(BOX_SUM, 2, "findall", ARM), "only coordinators find"),
        (put(GUIDE_INIT, 3, "agent"), "wrong type"),
        (put(ARM_INIT, 4, "agent"), "only coordinators have proxies"),
        (put(BOX_SUM, 2, "host"), "only coordinators have proxies"),
        (put(GUIDE_INIT, 3, "write_str"), "only resources write"),
        (put(BOX_SUM, 2, "write_int"), "only resources write"),
        (put(ARM_INIT, 11, "hops"), "only coordinators have hops"),
        (put(ARM_INIT, 11, "heartbeat_interval"), "only coordinators have a heartbeat"),
        (put(GUIDE_INIT, 3, "device"), "its own resource"),
        (put(TOOL_SHOW, 2, "device"), "its own resource"),
        (put(ARM_LIFT, 2, "device", 1), "does not exist"),
        (put(ARM_LIFT, 1, "push", ONE), "wrong type"),
        (put(ARM_INIT, 4, "exc_message"), "wrong type"),
        (put(ARM_INIT, 4, "array_len"), "wrong type"),
    ],
)
def test_invalid_groups_of_instructions_are_refused(change: DraftChange, reason: str) -> None:
    refused(change, reason)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (handler(4, 4, 1, EXCEPTION, 4), "not protect a range of whole instructions"),
        (handler(4, 1, 4, EXCEPTION, 4), "not protect a range of whole instructions"),
        (handler(0, 4, 4, EXCEPTION, 4), "not protect a range of whole instructions"),
        (handler(-9, 4, 4, EXCEPTION, 4), "not protect a range of whole instructions"),
        (handler(2, 4, 4, EXCEPTION, 4), "not protect a range of whole instructions"),
        (handler(1, 3, 4, EXCEPTION, 4), "not protect a range of whole instructions"),
        (handler(1, 99, 4, EXCEPTION, 4), "not protect a range of whole instructions"),
        (handler(1, 4, 2, EXCEPTION, 4), "does not exist"),
        (handler(1, 4, 1, EXCEPTION, 4), "in its own range"),
        (handler(1, 4, 0, EXCEPTION, 4), "does not exist"),
        (handler(1, 4, 5, EXCEPTION, 4), "does not exist"),
        (handler(1, 4, 4, 99, 4), "does not exist"),
        (handler(1, 4, 4, -1, 4), "does not exist"),
        (handler(1, 4, 4, EXCEPTION, 3), "does not fit its slot"),
        (handler(1, 4, 4, EXCEPTION, 0), "slot 0"),
        (handler(1, 4, 4, EXCEPTION, 99), "no slot 99"),
    ],
)
def test_invalid_handlers_are_refused(change: DraftChange, reason: str) -> None:
    refused(change, reason)
