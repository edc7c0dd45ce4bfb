"""What methods may do: which of them act, and which coordinators ask to be recovered elsewhere.

A portal acts when it may change something besides the values that it gives back. A caller of one that only
queries has lost nothing when the host dies in the middle of the call, so its host need not keep it first. A
coordinator that may call `heartbeatInterval` (appendix I) is fenced: it runs only under a lease of its host.

Computed from the instructions alone: whoever runs a program need not trust what made it. In doubt a method
acts, and a coordinator is fenced.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache

from lfield.bytecode.opcodes import BY_CODE, BY_NAME, Opcode
from lfield.bytecode.program import CATCH, FINALLY, MethodRecord, Program, Quad

_CALL, _MOVE, _PUSH, _DEVICE = (BY_NAME[name].code for name in ("call", "move", "push", "device"))
_HEARTBEAT = BY_NAME["heartbeat_interval"].code
_WRITES = frozenset({BY_NAME["putf"].code, BY_NAME["pute"].code})
#: Results that did not exist before the instruction: no other thread can hold them.
_MAKES = frozenset(BY_NAME[name].code for name in ("new", "newarray", "lds"))
#: Heads that leave the engine and change nothing but what people read, time and chance.
_READING = ("now", "lived", "random", "find", "findall", "agent", "host", "offers", "explain", "teams")
_TELLING = ("write", "print", *_READING, "yield", "sleep")
_HARMLESS = frozenset(row.code for row in BY_CODE.values() if row.name.partition("_")[0] in _TELLING)

# What a slot may hold, and what a method may change, as a set of bits: something that existed before and was
# not given to the method, or its parameter number n (0: the object that it runs on).
_OLD = 1


def _given(parameter: int) -> int:
    return 2 << parameter


#: What a portal must not change in order to only query: its arguments are copies, its object is the resource.
_LASTING = _OLD | _given(0)


@dataclass(slots=True)
class _Body:
    """What a method changes by itself, and its calls: the callee, and what each argument may be."""

    changes: int = 0
    calls: list[tuple[int, list[int]]] = field(default_factory=list)


@lru_cache(maxsize=8)
def acting_methods(program: Program) -> frozenset[int]:
    """The methods of a verified program that may, called as portals, do more than give a result.

    Those that lead to an instruction of a device which is no query, to a portal, or to a change of an object
    or array that may have existed before the call. Output, time and chance do not count.
    """
    bodies = [_read(program, method) for method in program.core.methods]
    found = [body.changes for body in bodies]
    changed = True
    while changed:
        changed = False
        for i, body in enumerate(bodies):
            changes = found[i]
            for callee, arguments in body.calls:
                changes |= _through(found[callee], arguments)
            changed |= changes != found[i]
            found[i] = changes
    return frozenset(i for i, changes in enumerate(found) if changes & _LASTING)


@lru_cache(maxsize=8)
def fenced_classes(program: Program) -> frozenset[str]:
    """The coordinators of a verified program of which some method leads to a call of `heartbeatInterval`.

    Every method of the class counts, also one that nobody calls; constructors are methods too.
    """
    methods = program.core.methods
    heads = [{(quad.op, quad.a) for quad in program.quads[m.entry : m.end]} for m in methods]
    leads = {i for i, found in enumerate(heads) if any(op == _HEARTBEAT for op, _ in found)}
    before = -1
    while before != len(leads):
        before = len(leads)
        leads |= {i for i, found in enumerate(heads) if any(op == _CALL and a in leads for op, a in found)}
    classes = [program.core.classes[methods[i].owner] for i in leads]
    return frozenset(record.name for record in classes if record.kind == "coordinator")


def _through(changes: int, arguments: list[int]) -> int:
    """What a caller changes by a call: its parameters are what the caller has given."""
    result = changes & _OLD
    for i, held in enumerate(arguments):
        if changes & _given(i):
            result |= held
    return result


def _read(program: Program, method: MethodRecord) -> _Body:
    held = _held(program, method)
    body = _Body()
    arguments: list[int] = []
    for quad in program.quads[method.entry : method.end]:
        if quad.op == _PUSH:
            arguments.append(held[quad.a] if quad.a >= 0 else 0)
            continue
        if quad.op in _WRITES:
            body.changes |= held[quad.a]
        elif quad.op == _CALL:
            body.calls.append((quad.a, arguments))
        elif _acts(program, BY_CODE[quad.op], quad):
            body.changes |= _OLD
        arguments = []
    return body


def _acts(program: Program, row: Opcode, quad: Quad) -> bool:
    """Whether a head that leaves the engine changes the world."""
    if quad.op == _DEVICE:
        return program.core.device_calls[quad.a].effect != "query"
    return row.exits and quad.op not in _HARMLESS


def _held(program: Program, method: MethodRecord) -> list[int]:
    """For each slot what it may hold anywhere in the method; nothing for what only the method has made."""
    held = [0] * len(method.slots)
    for slot in range(method.parameters + 1):
        held[slot] = _given(slot)
    for handler in method.handlers:
        if handler.kind in (CATCH, FINALLY):
            held[handler.slot] |= _OLD
    moves: list[tuple[int, int]] = []
    for quad in program.quads[method.entry : method.end]:
        operands = BY_CODE[quad.op].operands
        if not operands or operands[0].role != "D" or quad.op in _MAKES:
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
