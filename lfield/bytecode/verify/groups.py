"""Verifying groups: what is pushed, the head that takes it, and the pop of its result.

A group is checked as a whole, from its first push to its pop; see opcodes.py for why groups exist.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from lfield.bytecode.opcodes import BY_CODE, BY_NAME, Opcode
from lfield.bytecode.program import (
    ANY,
    ARRAY,
    BOOLEAN,
    BUILTIN_CLASSES,
    DEVICE,
    EXCEPTIONS,
    HELD,
    INT,
    NULL,
    OBJECT,
    PROXY,
    REAL,
    STRING,
    TICKET,
    VOID,
    Quad,
    TypeRecord,
)
from lfield.bytecode.verify.operands import MethodView

_PUSH, _POP = BY_NAME["push"], BY_NAME["pop"]
_EXACT = {"boolean": BOOLEAN, "int": INT, "real": REAL, "string": STRING}

#: What resources and plain classes do not have, by the instruction that is about it.
_OF_COORDINATORS = {"hops": "hops", "heartbeat_interval": "a heartbeat", "limit": "a time limit"}

#: What makes, or reads, exceptions that a program of lfield 0.3 does not have.
_YOUNG = frozenset(
    {"exc_others", "gather", "begin", "start", "fetch", "leave", "limit", "settle", "hold", "take", "drop"}
)

#: Whether a type index is what a head takes or gives.
Test = Callable[[MethodView, int], bool]


class Signature(NamedTuple):
    """What a head takes, in the order of the pushes, and gives (None for nothing)."""

    takes: list[Test]
    gives: Test | None


def check_group(view: MethodView, quads: tuple[Quad, ...], start: int) -> int:
    """Check the group that begins at `start`; returns the first instruction behind it."""
    end = view.method.end
    pc = start
    while pc < end and quads[pc].op == _PUSH.code:
        view.check_operands(pc, _PUSH, quads[pc])
        pc += 1
    row = BY_CODE.get(quads[pc].op) if pc < end else None
    if row is None or row.takes is None:
        raise view.refused(start, "what is pushed here is taken by no instruction")
    view.check_operands(pc, row, quads[pc])
    signature = _signature(view, pc, row, quads[pc])
    _check_pushes(view, quads[start:pc], start, signature)
    return _check_pop(view, quads, pc, signature)


def _check_pushes(view: MethodView, pushes: tuple[Quad, ...], start: int, signature: Signature) -> None:
    if len(pushes) != len(signature.takes):
        raise view.refused(start, f"{len(pushes)} values are pushed where {len(signature.takes)} are taken")
    for offset, (quad, test) in enumerate(zip(pushes, signature.takes, strict=True)):
        if not test(view, view.source(quad.a, start + offset)):
            raise view.refused(start + offset, "the value pushed is not what is taken")


def _check_pop(view: MethodView, quads: tuple[Quad, ...], head: int, signature: Signature) -> int:
    pc = head + 1
    popped = pc < view.method.end and quads[pc].op == _POP.code
    if popped != (signature.gives is not None):
        raise view.refused(head, "a result is popped exactly where there is one")
    if signature.gives is None:
        return pc
    view.check_operands(pc, _POP, quads[pc])
    if not signature.gives(view, view.slot(quads[pc].a, pc)):
        raise view.refused(pc, "the result does not fit the slot")
    return pc + 1


def _signature(view: MethodView, pc: int, row: Opcode, quad: Quad) -> Signature:
    if row.name in _YOUNG and view.core.builtins < len(BUILTIN_CLASSES):
        raise view.refused(pc, f"{row.name} needs exceptions that the program does not have")
    special = _SPECIAL.get(row.name)
    if special is not None:
        return special(view, pc, quad)
    if row.name.startswith("write_") and view.scope != "resource":
        raise view.refused(pc, "only resources write")
    if row.name in _OF_COORDINATORS and view.scope != "coordinator":
        raise view.refused(pc, f"only coordinators have {_OF_COORDINATORS[row.name]}")
    gives = _accepts(_EXACT[row.gives]) if row.gives else None
    return Signature([_taken(kind) for kind in row.takes or ()], gives)


def _call(view: MethodView, pc: int, quad: Quad) -> Signature:
    callee = view.core.methods[quad.a]
    if callee.kind not in ("method", "constructor"):
        raise view.refused(pc, "only methods and constructors are called")
    if not view.sees(view.core.classes[callee.owner]):
        raise view.refused(pc, "the method is out of scope here")
    arguments = callee.slots[: callee.parameters + 1]
    return Signature([*map(_accepts, arguments)], _given(callee.result))


def _pcall(view: MethodView, pc: int, quad: Quad) -> Signature:
    callee = view.core.methods[quad.a]
    if view.scope != "coordinator":
        raise view.refused(pc, "only coordinators call portals")
    if callee.kind != "portal":
        raise view.refused(pc, "pcall needs a portal")
    arguments = callee.slots[1 : callee.parameters + 1]
    return Signature([_proxy_of(callee.owner), *map(_accepts, arguments)], _given(callee.result))


def _begin(view: MethodView, pc: int, quad: Quad) -> Signature:
    """What `pcall` takes, behind the sentinel and the element that the result goes to."""
    proxy, *arguments = _pcall(view, pc, quad).takes
    result = view.core.methods[quad.a].result

    def takes_result(view: MethodView, index: int) -> bool:
        record = view.types.record(index)
        return record.kind == NULL or (
            record.kind == ARRAY and result != VOID and view.types.fits(result, record.of)
        )

    return Signature([_is_ticket, takes_result, _accepts(INT), proxy, *arguments], None)


def _settle(view: MethodView, pc: int, quad: Quad) -> Signature:
    _check_coordinator(view, pc)
    array = view.types.record(quad.a)
    if array.kind != ARRAY:
        raise view.refused(pc, "the target of a result is an element of an array")
    return Signature([_is_ticket, _accepts(quad.a), _accepts(INT), _accepts(array.of)], None)


def _gather(view: MethodView, pc: int, quad: Quad) -> Signature:
    _check_coordinator(view, pc)
    return Signature([], _is_ticket)


def _waits(view: MethodView, pc: int, quad: Quad) -> Signature:
    _check_coordinator(view, pc)
    return Signature([_is_ticket], None)


def _leave(view: MethodView, pc: int, quad: Quad) -> Signature:
    _check_coordinator(view, pc)
    return Signature([_is_ticket, _accepts(ANY)], None)


def _check_coordinator(view: MethodView, pc: int) -> None:
    if view.scope != "coordinator":
        raise view.refused(pc, "only coordinators work in parallel")


def _is_ticket(view: MethodView, index: int) -> bool:
    return view.types.kind(index) == TICKET


def _hold(view: MethodView, pc: int, quad: Quad) -> Signature:
    _check_reserves(view, pc)

    def is_kept(view: MethodView, index: int) -> bool:
        record = view.types.record(index)
        while record.kind == ARRAY:
            record = view.types.record(record.of)
        offer = record.kind == OBJECT and view.core.classes[record.of].capability
        return offer or record.kind == PROXY

    return Signature([is_kept], _is_numbers)


def _keeps(view: MethodView, pc: int, quad: Quad) -> Signature:
    _check_reserves(view, pc)
    return Signature([_is_numbers], None)


def _check_reserves(view: MethodView, pc: int) -> None:
    if view.scope != "coordinator":
        raise view.refused(pc, "only coordinators reserve resources")


def _is_numbers(view: MethodView, index: int) -> bool:
    return view.types.record(index) == TypeRecord(ARRAY, INT)


def _others(view: MethodView, pc: int, quad: Quad) -> Signature:
    return Signature([_accepts(ANY)], _accepts(EXCEPTIONS))


def _find(view: MethodView, pc: int, quad: Quad) -> Signature:
    _check_find(view, pc, quad)
    return Signature([_accepts(STRING)], _proxy_of(quad.a))


def _findall(view: MethodView, pc: int, quad: Quad) -> Signature:
    _check_find(view, pc, quad)
    proxy = _proxy_of(quad.a)

    def is_array_of_proxies(view: MethodView, index: int) -> bool:
        record = view.types.record(index)
        return record.kind == ARRAY and proxy(view, record.of)

    return Signature([], is_array_of_proxies)


def _check_find(view: MethodView, pc: int, quad: Quad) -> None:
    if view.scope != "coordinator":
        raise view.refused(pc, "only coordinators find resources")
    if view.core.classes[quad.a].kind != "resource":
        raise view.refused(pc, "only resources are found")


def _offers(view: MethodView, pc: int, quad: Quad) -> Signature:
    _check_query(view, pc, quad)
    offer = TypeRecord(OBJECT, quad.a)

    def is_array_of_offers(view: MethodView, index: int) -> bool:
        record = view.types.record(index)
        return record.kind == ARRAY and view.types.record(record.of) == offer

    return Signature([_accepts(STRING)], is_array_of_offers)


def _explain(view: MethodView, pc: int, quad: Quad) -> Signature:
    _check_query(view, pc, quad)
    return Signature([_accepts(STRING)], _accepts(STRING))


def _about(view: MethodView, pc: int, quad: Quad) -> Signature:
    if view.scope != "coordinator":
        raise view.refused(pc, "only coordinators have proxies")
    return Signature([lambda view, index: view.types.kind(index) == PROXY], _accepts(STRING))


def _check_query(view: MethodView, pc: int, quad: Quad) -> None:
    if view.scope != "coordinator":
        raise view.refused(pc, "only coordinators ask for capabilities")
    if not view.core.classes[quad.a].capability:
        raise view.refused(pc, "only capabilities have offers")


def _device(view: MethodView, pc: int, quad: Quad) -> Signature:
    call = view.core.device_calls[quad.a]
    if call.owner != view.method.owner:
        raise view.refused(pc, "a device is used by its own resource only")
    held = [_accepts(DEVICE)] if call.field == HELD else []
    return Signature([*held, *map(_accepts, call.parameters)], _given(call.result))


_SPECIAL: dict[str, Callable[[MethodView, int, Quad], Signature]] = {
    "call": _call,
    "pcall": _pcall,
    "find": _find,
    "findall": _findall,
    "offers": _offers,
    "explain": _explain,
    "agent": _about,
    "host": _about,
    "device": _device,
    "exc_others": _others,
    "gather": _gather,
    "begin": _begin,
    "start": _waits,
    "fetch": _waits,
    "leave": _leave,
    "settle": _settle,
    "hold": _hold,
    "take": _keeps,
    "drop": _keeps,
}


def _accepts(wanted: int) -> Test:
    return lambda view, index: view.types.fits(index, wanted)


def _given(result: int) -> Test | None:
    return None if result == VOID else lambda view, index: view.types.fits(result, index)


def _proxy_of(resource: int) -> Test:
    return lambda view, index: view.types.record(index) == TypeRecord(PROXY, resource)


def _taken(kind: str) -> Test:
    """The test for a kind of the table; `ref` is the exception whose words are asked for."""
    if kind == "array":
        return lambda view, index: view.types.kind(index) == ARRAY
    if kind == "ref":
        return lambda view, index: view.types.fits(index, ANY)
    return _accepts(_EXACT[kind])
