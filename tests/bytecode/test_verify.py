"""Every error of the verifier: a sound program with one change that makes it unsound."""

from __future__ import annotations

import msgspec
import pytest
from program_draft import (
    ARITHMETIC,
    ARM,
    ARM_INIT,
    ARM_LIFT,
    BOX,
    BOX_NEW,
    BOX_SUM,
    EXCEPTION,
    GUIDE,
    GUIDE_INIT,
    NOTHING,
    T_ARM,
    T_BOX,
    T_INTS,
    T_PROXIES,
    T_PROXY,
    T_STRINGS,
    T_TOOL,
    TOOL,
    TOOL_SHOW,
    TRUE,
    Draft,
    DraftChange,
    handler,
    put,
    refused,
)

from lfield.bytecode.opcodes import TABLE
from lfield.bytecode.program import (
    ANY,
    ARRAY,
    BOOLEAN,
    BUILTIN_CLASSES,
    BUILTIN_PARENTS,
    DEVICE,
    HELD_DEVICE,
    INT,
    NULL,
    OBJECT,
    PROXY,
    REAL,
    STRING,
    VOID,
    Core,
    DeviceCallRecord,
    DeviceField,
    FieldRecord,
    Handler,
    MethodDebug,
    TypeRecord,
)
from lfield.bytecode.verifier import verify
from lfield.errors import ProgramFileError
from lfield.lang.types import BUILTIN_EXCEPTIONS


def _without_init(draft: Draft, named: int) -> None:
    draft.change_method(GUIDE_INIT, kind="method")
    draft.change_class(GUIDE, init=named)


def test_the_sound_program_is_accepted() -> None:
    verify(Draft().program())


