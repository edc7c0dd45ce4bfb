"""Calls, returns, the monitor, and the heads that leave the engine (table J.3)."""

from __future__ import annotations

from lfield.vm.contract import BLOCKED, Done, Outside, Trap
from lfield.vm.memory import layout
from lfield.vm.memory.block import template
from lfield.vm.memory.layout import (
    FRAME,
    FRAME_CALLER,
    FRAME_DEPTH,
    FRAME_RETURN,
    FRAME_SLOTS,
    THREAD_ID,
)
from lfield.vm.reference.registers import LEAVE, Registers, Step, null_use

#: An argument as prepared: the slot it is in, or None and the word of the constant.
Argument = tuple[int | None, int]


def call(arguments: list[Argument], method: int, words: int, entry: int, after: int, name: str) -> Step:
    """A whole call group: a frame for the callee with the arguments in its first slots."""
    blank = template(FRAME, method, words)
    first = arguments[0][0]

    def step(m: Registers) -> int:
        block, w, slots = m.block, m.w, m.slots
        if first is not None and not w[slots + first]:
            raise null_use(f"call of '{name}'")
        depth = w[m.frame + FRAME_DEPTH] + 1
        if depth > m.limits.call_depth:
            raise Trap("LimitException", f"calls are nested deeper than {m.limits.call_depth}")
        place = block.stamp(blank)
        w[place + FRAME_CALLER] = m.frame
        w[place + FRAME_RETURN] = after
        w[place + FRAME_DEPTH] = depth
        into = place + FRAME_SLOTS
        for slot, constant in arguments:
            w[into] = constant if slot is None else w[slots + slot]
            into += 1
        m.frame = place
        m.slots = place + FRAME_SLOTS
        return entry

    return step


def enter(synchronized: bool, after: int) -> Step:
    """`frame`: takes the agent's monitor where the method is synchronized."""
    if not synchronized:
        return lambda m: after

    def step(m: Registers) -> int:
        w = m.w
        owner, thread = w[layout.W_OWNER], w[m.place + THREAD_ID]
        if owner and owner != thread:
            m.exit = BLOCKED
            return LEAVE
        w[layout.W_OWNER] = thread
        w[layout.W_ENTRIES] += 1
        return after

    return step


def release(w: memoryview[int]) -> None:
    """Leave the monitor once; it is free when it was left as often as entered."""
    w[layout.W_ENTRIES] -= 1
    if not w[layout.W_ENTRIES]:
        w[layout.W_OWNER] = 0


def leave(result: Argument | None, synchronized: bool, destinations: dict[int, int]) -> Step:
    """`return` and `rtn`: give the caller the result and go on behind its call.

    `destinations` has, for the instruction behind a call group that gives something, the slot of its pop.
    """
    slot, constant = result or (None, 0)

    def step(m: Registers) -> int:
        w, frame = m.w, m.frame
        word = constant if slot is None else w[m.slots + slot]
        if synchronized:
            release(w)
        caller = w[frame + FRAME_CALLER]
        if not caller:
            m.exit = Done(word)
            return LEAVE
        after = w[frame + FRAME_RETURN]
        # A frame on the top of the heap is given back at once: calls that allocate nothing cost no garbage.
        if frame + (w[frame] >> 32) == m.block.top:
            m.block.top = frame
        m.frame = caller
        m.slots = caller + FRAME_SLOTS
        destination = destinations.get(after)
        if destination is None:
            return after
        w[m.slots + destination] = word
        return after + 1

    return step


def outside(arguments: list[Argument], op: int, operand: int, checked: dict[int, str]) -> Step:
    """A head that leaves the engine; `checked` has what arguments must not be null for."""
    must = tuple(checked.items())

    def step(m: Registers) -> int:
        w, slots = m.w, m.slots
        words = [constant if slot is None else w[slots + slot] for slot, constant in arguments]
        for number, what in must:
            if not words[number]:
                raise null_use(what)
        m.exit = Outside(op, operand, words)
        return LEAVE

    return step


def reading(ask: Step, call: int, into: int, after: int) -> Step:
    """A query of telemetry: the host's last word while it is fresh enough, else `ask` leaves the engine."""

    def step(m: Registers) -> int:
        known = m.readings[call]
        if known is None or m.now() >= known.until:
            return ask(m)
        m.w[m.slots + into] = known.word
        m.asked = True
        return after

    return step
