"""Local portal calls: a thread in the resource's block, values copied both ways (chapter IV)."""

from __future__ import annotations

from collections.abc import Callable

from msgspec import Struct

from lfield.bytecode.program import REFERENCES, SOURCE, TRACE
from lfield.vm.agent import Agent, TeamMember
from lfield.vm.engine_interface import Trap
from lfield.vm.inspection import traceback
from lfield.vm.memory.block import Block, HeapFull
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
from lfield.vm.memory.serialised_results import serialise_built, serialise_object, serialise_word
from lfield.vm.memory.threads import count, only_thread, place_of
from lfield.vm.pending_call import PendingCall
from lfield.vm.scheduler import Scheduler

_RESTARTED = (
    "{0} has restarted since this proxy last called it: its fields have their initial values; this call has "
    "not begun"
)


def call(
    scheduler: Scheduler,
    member: TeamMember,
    caller: Agent,
    thread: int,
    method: int,
    words: list[int],
    reservation: int,
) -> None:
    """A `pcall` to a resource of this host, whose proxy is the first word: start its portal.

    `reservation` is the number of the caller's reservation, 0 for none.
    """
    try:
        resource = target_resource(scheduler, member, caller, words[0], method)
        w = caller.block.w
        # The caller is a coordinator, with a single thread.
        w[w[W_THREADS] + THREAD_STATE] = CALLING
        if not resource.open:
            resource.waiting.append((caller, thread))
            return
        if (reservation or resource.reserved) and not is_served(scheduler, resource, caller, reservation):
            return
        acts = method in scheduler.effectful_methods
        if (caller.fenced or (acts and not caller.is_persisted)) and not _may_start(scheduler, caller, acts):
            return
        served = start_call(scheduler, resource, caller, (caller, thread), method, words)
    except Trap as trap:
        scheduler.throw_builtin(caller, thread, trap.kind, trap.message, member.id)
        return
    if scheduler.hooks.stubs:
        serve(scheduler, resource, served, method, scheduler.run_queue.push_ready_front)
    else:
        scheduler.run_queue.push_ready_front(resource, served)


def live_resource(scheduler: Scheduler, member: TeamMember) -> Agent:
    """A live resource of this host. Raises Trap if the resource has died."""
    resource = scheduler.agents.get(member.id)
    if resource is None or resource.ended:
        reason = f"it died of {resource.report.splitlines()[0]}" if resource else "its host does not run it"
        raise Trap("UnreachableResourceException", f"{member.id} is not available: {reason}")
    return resource


def target_resource(
    scheduler: Scheduler, member: TeamMember, caller: Agent, proxy: int, method: int
) -> Agent:
    """The resource of this host that a proxy refers to, if it serves this caller. Raises Trap otherwise.

    Only this function checks rules. A copy older than the newest served one is refused. A proxy that was last
    called in another incarnation of this host throws an exception first, because the fields of its resource
    are lost.
    """
    resource = scheduler.agents.get(member.id)
    if resource is None or resource.ended:
        resource = live_resource(scheduler, member)
    if (rules := scheduler.hooks.rules) is not None and (reason := rules(caller.id, member.id, method)):
        raise Trap("AccessException", reason)
    w, start = caller.block.w, proxy + PROXY_START
    copy = w[W_GENERATION], w[W_SEQUENCE]
    if copy < resource.newest_callers.get(caller.id, copy) and (
        reason := _outdated_reason(scheduler, resource, caller, copy)
    ):
        raise Trap("UnreachableResourceException", reason)
    incarnation = w[start]
    if incarnation and incarnation != scheduler.incarnation:
        w[start] = scheduler.incarnation
        raise Trap("RestartException", _RESTARTED.format(member.id))
    return resource


def _outdated_reason(scheduler: Scheduler, resource: Agent, caller: Agent, copy: tuple[int, int]) -> str:
    """The reason why a copy older than the newest is refused; '' when the newest is of a stopped start."""
    generation, _ = resource.newest_callers[caller.id]
    if generation == copy[0]:
        stage = "copy"
    elif scheduler.world.is_superseded(caller.id, generation):
        return ""
    else:
        stage = "start"
    return f"a later {stage} of {caller.id} has called {resource.id}: this older one is no longer served"


def is_served(scheduler: Scheduler, resource: Agent, caller: Agent, reservation: int) -> bool:
    """Whether reservations permit a portal to start; otherwise its caller is suspended.

    Raises Trap if they will never permit it.
    """
    if not resource.reserved and not reservation:
        return True
    caller.freeze()
    try:
        served = scheduler.world.may_serve(caller, resource.member, reservation)
    except Trap:
        caller.resume()
        raise
    if served:
        # Otherwise the caller is suspended, or may have been released already.
        caller.resume()
    return served


