"""Portal calls on this host: a thread in the resource's block, values copied both ways (chapter IV)."""

from __future__ import annotations

from lfield.bytecode.program import BUILTIN_CLASSES, REFERENCES, TRACE
from lfield.vm.agent import Agent, Member
from lfield.vm.contract import Trap
from lfield.vm.inspect import traceback
from lfield.vm.memory.copier import deep_copy
from lfield.vm.memory.layout import CALLING, THREAD_PC, W_SELF
from lfield.vm.memory.threads import count, place_of
from lfield.vm.scheduler import Scheduler


def call(
    scheduler: Scheduler, member: Member, caller: Agent, thread: int, method: int, words: list[int]
) -> None:
    """A `pcall` to a resource of this host, whose proxy is the first word: begin its portal."""
    resource = scheduler.agents.get(member.id)
    if resource is None or resource.ended:
        why = f"it died of {resource.report.splitlines()[0]}" if resource else "its host does not run it"
        scheduler.refuse(
            caller, thread, "UnreachableResourceException", f"{member.id} is gone: {why}", member.id
        )
        return
    scheduler.set_state(caller, thread, CALLING)
    if not resource.open:
        resource.waiting.append((caller, thread))
        return
    try:
        served = begin(scheduler, resource, caller, thread, method, words)
    except Trap as trap:
        scheduler.refuse(caller, thread, trap.kind, trap.message, member.id)
        return
    scheduler.turns.next(resource, served)


def begin(
    scheduler: Scheduler, resource: Agent, caller: Agent, thread: int, method: int, words: list[int]
) -> int:
    """Copy the arguments and make the portal's thread; returns its id. Raises Trap at a limit."""
    limit = resource.limits.threads
    if count(resource.block) >= limit:
        raise Trap("LimitException", f"{resource.id} serves its limit of {limit} threads")
    scheduler.last_call += 1
    number = scheduler.last_call
    references = scheduler.reference_arguments(method)

    def work() -> int:
        block = resource.block
        into = list(words)
        if references:
            roots = [words[i] for i in references]
            copies = deep_copy(caller.block, roots, block, scheduler.layouts)
            for i, place in zip(references, copies, strict=True):
                into[i] = place
        into[0] = block.w[W_SELF]
        return scheduler.spawn(resource, method, into, number)

    served = scheduler.with_room(resource, work)
    scheduler.calls[number] = (caller, thread)
    return served


def finish(scheduler: Scheduler, resource: Agent, thread: int, number: int, word: int) -> None:
    """A portal returned: its caller goes on with a copy of the result."""
    caller, waiter = scheduler.calls[number]
    resource.served += 1
    place = place_of(caller.block, waiter)
    group = scheduler.engine.group(caller.block.w[place + THREAD_PC])
    if group.kind in REFERENCES and word:
        scheduler.complete(
            caller, waiter, lambda: deep_copy(resource.block, [word], caller.block, scheduler.layouts)[0]
        )
    else:
        scheduler.engine.complete(caller.block, place, word)
        scheduler.turns.next(caller, waiter)
    # Until here whoever waits would hear of the resource's end.
    del scheduler.calls[number]
    scheduler.forget(resource, thread)


def fail(scheduler: Scheduler, resource: Agent, thread: int, number: int, thrown: int) -> None:
    """A portal threw: its caller gets a copy of the object, with the lines it came from."""
    caller, waiter = scheduler.calls[number]
    resource.served += 1
    lines = traceback.lines(resource.block, scheduler.program, place_of(resource.block, thread))

    def work() -> int:
        block = caller.block
        copy = deep_copy(resource.block, [thrown], block, scheduler.layouts)[0]
        if block.w[copy] >> 8 & 0xFFFFFF < len(BUILTIN_CLASSES):
            text = block.text(block.w[copy + 1 + TRACE])
            here = "\n".join(f"    {line} in {resource.id}" for line in lines)
            block.w[copy + 1 + TRACE] = block.new_string(f"{text}\n{here}" if text else here)
        return copy

    try:
        copied = scheduler.with_room(caller, work)
    except Trap as trap:
        scheduler.refuse(caller, waiter, trap.kind, trap.message, resource.id)
    else:
        scheduler.throw(caller, waiter, copied)
    del scheduler.calls[number]
    scheduler.forget(resource, thread)
    scheduler.give_back(resource, thread)
