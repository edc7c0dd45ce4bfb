"""Side-effect analysis: finds the methods with effects, and the coordinators that request failover.

A portal has effects when it may change data other than its result. If a host fails during a call without
effects, the caller loses no data, so its host need not write the journal before the call. A coordinator that
may call `heartbeatInterval` (appendix I) is fenced: it runs only while its host holds a lease.

The analysis uses only the instructions, so a host need not trust the compiler. In doubt a method has effects,
and a coordinator is fenced.
"""

from __future__ import annotations

from functools import lru_cache

from msgspec import Struct, field

from lfield.bytecode.opcodes import BY_CODE, BY_NAME, Opcode
from lfield.bytecode.program import CATCH, FINALLY, MethodRecord, Program, Quad

_CALL, _MOVE, _PUSH, _DEVICE = (BY_NAME[name].code for name in ("call", "move", "push", "device"))
_HEARTBEAT, _READ = BY_NAME["heartbeat_interval"].code, BY_NAME["read_line"].code
_WRITES = frozenset({BY_NAME["putf"].code, BY_NAME["pute"].code})
#: Heads that change their first argument.
_CHANGES = frozenset(BY_NAME[name].code for name in ("append", "insert", "remove", "remove_last"))
#: Instructions whose result is a new object: no other thread can have a reference to it.
_ALLOCATIONS = frozenset(BY_NAME[name].code for name in ("new", "newarray", "lds"))
#: Heads that leave the engine without an effect, except on logs, time and random numbers.
_QUERIES = ("now", "lived", "random", "find", "findall", "agent", "host", "offers", "explain", "teams")
_HARMLESS_PREFIXES = ("write", "print", *_QUERIES, "yield", "sleep", "wait")
_HARMLESS = frozenset(
    row.code for row in BY_CODE.values() if row.name.partition("_")[0] in _HARMLESS_PREFIXES
)

# The possible origins of a slot's value, and of changed objects, as a set of bits: an existing object that is
# no parameter, or parameter number n (0: the object that the method runs on).
_OLD = 1


def _parameter_bit(parameter: int) -> int:
    return 2 << parameter


#: The changes that are effects of a portal: its arguments are copies, and its object is the resource.
_LASTING = _OLD | _parameter_bit(0)


class _Body(Struct):
    """The changes of a method itself, and its calls: the callee, and the origins of each argument."""

    changes: int = 0
    calls: list[tuple[int, list[int]]] = field(default_factory=list)


@lru_cache(maxsize=8)
def effectful_methods(program: Program) -> frozenset[int]:
    """The methods of a verified program that may, called as portals, have effects besides a result.

    These methods lead to an instruction of a device that is not a query, to a portal, or to a change of an
    object or array that may have existed before the call. Output, time and random numbers do not count.
    """
    bodies = [_read(program, method) for method in program.core.methods]
    changes_by_method = [body.changes for body in bodies]
    changed = True
    while changed:
        changed = False
        for i, body in enumerate(bodies):
            changes = changes_by_method[i]
            for callee, arguments in body.calls:
                changes |= _changes_of_call(changes_by_method[callee], arguments)
            changed |= changes != changes_by_method[i]
            changes_by_method[i] = changes
    return frozenset(i for i, changes in enumerate(changes_by_method) if changes & _LASTING)


@lru_cache(maxsize=8)
def fenced_classes(program: Program) -> frozenset[str]:
    """The coordinators of a verified program with a method that leads to a call of `heartbeatInterval`.

    Every method of the class counts, also uncalled ones and constructors.
    """
    return _classes_leading_to(program, _HEARTBEAT, "coordinator")


@lru_cache(maxsize=8)
def reading_classes(program: Program) -> frozenset[str]:
    """The resources of a verified program with a method that leads to a `read`."""
    return _classes_leading_to(program, _READ, "resource")


def _classes_leading_to(program: Program, code: int, kind: str) -> frozenset[str]:
    """The classes of a kind with a method that leads to an instruction."""
    methods = program.core.methods
    heads = [{(quad.op, quad.a) for quad in program.quads[m.entry : m.end]} for m in methods]
    leads = {i for i, found in enumerate(heads) if any(op == code for op, _ in found)}
    before = -1
    while before != len(leads):
        before = len(leads)
        leads |= {i for i, found in enumerate(heads) if any(op == _CALL and a in leads for op, a in found)}
    classes = [program.core.classes[methods[i].owner] for i in leads]
    return frozenset(record.name for record in classes if record.kind == kind)


def _changes_of_call(changes: int, arguments: list[int]) -> int:
    """The changes of a caller by a call: parameters of the callee map to its arguments."""
    result = changes & _OLD
    for i, held in enumerate(arguments):
        if changes & _parameter_bit(i):
            result |= held
    return result


def _read(program: Program, method: MethodRecord) -> _Body:
    held = _possible_origins(program, method)
    body = _Body()
    arguments: list[int] = []
    for quad in program.quads[method.entry : method.end]:
        if quad.op == _PUSH:
            arguments.append(held[quad.a] if quad.a >= 0 else 0)
            continue
        if quad.op in _WRITES:
            body.changes |= held[quad.a]
        elif quad.op in _CHANGES:
            body.changes |= arguments[0]
        elif quad.op == _CALL:
            body.calls.append((quad.a, arguments))
        elif _has_effect(program, BY_CODE[quad.op], quad):
            body.changes |= _OLD
        arguments = []
    return body


def _has_effect(program: Program, row: Opcode, quad: Quad) -> bool:
    """Whether a head that leaves the engine has an external effect."""
    if quad.op == _DEVICE:
        return program.core.device_calls[quad.a].effect != "query"
    return row.leaves_engine and quad.op not in _HARMLESS


def _possible_origins(program: Program, method: MethodRecord) -> list[int]:
    """For each slot the origins of its values anywhere in the method; none for objects created in the
    method."""
    held = [0] * len(method.slots)
    for slot in range(method.parameters + 1):
        held[slot] = _parameter_bit(slot)
    for handler in method.handlers:
        if handler.kind in (CATCH, FINALLY):
            held[handler.slot] |= _OLD
    moves: list[tuple[int, int]] = []
    for quad in program.quads[method.entry : method.end]:
        operands = BY_CODE[quad.op].operands
        if not operands or operands[0].role != "D" or quad.op in _ALLOCATIONS:
            continue
        if quad.op != _MOVE:
            held[quad.a] |= _OLD
        elif quad.b >= 0:
            moves.append((quad.a, quad.b))
    before: list[int] = []
    while before != held:
        before = list(held)
        for into, out in moves:
            held[into] |= held[out]
    return held