def test_a_program_without_debug_information_is_accepted() -> None:
    draft = Draft()
    draft.debug = []
    verify(draft.program())


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda d: d.types.pop(0), "first types"),
        (lambda d: d.types.append(TypeRecord(ARRAY, STRING)), "twice"),
        (lambda d: d.types.append(TypeRecord(ARRAY, len(d.types))), "earlier type"),
        (lambda d: d.types.append(TypeRecord(ARRAY, -1)), "earlier type"),
        (lambda d: d.types.append(TypeRecord(ARRAY, VOID)), "earlier type"),
        (lambda d: d.types.append(TypeRecord(ARRAY, NULL)), "earlier type"),
        (lambda d: d.types.append(TypeRecord(ARRAY, DEVICE)), "earlier type"),
        (lambda d: d.types.append(TypeRecord(ARRAY, T_ARM)), "earlier type"),
        (lambda d: d.types.append(TypeRecord(OBJECT, 99)), "of class 99"),
        (lambda d: d.types.append(TypeRecord(PROXY, -1)), "of class -1"),
        (lambda d: d.types.append(TypeRecord(PROXY, BOX)), "not a resource"),
        (lambda d: d.types.append(TypeRecord(PROXY, GUIDE)), "not a resource"),
        (lambda d: d.types.append(TypeRecord(17, 0)), "unknown kind 17"),
        (lambda d: d.types.append(TypeRecord(INT, 1)), "has no members"),
    ],
)
def test_invalid_types_are_refused(change: DraftChange, reason: str) -> None:
    refused(change, reason)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda d: d.change_class(0, name="Other"), "built-in exceptions"),
        (lambda d: d.change_class(3, fields=()), "built-in exceptions"),
        (lambda d: d.change_class(3, usage="resource"), "built-in exceptions"),
        (lambda d: d.change_class(TOOL, name="Box"), "same name"),
        (lambda d: d.change_class(BOX, name="x\x1b[2J"), "not an identifier"),
        (lambda d: d.change_class(BOX, kind="interface"), "unknown kind"),
        (lambda d: d.change_class(BOX, usage="thread"), "unknown kind"),
        (lambda d: d.change_class(TOOL, fields=(FieldRecord("a b", INT),)), "has the name"),
        (lambda d: d.change_class(TOOL, fields=(FieldRecord("a", 99),)), "no field can have"),
        (lambda d: d.change_class(TOOL, fields=(FieldRecord("a", VOID),)), "no field can have"),
        (lambda d: d.change_class(TOOL, fields=(FieldRecord("a", NULL),)), "no field can have"),
        (lambda d: d.change_class(TOOL, fields=(FieldRecord("a", T_ARM),)), "no field can have"),
        (lambda d: d.change_class(ARM, devices=()), "device fields"),
        (lambda d: d.change_class(ARM, devices=(DeviceField("foot", "Gripper"),)), "device fields"),
        (
            lambda d: d.change_class(
                TOOL, fields=(FieldRecord("a", DEVICE),), devices=(DeviceField("a", "Gripper"),)
            ),
            "not its device fields",
        ),
        (lambda d: d.change_class(BOX, init=BOX_SUM), "has an init"),
        (lambda d: d.change_class(GUIDE, init=-1), "not the init that its class names"),
        (lambda d: d.change_class(GUIDE, init=99), "not the init that its class names"),
        (lambda d: d.change_class(GUIDE, init=ARM_INIT), "not the init that its class names"),
        (lambda d: _without_init(d, -1), "Guide has no init"),
        (lambda d: _without_init(d, 99), "Guide has no init"),
        (lambda d: _without_init(d, BOX_SUM), "Guide has no init"),
    ],
)
def test_invalid_classes_are_refused(change: DraftChange, reason: str) -> None:
    refused(change, reason)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda d: d.constants.append(1 << 63), "beyond 64 bits"),
        (lambda d: d.constants.append(-(1 << 63) - 1), "beyond 64 bits"),
        (lambda d: d.change_device_call(owner=99), "does not have"),
        (lambda d: d.change_device_call(owner=-1), "does not have"),
        (lambda d: d.change_device_call(owner=BOX), "does not have"),
        (lambda d: d.change_device_call(field="foot"), "does not have"),
        (lambda d: d.change_device_call(device="Wheel"), "does not have"),
        (lambda d: d.change_device_call(effect="explode"), "unknown effect"),
        (lambda d: d.change_device_call(parameters=(T_BOX,)), "drivers do not support"),
        (lambda d: d.change_device_call(parameters=(VOID,)), "drivers do not support"),
        (lambda d: d.change_device_call(parameters=(99,)), "drivers do not support"),
        (lambda d: d.change_device_call(result=T_STRINGS), "drivers do not support"),
        (lambda d: d.change_device_call(result=-3), "drivers do not support"),
    ],
)
def test_invalid_constants_and_device_calls_are_refused(change: DraftChange, reason: str) -> None:
    refused(change, reason)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda d: d.change_method(BOX_NEW, owner=99), "no class of the program"),
        (lambda d: d.change_method(BOX_NEW, owner=3), "no class of the program"),
        (lambda d: d.change_method(BOX_NEW, name="f\x07"), "not an identifier"),
        (lambda d: d.change_method(BOX_NEW, kind="portal"), "method of kind 'portal'"),
        (lambda d: d.change_method(BOX_NEW, kind="init"), "method of kind 'init'"),
        (lambda d: d.change_method(ARM_LIFT, kind="constructor"), "method of kind 'constructor'"),
        (lambda d: d.change_method(BOX_NEW, kind="macro"), "method of kind 'macro'"),
        (lambda d: d.change_method(BOX_NEW, parameters=2), "slots and 2 parameters"),
        (lambda d: d.change_method(BOX_NEW, parameters=-1), "-1 parameters"),
        (lambda d: d.change_method(BOX_NEW, slots=()), "0 slots"),
        (lambda d: d.change_method(BOX_NEW, slots=(T_BOX,) + (INT,) * 4096), "4097 slots"),
        (lambda d: d.change_method(BOX_NEW, slots=(T_BOX, 99)), "does not exist"),
        (lambda d: d.change_method(BOX_NEW, slots=(T_BOX, -1)), "does not exist"),
        (lambda d: d.change_method(BOX_SUM, result=99), "does not exist"),
        (lambda d: d.change_method(BOX_NEW, slots=(T_TOOL, INT)), "slot 0"),
        (lambda d: d.change_method(BOX_NEW, slots=(T_BOX, VOID)), "no variable"),
        (lambda d: d.change_method(BOX_NEW, slots=(T_BOX, NULL)), "no variable"),
        (lambda d: d.change_method(BOX_NEW, slots=(T_BOX, DEVICE)), "no variable"),
        (lambda d: d.change_method(BOX_NEW, slots=(T_BOX, T_ARM)), "no variable"),
        (lambda d: d.change_method(BOX_SUM, result=NULL), "no value can have"),
        (lambda d: d.change_method(BOX_NEW, result=INT), "constructor and has a result"),
        (lambda d: d.change_method(GUIDE_INIT, parameters=0), "string"),
        (lambda d: d.change_method(GUIDE_INIT, slots=(T_ARM, T_STRINGS), owner=ARM), "init that its class"),
        (lambda d: d.change_method(ARM_INIT, slots=(T_ARM, T_INTS, STRING, T_TOOL)), "string"),
        (lambda d: d.change_method(ARM_INIT, result=INT), "string"),
    ],
)
def test_invalid_method_records_are_refused(change: DraftChange, reason: str) -> None:
    refused(change, reason)


