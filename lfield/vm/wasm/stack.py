"""How many calls fit WebAssembly's own stack, whatever is compiled: nobody can ask a function what it takes.

A function takes a place for each value that is needed again when the registers do not suffice. The compiler
computes nothing twice, so what an expression gave may be needed until the method's end; and it computes what
only a way out needs at that way out, with the whole chain of values that leads there. So places would grow
with the square of a method's length. But at a point it knows nothing any more, as who resumes comes there as
well, and no way goes over more than STRETCH instructions without one. What remains are values
that a loop does not change: an instruction has at most four, of 8 bytes. So places grow with the
instructions. The most that was found, in loops over hundreds of roots, comparisons and powers, is a quarter
of VALUES each, and half of ARGUMENT: what a call passes is there once as a value, and once more as it is
passed. Where slots are in the frame, nothing else grows. The half of all is in reserve, as
tests/vm/wasm/test_stack.py tries.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping

#: No way through a method goes over more instructions without a point.
STRETCH = 32
#: The size of WebAssembly's own stack, and what the driver, the runtime and the maths take of it, in bytes.
STACK, OTHERS = 1 << 20, 1 << 16
#: What a function takes at most: by itself, for each local, for what each instruction gives, and for each
#: argument that it passes on; in bytes.
ITSELF, LOCAL, VALUES, ARGUMENT = 256, 24, 32, 32


def most_bytes(instructions: int, passed: int, slots: int | None) -> int:
    """What the function of a method takes at most: of so many instructions, with so many arguments of a call.

    `slots` are those that are locals; None where all are in the frame.
    """
    values = instructions if slots is not None else STRETCH
    return ITSELF + LOCAL * (slots or 0) + VALUES * values + ARGUMENT * passed


def deepest(sizes: Mapping[int, int], calls: Mapping[int, Iterable[int]]) -> int:
    """How many calls below another one fit, by what each method's function takes and whom it calls.

    Only methods on a circle of calls, and between two circles, are in a chain of calls more than once.
    """
    if not sizes:
        return 0
    room = STACK - OTHERS
    of_any = room // max(sizes.values())
    circling, before = _peeled(set(sizes), sizes, calls)
    callers: dict[int, list[int]] = {method: [] for method in circling}
    for method in circling:
        for callee in circling.intersection(calls[method]):
            callers[callee].append(method)
    circling, behind = _peeled(circling, sizes, callers)
    rest = room - before - behind
    return max(of_any, rest // max((sizes[method] for method in circling), default=1)) - 1


def _peeled(
    methods: set[int], sizes: Mapping[int, int], calls: Mapping[int, Iterable[int]]
) -> tuple[set[int], int]:
    """The methods without those that nobody on a circle calls, and the most that a chain of these takes."""
    callees = {method: methods.intersection(calls[method]) for method in methods}
    callers = Counter(callee for found in callees.values() for callee in found)
    free = [method for method in methods if not callers[method]]
    above = dict.fromkeys(methods, 0)
    for method in free:
        for callee in callees[method]:
            above[callee] = max(above[callee], above[method] + sizes[method])
            callers[callee] -= 1
            if not callers[callee]:
                free.append(callee)
    return methods.difference(free), max((above[method] + sizes[method] for method in free), default=0)