def _may_start(scheduler: Scheduler, caller: Agent, acts: bool) -> bool:
    """Whether the portal may start now; else its caller (fenced, or not yet on disk) is suspended."""
    caller.freeze()
    may = scheduler.world.may_start_call(caller, acts)
    if may:
        # Otherwise the caller is suspended, or was released already.
        caller.resume()
    return may


def start_call(
    scheduler: Scheduler,
    resource: Agent,
    caller: Agent,
    waits: tuple[Agent, int] | PendingCall,
    method: int,
    words: list[int],
) -> int:
    """Copy the arguments and create the portal's thread, which is not queued yet; returns its id.

    The proxy is the first of the words; `waits` receives the result. Raises Trap at a limit.
    """
    limit = resource.limits.threads
    places = resource.block.places
    if (count(resource.block) if places is None else len(places)) >= limit:
        raise Trap("LimitException", f"{resource.id} already serves its limit of {limit} threads")
    number = next(scheduler.call_numbers)
    try:
        served = _thread(scheduler, resource, caller, method, words, number)
    except HeapFull:
        served = scheduler.run_with_collection(
            resource, lambda: _thread(scheduler, resource, caller, method, words, number)
        )
    scheduler.calls[number] = waits
    caller.block.w[words[0] + PROXY_START] = scheduler.incarnation
    resource.start_call_of(caller)
    if scheduler.hooks.observer is not None:
        scheduler.hooks.observer.on_call_started(resource, served, number, method, caller.id)
    return served


def _thread(
    scheduler: Scheduler, resource: Agent, caller: Agent, method: int, words: list[int], number: int
) -> int:
    """The thread of a portal, with copies of its arguments. Raises HeapFull."""
    block, into = resource.block, words.copy()
    if references := scheduler.reference_arguments[method]:
        roots = [words[i] for i in references]
        copies = deep_copy(caller.block, roots, block, scheduler.layouts)
        for i, place in zip(references, copies, strict=True):
            into[i] = place
    into[0] = block.w[W_SELF]
    return block.new_thread(scheduler.templates[method], into, number)


def serve(
    scheduler: Scheduler,
    resource: Agent,
    served: int,
    method: int,
    turn: Callable[[Agent, int], None],
) -> None:
    """Run a started portal in its `turn`, or let the stub of its resource answer.

    The thread then stays at the first instruction of the portal, outside any handler: exceptions go to the
    caller, and the portal can be cancelled like any other.
    """
    stand_in = scheduler.hooks.stubs.get(resource.id)
    if stand_in is None:
        turn(resource, served)
        return
    scheduler.set_state(resource, served, CALLING)
    entry = scheduler.program.core.methods[method].entry
    resource.block.w[place_of(resource.block, served) + THREAD_PC] = entry
    stand_in(_StubCall(scheduler, resource, served, method))


class _StubCall(Struct, frozen=True):
    """A call that is answered by a stub (`hooks.StubCall`)."""

    scheduler: Scheduler
    resource: Agent
    thread: int
    method: int

    def return_result(self, make: Callable[[Block], int]) -> None:
        """End the call with the result that `make` creates in the resource's block."""
        scheduler, resource = self.scheduler, self.resource
        if not self._is_pending:
            return
        try:
            word = scheduler.run_with_collection(resource, lambda: make(resource.block))
        except Trap as trap:
            self.throw(trap.kind, trap.message)
            return
        number = resource.block.w[place_of(resource.block, self.thread) + THREAD_CALL]
        finish(scheduler, resource, self.thread, number, word)

    def throw(self, kind: str, message: str) -> None:
        """End the call by a built-in exception."""
        if self._is_pending:
            self.scheduler.throw_builtin(self.resource, self.thread, kind, message, self.resource.id)

    @property
    def _is_pending(self) -> bool:
        return not self.resource.ended and place_of(self.resource.block, self.thread) != 0


def finish(scheduler: Scheduler, resource: Agent, thread: int, number: int, word: int) -> None:
    """A portal returned: its caller gets a copy of the result, if it still waits."""
    if number in scheduler.resource_queries:
        scheduler.resource_queries.pop(number)(word, 0)
        scheduler.forget(resource, thread)
        return
    resource.count_served()
    if scheduler.hooks.observer is not None:
        scheduler.hooks.observer.on_call_returned(resource, number, word)
    waits = scheduler.calls.get(number)
    if waits is not None:
        if isinstance(waits, PendingCall):
            _complete_pending(scheduler, resource, waits, word)
        else:
            _return(scheduler, resource, waits[0], waits[1], word)
        # Up to this point, a waiter would be informed of the resource's end.
        del scheduler.calls[number]
    scheduler.forget(resource, thread)


