"""Thread scheduler of one host's agents: completion, exceptions and termination.

Portals and host calls use its methods; the machine connects them.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import count
from typing import Literal, TypeVar

from lfield.bytecode.program import DEVICE, REFERENCES, MethodRecord, Program
from lfield.bytecode.side_effects import effectful_methods
from lfield.clock import Clock
from lfield.vm.agent import STOPPED, Agent
from lfield.vm.engine_interface import Engines, Trap
from lfield.vm.hooks import VmHooks
from lfield.vm.host_interface import HostInterface
from lfield.vm.inspection import traceback
from lfield.vm.memory import layout
from lfield.vm.memory.block import Block, HeapFull
from lfield.vm.memory.collector import collect
from lfield.vm.memory.layout import (
    CALLING,
    DEAD,
    OBJECT,
    THREAD_CALL,
    THREAD_PC,
    THREAD_STATE,
    W_THREADS,
    Layouts,
)
from lfield.vm.memory.serialised_results import serialise_built
from lfield.vm.memory.threads import place_of, thread_template, threads, unlink
from lfield.vm.memory.word_codec import new_exception
from lfield.vm.pending_call import CallKey, PendingCall
from lfield.vm.reference.unwinder import is_of_stop
from lfield.vm.turns.run_queue import RunQueue

T = TypeVar("T")
#: Seconds after its time limit from which the end of a block is reported as late.
LATE_THRESHOLD = 0.2


class Scheduler:
    """Agents by id, their turns, and the portal calls in progress.

    `incarnation` is the incarnation of the host. `failed(self, served, thread, call, thrown)` is called when
    a portal ends by an uncaught exception; `thrown` is the place of the exception in the block of `served`.
    """

    def __init__(
        self,
        program: Program,
        incarnation: int,
        world: HostInterface,
        clock: Clock,
        failed: Callable[[Scheduler, Agent, int, int, int], None],
        engines: Engines,
        hooks: VmHooks,
    ) -> None:
        self.program = program
        self.incarnation = incarnation
        self.world = world
        self.clock = clock
        self.engine = engines(program, clock.monotonic)
        self.layouts = self.engine.layouts
        self.agents: dict[str, Agent] = {}
        #: Resources whose `init` has not reached its first pause.
        self.opening: dict[str, Agent] = {}
        #: Portals with side effects, whose callers are stored first.
        self.effectful_methods = effectful_methods(program)
        #: Portal calls in progress: by number, the waiting caller, or the record of a pending call that is
        #: fetched later.
        self.calls: dict[int, tuple[Agent, int] | PendingCall] = {}
        #: Queries of the host, by call number: each query is called with the result word, or the place of the
        #: exception.
        self.resource_queries: dict[int, Callable[[int, int], None]] = {}
        #: Calls of a `together` that were started here, until they are fetched.
        self.pending_calls: dict[CallKey, PendingCall] = {}
        #: The numbers for portal calls.
        self.call_numbers = count(1)
        self.run_queue = RunQueue(clock)
        self.hooks = hooks
        self._on_failed = failed
        #: By method, which arguments are references (1: the first after the object itself).
        self.reference_arguments = [_references(program, method) for method in program.core.methods]
        #: By method, the template of a thread that runs it.
        self.templates = _Templates(program, self.layouts)

    # --- time -----------------------------------------------------------------------------------------

    def clock_of(self, agent: Agent) -> int:
        """The time of a coordinator's own clock, in ns: its lifetime on all hosts."""
        return round(self.clock.monotonic() * 1e9) + agent.offset

    def set_clock(self, agent: Agent, now: int) -> None:
        """Set a coordinator's own clock."""
        agent.set_age(now, round(self.clock.monotonic() * 1e9))

    # --- positions of threads -------------------------------------------------------------------------

    def instruction_of(self, agent: Agent, thread: int) -> int:
        """The instruction at a thread's position."""
        return agent.block.w[place_of(agent.block, thread) + THREAD_PC]

    def set_state(self, agent: Agent, thread: int, state: int) -> None:
        """Record the state of a waiting thread in the block."""
        agent.block.w[place_of(agent.block, thread) + THREAD_STATE] = state

    # --- start ----------------------------------------------------------------------------------------

    def create_agent_object(self, agent: Agent, record: int) -> None:
        """The object of a new agent, of a class by index, and the thread of its init. Raises HeapFull.

        A stub has no such thread.
        """
        block, core = agent.block, self.program.core
        w = block.w
        w[layout.W_SELF] = block.allocate(OBJECT, record, self.layouts.class_words[record])
        numbers = count(1)
        for i, field in enumerate(core.classes[record].fields, w[layout.W_SELF] + 1):
            if field.type == DEVICE:
                w[i] = next(numbers)
        w[layout.W_ID] = block.new_string(agent.id)
        if agent.id in self.hooks.stubs:
            self.open(agent)
            return
        texts = (agent.id, *agent.member.arguments)
        init = core.classes[record].init
        kind = core.methods[init].slots[1]
        array = block.new_array(kind, core.plain_array(kind), len(texts))
        for i, text in enumerate(texts, layout.elements(w, array)[0]):
            w[i] = block.new_string(text)
        loops = [
            i for i, method in enumerate(core.methods) if (method.owner, method.kind) == (record, "ticks")
        ]
        block.require(sum(len(self.templates[method]) for method in (init, *loops)))
        identity = self.spawn(agent, init, [w[layout.W_SELF], array], 0)
        if loops:
            agent.add_loops({method: self.spawn(agent, method, [w[layout.W_SELF]], 0) for method in loops})
        self.run_queue.push_back(agent, identity)

    def spawn(self, agent: Agent, method: int, words: list[int], call: int) -> int:
        """A thread of an agent, not yet queued. Raises HeapFull."""
        return agent.block.new_thread(self.templates[method], words, call)

    def open(self, agent: Agent) -> None:
        """A resource reached its first pause: start the waiting calls."""
        if agent.open:
            return
        self.opening.pop(agent.id, None)
        for caller, thread in agent.finish_init(self.clock_of(agent)):
            self.run_queue.push_back(caller, thread)

    # --- continuation ---------------------------------------------------------------------------------

    def complete_at_once(self, agent: Agent, thread: int, word: int = 0) -> None:
        """Pass the result of an immediate instruction to a thread, which keeps its turn."""
        self.engine.complete(agent.block, place_of(agent.block, thread), word)
        self.run_queue.push_front(agent, thread)

    def complete(
        self, agent: Agent, thread: int, word: Callable[[], int], *, keeps_turn: bool = False
    ) -> None:
        """Pass the result of its instruction to a waiting thread, and queue the thread, at the front if it
        `keeps_turn`.
        """
        try:
            result = self.run_with_collection(agent, word)
        except Trap as trap:
            self.throw_builtin(agent, thread, trap.kind, trap.message)
            return
        self.engine.complete(agent.block, place_of(agent.block, thread), result)
        if keeps_turn:
            self.run_queue.push_front(agent, thread)
        else:
            self.run_queue.push_back(agent, thread)

    def throw_builtin(self, agent: Agent, thread: int, kind: str, message: str, source: str = "") -> None:
        """Throw a built-in exception at the position of a waiting thread."""
        if agent.ended:
            return
        try:
            thrown = self.run_with_collection(
                agent, lambda: new_exception(agent.block, self.layouts, kind, message, source)
            )
        except Trap:
            self.die(agent, f"{kind}: {message} (and the heap is too full to throw it)")
            return
        self.throw(agent, thread, thrown)

    def throw_expired(self, caller: Agent, thread: int, source: str) -> None:
        """After the end of a call that a time limit has cancelled: throw in its caller, with the delay."""
        late = (self.clock_of(caller) - caller.expired_at) / 1e9
        lateness = f", {late:.1f} s late: it took that long to end" if late >= LATE_THRESHOLD else ""
        self.throw_builtin(caller, thread, "TimeLimitException", f"{caller.expiry_message}{lateness}", source)

    def throw(self, agent: Agent, thread: int, thrown: int) -> None:
        """Throw the object at `thrown` at a thread's position."""
        agent.on_throw()
        if self.engine.throw(agent.block, place_of(agent.block, thread), thrown):
            if agent.blocked:
                self.unblock(agent)
            self.run_queue.push_front(agent, thread)
        else:
            self.uncaught(agent, thread, thrown)

    def freeze(self, agent: Agent, thread: int) -> None:
        """Suspend a coordinator, which has a single thread, at its portal call."""
        w = agent.block.w
        w[w[W_THREADS] + THREAD_STATE] = CALLING
        agent.freeze()

    def recheck_pollers(self, agent: Agent) -> None:
        """The block may have changed: let parked pollers check again."""
        for thread in agent.drain_pollers():
            self.run_queue.push_back(agent, thread)

    def unblock(self, agent: Agent) -> None:
        """Let threads that wait for the agent's monitor try again, if it is free."""
        if agent.block.w[layout.W_OWNER]:
            return
        for thread in agent.drain_blocked():
            self.run_queue.push_back(agent, thread)

    def release_monitor(self, agent: Agent, thread: int) -> None:
        """Release the monitor of a thread that ended by an exception."""
        w = agent.block.w
        if w[layout.W_OWNER] == thread:
            w[layout.W_OWNER] = w[layout.W_ENTRIES] = 0
            self.unblock(agent)

    def run_with_collection(self, agent: Agent, work: Callable[[], T]) -> T:
        """Execute `work`, which may raise HeapFull, again after each collection. Raises Trap at the limit.

        Each collection leaves at least twice the words known to be needed, so work of unknown size needs few
        collections.
        """
        while True:
            start = agent.block.top
            try:
                return work()
            except HeapFull as full:
                words = agent.block.missing_words(start, full)
            collect(agent.block, self.layouts, words)
            if agent.block.top + words > agent.block.limit:
                raise Trap(
                    "LimitException", f"the heap of {agent.id} is over its limit of {agent.limits.heap} bytes"
                )

    def collect_and_retry(self, agent: Agent, thread: int, words: int) -> None:
        """Collect garbage for an instruction that needs `words` more words, and repeat the instruction;
        otherwise throw.
        """
        block = agent.block
        collect(block, self.layouts, words)
        if block.top + words <= block.limit:
            self.run_queue.push_front(agent, thread)
            return
        message = f"the heap is over its limit of {agent.limits.heap} bytes"
        try:
            thrown = new_exception(block, self.layouts, "LimitException", message, agent.id)
        except HeapFull:
            self.die(agent, f"LimitException: {message}", thread)
            return
        self.throw(agent, thread, thrown)

    # --- end ------------------------------------------------------------------------------------------

    def uncaught(self, agent: Agent, thread: int, thrown: int) -> None:
        """An uncaught exception: the portal fails, or the agent dies."""
        call = agent.block.w[place_of(agent.block, thread) + THREAD_CALL]
        if call:
            self.flush(agent, thread)
            self._on_failed(self, agent, thread, call, thrown)
            return
        if agent.member.kind == "coordinator" and is_of_stop(agent.block, self.program, thrown):
            self.finish(agent, STOPPED)
            return
        name, message, trace = traceback.describe(agent.block, self.program, thrown)
        self.die(agent, f"{name}: {message}" if message else name, thread, trace)

    def finish(self, agent: Agent, report: str = "") -> None:
        """A coordinator has ended normally, or by a stop."""
        agent.end("done", report)
        self.release(agent)
        self.world.ended(agent)

    def die(
        self, agent: Agent, reason: str, thread: int = 0, trace: str = "", *, broken: bool = False
    ) -> None:
        """End an agent; its report has the reason and the stack. `broken`: a bug of lfield is the cause."""
        lines = [reason]
        if trace:
            lines += trace.splitlines()
        place = place_of(agent.block, thread) if thread else 0
        if place:
            lines += [f"    {line}" for line in traceback.lines(agent.block, self.program, place, trace)]
            agent.block.w[place + THREAD_STATE] = DEAD
        agent.die("\n".join(lines), broken=broken)
        self.opening.pop(agent.id, None)
        if self.hooks.observer is not None:
            self.hooks.observer.on_resource_died(agent, reason)
        self._fail_waiters(agent, f"{agent.id} has died: {reason}")
        if agent.member.kind == "coordinator":
            self.release(agent)
        self.world.ended(agent)

    def _fail_waiters(self, resource: Agent, message: str) -> None:
        """Throw in all callers of a resource that has died."""
        calls: list[tuple[Agent, int] | PendingCall] = [*resource.drain_waiting()]
        if resource.member.kind == "resource" and resource.block.w[layout.W_THREADS]:
            numbers = [resource.block.w[place + THREAD_CALL] for place in threads(resource.block)]
            calls += [self.calls.pop(number) for number in numbers if number in self.calls]
            for number in numbers:
                self.resource_queries.pop(number, None)
        for call in calls:
            if isinstance(call, PendingCall):
                self.fail_pending(call, "UnreachableResourceException", message, resource.id)
            else:
                self.throw_builtin(*call, "UnreachableResourceException", message, resource.id)

    def complete_pending(self, pending: PendingCall, state: Literal["done", "thrown"], result: bytes) -> None:
        """A pending call has ended: the host stores the result, and a waiter checks again."""
        if pending.state != "running":
            return
        pending.state, pending.result = state, result
        if not pending.dropped:
            self.world.on_call_completed(pending)
        self.wake_waiter(pending)

    def wake_waiter(self, pending: PendingCall) -> None:
        """A coordinator that waits for this call, or for the first of several, checks once more."""
        waiter, pending.waiter = pending.waiter, None
        if waiter is None:
            return
        if waiter[0].stop_waiting_for_any():
            for other in self.pending_calls.values():
                if other.waiter is not None and other.waiter[0] is waiter[0]:
                    other.waiter = None
        self.run_queue.push_front(*waiter)

    def fail_pending(self, pending: PendingCall, kind: str, message: str, source: str) -> None:
        """End a pending call by a built-in exception."""

        def make(block: Block) -> int:
            return new_exception(block, self.layouts, kind, message, source)

        pending.failure = f"{kind}: {message}"
        self.complete_pending(pending, "thrown", serialise_built(self.program.digest, make))

    def release(self, agent: Agent) -> None:
        """Remove a coordinator that has left or ended."""
        if self.agents.get(agent.id) is agent:
            del self.agents[agent.id]
        self.run_queue.cancel_alarms(agent)

    def forget(self, agent: Agent, thread: int) -> None:
        """Remove an ended thread of a live agent."""
        unlink(agent.block, thread)
        if agent.monitor_waits:
            agent.monitor_waits.pop(thread, None)
        if agent.poll_counts or agent.outward_pollers or agent.pending_cancels:
            agent.poll_counts.pop(thread, None)
            agent.outward_pollers.discard(thread)
            agent.pending_cancels.pop(thread, None)

    def end_line(self, agent: Agent, thread: int) -> None:
        """Write the rest of a thread's line as a line, because the thread waits for an answer to it."""
        if rest := agent.lines.pop(thread, ""):
            self.world.write(agent, f"{rest}\n")

    def flush(self, agent: Agent, thread: int) -> None:
        """Write the rest of a thread's line."""
        if rest := agent.lines.pop(thread, ""):
            self.world.write(agent, rest)


class _Templates(dict[int, "memoryview[int]"]):
    """Templates, created on first use."""

    def __init__(self, program: Program, layouts: Layouts) -> None:
        self._program, self._layouts = program, layouts

    def __missing__(self, method: int) -> memoryview[int]:
        record = self._program.core.methods[method]
        entry = record.entry if record.synchronized else record.entry + 1
        self[method] = template = thread_template(method, self._layouts.frame_words[method], entry)
        return template


def _references(program: Program, method: MethodRecord) -> tuple[int, ...]:
    types, slots = program.core.types, method.slots
    return tuple(i for i in range(1, method.parameters + 1) if types[slots[i]].kind in REFERENCES)
