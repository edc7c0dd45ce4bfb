"""Parallel work, time limits, reservations, `finally`: a sound program, and each error of the verifier."""

from __future__ import annotations

import re
from collections.abc import Callable

import msgspec
import pytest

from lfield.bytecode.disassembler import disassemble
from lfield.bytecode.encoding import decode, encode
from lfield.bytecode.opcodes import BY_NAME
from lfield.bytecode.program import (
    ARRAY,
    BOOLEAN,
    BUILTIN_CLASSES,
    EXCEPTIONS,
    FINALLY,
    INT,
    LANDING,
    LIMIT,
    OLDEST_BUILTINS,
    REAL,
    RESERVED,
    SUPPRESSED_FIELD,
    TICKET,
    Core,
    FieldRecord,
    MethodRecord,
    Program,
    Quad,
    TypeRecord,
    encode_quads,
)
from lfield.bytecode.verifier import verify
from lfield.bytecode.verifier.record_checks import BUILTIN_RECORDS
from lfield.errors import ProgramFileError
from lfield.testing.golden import compile_text

SOUND = compile_text(
    """
    resource Arm {
      init(string[] arg) { try { yield(); } finally { print("done"); } }
      portal lift(real height) emit real { return height; }
      portal stop() { }
    }
    coordinator Boss {
      init(string[] arg) {
        Arm arm = findArm("arm"); int[] counts = new int[2]; real got; int n = 3;
        within (2.0) {
          together { got = arm.lift(1.0); arm.stop(); sleep(1.0); }
        }
        try { n = n + 1; } catch (Exception e) { n = e.others().length(); } finally { n = n + 2; }
        reserve (new Arm[] {arm}) { arm.stop(); }
      }
    }
    """
)
BOSS, ARM = SOUND.class_index["Boss"], SOUND.class_index["Arm"]
INIT, ARM_INIT = (
    next(i for i, m in enumerate(SOUND.core.methods) if m.owner == c and m.kind == "init")
    for c in (BOSS, ARM)
)
LIFT = next(i for i, m in enumerate(SOUND.core.methods) if m.name == "lift")
TICKETS = SOUND.core.types.index(TypeRecord(TICKET))
NO_DEBUG = msgspec.structs.replace(SOUND.debug, methods=())
_PUSH = BY_NAME["push"].code

Change = Callable[[Core], Core]


def test_encoding_and_decoding_keep_a_program_with_together() -> None:
    assert decode(encode(SOUND)).core == SOUND.core


def refused(change: Change, reason: str) -> None:
    core = change(SOUND.core)
    with pytest.raises(ProgramFileError, match=reason):
        verify(Program(core, NO_DEBUG, b""))


def _quads(change: Callable[[list[Quad]], None]) -> Change:
    def changed(core: Core) -> Core:
        quads = list(SOUND.quads)
        change(quads)
        return msgspec.structs.replace(core, code=encode_quads(quads))

    return changed


def _at(quads: list[Quad], name: str, which: int = 0) -> int:
    return [pc for pc, quad in enumerate(quads) if quad.op == BY_NAME[name].code][which]


def _pushed(name: str, back: int, operand: int, which: int = 0) -> Change:
    """Change the operand of the push `back` instructions before a head."""

    def change(quads: list[Quad]) -> None:
        pc = _at(quads, name, which) - back
        assert quads[pc].op == _PUSH
        quads[pc] = Quad(_PUSH, operand, 0, 0)

    return _quads(change)


def _slot(kind: int, method: int = INIT) -> int:
    return SOUND.core.methods[method].slots.index(kind, 1)


def _method(index: int, **fields: object) -> Change:
    def change(core: Core) -> Core:
        methods = list(core.methods)
        methods[index] = msgspec.structs.replace(methods[index], **fields)
        return msgspec.structs.replace(core, methods=tuple(methods))

    return change


def _slots(index: int, *kinds: int) -> Change:
    return _method(index, slots=(*SOUND.core.methods[index].slots, *kinds))


def _row(first: int, index: int = INIT, **fields: object) -> Change:
    """Change fields of the first row of a kind."""
    rows = list(SOUND.core.methods[index].handlers)
    which = next(i for i, row in enumerate(rows) if row.kind == first)
    rows[which] = msgspec.structs.replace(rows[which], **fields)
    return _method(index, handlers=tuple(rows))