def _lift_parameter(kind: int) -> DraftChange:
    return lambda d: d.change_method(ARM_LIFT, slots=(T_ARM, kind, REAL, INT, ANY))


@pytest.mark.parametrize(
    "change",
    [
        _lift_parameter(T_PROXY),
        _lift_parameter(T_PROXIES),
        _lift_parameter(T_TOOL),
        _lift_parameter(ANY),
        lambda d: d.change_method(ARM_LIFT, result=T_PROXY),
        lambda d: d.change_class(BOX, fields=(FieldRecord("value", INT), FieldRecord("next", T_PROXIES))),
        lambda d: d.change_class(BOX, fields=(FieldRecord("value", INT), FieldRecord("next", ANY))),
        lambda d: d.change_class(BOX, usage="coordinator"),
    ],
)
def test_types_of_one_kind_of_agent_cannot_cross_a_portal(change: DraftChange) -> None:
    refused(change, "cannot cross")


def _with_core(**fields: object) -> DraftChange:
    def change(draft: Draft) -> None:
        core = draft.core()
        changed_core = Core(*(fields.get(f, getattr(core, f)) for f in Core.__struct_fields__))
        draft.core = lambda: changed_core  # type: ignore[method-assign]  # only this draft

    return change


def _with_method(index: int, **fields: int) -> DraftChange:
    def change(draft: Draft) -> None:
        core = draft.core()
        methods = [*core.methods]
        methods[index] = msgspec.structs.replace(methods[index], **fields)
        _with_core(methods=tuple(methods))(draft)

    return change


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (_with_method(0, entry=1), "gap or an overlap"),
        (_with_method(0, end=0), "gap or an overlap"),
        (_with_method(0, end=-1), "gap or an overlap"),
        (_with_method(0, end=4), "gap or an overlap"),
        (_with_method(6, end=1 << 40), "longer or shorter"),
        (_with_core(code=b""), "longer or shorter"),
        (lambda d: _with_core(code=d.core().code + b"\0" * 16)(d), "longer or shorter"),
        (lambda d: _with_core(code=d.core().code[:-1])(d), "longer or shorter"),
    ],
)
def test_methods_must_cover_the_code(change: DraftChange, reason: str) -> None:
    refused(change, reason)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda d: d.debug.pop(), "does not match its methods"),
        (lambda d: d.sources.pop(), "has no source file"),
        (lambda d: d.debug.__setitem__(0, MethodDebug(-1, (), (), "")), "has no source file"),
        (lambda d: d.debug.__setitem__(0, MethodDebug(0, ((2, 1), (1, 1)), (), "")), "out of order"),
        (lambda d: d.debug.__setitem__(0, MethodDebug(0, ((99, 1),), (), "")), "out of order"),
        (lambda d: d.debug.__setitem__(1, MethodDebug(0, ((-1, 1),), (), "")), "out of order"),
        (lambda d: d.debug.__setitem__(0, MethodDebug(0, ((0, 0),), (), "")), "out of order"),
        (lambda d: d.debug.__setitem__(0, MethodDebug(0, (), ((2, "x"),), "")), "slot that does not exist"),
    ],
)
def test_invalid_debug_information_is_refused(change: DraftChange, reason: str) -> None:
    refused(change, reason)


def test_a_handler_may_catch_a_class_of_the_program() -> None:
    draft = Draft()
    handler(1, 4, 4, BOX, 1)(draft)
    verify(draft.program())


def test_a_handler_of_exception_needs_a_slot_for_any_object() -> None:
    handler = (Handler(1, 3, 4, EXCEPTION, 2),)
    refused(lambda d: d.change_method(TOOL_SHOW, handlers=handler), "does not fit its slot")
    unrelated = (Handler(1, 3, 4, ARITHMETIC + 1, 2),)
    refused(lambda d: d.change_method(TOOL_SHOW, handlers=unrelated), "does not fit its slot")


def test_a_handler_cannot_catch_an_agent() -> None:
    refused(handler(1, 4, 4, ARM, 4), "catches something that is not a class")


def test_an_error_has_the_method_and_the_instruction() -> None:
    draft = Draft()
    draft.put(BOX_SUM, 2, "move", 2, TRUE)
    with pytest.raises(ProgramFileError) as error:
        verify(draft.program())
    assert (error.value.method, error.value.pc) == ("sum", 5)


