"""Parallel work, time limits, reservations, `finally`: each error in a sound program is refused."""

from __future__ import annotations

import re

import msgspec
import pytest
from core_changes import Change, SoundCode, change_class, change_method, position

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
CODE = SoundCode(SOUND)
_PUSH = BY_NAME["push"].code


def test_encoding_and_decoding_keep_a_program_with_together() -> None:
    assert decode(encode(SOUND)).core == SOUND.core


def _slot(kind: int, method: int = INIT) -> int:
    return SOUND.core.methods[method].slots.index(kind, 1)


def _slots(index: int, *kinds: int) -> Change:
    return change_method(index, slots=(*SOUND.core.methods[index].slots, *kinds))


def _row(first: int, index: int = INIT, **fields: object) -> Change:
    """Change fields of the first row of a kind."""
    rows = list(SOUND.core.methods[index].handlers)
    which = next(i for i, row in enumerate(rows) if row.kind == first)
    rows[which] = msgspec.structs.replace(rows[which], **fields)
    return change_method(index, handlers=tuple(rows))


INTS = SOUND.core.types.index(TypeRecord(ARRAY, INT))
REALS = SOUND.core.types.index(TypeRecord(ARRAY, REAL))
NOTHING = -1 - SOUND.core.constants.index(None)
NUMBER = _slot(INT)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        # begin of lift: sentinel, array, index, proxy, height
        (CODE.push("begin", 5, NUMBER), "wrong type"),
        (CODE.push("begin", 4, _slot(INTS)), "wrong type"),
        (CODE.push("begin", 4, NUMBER), "wrong type"),
        (CODE.push("begin", 3, _slot(REALS)), "wrong type"),
        (CODE.push("begin", 2, _slot(INTS)), "wrong type"),
        (CODE.push("begin", 1, NUMBER), "wrong type"),
        # begin of stop, which has no result
        (CODE.push("begin", 3, _slot(REALS), 1), "wrong type"),
        (
            CODE.put("begin", "begin", INIT),
            "a portal",
        ),
        (CODE.push("start", 1, NUMBER), "wrong type"),
        (CODE.push("fetch", 1, NUMBER), "wrong type"),
        (CODE.push("leave", 2, NUMBER), "wrong type"),
        (CODE.push("leave", 1, NUMBER), "wrong type"),
        (CODE.push("limit", 1, NUMBER), "wrong type"),
        (CODE.push("exc_others", 1, NUMBER), "wrong type"),
        (
            CODE.put("gather", "pop", _slot(INTS), after=1),
            "does not fit the slot",
        ),
        (
            CODE.put("yield", "gather"),
            "only coordinators work in parallel",
        ),
        (
            CODE.put("yield", "limit"),
            "only coordinators have a time limit",
        ),
    ],
)
def test_invalid_instructions_of_together_are_refused(change: Change, reason: str) -> None:
    CODE.refused(change, reason)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (CODE.push("hold", 1, NUMBER), "wrong type"),
        (CODE.push("hold", 1, _slot(INTS)), "wrong type"),
        (CODE.push("hold", 1, NOTHING), "wrong type"),
        (CODE.push("take", 1, _slot(REALS)), "wrong type"),
        (CODE.push("drop", 1, NUMBER), "wrong type"),
        (
            CODE.put("hold", "pop", NUMBER, after=1),
            "does not fit the slot",
        ),
        *(
            (
                CODE.put("yield", name),
                "only coordinators reserve",
            )
            for name in ("hold", "take", "drop")
        ),
    ],
)
def test_invalid_reservations_are_refused(change: Change, reason: str) -> None:
    CODE.refused(change, reason)


def test_the_result_of_a_call_may_be_discarded() -> None:
    CODE.accepted(CODE.push("begin", 4, NOTHING))


def _settled(*operands: int, kind: int = REALS) -> Change:
    """Replace the begin of stop by a settle with these operands."""

    def change(quads: list[Quad]) -> None:
        pc = position(quads, "begin", 1)
        quads[pc - 4 : pc] = [Quad(_PUSH, operand, 0, 0) for operand in (*operands, 0, 0, 0, 0)[:4]]
        quads[pc] = Quad(BY_NAME["settle"].code, kind, 0, 0)

    return CODE.change(change)


_SENTINEL, _ARRAY, _REAL = _slot(TICKETS), _slot(REALS), _slot(REAL)