INTS = SOUND.core.types.index(TypeRecord(ARRAY, INT))
REALS = SOUND.core.types.index(TypeRecord(ARRAY, REAL))
NOTHING = -1 - SOUND.core.constants.index(None)
NUMBER = _slot(INT)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        # begin of lift: sentinel, array, index, proxy, height
        (_pushed("begin", 5, NUMBER), "wrong type"),
        (_pushed("begin", 4, _slot(INTS)), "wrong type"),
        (_pushed("begin", 4, NUMBER), "wrong type"),
        (_pushed("begin", 3, _slot(REALS)), "wrong type"),
        (_pushed("begin", 2, _slot(INTS)), "wrong type"),
        (_pushed("begin", 1, NUMBER), "wrong type"),
        # begin of stop: it has no result
        (_pushed("begin", 3, _slot(REALS), 1), "wrong type"),
        (
            _quads(lambda q: q.__setitem__(_at(q, "begin"), Quad(BY_NAME["begin"].code, INIT, 0, 0))),
            "a portal",
        ),
        (_pushed("start", 1, NUMBER), "wrong type"),
        (_pushed("fetch", 1, NUMBER), "wrong type"),
        (_pushed("leave", 2, NUMBER), "wrong type"),
        (_pushed("leave", 1, NUMBER), "wrong type"),
        (_pushed("limit", 1, NUMBER), "wrong type"),
        (_pushed("exc_others", 1, NUMBER), "wrong type"),
        (
            _quads(
                lambda q: q.__setitem__(_at(q, "gather") + 1, Quad(BY_NAME["pop"].code, _slot(INTS), 0, 0))
            ),
            "does not fit the slot",
        ),
        (
            _quads(lambda q: q.__setitem__(_at(q, "yield"), Quad(BY_NAME["gather"].code, 0, 0, 0))),
            "only coordinators work in parallel",
        ),
        (
            _quads(lambda q: q.__setitem__(_at(q, "yield"), Quad(BY_NAME["limit"].code, 0, 0, 0))),
            "only coordinators have a time limit",
        ),
    ],
)
def test_invalid_instructions_of_together_are_refused(change: Change, reason: str) -> None:
    refused(change, reason)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (_pushed("hold", 1, NUMBER), "wrong type"),
        (_pushed("hold", 1, _slot(INTS)), "wrong type"),
        (_pushed("hold", 1, NOTHING), "wrong type"),
        (_pushed("take", 1, _slot(REALS)), "wrong type"),
        (_pushed("drop", 1, NUMBER), "wrong type"),
        (
            _quads(lambda q: q.__setitem__(_at(q, "hold") + 1, Quad(BY_NAME["pop"].code, NUMBER, 0, 0))),
            "does not fit the slot",
        ),
        *(
            (
                _quads(
                    lambda q, name=name: q.__setitem__(_at(q, "yield"), Quad(BY_NAME[name].code, 0, 0, 0))
                ),
                "only coordinators reserve",
            )
            for name in ("hold", "take", "drop")
        ),
    ],
)
def test_invalid_reservations_are_refused(change: Change, reason: str) -> None:
    refused(change, reason)


def test_the_result_of_a_call_may_be_discarded() -> None:
    verify(Program(_pushed("begin", 4, NOTHING)(SOUND.core), SOUND.debug, b""))


def _settled(*operands: int, kind: int = REALS) -> Change:
    """Replace the begin of stop by a settle with these operands."""

    def change(quads: list[Quad]) -> None:
        pc = _at(quads, "begin", 1)
        quads[pc - 4 : pc] = [Quad(_PUSH, operand, 0, 0) for operand in (*operands, 0, 0, 0, 0)[:4]]
        quads[pc] = Quad(BY_NAME["settle"].code, kind, 0, 0)

    return _quads(change)


_SENTINEL, _ARRAY, _REAL = _slot(TICKETS), _slot(REALS), _slot(REAL)


def test_a_settle_is_accepted() -> None:
    for array in (_ARRAY, NOTHING):
        verify(Program(_settled(_SENTINEL, array, NUMBER, _REAL)(SOUND.core), NO_DEBUG, b""))


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (_settled(NUMBER, _ARRAY, NUMBER, _REAL), "wrong type"),
        (_settled(_SENTINEL, _slot(INTS), NUMBER, _REAL), "wrong type"),
        (_settled(_SENTINEL, _ARRAY, _REAL, _REAL), "wrong type"),
        (_settled(_SENTINEL, _ARRAY, NUMBER, NUMBER), "wrong type"),
        (_settled(_SENTINEL, _ARRAY, NUMBER, _REAL, kind=REAL), "an element of an array"),
        (_settled(_SENTINEL, _ARRAY, NUMBER, _REAL, kind=10_000), "does not exist"),
        (
            _quads(lambda q: q.__setitem__(_at(q, "yield"), Quad(BY_NAME["settle"].code, REALS, 0, 0))),
            "only coordinators work in parallel",
        ),
    ],
)
def test_an_invalid_settle_is_refused(change: Change, reason: str) -> None:
    refused(change, reason)


