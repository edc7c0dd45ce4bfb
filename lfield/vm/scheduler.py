"""The agents of one host and their threads: what an answer, an exception or an end does to them.

It stands below portals and outside, which use its verbs, and knows neither; the machine joins them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TypeVar

from lfield.bytecode.acting import acting_methods
from lfield.bytecode.program import REFERENCES, Program
from lfield.clock import Clock
from lfield.vm.agent import Agent
from lfield.vm.begun import Begun, Key
from lfield.vm.contract import Trap
from lfield.vm.inspect import traceback
from lfield.vm.memory import layout
from lfield.vm.memory.block import Full
from lfield.vm.memory.collector import collect
from lfield.vm.memory.layout import CALLING, DEAD, THREAD_CALL, THREAD_PC, THREAD_STATE
from lfield.vm.memory.threads import new_thread, place_of, threads, unlink
from lfield.vm.memory.values import new_exception
from lfield.vm.reference import Engine
from lfield.vm.turns import Turns
from lfield.vm.world import World

T = TypeVar("T")


class Scheduler:
    """Agents by id, their turns, and the portal calls under way.

    `life` is the number of this life of the host. `failed(served, thread, call, thrown)` is told when the
    portal that a thread serves ends by an exception that nobody in it catches; `thrown` is the object's place
    in the block of `served`.
    """

    def __init__(
        self,
        program: Program,
        life: int,
        world: World,
        clock: Clock,
        failed: Callable[[Agent, int, int, int], None],
    ) -> None:
        self.program = program
        self.life = life
        self.world = world
        self.clock = clock
        self.engine = Engine(program, clock.monotonic)
        self.layouts = self.engine.layouts
        self.agents: dict[str, Agent] = {}
        #: The portals whose callers are kept first: they may change something.
        self.acting = acting_methods(program)
        #: The portal calls under way: for each number, who waits for it.
        self.calls: dict[int, tuple[Agent, int]] = {}
        #: The calls that a `together` has begun here, until they are fetched.
        self.begun: dict[Key, Begun] = {}
        #: The number of the last portal call that began.
        self.last_call = 0
        self.turns = Turns(clock)
        self._failed = failed
        self._reference_arguments: dict[int, tuple[int, ...]] = {}

    # --- where threads are ----------------------------------------------------------------------------

    def standing(self, agent: Agent, thread: int) -> int:
        """The instruction a thread stands at."""
        return agent.block.w[place_of(agent.block, thread) + THREAD_PC]

    def set_state(self, agent: Agent, thread: int, state: int) -> None:
        """Note in the block what the thread waits for."""
        agent.block.w[place_of(agent.block, thread) + THREAD_STATE] = state

    # --- beginning ------------------------------------------------------------------------------------

    def spawn(self, agent: Agent, method: int, words: list[int], call: int) -> int:
        """A thread of an agent, not yet in the queue; raises Full."""
        record = self.program.core.methods[method]
        frame = self.layouts.frame_words[method]
        entry = record.entry if record.synchronized else record.entry + 1
        return new_thread(agent.block, method, frame, entry, words, call)

    def reference_arguments(self, method: int) -> tuple[int, ...]:
        """Which arguments of a portal are references (1: the first after the resource itself)."""
        found = self._reference_arguments.get(method)
        if found is None:
            record, types = self.program.core.methods[method], self.program.core.types
            found = tuple(
                i for i in range(1, record.parameters + 1) if types[record.slots[i]].kind in REFERENCES
            )
            self._reference_arguments[method] = found
        return found

    def open(self, agent: Agent) -> None:
        """A resource came to its first pause: calls that waited for it begin."""
        if agent.open:
            return
        agent.open = True
        waiting, agent.waiting = agent.waiting, []
        for caller, thread in waiting:
            self.turns.last(caller, thread)

    # --- going on -------------------------------------------------------------------------------------

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

    def throw(self, agent: Agent, thread: int, thrown: int) -> None:
        """Throw the object at `thrown` where a thread stands."""
        agent.kept = False
        if self.engine.throw(agent.block, place_of(agent.block, thread), thrown):
            if agent.blocked:
                self.unblock(agent)
            self.turns.next(agent, thread)
        else:
            self.uncaught(agent, thread, thrown)

    def freeze(self, agent: Agent, thread: int) -> None:
        """Hold a coordinator at its portal call."""
        self.set_state(agent, thread, CALLING)
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
        """Do work that may raise Full, after a collection if it must; raises Trap at the limit."""
        try:
            return work()
        except Full as full:
            words = full.words
        while True:
            collect(agent.block, self.layouts, words)
            if agent.block.top + words > agent.block.limit:
                raise Trap(
                    "LimitException", f"the heap of {agent.id} is over its limit of {agent.limits.heap} bytes"
                )
            try:
                return work()
            except Full as full:
                words += full.words

    # --- ending ---------------------------------------------------------------------------------------

    def uncaught(self, agent: Agent, thread: int, thrown: int) -> None:
        """Nobody in the thread catches what was thrown: its portal fails, or else the agent dies."""
        call = agent.block.w[place_of(agent.block, thread) + THREAD_CALL]
        if call:
            self.flush(agent, thread)
            self._failed(agent, thread, call, thrown)
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
            lines += [f"    {line}" for line in traceback.lines(agent.block, self.program, place)]
            agent.block.w[place + THREAD_STATE] = DEAD
        agent.report = "\n".join(lines)
        agent.ended = "died"
        for waiting, waiter in self._abandoned(agent):
            self.refuse(
                waiting, waiter, "UnreachableResourceException", f"{agent.id} has died: {reason}", agent.id
            )
        if agent.member.kind == "coordinator":
            self.release(agent)
        self.world.ended(agent)

    def _abandoned(self, resource: Agent) -> Iterator[tuple[Agent, int]]:
        """Everybody who waits for a resource that has just died."""
        yield from resource.waiting
        resource.waiting = []
        if resource.member.kind != "resource" or not resource.block.w[layout.W_THREADS]:
            return
        for place in list(threads(resource.block)):
            number = resource.block.w[place + THREAD_CALL]
            if number in self.calls:
                yield self.calls.pop(number)

    def release(self, agent: Agent) -> None:
        """Forget a coordinator that has left or has ended."""
        if self.agents.get(agent.id) is agent:
            del self.agents[agent.id]

    def forget(self, agent: Agent, thread: int) -> None:
        """A thread of an agent that goes on has come to its end."""
        unlink(agent.block, thread)
        agent.polls.pop(thread, None)
        agent.asked.discard(thread)

    def flush(self, agent: Agent, thread: int) -> None:
        """Write what a thread has left of a line."""
        if rest := agent.lines.pop(thread, ""):
            self.world.write(agent, rest)
