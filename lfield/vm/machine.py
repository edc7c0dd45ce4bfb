"""The machine of one host: its agents, their threads, and whose turn it is.

A synchronous state machine: the host calls it (start, admit, answer, run), it calls the host's `World`.
Time is read from the clock it was given. `run` returns when nothing can run, and says until when.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Sequence
from typing import TypeVar

from lfield.bytecode.program import REFERENCES, Program
from lfield.clock import Clock
from lfield.errors import DeviceError
from lfield.manifest import DeviceValue
from lfield.vm import portals
from lfield.vm.agent import Agent, Member
from lfield.vm.exits import Blocked, Done, Exit, NoRoom, Outside, Spent, Thrown
from lfield.vm.inspect import traceback
from lfield.vm.limits import Limits
from lfield.vm.memory import layout
from lfield.vm.memory.block import Block, Full
from lfield.vm.memory.collector import collect, compact
from lfield.vm.memory.layout import (
    BLOCKED,
    CALLING,
    DEAD,
    OBJECT,
    THREAD_CALL,
    THREAD_ID,
    THREAD_PC,
    THREAD_STATE,
)
from lfield.vm.memory.liveness import Liveness
from lfield.vm.memory.soundness import Soundness
from lfield.vm.memory.values import word_for
from lfield.vm.offers import Shapes
from lfield.vm.outside import Outsiders
from lfield.vm.readings import Reading
from lfield.vm.reference import Engine
from lfield.vm.reference.registers import Trap
from lfield.vm.reference.run import new_exception
from lfield.vm.threads import new_thread, place_of, unlink
from lfield.vm.turns import Turns
from lfield.vm.world import World

#: Instructions a thread may run before the next one's turn.
SLICE = 2000
#: Slices one call of `run` gives before it lets the host look at the world.
ROUND = 20

T = TypeVar("T")


class Machine:
    """The agents of one host.

    `team` is every agent of the deployment in its order, `here` this host's number in it.
    """

    def __init__(
        self,
        program: Program,
        team: Sequence[Member],
        here: int,
        world: World,
        clock: Clock,
        dice: random.Random | None = None,
    ) -> None:
        self.program = program
        self.team = team
        self.here = here
        self.world = world
        self.clock = clock
        self.engine = Engine(program, clock.monotonic)
        self.layouts = self.engine.layouts
        self.dice = dice or random.Random()
        self.agents: dict[str, Agent] = {}
        #: The portal calls under way: for each number, who waits for it.
        self.calls: dict[int, tuple[Agent, int]] = {}
        self.last_call = 0
        self.turns = Turns(clock)
        self.shapes = Shapes(program)
        self._reference_arguments: dict[int, tuple[int, ...]] = {}
        self._outsiders = Outsiders(self)
        self._liveness = Liveness(program, self.layouts)
        self._soundness = Soundness(self.engine.prepared, [member.type for member in team])

    # --- agents come and go ---------------------------------------------------------------------------

    def start(self, member: Member, limits: Limits, generation: int) -> Agent:
        """Create an agent and the thread of its init; it runs at the next `run`."""
        record = self.program.class_index[member.type]
        block = Block.empty(self.program.digest, limits.heap // 8)
        readings: list[Reading | None] = [None] * len(self.program.core.device_calls)
        agent = Agent(member, block, limits, readings, open=member.kind == "coordinator")
        w = block.w
        w[layout.W_CLASS] = record
        w[layout.W_GENERATION] = generation
        block.visit(self.here)
        self.agents[member.id] = agent
        try:
            self.with_room(agent, lambda: self._begin(agent, record))
        except Trap as trap:
            self.die(agent, f"LimitException: {trap.message}")
        return agent

    def _begin(self, agent: Agent, record: int) -> None:
        block = agent.block
        w = block.w
        w[layout.W_SELF] = block.allocate(OBJECT, record, self.layouts.class_words[record])
        w[layout.W_ID] = block.new_string(agent.id)
        texts = (agent.id, *agent.member.arguments)
        init = self.program.core.classes[record].init
        strings = self.program.core.methods[init].slots[1]
        array = block.allocate(layout.ARRAY, strings, 1 + len(texts))
        for i, text in enumerate(texts, array + 1):
            w[i] = block.new_string(text)
        identity = self.spawn(agent, init, [w[layout.W_SELF], array], 0)
        self.turns.last(agent, identity)

    def admit(self, member: Member, image: bytes | memoryview, limits: Limits) -> Agent:
        """Inject a coordinator that came from another host; raises BlockError when its bytes are not sound.

        It goes on at its portal call, now here.
        """
        block = self._soundness.check(image, limits.heap // 8)
        block.w[layout.W_HOPS] += 1
        block.visit(self.here)
        agent = Agent(member, block, limits, [], open=True)
        self.agents[member.id] = agent
        self.turns.next(agent, block.w[block.w[layout.W_THREADS] + THREAD_ID])
        return agent

    def pack(self, agent: Agent) -> memoryview:
        """The bytes of a frozen coordinator, live data only."""
        self._liveness.clear_dead(agent.block)
        compact(agent.block, self.layouts)
        return agent.block.image()

    def release(self, agent: Agent) -> None:
        """Forget a coordinator that has left."""
        if self.agents.get(agent.id) is agent:
            del self.agents[agent.id]

    def resume(self, agent: Agent, kind: str, message: str, source: str = "") -> None:
        """Let a frozen coordinator go on with an exception in the statement that called the portal."""
        agent.frozen = False
        self.refuse(agent, agent.block.w[agent.block.w[layout.W_THREADS] + THREAD_ID], kind, message, source)

    # --- answers from the world -----------------------------------------------------------------------

    def answer(self, agent: Agent, thread: int, value: DeviceValue, kind: int, device: str) -> None:
        """The value (of a type, by index) of the device instruction a thread waits for."""
        if agent.ended:
            return
        try:
            self.complete(agent, thread, lambda: word_for(agent.block, self.program, kind, value, device))
        except DeviceError as error:
            self.refuse(agent, thread, error.kind, str(error), error.device)

    def refuse(self, agent: Agent, thread: int, kind: str, message: str, source: str = "") -> None:
        """Throw a built-in exception where a waiting thread stands."""
        if agent.ended:
            return
        try:
            thrown = self.with_room(agent, lambda: new_exception(agent.block, kind, message, source))
        except Trap:
            self.die(agent, f"{kind}: {message} (and no room left to throw it)")
            return
        self.throw(agent, thread, thrown)

    def complete(self, agent: Agent, thread: int, word: Callable[[], int]) -> None:
        """Give a waiting thread the word its head asked for, and its turn."""
        try:
            result = self.with_room(agent, word)
        except Trap as trap:
            self.refuse(agent, thread, trap.kind, trap.message)
            return
        self.engine.complete(agent.block, place_of(agent.block, thread), result)
        self.turns.last(agent, thread)

    # --- the loop -------------------------------------------------------------------------------------

    def run(self) -> float | None:
        """Give turns until nothing is ready or a round is over.

        Returns the seconds until a thread can run again (0: at once), or None when only the world can
        change that.
        """
        turns = self.turns
        turns.wake()
        for _ in range(ROUND):
            if not turns:
                break
            self._turn(*turns.take())
        return turns.pause()

    def _turn(self, agent: Agent, thread: int) -> None:
        """One slice of one thread, and whatever its exit asks for."""
        if agent.ended or agent.frozen:
            return
        block = agent.block
        place = place_of(block, thread)
        leave = self.engine.run(block, place, SLICE, agent.limits, agent.readings)
        if agent.polls and self.engine.asked:
            agent.asked.add(thread)
        if agent.blocked and not block.w[layout.W_OWNER]:
            self._unblock(agent)
        agent.polled = False
        self._handle(agent, thread, leave)
        if not agent.polled and (agent.seen or agent.pollers):
            self.stir(agent)

    def stir(self, agent: Agent) -> None:
        """The block may have changed: what its parked pollers wait for may be so now."""
        agent.seen = b""
        waiting, agent.pollers = agent.pollers, set()
        for thread in sorted(waiting):
            self.turns.last(agent, thread)

    def _handle(self, agent: Agent, thread: int, leave: Exit) -> None:
        match leave:
            case Outside():
                self._outsiders.carry_out(agent, thread, leave)
            case Spent():
                self.turns.last(agent, thread)
            case Done():
                self._done(agent, thread, leave.word)
            case NoRoom():
                self._make_room(agent, thread, leave.words)
            case Blocked():
                self.set_state(agent, thread, BLOCKED)
                agent.blocked.append(thread)
            case Thrown():
                self._uncaught(agent, thread, leave.place)

    def give_back(self, agent: Agent, thread: int) -> None:
        """Free the monitor that a thread held when it ended by an exception."""
        w = agent.block.w
        if w[layout.W_OWNER] == thread:
            w[layout.W_OWNER] = w[layout.W_ENTRIES] = 0
            self._unblock(agent)

    def _unblock(self, agent: Agent) -> None:
        waiting, agent.blocked = agent.blocked, []
        for thread in waiting:
            self.turns.last(agent, thread)

    def _make_room(self, agent: Agent, thread: int, words: int) -> None:
        block = agent.block
        collect(block, self.layouts, words)
        if block.top + words <= block.limit:
            self.turns.next(agent, thread)
            return
        message = f"the heap is over its limit of {agent.limits.heap} bytes"
        try:
            thrown = new_exception(block, "LimitException", message, agent.id)
        except Full:
            self.die(agent, f"LimitException: {message}", thread)
            return
        self.throw(agent, thread, thrown)

    # --- threads --------------------------------------------------------------------------------------

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

    def set_state(self, agent: Agent, thread: int, state: int) -> None:
        """Note in the block what the thread waits for."""
        agent.block.w[place_of(agent.block, thread) + THREAD_STATE] = state

    def freeze(self, agent: Agent, thread: int) -> None:
        """Hold a coordinator at its portal call."""
        self.set_state(agent, thread, CALLING)
        agent.frozen = True

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

    # --- ends -----------------------------------------------------------------------------------------

    def _done(self, agent: Agent, thread: int, word: int) -> None:
        self.flush(agent, thread)
        call = agent.block.w[place_of(agent.block, thread) + THREAD_CALL]
        if call:
            portals.finish(self, agent, thread, call, word)
        elif agent.member.kind == "coordinator":
            agent.ended = "done"
            self.release(agent)
            self.world.ended(agent)
        else:
            self.forget(agent, thread)
            self.open(agent)

    def _uncaught(self, agent: Agent, thread: int, thrown: int) -> None:
        call = agent.block.w[place_of(agent.block, thread) + THREAD_CALL]
        if call:
            self.flush(agent, thread)
            portals.fail(self, agent, thread, call, thrown)
            return
        name, message, trace = traceback.describe(agent.block, self.program, thrown)
        self.die(agent, f"{name}: {message}" if message else name, thread, trace)

    def throw(self, agent: Agent, thread: int, thrown: int) -> None:
        """Throw the object at `thrown` where a thread stands."""
        if self.engine.throw(agent.block, place_of(agent.block, thread), thrown):
            if agent.blocked and not agent.block.w[layout.W_OWNER]:
                self._unblock(agent)
            self.turns.next(agent, thread)
        else:
            self._uncaught(agent, thread, thrown)

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
        for waiting, waiter in portals.abandoned(self, agent):
            self.refuse(
                waiting, waiter, "UnreachableResourceException", f"{agent.id} has died: {reason}", agent.id
            )
        if agent.member.kind == "coordinator":
            self.release(agent)
        self.world.ended(agent)

    def open(self, agent: Agent) -> None:
        """A resource came to its first pause: calls that waited for it begin."""
        if agent.open:
            return
        agent.open = True
        waiting, agent.waiting = agent.waiting, []
        for caller, thread in waiting:
            self.turns.last(caller, thread)

    def forget(self, agent: Agent, thread: int) -> None:
        """A thread of an agent that goes on has come to its end."""
        unlink(agent.block, thread)
        agent.polls.pop(thread, None)
        agent.asked.discard(thread)

    def flush(self, agent: Agent, thread: int) -> None:
        """Write what a thread has left of a line."""
        if rest := agent.lines.pop(thread, ""):
            self.world.write(agent, rest)

    def place(self, agent: Agent, thread: int) -> int:
        """Where a thread's record is in the agent's block."""
        return place_of(agent.block, thread)

    def standing(self, agent: Agent, thread: int) -> int:
        """The instruction a thread stands at."""
        return agent.block.w[place_of(agent.block, thread) + THREAD_PC]