OWN = compile_text(
    """
    class Boom { public int n; public boolean[] parts; public Boom(int n) { this.n = n; } }
    class Plain { public int n; }
    resource R {
      init(string[] arg) { Plain one = new Plain(); try { fail(new Boom(one.n)); } catch (Boom b) { } }
      private void fail(Exception e) { throw e; }
      portal told(Boom boom) { }
    }
    """
)
_BOOM, _PLAIN, _R = (OWN.class_index[name] for name in ("Boom", "Plain", "R"))


def _other_fields(index: int, *fields: FieldRecord) -> Core:
    classes = list(OWN.core.classes)
    classes[index] = msgspec.structs.replace(classes[index], fields=fields)
    return msgspec.structs.replace(OWN.core, classes=tuple(classes))


def test_exception_classes_have_a_field_for_suppressed_exceptions() -> None:
    verify(OWN)
    assert [field.name for field in OWN.core.classes[_BOOM].fields] == ["n", "parts", SUPPRESSED_FIELD]
    assert OWN.others == {**dict.fromkeys(range(len(BUILTIN_CLASSES)), 3), _BOOM: 2}


@pytest.mark.parametrize(
    ("core", "reason"),
    [
        (
            _other_fields(_PLAIN, FieldRecord("n", INT), FieldRecord(SUPPRESSED_FIELD, INT)),
            "no field for suppressed",
        ),
        (_other_fields(_PLAIN, FieldRecord(SUPPRESSED_FIELD, INT)), "no field for suppressed"),
        (_other_fields(_R, FieldRecord(SUPPRESSED_FIELD, EXCEPTIONS)), "no field for suppressed"),
        (
            _other_fields(_PLAIN, FieldRecord(SUPPRESSED_FIELD, EXCEPTIONS), FieldRecord("n", INT)),
            "has the name ''",
        ),
        (
            _other_fields(
                _PLAIN, FieldRecord(SUPPRESSED_FIELD, EXCEPTIONS), FieldRecord(SUPPRESSED_FIELD, EXCEPTIONS)
            ),
            "has the name ''",
        ),
        # Only the machine's own field may have a type that cannot cross a portal.
        (_other_fields(_BOOM, FieldRecord("n", INT), FieldRecord("parts", EXCEPTIONS)), "cannot cross"),
    ],
)
def test_an_invalid_field_for_suppressed_exceptions_is_refused(core: Core, reason: str) -> None:
    with pytest.raises(ProgramFileError, match=reason):
        verify(Program(core, msgspec.structs.replace(OWN.debug, methods=()), b""))


def test_an_older_program_has_no_field_for_suppressed_exceptions() -> None:
    old = _old("R")
    record = msgspec.structs.replace(old.classes[-1], fields=(FieldRecord(SUPPRESSED_FIELD, BOOLEAN),))
    refused(lambda _: msgspec.structs.replace(old, classes=(*old.classes[:-1], record)), "has the name ''")


