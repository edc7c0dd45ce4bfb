"""The agents of one host and their threads: what an answer, an exception or an end does to them.

It stands below portals and outside, which use its verbs, and knows neither; the machine joins them.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import count
from typing import Literal, TypeVar

from lfield.bytecode.acting import acting_methods
from lfield.bytecode.program import DEVICE, REFERENCES, MethodRecord, Program
from lfield.clock import Clock
from lfield.vm.agent import Agent
from lfield.vm.attached import Attached
from lfield.vm.begun import Begun, Key
from lfield.vm.contract import Engines, Trap
from lfield.vm.inspect import traceback
from lfield.vm.memory import layout
from lfield.vm.memory.block import Block, Full
from lfield.vm.memory.collector import collect
from lfield.vm.memory.layout import (
    ARRAY,
    CALLING,
    DEAD,
    OBJECT,
    THREAD_CALL,
    THREAD_PC,
    THREAD_STATE,
    W_THREADS,
    Layouts,
)
from lfield.vm.memory.parcels import parcel_made
from lfield.vm.memory.threads import new_thread, place_of, thread_template, threads, unlink
from lfield.vm.memory.values import new_exception
from lfield.vm.turns import Turns
from lfield.vm.world import World

T = TypeVar("T")
#: A block that ends so many seconds after its time limit is told as late.
LATE = 0.2


class Scheduler:
    """Agents by id, their turns, and the portal calls under way.

    `life` is the number of this life of the host. `failed(self, served, thread, call, thrown)` is told when
    the portal that a thread serves ends by an exception that nobody in it catches; `thrown` is where it is
    in the block of `served`.
    """

    def __init__(
        self,
        program: Program,
        life: int,
        world: World,
        clock: Clock,
        failed: Callable[[Scheduler, Agent, int, int, int], None],
        engines: Engines,
    ) -> None:
        self.program = program
        self.life = life
        self.world = world
        self.clock = clock
        self.engine = engines(program, clock.monotonic)
        self.layouts = self.engine.layouts
        self.agents: dict[str, Agent] = {}
        #: Those of them whose `init` has not come to its first pause.
        self.opening: dict[str, Agent] = {}
        #: The portals whose callers are kept first: they may change something.
        self.acting = acting_methods(program)
        #: The portal calls under way: for each number, who waits for it, or the record of a call that was
        #: begun and is fetched later.
        self.calls: dict[int, tuple[Agent, int] | Begun] = {}
        #: The portals that the host itself has asked, by the number of the call: each is told the word that
        #: is given, or the place of what is thrown.
        self.questions: dict[int, Callable[[int, int], None]] = {}
        #: The calls that a `together` has begun here, until they are fetched.
        self.begun: dict[Key, Begun] = {}
        #: The number of the last portal call that began.
        self.last_call = 0
        self.turns = Turns(clock)
        self.attached = Attached()
        self._failed = failed
        #: By method, which arguments are references (1: the first after the object itself).
        self.reference_arguments = [_references(program, method) for method in program.core.methods]
        #: By method, what a thread that runs it looks like at first.
        self.templates = _Templates(program, self.layouts)

    # --- time -----------------------------------------------------------------------------------------

    def clock_of(self, agent: Agent) -> int:
        """The time of a coordinator's own clock, in ns: for how long it has lived, on all its hosts."""
        return round(self.clock.monotonic() * 1e9) + agent.offset

    def set_clock(self, agent: Agent, now: int) -> None:
        """Let a coordinator's own clock be this."""
        agent.offset = now - round(self.clock.monotonic() * 1e9)

    # --- where threads are ----------------------------------------------------------------------------

    def standing(self, agent: Agent, thread: int) -> int:
        """The instruction a thread stands at."""
        return agent.block.w[place_of(agent.block, thread) + THREAD_PC]

    def set_state(self, agent: Agent, thread: int, state: int) -> None:
        """Note in the block what the thread waits for."""
        agent.block.w[place_of(agent.block, thread) + THREAD_STATE] = state

    # --- beginning ------------------------------------------------------------------------------------

    def born(self, agent: Agent, record: int) -> None:
        """The object of a new agent, of a class by its index, and the thread of its init; raises Full.

        One that something stands in for has no such thread.
        """
        block, core = agent.block, self.program.core
        w = block.w
        w[layout.W_SELF] = block.allocate(OBJECT, record, self.layouts.class_words[record])
        numbers = count(1)
        for i, field in enumerate(core.classes[record].fields, w[layout.W_SELF] + 1):
            if field.type == DEVICE:
                w[i] = next(numbers)
        w[layout.W_ID] = block.new_string(agent.id)
        if agent.id in self.attached.stand_ins:
            self.open(agent)
            return
        texts = (agent.id, *agent.member.arguments)
        init = core.classes[record].init
        array = block.allocate(ARRAY, core.methods[init].slots[1], 1 + len(texts))
        for i, text in enumerate(texts, array + 1):
            w[i] = block.new_string(text)
        identity = self.spawn(agent, init, [w[layout.W_SELF], array], 0)
        self.turns.last(agent, identity)

    def spawn(self, agent: Agent, method: int, words: list[int], call: int) -> int:
        """A thread of an agent, not yet in the queue; raises Full."""
        return new_thread(agent.block, self.templates[method], words, call)

    def open(self, agent: Agent) -> None:
        """A resource came to its first pause: calls that waited for it begin."""
        if agent.open:
            return
        agent.open = True
        self.opening.pop(agent.id, None)
        waiting, agent.waiting = agent.waiting, []
        for caller, thread in waiting:
            self.turns.last(caller, thread)

    # --- going on -------------------------------------------------------------------------------------

    def go_on(self, agent: Agent, thread: int, word: int = 0) -> None:
        """Give a thread the word of a head that took no time: it keeps its turn."""
        self.engine.complete(agent.block, place_of(agent.block, thread), word)
        self.turns.next(agent, thread)

    def complete(self, agent: Agent, thread: int, word: Callable[[], int]) -> None:
        """Give a waiting thread the word its head asked for, and its turn."""
        try:
            result = self.with_room(agent, word)
        except Trap as trap:
            self.refuse(agent, thread, trap.kind, trap.message)
            return
        self.engine.complete(agent.block, place_of(agent.block, thread), result)
        self.turns.last(agent, thread)

    def refuse(self, agent: Agent, thread: int, kind: str, message: str, source: str = "") -> None:
        """Throw a built-in exception where a waiting thread stands."""
        if agent.ended:
            return
        try:
            thrown = self.with_room(
                agent, lambda: new_exception(agent.block, self.layouts, kind, message, source)
            )
        except Trap:
            self.die(agent, f"{kind}: {message} (and no room left to throw it)")
            return
        self.throw(agent, thread, thrown)

    def refuse_over(self, caller: Agent, thread: int, source: str) -> None:
        """A call that a time limit has cancelled has ended: its caller hears of it, and how late it is."""
        late = (self.clock_of(caller) - caller.over_at) / 1e9
        said = f", {late:.1f} s late since it took so long to end" if late >= LATE else ""
        self.refuse(caller, thread, "TimeLimitException", f"{caller.over}{said}", source)

    def throw(self, agent: Agent, thread: int, thrown: int) -> None:
        """Throw the object at `thrown` where a thread stands."""
        agent.kept = False
        agent.over = ""
        if self.engine.throw(agent.block, place_of(agent.block, thread), thrown):
            if agent.blocked:
                self.unblock(agent)
            self.turns.next(agent, thread)
        else:
            self.uncaught(agent, thread, thrown)

    def freeze(self, agent: Agent, thread: int) -> None:
        """Hold a coordinator, which has no other thread, at its portal call."""
        w = agent.block.w
        w[w[W_THREADS] + THREAD_STATE] = CALLING
        agent.frozen = True

    def stir(self, agent: Agent) -> None:
        """The block may have changed: what its parked pollers wait for may be so now."""
        agent.seen = b""
        waiting, agent.pollers = agent.pollers, set()
        for thread in sorted(waiting):
            self.turns.last(agent, thread)

    def unblock(self, agent: Agent) -> None:
        """Those who wait for the agent's monitor try again, if it is free."""
        if agent.block.w[layout.W_OWNER]:
            return
        waiting, agent.blocked = agent.blocked, []
        for thread in waiting:
            self.turns.last(agent, thread)

    def give_back(self, agent: Agent, thread: int) -> None:
        """Free the monitor that a thread held when it ended by an exception."""
        w = agent.block.w
        if w[layout.W_OWNER] == thread:
            w[layout.W_OWNER] = w[layout.W_ENTRIES] = 0
            self.unblock(agent)

    def with_room(self, agent: Agent, work: Callable[[], T]) -> T:
        """Do work that may raise Full, from its beginning after a collection; raises Trap at the limit.

        A collection leaves at least twice the room that the work is known to need, so of work that does not
        say it all at once, few are needed: it comes twice as far each time.
        """
        while True:
            start = agent.block.top
            try:
                return work()
            except Full as full:
                words = agent.block.lacking(start, full)
            collect(agent.block, self.layouts, words)
            if agent.block.top + words > agent.block.limit:
                raise Trap(
                    "LimitException", f"the heap of {agent.id} is over its limit of {agent.limits.heap} bytes"
                )

    def make_room(self, agent: Agent, thread: int, words: int) -> None:
        """A thread's instruction lacks so many words: it runs again when there are, else it throws."""
        block = agent.block
        collect(block, self.layouts, words)
        if block.top + words <= block.limit:
            self.turns.next(agent, thread)
            return
        message = f"the heap is over its limit of {agent.limits.heap} bytes"
        try:
            thrown = new_exception(block, self.layouts, "LimitException", message, agent.id)
        except Full:
            self.die(agent, f"LimitException: {message}", thread)
            return
        self.throw(agent, thread, thrown)

    # --- ending ---------------------------------------------------------------------------------------

    def uncaught(self, agent: Agent, thread: int, thrown: int) -> None:
        """Nobody in the thread catches what was thrown: its portal fails, or else the agent dies."""
        call = agent.block.w[place_of(agent.block, thread) + THREAD_CALL]
        if call:
            self.flush(agent, thread)
            self._failed(self, agent, thread, call, thrown)
            return
        name, message, trace = traceback.describe(agent.block, self.program, thrown)
        self.die(agent, f"{name}: {message}" if message else name, thread, trace)

    def die(self, agent: Agent, reason: str, thread: int = 0, trace: str = "") -> None:
        """End an agent: its report says what it died of and where it stood."""
        lines = [reason]
        if trace:
            lines += trace.splitlines()
        place = place_of(agent.block, thread) if thread else 0
        if place:
            lines += [f"    {line}" for line in traceback.lines(agent.block, self.program, place, trace)]
            agent.block.w[place + THREAD_STATE] = DEAD
        agent.report = "\n".join(lines)
        agent.ended = "died"
        self.opening.pop(agent.id, None)
        if self.attached.watch is not None:
            self.attached.watch.died(agent, reason)
        self._tell_of_death(agent, f"{agent.id} has died: {reason}")
        if agent.member.kind == "coordinator":
            self.release(agent)
        self.world.ended(agent)

    def _tell_of_death(self, resource: Agent, message: str) -> None:
        """Everybody who waits for a resource that has just died hears of it."""
        waiting, resource.waiting = resource.waiting, []
        calls: list[tuple[Agent, int] | Begun] = [*waiting]
        if resource.member.kind == "resource" and resource.block.w[layout.W_THREADS]:
            numbers = [resource.block.w[place + THREAD_CALL] for place in threads(resource.block)]
            calls += [self.calls.pop(number) for number in numbers if number in self.calls]
            for number in numbers:
                self.questions.pop(number, None)
        for call in calls:
            if isinstance(call, Begun):
                self.fail_begun(call, "UnreachableResourceException", message, resource.id)
            else:
                self.refuse(*call, "UnreachableResourceException", message, resource.id)

    def come_back(self, begun: Begun, state: Literal["done", "thrown"], parcel: bytes) -> None:
        """A call that was begun here has its end: the host keeps it, whoever waits here looks again."""
        if begun.state != "running":
            return
        begun.state, begun.parcel = state, parcel
        if not begun.dropped:
            self.world.came_back(begun)
        waiter, begun.waiter = begun.waiter, None
        if waiter is not None:
            self.turns.next(*waiter)

    def fail_begun(self, begun: Begun, kind: str, message: str, source: str) -> None:
        """A call that was begun here ends by a built-in exception."""

        def make(block: Block) -> int:
            return new_exception(block, self.layouts, kind, message, source)

        self.come_back(begun, "thrown", parcel_made(self.program.digest, make))

    def release(self, agent: Agent) -> None:
        """Forget a coordinator that has left or has ended."""
        if self.agents.get(agent.id) is agent:
            del self.agents[agent.id]
        self.turns.quiet(agent)

    def forget(self, agent: Agent, thread: int) -> None:
        """A thread of an agent that goes on has come to its end."""
        unlink(agent.block, thread)
        if agent.polls or agent.asked or agent.cancels:
            agent.polls.pop(thread, None)
            agent.asked.discard(thread)
            agent.cancels.pop(thread, None)

    def flush(self, agent: Agent, thread: int) -> None:
        """Write what a thread has left of a line."""
        if rest := agent.lines.pop(thread, ""):
            self.world.write(agent, rest)


class _Templates(dict[int, "memoryview[int]"]):
    """Made when they are first wanted."""

    def __init__(self, program: Program, layouts: Layouts) -> None:
        self._program, self._layouts = program, layouts

    def __missing__(self, method: int) -> memoryview[int]:
        record = self._program.core.methods[method]
        entry = record.entry if record.synchronized else record.entry + 1
        self[method] = made = thread_template(method, self._layouts.frame_words[method], entry)
        return made


def _references(program: Program, method: MethodRecord) -> tuple[int, ...]:
    types, slots = program.core.types, method.slots
    return tuple(i for i in range(1, method.parameters + 1) if types[slots[i]].kind in REFERENCES)
