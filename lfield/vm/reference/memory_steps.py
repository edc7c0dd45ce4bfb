"""Moves, fields, elements, allocation and jumps (tables J.1, J.2, J.4)."""

from __future__ import annotations

from lfield.vm.engine_interface import Trap
from lfield.vm.memory.block import template
from lfield.vm.memory.layout import OBJECT, elements
from lfield.vm.reference.call_steps import Registers, Step, null_use


def jump(label: int) -> Step:
    """`jmp`."""
    return lambda m: label


def branch(label: int, slot: int, when: bool, after: int) -> Step:
    """`bnz` (when true) and `bz` (when false)."""
    if when:
        return lambda m: label if m.w[m.slots + slot] else after
    return lambda m: after if m.w[m.slots + slot] else label


def move(a: int, b: int | None, constant: int, after: int) -> Step:
    """`move`: any word, from a slot or the bits of a constant."""
    if b is None:

        def from_constant(m: Registers) -> int:
            m.w[m.slots + a] = constant
            return after

        return from_constant

    slot = b

    def from_slot(m: Registers) -> int:
        w, slots = m.w, m.slots
        w[slots + a] = w[slots + slot]
        return after

    return from_slot


def get_field(a: int, b: int, offset: int, name: str, after: int) -> Step:
    """`getf`: the field `offset` words into the object."""

    def step(m: Registers) -> int:
        w, slots = m.w, m.slots
        place = w[slots + b]
        if not place:
            raise null_use(f"field '{name}'")
        w[slots + a] = w[place + offset]
        return after

    return step


def put_field(a: int, offset: int, c: int | None, constant: int, name: str, after: int) -> Step:
    """`putf`."""

    def step(m: Registers) -> int:
        w, slots = m.w, m.slots
        place = w[slots + a]
        if not place:
            raise null_use(f"field '{name}'")
        w[place + offset] = constant if c is None else w[slots + c]
        return after

    return step


def _element(w: memoryview[int], place: int, index: int) -> int:
    """The word of an element; traps on null and on an invalid index."""
    if not place:
        raise null_use("element")
    first, end = elements(w, place)
    if not 0 <= index < end - first:
        raise Trap("IndexException", f"index {index} of an array of length {end - first}")
    return first + index


def get_element(a: int, b: int, c: int | None, constant: int, after: int) -> Step:
    """`gete`."""

    def step(m: Registers) -> int:
        w, slots = m.w, m.slots
        w[slots + a] = w[_element(w, w[slots + b], constant if c is None else w[slots + c])]
        return after

    return step


def put_element(a: int, b: int, c: int | None, constant: int, after: int) -> Step:
    """`pute`."""

    def step(m: Registers) -> int:
        w, slots = m.w, m.slots
        w[_element(w, w[slots + a], w[slots + b])] = constant if c is None else w[slots + c]
        return after

    return step


def load_string(a: int, text: str, after: int) -> Step:
    """`lds`: a new copy on the heap each time; strings are immutable."""

    def step(m: Registers) -> int:
        place = m.block.new_string(text)
        m.w[m.slots + a] = place
        return after

    return step


def new_object(a: int, record: int, words: int, after: int) -> Step:
    """`new`."""
    blank = template(OBJECT, record, words)

    def step(m: Registers) -> int:
        m.w[m.slots + a] = m.block.place_template(blank)
        return after

    return step


def check_length(m: Registers, length: int) -> None:
    """Raise Trap for an array of more elements than the limit."""
    if length > m.limits.array_length:
        raise Trap("LimitException", f"an array of {length} is over the limit of {m.limits.array_length}")


def new_array(a: int, record: int, c: int | None, constant: int, after: int) -> Step:
    """`newarray`; a growable array has its elements in an array of another type."""

    def step(m: Registers) -> int:
        length = constant if c is None else m.w[m.slots + c]
        if length < 0:
            raise Trap("LimitException", f"an array cannot have length {length}")
        check_length(m, length)
        m.w[m.slots + a] = m.block.new_array(record, m.plain_arrays[record], length)
        return after

    return step
