"""Growable arrays: the verifier refuses a sound program with one change that makes it unsound."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from program_draft import (
    ARM_INIT,
    BOX,
    BOX_SUM,
    GUIDE_INIT,
    HALF,
    NOTHING,
    ONE,
    T_BOX,
    T_INTS,
    T_PROXIES,
    T_STRINGS,
    TRUE,
    Draft,
)

from lfield.bytecode.program import ANY, BOOLEAN, GROWABLE, INT, TypeRecord
from lfield.bytecode.verifier import verify
from lfield.errors import ProgramFileError

Change = Callable[[Draft], object]
#: The type of the growable array.
GROWING = len(Draft().types)
#: The instructions, with their positions.
_CODE: list[tuple[str, int, int, int]] = [
    ("frame", BOX_SUM, 0, 0),
    ("newarray", 4, GROWING, ONE),  # 1
    ("push", 4, 0, 0),
    ("push", 1, 0, 0),
    ("append", GROWING, 0, 0),  # 4
    ("push", 4, 0, 0),  # 5
    ("push", ONE, 0, 0),
    ("push", ONE, 0, 0),
    ("insert", GROWING, 0, 0),  # 8
    ("push", 4, 0, 0),  # 9
    ("push", 1, 0, 0),
    ("remove", GROWING, 0, 0),  # 11
    ("pop", 2, 0, 0),
    ("push", 4, 0, 0),  # 13
    ("remove_last", GROWING, 0, 0),
    ("pop", 2, 0, 0),
    ("gete", 2, 4, ONE),  # 16
    ("pute", 4, 2, ONE),
    ("push", 4, 0, 0),  # 18
    ("array_len", 0, 0, 0),
    ("pop", 2, 0, 0),
    ("return", 2, 0, 0),  # 21
]


def draft_of(change: Change = lambda draft: None) -> Draft:
    draft = Draft()
    draft.types.append(TypeRecord(GROWABLE, T_INTS))
    draft.change_method(BOX_SUM, slots=(T_BOX, INT, INT, BOOLEAN, GROWING, T_BOX, ANY))
    draft.code[BOX_SUM] = list(_CODE)
    change(draft)
    return draft


def put(at: int, *quad: str | int) -> Change:
    return lambda draft: draft.put(BOX_SUM, at, *quad)


def test_the_sound_program_is_accepted() -> None:
    verify(draft_of().program())


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda d: d.types.append(TypeRecord(GROWABLE, T_INTS)), "twice"),
        (lambda d: d.types.append(TypeRecord(GROWABLE, GROWING)), "in no array"),
        (lambda d: d.types.append(TypeRecord(GROWABLE, INT)), "in no array"),
        (lambda d: d.types.append(TypeRecord(GROWABLE, -1)), "in no array"),
        (lambda d: d.types.append(TypeRecord(GROWABLE, 99)), "in no array"),
        (put(1, "newarray", 4, T_INTS, ONE), "not that of the slot"),
        (put(4, "append", T_INTS), "changes its length"),
        (put(4, "append", T_BOX), "changes its length"),
        (put(4, "append", 99), "does not exist"),
        (put(2, "push", NOTHING), ""),
        (put(2, "push", ONE), "wrong type"),
        (put(3, "push", TRUE), "wrong type"),
        (put(3, "push", NOTHING), "wrong type"),
        (put(4, "insert", GROWING), "2 values are pushed, 3 expected"),
        (put(6, "push", HALF), "wrong type"),
        (put(7, "push", HALF), "wrong type"),
        (put(8, "append", GROWING), "3 values are pushed, 2 expected"),
        (put(10, "push", TRUE), "wrong type"),
        (put(12, "pop", 3), "does not fit the slot"),
        (put(14, "append", GROWING), "1 values are pushed, 2 expected"),
        (put(15, "pop", 5), "does not fit the slot"),
        (put(16, "gete", 3, 4, ONE), "element does not fit"),
        (put(17, "pute", 4, 2, TRUE), "does not fit the element"),
    ],
)
def test_invalid_uses_of_growable_arrays_are_refused(change: Change, reason: str) -> None:
    draft = draft_of(change)
    if not reason:  # The verifier accepts null for every type; the engines throw the exception.
        verify(draft.program())
        return
    with pytest.raises(ProgramFileError, match=reason):
        verify(draft.program())


def test_an_init_may_take_a_growable_array() -> None:
    def change(draft: Draft) -> None:
        draft.types.append(TypeRecord(GROWABLE, T_STRINGS))
        method = draft.methods[ARM_INIT]
        slots = [len(draft.types) - 1 if kind == T_STRINGS else kind for kind in method.slots]
        draft.change_method(ARM_INIT, slots=tuple(slots))

    verify(draft_of(change).program())


def test_findall_returns_a_growable_array_if_the_program_has_that_type() -> None:
    def with_type(draft: Draft) -> None:
        draft.types.append(TypeRecord(GROWABLE, T_PROXIES))

    with pytest.raises(ProgramFileError, match="does not fit the slot"):
        verify(draft_of(with_type).program())

    def with_type_and_slot(draft: Draft) -> None:
        with_type(draft)
        method = draft.methods[GUIDE_INIT]
        slots = [len(draft.types) - 1 if kind == T_PROXIES else kind for kind in method.slots]
        draft.change_method(GUIDE_INIT, slots=tuple(slots))

    verify(draft_of(with_type_and_slot).program())


@pytest.mark.parametrize("name", ["map<string, int>", "map<int, map<string, Box[]>>"])
def test_a_class_may_be_named_as_a_map_type(name: str) -> None:
    draft = draft_of()
    draft.change_class(BOX, name=name)
    verify(draft.program())


@pytest.mark.parametrize(
    "name", ["map<>", "map<string\x1b, int>", "list<int>", "map<a;b>", "map<int, int>\n"]
)
def test_other_generic_class_names_are_refused(name: str) -> None:
    draft = draft_of()
    draft.change_class(BOX, name=name)
    with pytest.raises(ProgramFileError, match="not an identifier"):
        verify(draft.program())