def _field(core: Core) -> Core:
    classes = list(core.classes)
    classes[BOSS] = msgspec.structs.replace(classes[BOSS], fields=(FieldRecord("a", TICKETS),))
    return msgspec.structs.replace(core, classes=tuple(classes))


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (_slots(ARM_INIT, TICKETS), "a type no variable can have"),
        (_slots(LIFT, TICKETS), "a type no variable can have"),
        (_method(INIT, result=TICKETS), "a result of a type"),
        (_field, "a type no field can have"),
        (
            lambda core: msgspec.structs.replace(core, types=(*core.types, TypeRecord(ARRAY, TICKETS))),
            "not an earlier type of values",
        ),
        (
            lambda core: msgspec.structs.replace(core, types=(*core.types, TypeRecord(TICKET, 1))),
            "unknown kind",
        ),
    ],
)
def test_tickets_are_only_in_slots_of_coordinators(change: Change, reason: str) -> None:
    refused(change, reason)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (_row(LIMIT, kind=9), "no handlers of kind 9"),
        (_row(LIMIT, kind=-1), "no handlers of kind -1"),
        (_row(LIMIT, target=SOUND.core.methods[INIT].end - 1), "has a target"),
        (_row(LIMIT, catches=1), "has a target"),
        (_row(LIMIT, slot=_slot(TICKETS)), "not an int"),
        (_row(LIMIT, slot=999), "no slot 999"),
        (_row(LIMIT, slot=0), "slot 0 cannot be written"),
        (_row(LIMIT, end=SOUND.core.methods[INIT].end + 1), "not protect a range of whole instructions"),
        (_row(LANDING, slot=1), "has a target"),
        (_row(LANDING, target=1), "has a target"),
        (_row(FINALLY, catches=1), "names a class"),
        (_row(FINALLY, target=0), "does not exist"),
        (_row(FINALLY, slot=NUMBER), "does not fit its slot"),
        (_row(LANDING, ARM_INIT, kind=LIMIT), "only coordinators have a time limit"),
        (_row(LANDING, ARM_INIT, kind=RESERVED), "only coordinators have a time limit, or reserve"),
        (_row(RESERVED, slot=NUMBER), "reserve are not an int"),
        (_row(RESERVED, slot=_slot(REALS)), "reserve are not an int"),
        (_row(RESERVED, slot=0), "slot 0 cannot be written"),
        (_row(RESERVED, target=SOUND.core.methods[INIT].end - 1), "has a target"),
        (_row(RESERVED, catches=1), "has a target"),
    ],
)
def test_invalid_handler_rows_are_refused(change: Change, reason: str) -> None:
    refused(change, reason)


def test_a_listing_shows_the_kinds_of_rows() -> None:
    text = disassemble(SOUND)
    for words in (
        r"finally \^\d+ at L\d+",
        r"\d landing$",
        r"limit \^\d+$",
        r"reserved \^\d+$",
        r"catch Exception",
        r"\^\d+ +ticket$",
    ):
        assert re.search(words, text, re.MULTILINE), words


# --- programs of lfield 0.3 ---------------------------------------------------------------------------


def _old(name: str) -> Core:
    """The core of a program with one resource of that name, as lfield 0.3 compiled it."""
    classes = [
        msgspec.structs.replace(record, fields=record.fields[:3])
        for record in BUILTIN_RECORDS[:OLDEST_BUILTINS]
    ]
    made = compile_text("resource R { init(string[] arg) { } }")
    own = made.core.classes[-1]
    types = [TypeRecord(t.kind, OLDEST_BUILTINS) if t.kind == 9 else t for t in made.core.types]
    del types[EXCEPTIONS]
    kinds = {
        t: types.index(TypeRecord(9, OLDEST_BUILTINS) if made.core.types[t].kind == 9 else made.core.types[t])
        for t in made.core.methods[0].slots
    }
    method: MethodRecord = msgspec.structs.replace(
        made.core.methods[0], owner=OLDEST_BUILTINS, slots=tuple(kinds[t] for t in made.core.methods[0].slots)
    )
    return msgspec.structs.replace(
        made.core,
        types=tuple(types),
        classes=(*classes, msgspec.structs.replace(own, name=name)),
        methods=(method,),
    )


@pytest.mark.parametrize("name", ["R", *BUILTIN_CLASSES[OLDEST_BUILTINS:]])
def test_an_older_program_may_define_classes_named_as_newer_exceptions(name: str) -> None:
    program = Program(_old(name), NO_DEBUG, b"")
    verify(program)
    assert program.builtins == OLDEST_BUILTINS
    assert program.units == {name: "resource"}


def test_built_in_classes_of_two_versions_are_not_mixed() -> None:
    old = _old("R")
    mixed = (old.classes[0], *BUILTIN_RECORDS[1:OLDEST_BUILTINS], *old.classes[OLDEST_BUILTINS:])
    refused(lambda core: msgspec.structs.replace(old, classes=mixed), "built-in exceptions")
    refused(lambda core: msgspec.structs.replace(core, types=core.types[:EXCEPTIONS]), "first types")


def test_new_instructions_need_the_new_exceptions() -> None:
    core = _old("R")
    for name in ("exc_others", "gather", "begin", "start", "fetch", "leave", "limit", "settle"):
        quads = [Quad(BY_NAME[word].code, 0, 0, 0) for word in ("frame", name, "rtn")]
        method = msgspec.structs.replace(core.methods[0], end=3)
        changed = msgspec.structs.replace(core, methods=(method,), code=encode_quads(quads))
        refused(lambda _, changed=changed: changed, f"{name} needs exceptions")
