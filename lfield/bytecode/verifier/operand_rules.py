"""Verifier rules beyond the table: relations between the operands of one instruction."""

from __future__ import annotations

from collections.abc import Callable

from lfield.bytecode.program import ANY, DEVICE, NULL, OBJECT, PROXY, VOID, Quad, TypeRecord
from lfield.bytecode.verifier.operands import MethodView

Rule = Callable[[MethodView, int, Quad], bool]


def _move(view: MethodView, pc: int, quad: Quad) -> bool:
    return view.types.fits(view.source(quad.b, pc), view.slot(quad.a, pc))


def _getf(view: MethodView, pc: int, quad: Quad) -> bool:
    return view.types.fits(view.field_type(pc, quad.b, quad.c), view.slot(quad.a, pc))


def _putf(view: MethodView, pc: int, quad: Quad) -> bool:
    holder = view.core.classes[view.types.record(view.slot(quad.a, pc)).of]
    if view.field_type(pc, quad.a, quad.b) == DEVICE and holder.kind == "resource":
        return False  # A resource has its devices from the deployment.
    return view.types.fits(view.source(quad.c, pc), view.field_type(pc, quad.a, quad.b))


def _gete(view: MethodView, pc: int, quad: Quad) -> bool:
    return view.types.fits(view.types.element(view.slot(quad.b, pc)), view.slot(quad.a, pc))


def _pute(view: MethodView, pc: int, quad: Quad) -> bool:
    return view.types.fits(view.source(quad.c, pc), view.types.element(view.slot(quad.a, pc)))


def _lds(view: MethodView, pc: int, quad: Quad) -> bool:
    return isinstance(view.core.constants[quad.b], str)


def _new(view: MethodView, pc: int, quad: Quad) -> bool:
    record = view.core.classes[quad.b]
    fitting = (TypeRecord(OBJECT, quad.b), TypeRecord(ANY))
    fits = view.types.record(view.slot(quad.a, pc)) in fitting
    return fits and record.kind == "class" and view.can_access(record)


def _newarray(view: MethodView, pc: int, quad: Quad) -> bool:
    return view.types.is_array(quad.b) and view.slot(quad.a, pc) == quad.b


def _return(view: MethodView, pc: int, quad: Quad) -> bool:
    return view.method.result != VOID and view.types.fits(view.source(quad.a, pc), view.method.result)


def _rtn(view: MethodView, pc: int, quad: Quad) -> bool:
    return view.method.result == VOID


def _has_equal_kinds(view: MethodView, pc: int, quad: Quad) -> bool:
    kinds = {view.types.kind(view.source(operand, pc)) for operand in quad[2:]}
    return PROXY not in kinds or kinds <= {PROXY, NULL}


def _throw(view: MethodView, pc: int, quad: Quad) -> bool:
    return view.types.fits(view.slot(quad.a, pc), ANY)


#: Rules by instruction name; the table fully describes instructions without a rule.
RULES: dict[str, tuple[Rule, str]] = {
    "move": (_move, "the value does not fit the slot"),
    "getf": (_getf, "the field does not fit the slot"),
    "putf": (_putf, "the value does not fit the field"),
    "gete": (_gete, "the element does not fit the slot"),
    "pute": (_pute, "the value does not fit the element"),
    "lds": (_lds, "the constant is not a string"),
    "new": (_new, "the object cannot be created here, or does not fit the slot"),
    "newarray": (_newarray, "the type is not an array, or not that of the slot"),
    "eqr": (_has_equal_kinds, "a proxy is compared with something else"),
    "sner": (_has_equal_kinds, "a proxy is compared with something else"),
    "return": (_return, "the value is not the result of this method"),
    "rtn": (_rtn, "the method must return a result"),
    "throw": (_throw, "only objects of classes can be thrown"),
}