def _complete_pending(scheduler: Scheduler, resource: Agent, pending: PendingCall, word: int) -> None:
    """Store the result of a pending call until its coordinator fetches it."""
    core = scheduler.program.core
    if word and core.types[core.methods[pending.method].result].kind in REFERENCES:
        parcel = serialise_object(resource.block, word, scheduler.program.digest, scheduler.layouts)
    else:
        parcel = serialise_word(word)
    scheduler.complete_pending(pending, "done", parcel)


def _return(scheduler: Scheduler, resource: Agent, caller: Agent, waiter: int, word: int) -> None:
    if caller.expiry_message:
        scheduler.throw_expired(caller, waiter, resource.id)
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
        scheduler.run_queue.push_ready_front(caller, waiter)


def fail(scheduler: Scheduler, resource: Agent, thread: int, number: int, thrown: int) -> None:
    """A portal threw: its caller, if it waits, gets a copy of the object with its trace."""
    if number in scheduler.resource_queries:
        scheduler.resource_queries.pop(number)(0, thrown)
    else:
        _failed(scheduler, resource, thread, number, thrown)
    scheduler.forget(resource, thread)
    scheduler.release_monitor(resource, thread)


def _failed(scheduler: Scheduler, resource: Agent, thread: int, number: int, thrown: int) -> None:
    resource.count_served()
    if scheduler.hooks.observer is not None:
        scheduler.hooks.observer.on_call_threw(resource, number, thrown)
    if number in scheduler.calls:
        _throw(scheduler, resource, thread, number, thrown)


def _throw(scheduler: Scheduler, resource: Agent, thread: int, number: int, thrown: int) -> None:
    waits = scheduler.calls[number]
    name, message, trace = traceback.describe(resource.block, scheduler.program, thrown)
    place = place_of(resource.block, thread)
    lines = traceback.lines(resource.block, scheduler.program, place, trace)
    trace_lines = [_with_resource(line, resource.id) for line in trace.splitlines()]
    full_trace = "\n".join([*trace_lines, *(f"    {line} in {resource.id}" for line in lines)])

    def copy(block: Block) -> int:
        copied = deep_copy(resource.block, [thrown], block, scheduler.layouts)[0]
        if block.w[copied] >> 8 & 0xFFFFFF < scheduler.program.builtins:
            block.w[copied + 1 + TRACE] = block.new_string(full_trace)
            about = _source_of(block.text(block.w[copied + 1 + SOURCE]), resource.id)
            block.w[copied + 1 + SOURCE] = block.new_string(about)
        return copied

    if isinstance(waits, PendingCall):
        waits.failure = f"{name}: {message}"
        scheduler.complete_pending(waits, "thrown", serialise_built(scheduler.program.digest, copy))
    else:
        _rethrow(scheduler, resource, *waits, copy)
    del scheduler.calls[number]


def _source_of(about: str, resource: str) -> str:
    """The source of an exception for callers: the resource, or one of its devices."""
    known = about == resource or about.startswith(f"{resource}.")
    return about if known else f"{resource}.{about}" if about else resource


def _with_resource(line: str, resource: str) -> str:
    """A line of a trace with its resource, which is missing in the note of a `finally`."""
    return line if " in " in line.rpartition(")")[2] else f"{line} in {resource}"


def _rethrow(
    scheduler: Scheduler, resource: Agent, caller: Agent, waiter: int, copy: Callable[[Block], int]
) -> None:
    if caller.expiry_message:
        scheduler.throw_expired(caller, waiter, resource.id)
        return
    try:
        copied = scheduler.run_with_collection(caller, lambda: copy(caller.block))
    except Trap as trap:
        scheduler.throw_builtin(caller, waiter, trap.kind, trap.message, resource.id)
    else:
        scheduler.throw(caller, waiter, copied)


def detach_caller(scheduler: Scheduler, caller: Agent) -> bool:
    """Detach the waiting caller of a portal call; its result will be dropped. Returns False without a waiting
    caller.
    """
    return (
        leave_init_queue(scheduler, caller)
        or scheduler.calls.pop(call_number(scheduler, caller), None) is not None
    )


def leave_init_queue(scheduler: Scheduler, caller: Agent) -> bool:
    """Remove a coordinator from the queue of a resource whose init is running; false if it was not in the
    queue.
    """
    thread = only_thread(caller.block)
    return any(resource.remove_waiting(caller, thread) for resource in scheduler.agents.values())


def call_number(scheduler: Scheduler, caller: Agent) -> int:
    """The number of the portal call that a coordinator waits for, 0 for none."""
    calls = scheduler.calls.items()
    return next((n for n, waits in calls if not isinstance(waits, PendingCall) and waits[0] is caller), 0)
