"""Bound of the call depth on the WebAssembly stack: wasmtime does not report the stack use of a function.

A function spills every value that is needed later than registers allow. The compiler computes no value twice,
so a value may be needed until the method's end; and it computes the values of an exit at this exit, with the
whole chain of operations that leads there. Spills could thus grow quadratically. But at a point the compiler
knows no value, since resumed methods enter there, and no path exceeds STRETCH instructions without a point.
The remaining values are loop invariants: at most four per instruction, of 8 bytes, so spills grow linearly.
The measured maximum, in loops over hundreds of roots, comparisons and powers, is a quarter of VALUES for
each, and half of ARGUMENT: an argument is stored once as a value and once when it is passed. With slots in
the frame, no other part grows. Half of the total is a reserve, as tests/vm/wasm/test_stack.py checks.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping

#: Maximum instructions of a path without a point.
STRETCH = 32
#: Size of the WebAssembly stack, and the share of trampoline, runtime and maths, in bytes.
STACK, OTHERS = 1 << 20, 1 << 16
#: Maximum stack of a function in bytes: fixed, per local, per instruction result, and per passed argument.
ITSELF, LOCAL, VALUES, ARGUMENT = 256, 24, 32, 32


def most_bytes(instructions: int, passed: int, slots: int | None) -> int:
    """Maximum stack of a method's function, by number of instructions and of arguments of a call.

    `slots` is the number of slots that are locals; None if all are in the frame.
    """
    values = instructions if slots is not None else STRETCH
    return ITSELF + LOCAL * (slots or 0) + VALUES * values + ARGUMENT * passed


def deepest(sizes: Mapping[int, int], calls: Mapping[int, Iterable[int]]) -> int:
    """The call depth that fits, by the stack and the callees of each method's function.

    Only methods on call cycles, and between two cycles, occur more than once in a call chain.
    """
    if not sizes:
        return 0
    available = STACK - OTHERS
    of_any = available // max(sizes.values())
    circling, before = _peeled(set(sizes), sizes, calls)
    callers: dict[int, list[int]] = {method: [] for method in circling}
    for method in circling:
        for callee in circling.intersection(calls[method]):
            callers[callee].append(method)
    circling, behind = _peeled(circling, sizes, callers)
    rest = available - before - behind
    return max(of_any, rest // max((sizes[method] for method in circling), default=1)) - 1


def _peeled(
    methods: set[int], sizes: Mapping[int, int], calls: Mapping[int, Iterable[int]]
) -> tuple[set[int], int]:
    """The methods except those that no cycle calls, and the maximum stack of a chain of the latter."""
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
