"""Loops of resources: the places where the verifier allows them and their instructions."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from program_draft import (
    ARM,
    ARM_LIFT,
    BOX,
    GUIDE,
    NOTHING,
    ONE,
    T_ARM,
    T_BOX,
    T_GUIDE,
    T_OVERFLOW,
    TRUE,
    Draft,
)

from lfield.bytecode.program import INT, VOID, MethodRecord
from lfield.bytecode.verifier import verify
from lfield.errors import ProgramFileError

Change = Callable[[Draft], None]
BODY, TICKS, OTHER = (len(Draft().methods) + n for n in range(3))
_CODE: list[tuple[str, int, int, int]] = [
    ("frame", TICKS, 0, 0),
    ("push", ONE, 0, 0),  # 1
    ("push", ONE, 0, 0),
    ("tick", 0, 0, 0),
    ("pop", 1, 0, 0),  # 4
    ("suppress", OTHER, 0, 0),
    ("control", 0, 0, 0),  # 6
    ("push", 0, 0, 0),
    ("call", BODY, 0, 0),  # 8
    ("push", 2, 0, 0),
    ("tick_failed", 0, 0, 0),  # 10
    ("rtn", 0, 0, 0),
]


def draft_of(change: Change = lambda draft: None) -> Draft:
    draft = Draft()
    for name, kind, slots in (
        ("watch", "loop", (T_ARM,)),
        ("watch", "ticks", (T_ARM, INT, T_OVERFLOW)),
        ("other", "ticks", (T_ARM,)),
    ):
        draft.methods.append(MethodRecord(name, ARM, kind, 0, VOID, slots, 0, 0))
        draft.debug.append(draft.debug[0])
    draft.code += [
        [("frame", BODY, 0, 0), ("rtn", 0, 0, 0)],
        list(_CODE),
        [("frame", OTHER, 0, 0), ("rtn", 0, 0, 0)],
    ]
    change(draft)
    return draft


def put(at: int, *quad: str | int) -> Change:
    return lambda draft: draft.put(TICKS, at, *quad)


def method(index: int, **fields: object) -> Change:
    return lambda draft: draft.change_method(index, **fields)


def test_the_sound_program_is_accepted() -> None:
    verify(draft_of().program())


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (put(1, "push", TRUE), "wrong type"),
        (put(1, "push", NOTHING), "wrong type"),
        (put(4, "pop", 2), "does not fit the slot"),
        (put(5, "suppress", BODY), "only another loop"),
        (put(5, "suppress", ARM_LIFT), "only another loop"),
        (put(5, "suppress", 99), "does not exist"),
        (put(9, "push", ONE), "wrong type"),
        (put(8, "call", OTHER), "only methods and constructors"),
        (method(TICKS, kind="method"), "only loops have ticks"),
        (method(TICKS, kind="loop"), "only loops have ticks"),
        (method(BODY, kind="portal"), "only methods and constructors"),
        (method(OTHER, owner=GUIDE, slots=(T_GUIDE,)), "cannot have a method of kind 'ticks'"),
        (method(OTHER, owner=BOX, slots=(T_BOX,), kind="loop"), "cannot have a method of kind 'loop'"),
        (method(OTHER, slots=(T_ARM, INT), parameters=1), "has parameters"),
        (method(OTHER, synchronized=True), "has parameters or the monitor"),
        (method(BODY, result=INT), "has a result"),
    ],
)
def test_invalid_loops_are_refused(change: Change, reason: str) -> None:
    with pytest.raises(ProgramFileError, match=reason):
        verify(draft_of(change).program())


def test_only_the_thread_of_a_loop_calls_its_body() -> None:
    def change(draft: Draft) -> None:
        draft.code[OTHER][1:1] = [("push", 0, 0, 0), ("call", BODY, 0, 0)]
        draft.change_method(OTHER, kind="method")
        draft.put(TICKS, 5, "suppress", TICKS)

    with pytest.raises(ProgramFileError, match="only methods and constructors"):
        verify(draft_of(change).program())
