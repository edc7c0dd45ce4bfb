"""Portal calls on this host: a thread in the resource's block, values copied both ways (chapter IV)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from lfield.bytecode.program import REFERENCES, SOURCE, TRACE
from lfield.vm.agent import Agent, Member
from lfield.vm.begun import Begun
from lfield.vm.contract import Trap
from lfield.vm.inspect import traceback
from lfield.vm.memory.block import Block, Full
from lfield.vm.memory.copier import deep_copy
from lfield.vm.memory.layout import (
    CALLING,
    PROXY_START,
    READY,
    THREAD_CALL,
    THREAD_PC,
    THREAD_STATE,
    W_GENERATION,
    W_SELF,
    W_SEQUENCE,
    W_THREADS,
)
from lfield.vm.memory.parcels import parcel_made, parcel_of, plain_parcel
from lfield.vm.memory.threads import count, new_thread, place_of, threads
from lfield.vm.scheduler import Scheduler

_RESTARTED = (
    "{0} was started again since this proxy last called it: its fields are as new; this call has not begun"
)


def call(
    scheduler: Scheduler,
    member: Member,
    caller: Agent,
    thread: int,
    method: int,
    words: list[int],
    reservation: int,
) -> None:
    """A `pcall` to a resource of this host, whose proxy is the first word: begin its portal.

    `reservation` is the number by which the caller has reserved it, 0 when it has not.
    """
    try:
        resource = called(scheduler, member, caller, words[0], method)
    except Trap as trap:
        scheduler.refuse(caller, thread, trap.kind, trap.message, member.id)
        return
    w = caller.block.w
    # Who calls is a coordinator, and has no other thread.
    w[w[W_THREADS] + THREAD_STATE] = CALLING
    if not resource.open:
        resource.waiting.append((caller, thread))
        return
    try:
        if (reservation or resource.reserved) and not serves(scheduler, resource, caller, reservation):
            return
        acts = method in scheduler.acting
        if (caller.fenced or (acts and not caller.kept)) and not _may_begin(scheduler, caller, acts):
            return
        served = begin(scheduler, resource, caller, (caller, thread), method, words)
    except Trap as trap:
        scheduler.refuse(caller, thread, trap.kind, trap.message, member.id)
        return
    if scheduler.attached.stand_ins:
        serve(scheduler, resource, served, method, scheduler.turns.soon)
    else:
        scheduler.turns.soon(resource, served)


def living(scheduler: Scheduler, member: Member) -> Agent:
    """A resource of this host; raises Trap when it is gone."""
    resource = scheduler.agents.get(member.id)
    if resource is None or resource.ended:
        why = f"it died of {resource.report.splitlines()[0]}" if resource else "its host does not run it"
        raise Trap("UnreachableResourceException", f"{member.id} is gone: {why}")
    return resource


def called(scheduler: Scheduler, member: Member, caller: Agent, proxy: int, method: int) -> Agent:
    """The resource of this host that a proxy leads to, if it serves this caller; else raises Trap.

    Rules are asked here, and nowhere else. A copy older than the newest that was served is refused. A proxy
    that was called in another life of this host is told first: the fields of its resource are lost.
    """
    resource = scheduler.agents.get(member.id)
    if resource is None or resource.ended:
        resource = living(scheduler, member)
    if (rules := scheduler.attached.rules) is not None and (why := rules(caller.id, member.id, method)):
        raise Trap("AccessException", why)
    w, start = caller.block.w, proxy + PROXY_START
    copy = w[W_GENERATION], w[W_SEQUENCE]
    if copy < resource.callers.get(caller.id, copy) and (why := _outdated(scheduler, resource, caller, copy)):
        raise Trap("UnreachableResourceException", why)
    life = w[start]
    if life and life != scheduler.life:
        w[start] = scheduler.life
        raise Trap("RestartException", _RESTARTED.format(member.id))
    return resource


def _outdated(scheduler: Scheduler, resource: Agent, caller: Agent, copy: tuple[int, int]) -> str:
    """Why a copy older than the newest is not served; '' when the newest is of a start that was stopped."""
    generation, _ = resource.callers[caller.id]
    if generation == copy[0]:
        what = "copy"
    elif scheduler.world.superseded(caller.id, generation):
        return ""
    else:
        what = "start"
    return f"a later {what} of {caller.id} has called {resource.id}: this one is not served any more"


def serves(scheduler: Scheduler, resource: Agent, caller: Agent, reservation: int) -> bool:
    """Whether a reservation, the caller's or somebody else's, lets a portal begin; else its caller is frozen.

    Raises Trap when it never will.
    """
    if not resource.reserved and not reservation:
        return True
    caller.frozen = True
    try:
        served = scheduler.world.serves(caller, resource.member, reservation)
    except Trap:
        caller.frozen = False
        raise
    if served:
        # Else it is frozen, or may have been let go already.
        caller.frozen = False
    return served


def _may_begin(scheduler: Scheduler, caller: Agent, acts: bool) -> bool:
    """Whether the portal may begin now; else its caller is frozen until its host lets it call again.

    Only asked of who is fenced, or acts and is not kept.
    """
    caller.frozen = True
    if not scheduler.world.may_begin(caller, acts):
        return False
    caller.frozen = False
    return True


def begin(
    scheduler: Scheduler,
    resource: Agent,
    caller: Agent,
    waits: tuple[Agent, int] | Begun,
    method: int,
    words: list[int],
) -> int:
    """Copy the arguments and make the portal's thread, not yet in the queue; returns its id.

    The proxy is the first of the words; `waits` is who hears of the end. Raises Trap at a limit.
    """
    limit = resource.limits.threads
    if count(resource.block) >= limit:
        raise Trap("LimitException", f"{resource.id} serves its limit of {limit} threads")
    number = scheduler.last_call = scheduler.last_call + 1
    try:
        served = _thread(scheduler, resource, caller, method, words, number)
    except Full:
        served = scheduler.with_room(
            resource, lambda: _thread(scheduler, resource, caller, method, words, number)
        )
    scheduler.calls[number] = waits
    w = caller.block.w
    w[words[0] + PROXY_START] = scheduler.life
    resource.callers[caller.id] = w[W_GENERATION], w[W_SEQUENCE]
    caller.kept = False
    if scheduler.attached.watch is not None:
        scheduler.attached.watch.began(resource, served, number, method, caller.id)
    return served


def _thread(
    scheduler: Scheduler, resource: Agent, caller: Agent, method: int, words: list[int], number: int
) -> int:
    """The thread of a portal, with copies of its arguments; raises Full."""
    block, into = resource.block, words.copy()
    if references := scheduler.reference_arguments[method]:
        roots = [words[i] for i in references]
        copies = deep_copy(caller.block, roots, block, scheduler.layouts)
        for i, place in zip(references, copies, strict=True):
            into[i] = place
    into[0] = block.w[W_SELF]
    return new_thread(block, scheduler.templates[method], into, number)


def serve(
    scheduler: Scheduler,
    resource: Agent,
    served: int,
    method: int,
    turn: Callable[[Agent, int], None],
) -> None:
    """Let a portal that has begun have its `turn`, or be answered by what stands in for its resource.

    The thread then stays at the first instruction of the portal, where no handler is: what is thrown there
    goes to the caller, and it can be cancelled as any other.
    """
    stand_in = scheduler.attached.stand_ins.get(resource.id)
    if stand_in is None:
        turn(resource, served)
        return
    scheduler.set_state(resource, served, CALLING)
    entry = scheduler.program.core.methods[method].entry
    resource.block.w[place_of(resource.block, served) + THREAD_PC] = entry
    stand_in(_Call(scheduler, resource, served, method))


@dataclass(frozen=True, slots=True)
class _Call:
    """A call that something stands in for (`attached.Asked`)."""

    scheduler: Scheduler
    resource: Agent
    thread: int
    method: int

    def give(self, make: Callable[[Block], int]) -> None:
        """End it with the result that `make` puts into the resource's block."""
        scheduler, resource = self.scheduler, self.resource
        if not self._goes_on:
            return
        try:
            word = scheduler.with_room(resource, lambda: make(resource.block))
        except Trap as trap:
            self.throw(trap.kind, trap.message)
            return
        number = resource.block.w[place_of(resource.block, self.thread) + THREAD_CALL]
        finish(scheduler, resource, self.thread, number, word)

    def throw(self, kind: str, message: str) -> None:
        """End it by a built-in exception."""
        if self._goes_on:
            self.scheduler.refuse(self.resource, self.thread, kind, message, self.resource.id)

    @property
    def _goes_on(self) -> bool:
        return not self.resource.ended and place_of(self.resource.block, self.thread) != 0


