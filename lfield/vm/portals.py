"""Portal calls on this host: a thread in the resource's block, values copied both ways (chapter IV)."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from lfield.bytecode.program import BUILTIN_CLASSES, REFERENCES, TRACE
from lfield.vm.inspect import traceback
from lfield.vm.memory.copier import deep_copy
from lfield.vm.memory.layout import CALLING, THREAD_CALL, THREAD_PC, W_SELF, W_THREADS
from lfield.vm.reference.registers import Trap
from lfield.vm.threads import count, place_of, threads

if TYPE_CHECKING:
    from lfield.vm.agent import Agent
    from lfield.vm.machine import Machine


def call(machine: Machine, caller: Agent, thread: int, method: int, words: list[int]) -> None:
    """A `pcall` whose first word is a proxy: begin the portal here, or send the coordinator on its way."""
    member = machine.team[caller.block.w[words[0] + 1]]
    if member.host != machine.here:
        machine.freeze(caller, thread)
        machine.world.depart(caller, member)
        return
    resource = machine.agents.get(member.id)
    if resource is None or resource.ended:
        why = f"it died of {resource.report.splitlines()[0]}" if resource else "its host does not run it"
        machine.refuse(
            caller, thread, "UnreachableResourceException", f"{member.id} is gone: {why}", member.id
        )
        return
    machine.set_state(caller, thread, CALLING)
    if not resource.open:
        resource.waiting.append((caller, thread))
        return
    try:
        served = begin(machine, resource, caller, thread, method, words)
    except Trap as trap:
        machine.refuse(caller, thread, trap.kind, trap.message, member.id)
        return
    machine.turns.next(resource, served)


def begin(
    machine: Machine, resource: Agent, caller: Agent, thread: int, method: int, words: list[int]
) -> int:
    """Copy the arguments and make the portal's thread; returns its id. Raises Trap at a limit."""
    limit = resource.limits.threads
    if count(resource.block) >= limit:
        raise Trap("LimitException", f"{resource.id} serves its limit of {limit} threads")
    machine.last_call += 1
    number = machine.last_call
    references = machine.reference_arguments(method)

    def work() -> int:
        block = resource.block
        into = list(words)
        if references:
            roots = [words[i] for i in references]
            copies = deep_copy(caller.block, roots, block, machine.layouts)
            for i, place in zip(references, copies, strict=True):
                into[i] = place
        into[0] = block.w[W_SELF]
        return machine.spawn(resource, method, into, number)

    served = machine.with_room(resource, work)
    machine.calls[number] = (caller, thread)
    return served


def finish(machine: Machine, resource: Agent, thread: int, number: int, word: int) -> None:
    """A portal returned: its caller goes on with a copy of the result."""
    caller, waiter = machine.calls.pop(number)
    resource.served += 1
    place = machine.place(caller, waiter)
    group = machine.engine.group(caller.block.w[place + THREAD_PC])
    if group.kind in REFERENCES and word:
        machine.complete(
            caller, waiter, lambda: deep_copy(resource.block, [word], caller.block, machine.layouts)[0]
        )
    else:
        machine.engine.complete(caller.block, place, word)
        machine.turns.next(caller, waiter)
    machine.forget(resource, thread)


def fail(machine: Machine, resource: Agent, thread: int, number: int, thrown: int) -> None:
    """A portal threw: its caller gets a copy of the object, with the lines it came from."""
    caller, waiter = machine.calls.pop(number)
    resource.served += 1
    lines = traceback.lines(resource.block, machine.program, place_of(resource.block, thread))

    def work() -> int:
        block = caller.block
        copy = deep_copy(resource.block, [thrown], block, machine.layouts)[0]
        if block.w[copy] >> 8 & 0xFFFFFF < len(BUILTIN_CLASSES):
            text = block.text(block.w[copy + 1 + TRACE])
            here = "\n".join(f"    {line} in {resource.id}" for line in lines)
            block.w[copy + 1 + TRACE] = block.new_string(f"{text}\n{here}" if text else here)
        return copy

    try:
        copied = machine.with_room(caller, work)
    except Trap as trap:
        machine.refuse(caller, waiter, trap.kind, trap.message, resource.id)
    else:
        machine.throw(caller, waiter, copied)
    machine.forget(resource, thread)
    machine.give_back(resource, thread)


def abandoned(machine: Machine, resource: Agent) -> Iterator[tuple[Agent, int]]:
    """Everybody who waits for a resource that has just died."""
    yield from resource.waiting
    resource.waiting = []
    if resource.member.kind != "resource" or not resource.block.w[W_THREADS]:
        return
    for place in list(threads(resource.block)):
        number = resource.block.w[place + THREAD_CALL]
        if number in machine.calls:
            yield machine.calls.pop(number)
