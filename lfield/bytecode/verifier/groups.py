"""Verifies groups: the pushes, the head with these arguments, and the pop of its result.

A group is checked as a whole, from its first push to its pop; see opcodes.py for the reason.
"""

from __future__ import annotations

from collections.abc import Callable

from lfield.bytecode.opcodes import BY_CODE, BY_NAME, Opcode
from lfield.bytecode.program import (
    ANY,
    ARRAY,
    BOOLEAN,
    BUILTIN_CLASSES,
    DEVICE,
    EXCEPTIONS,
    GROWABLE,
    HELD_DEVICE,
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
from lfield.bytecode.verifier.operands import MethodView
from lfield.bytecode.verifier.query_groups import (
    QUERY_SIGNATURES,
    GroupSignature,
    TypeTest,
    accepts,
    proxy_of,
    result_test,
)

_PUSH, _POP = BY_NAME["push"], BY_NAME["pop"]
_EXACT = {"boolean": BOOLEAN, "int": INT, "real": REAL, "string": STRING}

#: Features of coordinators only, by instruction.
_OF_COORDINATORS = {
    **{"hops": "hops", "heartbeat_interval": "a heartbeat", "limit": "a time limit"},
    **dict.fromkeys(("seq_start", "seq_stop", "seq_end", "seq_alive"), "other coordinators to start"),
}

#: Instructions that create or read exceptions that are missing in a program of lfield 0.3.
_NOT_IN_0_3 = frozenset({"exc_others"} | {row.name for row in BY_CODE.values() if 1600 <= row.code < 1850})


def check_group(view: MethodView, quads: tuple[Quad, ...], start: int) -> int:
    """Check the group that starts at `start`; returns the instruction after it."""
    end = view.method.end
    pc = start
    while pc < end and quads[pc].op == _PUSH.code:
        view.check_operands(pc, _PUSH, quads[pc])
        pc += 1
    row = BY_CODE.get(quads[pc].op) if pc < end else None
    if row is None or row.argument_kinds is None:
        raise view.refused(start, "the pushed values are not used by an instruction")
    view.check_operands(pc, row, quads[pc])
    signature = _signature(view, pc, row, quads[pc])
    _check_pushes(view, quads[start:pc], start, signature)
    return _check_pop(view, quads, pc, signature)


def _check_pushes(view: MethodView, pushes: tuple[Quad, ...], start: int, signature: GroupSignature) -> None:
    if len(pushes) != len(signature.parameters):
        raise view.refused(start, f"{len(pushes)} values are pushed, {len(signature.parameters)} expected")
    for offset, (quad, test) in enumerate(zip(pushes, signature.parameters, strict=True)):
        if not test(view, view.source(quad.a, start + offset)):
            raise view.refused(start + offset, "the pushed value has the wrong type")


def _check_pop(view: MethodView, quads: tuple[Quad, ...], head: int, signature: GroupSignature) -> int:
    pc = head + 1
    popped = pc < view.method.end and quads[pc].op == _POP.code
    if popped != (signature.result is not None):
        raise view.refused(head, "a result must be popped, and only a result")
    if signature.result is None:
        return pc
    view.check_operands(pc, _POP, quads[pc])
    if not signature.result(view, view.slot(quads[pc].a, pc)):
        raise view.refused(pc, "the result does not fit the slot")
    return pc + 1


def _signature(view: MethodView, pc: int, row: Opcode, quad: Quad) -> GroupSignature:
    if row.name in _NOT_IN_0_3 and view.core.builtins < len(BUILTIN_CLASSES):
        raise view.refused(pc, f"{row.name} needs exceptions that the program does not have")
    special = _SPECIAL.get(row.name)
    if special is not None:
        return special(view, pc, quad)
    if (row.name.startswith("write_") or row.name == "read_line") and view.scope != "resource":
        raise view.refused(pc, "only resources write and read")
    if row.name in _OF_COORDINATORS and view.scope != "coordinator":
        raise view.refused(pc, f"only coordinators have {_OF_COORDINATORS[row.name]}")
    result = accepts(_EXACT[row.result_kind]) if row.result_kind else None
    return GroupSignature([_kind_test(kind) for kind in row.argument_kinds or ()], result)


def _call(view: MethodView, pc: int, quad: Quad) -> GroupSignature:
    callee = view.core.methods[quad.a]
    if callee.kind not in ("method", "constructor") and (callee.kind, view.method.kind) != ("loop", "ticks"):
        raise view.refused(pc, "only methods and constructors are called")
    if not view.can_access(view.core.classes[callee.owner]):
        raise view.refused(pc, "the method is out of scope here")
    arguments = callee.slots[: callee.parameters + 1]
    return GroupSignature([*map(accepts, arguments)], result_test(callee.result))


def _pcall(view: MethodView, pc: int, quad: Quad) -> GroupSignature:
    callee = view.core.methods[quad.a]
    if view.scope != "coordinator":
        raise view.refused(pc, "only coordinators call portals")
    if callee.kind != "portal":
        raise view.refused(pc, "pcall needs a portal")
    arguments = callee.slots[1 : callee.parameters + 1]
    return GroupSignature([proxy_of(callee.owner), *map(accepts, arguments)], result_test(callee.result))


def _collect_call(view: MethodView, pc: int, quad: Quad) -> GroupSignature:
    """The arguments of `pcall`, after the sentinel and the target of the result."""
    proxy, *arguments = _pcall(view, pc, quad).parameters
    result = view.core.methods[quad.a].result

    def accepts_result(view: MethodView, index: int) -> bool:
        return view.types.kind(index) == NULL or (
            view.types.is_array(index)
            and result != VOID
            and view.types.fits(result, view.types.element(index))
        )

    return GroupSignature([_is_ticket, accepts_result, accepts(INT), proxy, *arguments], None)


def _settle(view: MethodView, pc: int, quad: Quad) -> GroupSignature:
    _check_coordinator(view, pc)
    if not view.types.is_array(quad.a):
        raise view.refused(pc, "the target of a result is an element of an array")
    element = accepts(view.types.element(quad.a))
    return GroupSignature([_is_ticket, accepts(quad.a), accepts(INT), element], None)


def _gather(view: MethodView, pc: int, quad: Quad) -> GroupSignature:
    _check_coordinator(view, pc)
    return GroupSignature([], _is_ticket)


def _waits(view: MethodView, pc: int, quad: Quad) -> GroupSignature:
    _check_coordinator(view, pc)
    return GroupSignature([_is_ticket], None)


def _leave(view: MethodView, pc: int, quad: Quad) -> GroupSignature:
    _check_coordinator(view, pc)
    return GroupSignature([_is_ticket, accepts(ANY)], None)


def _tickets(view: MethodView, pc: int, quad: Quad) -> GroupSignature:
    """A ticket, or an array of futures: objects whose first field is a ticket."""
    _check_coordinator(view, pc)

    def has_tickets(view: MethodView, index: int) -> bool:
        if not view.types.is_array(index):
            return _is_ticket(view, index)
        fields = view.types.fields(view.types.element(index))
        return bool(fields) and _is_ticket(view, fields[0].type)

    results = {"next": accepts(INT), "ended": accepts(BOOLEAN), "failure": accepts(ANY)}
    name = BY_CODE[quad.op].name
    single = name in ("launch", "ended")
    return GroupSignature([_is_ticket if single else has_tickets], results.get(name))


def _waits_in_monitor(view: MethodView, pc: int, quad: Quad) -> GroupSignature:
    """A thread that holds the monitor leaves it, so its method must be synchronized."""
    if view.scope != "resource" or not view.method.synchronized:
        raise view.refused(pc, "only synchronized methods of resources leave the monitor")
    row = BY_CODE[quad.op]
    parameters = [accepts(_EXACT[kind]) for kind in row.argument_kinds or ()]
    return GroupSignature([*parameters], accepts(INT) if row.result_kind else None)


def _check_coordinator(view: MethodView, pc: int) -> None:
    if view.scope != "coordinator":
        raise view.refused(pc, "only coordinators work in parallel")


def _is_ticket(view: MethodView, index: int) -> bool:
    return view.types.kind(index) == TICKET


def _hold(view: MethodView, pc: int, quad: Quad) -> GroupSignature:
    _check_reserves(view, pc)

    def is_kept(view: MethodView, index: int) -> bool:
        while view.types.is_array(index):
            index = view.types.element(index)
        record = view.types.record(index)
        offer = record.kind == OBJECT and view.core.classes[record.of].capability
        return offer or record.kind == PROXY

    return GroupSignature([is_kept], _is_numbers)


def _reservation_array(view: MethodView, pc: int, quad: Quad) -> GroupSignature:
    _check_reserves(view, pc)
    return GroupSignature([_is_numbers], None)


def _check_reserves(view: MethodView, pc: int) -> None:
    if view.scope != "coordinator":
        raise view.refused(pc, "only coordinators reserve resources")


def _is_numbers(view: MethodView, index: int) -> bool:
    return view.types.record(index) == TypeRecord(ARRAY, INT)


def _others(view: MethodView, pc: int, quad: Quad) -> GroupSignature:
    def is_array_of_exceptions(view: MethodView, index: int) -> bool:
        return view.core.plain_array(index) == EXCEPTIONS

    return GroupSignature([accepts(ANY)], is_array_of_exceptions)


def _append(view: MethodView, pc: int, quad: Quad) -> GroupSignature:
    element = _growing_element(view, pc, quad)
    return GroupSignature([accepts(quad.a), accepts(element)], None)


def _insert(view: MethodView, pc: int, quad: Quad) -> GroupSignature:
    element = _growing_element(view, pc, quad)
    return GroupSignature([accepts(quad.a), accepts(INT), accepts(element)], None)


def _remove(view: MethodView, pc: int, quad: Quad) -> GroupSignature:
    element = _growing_element(view, pc, quad)
    return GroupSignature([accepts(quad.a), accepts(INT)], result_test(element))


def _remove_last(view: MethodView, pc: int, quad: Quad) -> GroupSignature:
    element = _growing_element(view, pc, quad)
    return GroupSignature([accepts(quad.a)], result_test(element))


def _growing_element(view: MethodView, pc: int, quad: Quad) -> int:
    """The type of the elements of an array that grows."""
    if view.types.kind(quad.a) != GROWABLE:
        raise view.refused(pc, "only an array of a type that grows changes its length")
    return view.types.element(quad.a)


def _tick(view: MethodView, pc: int, quad: Quad) -> GroupSignature:
    _check_loop(view, pc)
    return GroupSignature([accepts(INT), accepts(INT)], accepts(INT))


def _suppress(view: MethodView, pc: int, quad: Quad) -> GroupSignature:
    _check_loop(view, pc)
    other = view.core.methods[quad.a]
    if other.kind != "ticks" or other.owner != view.method.owner:
        raise view.refused(pc, "only another loop of this resource is suppressed")
    return GroupSignature([], None)


def _control(view: MethodView, pc: int, quad: Quad) -> GroupSignature:
    _check_loop(view, pc)
    return GroupSignature([], None)


def _tick_failed(view: MethodView, pc: int, quad: Quad) -> GroupSignature:
    _check_loop(view, pc)
    return GroupSignature([accepts(ANY)], None)


def _check_loop(view: MethodView, pc: int) -> None:
    if view.method.kind != "ticks":
        raise view.refused(pc, "only loops have ticks")


def _device(view: MethodView, pc: int, quad: Quad) -> GroupSignature:
    call = view.core.device_calls[quad.a]
    if call.owner != view.method.owner:
        raise view.refused(pc, "a device is used by its own resource only")
    held = [accepts(DEVICE)] if call.field == HELD_DEVICE else []
    return GroupSignature([*held, *map(accepts, call.parameters)], result_test(call.result))


_SPECIAL: dict[str, Callable[[MethodView, int, Quad], GroupSignature]] = {
    **QUERY_SIGNATURES,
    "call": _call,
    "pcall": _pcall,
    "device": _device,
    "exc_others": _others,
    "append": _append,
    "insert": _insert,
    "remove": _remove,
    "remove_last": _remove_last,
    "gather": _gather,
    "begin": _collect_call,
    "start": _waits,
    "fetch": _waits,
    "leave": _leave,
    "settle": _settle,
    "hold": _hold,
    "launch": _tickets,
    "next": _tickets,
    "ended": _tickets,
    "cancel": _tickets,
    "failure": _tickets,
    "wait_limit": _waits_in_monitor,
    "wait_leave": _waits_in_monitor,
    "wait_enter": _waits_in_monitor,
    "take": _reservation_array,
    "drop": _reservation_array,
    "tick": _tick,
    "suppress": _suppress,
    "control": _control,
    "tick_failed": _tick_failed,
}


def _kind_test(kind: str) -> TypeTest:
    """The test for a kind of the table; `ref` is the exception whose details are read."""
    if kind == "array":
        return lambda view, index: view.types.is_array(index)
    if kind == "ref":
        return lambda view, index: view.types.fits(index, ANY)
    return accepts(_EXACT[kind])