def finish(scheduler: Scheduler, resource: Agent, thread: int, number: int, word: int) -> None:
    """A portal returned: its caller goes on with a copy of the result, if it still waits."""
    if number in scheduler.questions:
        scheduler.questions.pop(number)(word, 0)
        scheduler.forget(resource, thread)
        return
    resource.served += 1
    if scheduler.attached.watch is not None:
        scheduler.attached.watch.gave(resource, number, word)
    waits = scheduler.calls.get(number)
    if waits is not None:
        if isinstance(waits, Begun):
            _give(scheduler, resource, waits, word)
        else:
            _return(scheduler, resource, waits[0], waits[1], word)
        # Until here whoever waits would hear of the resource's end.
        del scheduler.calls[number]
    scheduler.forget(resource, thread)


def _give(scheduler: Scheduler, resource: Agent, begun: Begun, word: int) -> None:
    """What a begun call gives is put aside, until its coordinator fetches it."""
    core = scheduler.program.core
    if word and core.types[core.methods[begun.method].result].kind in REFERENCES:
        parcel = parcel_of(resource.block, word, scheduler.program.digest, scheduler.layouts)
    else:
        parcel = plain_parcel(word)
    scheduler.come_back(begun, "done", parcel)


def _return(scheduler: Scheduler, resource: Agent, caller: Agent, waiter: int, word: int) -> None:
    if caller.over:
        scheduler.refuse_over(caller, waiter, resource.id)
        return
    w = caller.block.w
    place = w[W_THREADS]
    if word and scheduler.engine.groups[w[place + THREAD_PC]].kind in REFERENCES:
        scheduler.complete(
            caller, waiter, lambda: deep_copy(resource.block, [word], caller.block, scheduler.layouts)[0]
        )
    else:
        scheduler.engine.complete(caller.block, place, word)
        w[place + THREAD_STATE] = READY
        scheduler.turns.soon(caller, waiter)