def test_null_fits_references_and_objects_fit_any() -> None:
    draft = Draft()
    draft.put(BOX_SUM, 2, "move", 4, NOTHING)
    draft.put(BOX_SUM, 6, "move", 6, 5)
    draft.put(BOX_SUM, 10, "eqnull", 3, NOTHING)
    verify(draft.program())


def _with_device(method: int) -> Draft:
    """A draft with a device field in class Tool, and a slot for a device in a method."""
    draft = Draft()
    draft.change_class(TOOL, fields=(FieldRecord("grip", DEVICE),))
    draft.change_method(method, slots=(*draft.methods[method].slots, DEVICE))
    return draft


def test_a_resource_specific_class_may_have_a_device() -> None:
    draft = _with_device(TOOL_SHOW)
    draft.put(TOOL_SHOW, 3, "getf", 3, 0, 0)
    verify(draft.program())
    draft.put(TOOL_SHOW, 3, "putf", 0, 0, 3)
    verify(draft.program())
    draft.device_calls.append(DeviceCallRecord(TOOL, HELD_DEVICE, "Gripper", "grip", (), VOID, "actuate"))
    draft.code[TOOL_SHOW][1:3] = [("push", 3, 0, 0), ("device", 1, 0, 0)]
    verify(draft.program())


def test_a_device_cannot_leave_its_resource() -> None:
    for change, reason in [
        (
            lambda d: d.change_class(BOX, fields=(FieldRecord("a", DEVICE),)),
            "Box has a device",
        ),
        (lambda d: d.change_method(BOX_NEW, slots=(T_BOX, INT, DEVICE)), "a type no variable can have"),
        (
            lambda d: d.change_method(GUIDE_INIT, slots=(*d.methods[GUIDE_INIT].slots, DEVICE)),
            "no variable can",
        ),
        (lambda d: d.change_device_call(owner=BOX, field=HELD_DEVICE), "of a class without resource"),
        (lambda d: d.change_device_call(owner=GUIDE, field=HELD_DEVICE), "of a class without resource"),
        (lambda d: d.change_device_call(owner=99, field=HELD_DEVICE), "of a class without resource"),
        (
            lambda d: d.change_device_call(owner=ARM, field=HELD_DEVICE),
            "1 values are pushed, 2 expected",
        ),
        (put(ARM_INIT, 2, "putf", 0, 1, 4), "does not fit the field"),
        (put(ARM_INIT, 2, "move", 4, NOTHING), "does not fit the slot"),
        (put(ARM_INIT, 2, "eqnull", 4, 4), "wrong type"),
    ]:
        draft = _with_device(ARM_INIT)
        change(draft)
        with pytest.raises(ProgramFileError, match=reason):
            verify(draft.program())


def _proxy_compared_with(operand: int) -> Draft:
    draft = Draft()
    draft.change_method(GUIDE_INIT, slots=(*draft.methods[GUIDE_INIT].slots, BOOLEAN))
    draft.put(GUIDE_INIT, 18, "eqr", 7, 2, operand)
    return draft


def test_a_proxy_is_compared_only_with_proxies() -> None:
    for operand in (2, NOTHING):
        verify(_proxy_compared_with(operand).program())
    for operand in (3, 4, 6):
        with pytest.raises(ProgramFileError, match="a proxy is compared with something else"):
            verify(_proxy_compared_with(operand).program())


def test_the_instruction_table_is_consistent() -> None:
    """At most three operands, known kinds, and one number and name per row."""
    kinds = {"boolean", "int", "real", "string", "object", "array", "ref", "same", "any", ""}
    assert len({row.code for row in TABLE}) == len({row.name for row in TABLE}) == len(TABLE)
    for row in TABLE:
        assert len(row.operands) <= 3
        assert {operand.kind for operand in row.operands} <= kinds
        assert {operand.role for operand in row.operands} <= set("DSVLCTMFKI")
        assert {*(row.argument_kinds or ()), row.result_kind} <= kinds
    assert BUILTIN_CLASSES[EXCEPTION] == "Exception"


def test_language_and_bytecode_have_the_same_exceptions() -> None:
    assert ("Exception", *BUILTIN_EXCEPTIONS) == BUILTIN_CLASSES
    special = {name: kind for name, kind in BUILTIN_EXCEPTIONS.items() if kind != "Exception"}
    assert special == BUILTIN_PARENTS