def test_a_settle_is_accepted() -> None:
    for array in (_ARRAY, NOTHING):
        CODE.accepted(_settled(_SENTINEL, array, NUMBER, _REAL))


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
            CODE.put("yield", "settle", REALS),
            "only coordinators work in parallel",
        ),
    ],
)
def test_an_invalid_settle_is_refused(change: Change, reason: str) -> None:
    CODE.refused(change, reason)


OWN = compile_text(
    """
    class Boom { public int n; public boolean[] parts; public Boom(int n) { this.n = n; } }
    class Plain { public int n; }
    resource R {
      init(string[] arg) { Plain one = new Plain(); try { fail(new Boom(one.n)); } catch (Boom b) { } }
      private void fail(Exception e) { throw e; }
      portal report(Boom boom) { }
    }
    """
)
_BOOM, _PLAIN, _R = (OWN.class_index[name] for name in ("Boom", "Plain", "R"))


def _other_fields(index: int, *fields: FieldRecord) -> Change:
    return change_class(index, fields=fields)


def test_exception_classes_have_a_field_for_suppressed_exceptions() -> None:
    verify(OWN)
    assert [field.name for field in OWN.core.classes[_BOOM].fields] == ["n", "parts", SUPPRESSED_FIELD]
    assert OWN.others == {**dict.fromkeys(range(len(BUILTIN_CLASSES)), 3), _BOOM: 2}


@pytest.mark.parametrize(
    ("change", "reason"),
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
def test_an_invalid_field_for_suppressed_exceptions_is_refused(change: Change, reason: str) -> None:
    SoundCode(OWN).refused(change, reason)


def test_an_older_program_has_no_field_for_suppressed_exceptions() -> None:
    old = _old("R")
    record = msgspec.structs.replace(old.classes[-1], fields=(FieldRecord(SUPPRESSED_FIELD, BOOLEAN),))
    CODE.refused(
        lambda _: msgspec.structs.replace(old, classes=(*old.classes[:-1], record)), "has the name ''"
    )


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (_slots(ARM_INIT, TICKETS), "a type no variable can have"),
        (_slots(LIFT, TICKETS), "a type no variable can have"),
        (change_method(INIT, result=TICKETS), "a result of a type"),
        (change_class(BOSS, fields=(FieldRecord("a", TICKETS),)), "a type no field can have"),
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
    CODE.refused(change, reason)


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
    CODE.refused(change, reason)


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
    program = compile_text("resource R { init(string[] arg) { } }")
    own = program.core.classes[-1]
    types = [TypeRecord(t.kind, OLDEST_BUILTINS) if t.kind == 9 else t for t in program.core.types]
    del types[EXCEPTIONS]
    kinds = {
        t: types.index(
            TypeRecord(9, OLDEST_BUILTINS) if program.core.types[t].kind == 9 else program.core.types[t]
        )
        for t in program.core.methods[0].slots
    }
    method: MethodRecord = msgspec.structs.replace(
        program.core.methods[0],
        owner=OLDEST_BUILTINS,
        slots=tuple(kinds[t] for t in program.core.methods[0].slots),
    )
    return msgspec.structs.replace(
        program.core,
        types=tuple(types),
        classes=(*classes, msgspec.structs.replace(own, name=name)),
        methods=(method,),
    )


@pytest.mark.parametrize("name", ["R", *BUILTIN_CLASSES[OLDEST_BUILTINS:]])
def test_an_older_program_may_define_classes_named_as_newer_exceptions(name: str) -> None:
    program = Program(_old(name), CODE.debug, b"")
    verify(program)
    assert program.builtins == OLDEST_BUILTINS
    assert program.units == {name: "resource"}


def test_built_in_classes_of_two_versions_are_not_mixed() -> None:
    old = _old("R")
    mixed = (old.classes[0], *BUILTIN_RECORDS[1:OLDEST_BUILTINS], *old.classes[OLDEST_BUILTINS:])
    CODE.refused(lambda core: msgspec.structs.replace(old, classes=mixed), "built-in exceptions")
    CODE.refused(lambda core: msgspec.structs.replace(core, types=core.types[:EXCEPTIONS]), "first types")


def test_new_instructions_need_the_new_exceptions() -> None:
    core = _old("R")
    for name in ("exc_others", "gather", "begin", "start", "fetch", "leave", "limit", "settle"):
        quads = [Quad(BY_NAME[word].code, 0, 0, 0) for word in ("frame", name, "rtn")]
        method = msgspec.structs.replace(core.methods[0], end=3)
        changed = msgspec.structs.replace(core, methods=(method,), code=encode_quads(quads))
        CODE.refused(lambda _, changed=changed: changed, f"{name} needs exceptions")