def fail(scheduler: Scheduler, resource: Agent, thread: int, number: int, thrown: int) -> None:
    """A portal threw: its caller gets a copy of the object, with the lines it came from, if it waits."""
    if number in scheduler.questions:
        scheduler.questions.pop(number)(0, thrown)
    else:
        _failed(scheduler, resource, thread, number, thrown)
    scheduler.forget(resource, thread)
    scheduler.give_back(resource, thread)


def _failed(scheduler: Scheduler, resource: Agent, thread: int, number: int, thrown: int) -> None:
    resource.served += 1
    if scheduler.attached.watch is not None:
        scheduler.attached.watch.threw(resource, number, thrown)
    if number in scheduler.calls:
        _throw(scheduler, resource, thread, number, thrown)


def _throw(scheduler: Scheduler, resource: Agent, thread: int, number: int, thrown: int) -> None:
    waits = scheduler.calls[number]
    trace = traceback.describe(resource.block, scheduler.program, thrown)[2]
    place = place_of(resource.block, thread)
    lines = traceback.lines(resource.block, scheduler.program, place, trace)
    noted = [_placed(line, resource.id) for line in trace.splitlines()]
    here = "\n".join([*noted, *(f"    {line} in {resource.id}" for line in lines)])

    def copy(block: Block) -> int:
        copied = deep_copy(resource.block, [thrown], block, scheduler.layouts)[0]
        if block.w[copied] >> 8 & 0xFFFFFF < scheduler.program.builtins:
            block.w[copied + 1 + TRACE] = block.new_string(here)
            about = _whose(block.text(block.w[copied + 1 + SOURCE]), resource.id)
            block.w[copied + 1 + SOURCE] = block.new_string(about)
        return copied

    if isinstance(waits, Begun):
        scheduler.come_back(waits, "thrown", parcel_made(scheduler.program.digest, copy))
    else:
        _rethrow(scheduler, resource, *waits, copy)
    del scheduler.calls[number]


def _whose(about: str, resource: str) -> str:
    """What an exception is about, for those outside: the resource, or a device of it."""
    known = about == resource or about.startswith(f"{resource}.")
    return about if known else f"{resource}.{about}" if about else resource


def _placed(line: str, resource: str) -> str:
    """A line of a trace with the resource that it was in: what a `finally` has noted does not say it."""
    return line if " in " in line.rpartition(")")[2] else f"{line} in {resource}"


def _rethrow(
    scheduler: Scheduler, resource: Agent, caller: Agent, waiter: int, copy: Callable[[Block], int]
) -> None:
    if caller.over:
        scheduler.refuse_over(caller, waiter, resource.id)
        return
    try:
        copied = scheduler.with_room(caller, lambda: copy(caller.block))
    except Trap as trap:
        scheduler.refuse(caller, waiter, trap.kind, trap.message, resource.id)
    else:
        scheduler.throw(caller, waiter, copied)


def of_others(scheduler: Scheduler, resource: Agent, agent: str) -> bool:
    """Whether a portal call of anybody but that coordinator is under way in a resource.

    One that was taken from its caller is somebody else's: nothing is known of it any more. What the host asks
    is nobody's call.
    """
    if resource.ended:
        return False
    for place in threads(resource.block):
        number = resource.block.w[place + THREAD_CALL]
        if not number or number in scheduler.questions:
            continue
        waits = scheduler.calls.get(number)
        who = waits if waits is None or isinstance(waits, Begun) else waits[0]
        if who is None or who.id != agent:
            return True
    return False


def abandon(scheduler: Scheduler, caller: Agent) -> bool:
    """Nobody waits any more for the portal that was called, what it gives is dropped; false for none."""
    return withdraw(scheduler, caller) or scheduler.calls.pop(call_of(scheduler, caller), None) is not None


def withdraw(scheduler: Scheduler, caller: Agent) -> bool:
    """A coordinator waits no more for a resource whose init is still busy; false when it did not."""
    for resource in scheduler.agents.values():
        left = [(waiting, thread) for waiting, thread in resource.waiting if waiting is not caller]
        if len(left) < len(resource.waiting):
            resource.waiting = left
            return True
    return False


def call_of(scheduler: Scheduler, caller: Agent) -> int:
    """The number of the portal call that a coordinator waits for, 0 when there is none."""
    calls = scheduler.calls.items()
    return next((n for n, waits in calls if not isinstance(waits, Begun) and waits[0] is caller), 0)
