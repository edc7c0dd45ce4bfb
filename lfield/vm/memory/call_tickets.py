"""Tickets of a block: the portal calls of a `together`, newest first after a sentinel (decision 46)."""

from __future__ import annotations

from collections.abc import Mapping

from lfield.bytecode.program import ANY, Program
from lfield.bytecode.program import OBJECT as OBJECT_TYPE
from lfield.errors import BlockError
from lfield.vm.memory import layout
from lfield.vm.memory.block import Block
from lfield.vm.memory.layout import (
    COUNT_LIMIT,
    FRAME,
    FRAME_CALLER,
    FRAME_RETURN,
    PROXY,
    TICKET,
    TICKET_ARRAY,
    TICKET_CALL,
    TICKET_CANCELLING,
    TICKET_COLLECTED,
    TICKET_GENERATION,
    TICKET_INDEX,
    TICKET_METHOD,
    TICKET_NEXT,
    TICKET_NUMBER,
    TICKET_PROXY,
    TICKET_RETURNED,
    TICKET_STARTED,
    TICKET_STATE,
    TICKET_THROWN,
    TICKET_VALUE,
    TICKET_WORDS,
)

#: The words of a ticket about its call; unused in a ticket of an existing result.
_OF_CALLS = (TICKET_CALL, TICKET_METHOD, TICKET_GENERATION, TICKET_THROWN)


def tickets_of(block: Block, sentinel: int) -> list[int]:
    """The tickets of one `together`, in the order of collection."""
    w = block.w
    found = []
    ticket = w[sentinel + TICKET_NEXT]
    while ticket:
        found.append(ticket)
        ticket = w[ticket + TICKET_NEXT]
    found.reverse()
    return found


def pending_call_numbers(block: Block) -> set[int]:
    """The numbers of all pending calls of a block that was just packed."""
    w, found, place = block.w, set(), block.heap
    while place < block.top:
        if w[place] & 0xFF == TICKET and w[place + TICKET_STATE] in (TICKET_STARTED, TICKET_CANCELLING):
            found.add(w[place + TICKET_NUMBER])
        place += w[place] >> 32
    return found


def new_ticket(
    block: Block, sentinel: int, method: int, proxy: int, call: int, target: tuple[int, int]
) -> int:
    """Add a call to a `together`; `target` is array (0: none) and index. Raises HeapFull before a change."""
    w = block.w
    array, index = target
    place = block.allocate(TICKET, w[array] >> 8 & 0xFFFFFF if array else 0, TICKET_WORDS)
    w[layout.W_TICKETS] += 1
    w[place + TICKET_NUMBER] = w[layout.W_TICKETS]
    w[place + TICKET_PROXY] = proxy
    w[place + TICKET_CALL] = call
    w[place + TICKET_METHOD] = method
    w[place + TICKET_ARRAY] = array
    w[place + TICKET_INDEX] = index
    w[place + TICKET_STATE] = TICKET_COLLECTED
    w[place + TICKET_NEXT] = w[sentinel + TICKET_NEXT]
    w[sentinel + TICKET_NEXT] = place
    return place


def check_ticket(program: Program, w: memoryview[int], starts: Mapping[int, int], place: int) -> None:
    """Check a ticket whose references have the right types.

    `starts` has the lower half of the header of every object on the heap. Raises BlockError.
    """
    number, state = w[place + TICKET_NUMBER], w[place + TICKET_STATE]
    if not number:
        _check_sentinel(w, starts, place)
        return
    if not 0 < number <= w[layout.W_TICKETS] or not 0 <= w[place + TICKET_GENERATION] < COUNT_LIMIT:
        raise BlockError("a ticket has an invalid number", word=place)
    if not TICKET_COLLECTED <= state <= TICKET_RETURNED:
        raise BlockError("a ticket has an invalid state", word=place)
    _check_next(w, starts, place, number)
    _check_element(w, starts, place)
    if w[place + TICKET_PROXY]:
        _check_call(program, w, starts, place)
        _check_result(program, w, starts, place)
    elif state != TICKET_RETURNED or not w[place + TICKET_ARRAY] or any(w[place + i] for i in _OF_CALLS):
        raise BlockError("a ticket does not refer to a resource", word=place)
    if state in (TICKET_COLLECTED, TICKET_STARTED, TICKET_CANCELLING) and (
        w[place + TICKET_VALUE] or w[place + TICKET_THROWN]
    ):
        raise BlockError("a ticket has a result before its call has returned", word=place)


def _check_sentinel(w: memoryview[int], starts: Mapping[int, int], place: int) -> None:
    if starts[place] != TICKET or any(w[place + i] for i in range(1, TICKET_NEXT)):
        raise BlockError("the sentinel of a together has a call", word=place)
    _check_next(w, starts, place, COUNT_LIMIT)


def _check_next(w: memoryview[int], starts: Mapping[int, int], place: int, number: int) -> None:
    """Check that numbers decrease along a chain, so that it has no cycle."""
    before = w[place + TICKET_NEXT]
    if before and not 0 < w[before + TICKET_NUMBER] < number:
        raise BlockError("the tickets of a together do not form a chain", word=place)


def _check_call(program: Program, w: memoryview[int], starts: Mapping[int, int], place: int) -> None:
    """Check the portal, the proxy of its resource, and the frame with its arguments."""
    method, call = w[place + TICKET_METHOD], w[place + TICKET_CALL]
    methods = program.core.methods
    if not 0 <= method < len(methods) or methods[method].kind != "portal":
        raise BlockError("a ticket does not refer to a portal", word=place)
    if starts.get(w[place + TICKET_PROXY]) != PROXY | methods[method].owner << 8:
        raise BlockError("a ticket refers to a resource without its portal", word=place)
    if bool(call) != (w[place + TICKET_STATE] == TICKET_COLLECTED):
        raise BlockError("a ticket has arguments after its call has started, or none before", word=place)
    if call and (starts[call] != FRAME | method << 8 or w[call + FRAME_CALLER] or w[call + FRAME_RETURN]):
        raise BlockError("the arguments of a ticket are not those of its portal", word=place)


def _check_element(w: memoryview[int], starts: Mapping[int, int], place: int) -> None:
    """Check the array element for the result."""
    array, index, kind = w[place + TICKET_ARRAY], w[place + TICKET_INDEX], starts[place] >> 8
    if not kind:
        if array or index or w[place + TICKET_VALUE]:
            raise BlockError("a ticket has a result and no target", word=place)
        return
    # Elements of a growable array may have been removed since then; `fetch` checks the index again.
    shrinks = array and w[array] & 0xFF == layout.GROWABLE
    if not array or index < 0 or (not shrinks and index >= layout.length(w, array)):
        raise BlockError("the target of a ticket is not an element of its array", word=place)


def _check_result(program: Program, w: memoryview[int], starts: Mapping[int, int], place: int) -> None:
    """Check that the element, if any, can hold the portal's result."""
    kind = starts[place] >> 8
    if not kind:
        return
    core = program.core
    result_type, element_type = core.methods[w[place + TICKET_METHOD]].result, core.element(kind)
    if result_type == element_type:
        return
    result, element = core.types[result_type], core.types[element_type]
    general = element.kind == ANY or (element.kind == OBJECT_TYPE and element.of in program.kinds[result.of])
    if result.kind != OBJECT_TYPE or not general:
        raise BlockError("the target of a ticket cannot hold the result of its portal", word=place)
