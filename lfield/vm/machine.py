"""The machine of one host: its agents, their threads, and whose turn it is.

A synchronous state machine: the host calls it (start, admit, answer, run), it calls the host's `World`.
Time is read from the clock it was given. `run` returns when nothing can run, and says until when.
"""

from __future__ import annotations

import random
import traceback as python_traceback
from collections.abc import Callable, Collection, Sequence
from typing import Any

from lfield.bytecode.program import Program
from lfield.clock import Clock
from lfield.errors import DeviceError
from lfield.manifest import DeviceValue
from lfield.vm import portals
from lfield.vm.agent import Agent, Member
from lfield.vm.asking.questions import Questions
from lfield.vm.begun import Begun
from lfield.vm.cancelling import CANCELLED, Cancelling
from lfield.vm.contract import (
    Blocked,
    Done,
    Engines,
    Exit,
    Limits,
    NoRoom,
    Outside,
    Reading,
    Spent,
    Thrown,
    Trap,
)
from lfield.vm.limits import DOWN, ON_ITS_WAY, TimeLimits
from lfield.vm.memory import layout
from lfield.vm.memory.block import Block
from lfield.vm.memory.collector import compact
from lfield.vm.memory.layout import BLOCKED, READY, THREAD_CALL, THREAD_ID, THREAD_STATE
from lfield.vm.memory.liveness import Liveness
from lfield.vm.memory.soundness import Soundness
from lfield.vm.memory.threads import only_thread, place_of
from lfield.vm.memory.values import word_for
from lfield.vm.outside import Outsiders
from lfield.vm.reference import Engine
from lfield.vm.reserve.heads import Reserving
from lfield.vm.reserve.held import Held
from lfield.vm.scheduler import Scheduler
from lfield.vm.together.calls import BegunCalls
from lfield.vm.together.heads import Together
from lfield.vm.together.visits import Visits
from lfield.vm.world import World

#: Instructions a thread may run before the next one's turn.
SLICE = 2000
#: How much one call of `run` does before it lets the host look at the world: so many slices, in so many turns
#: at most, since whoever calls portals does little in each, and for so many seconds.
ROUND, TURNS, LONGEST = 20, 100, 0.005


class Machine:
    """The agents of one host.

    `team` is every agent of the deployment in its order, `here` this host's number in it, `life` a number
    that tells this life of the host from all others; `fenced` are the coordinators that begin no portal
    unasked. An exception that is none of L's, a bug of ours, ends the agent in whose turn it happened, with a
    report. `engines` makes what runs the program: the reference engine, if nothing is said.
    """

    def __init__(
        self,
        program: Program,
        team: Sequence[Member],
        here: int,
        life: int,
        world: World,
        clock: Clock,
        dice: random.Random,
        fenced: Collection[str] = (),
        engines: Engines | None = None,
    ) -> None:
        self.program = program
        self.team = team
        self._here, self._world, self._fenced, self._now = here, world, fenced, clock.monotonic
        self._scheduler = scheduler = Scheduler(
            program, 1 + life % (layout.START_LIMIT - 1), world, clock, portals.fail, engines or Engine
        )
        #: The agents that are here, by id.
        self.agents = scheduler.agents
        #: Those of them whose `init` has not come to its first pause.
        self.opening = scheduler.opening
        #: What watches its portal calls and what it computes, refuses some, or stands in for resources.
        self.attached = scheduler.attached
        self.engine, self.layouts, self._turns = scheduler.engine, scheduler.layouts, scheduler.turns
        cancelling = self._cancelling = Cancelling(scheduler)
        self._liveness = Liveness(program, scheduler.layouts)
        self.questions = Questions(scheduler)
        self._soundness = Soundness(program, scheduler.layouts, [m.type for m in team], self.engine.space)
        begun = self._begun = BegunCalls(scheduler, cancelling, self._soundness)
        #: The calls that were begun here, by what is told of them (see `BegunCalls`).
        self.begun_calls, self.fetched, self.kept_result = begun.calls, begun.fetched, begun.kept
        self.restore_begun, self.forget_begun = begun.restore, begun.forget
        self.cancel_begun, self.end_begun = begun.cancel, begun.end
        held = Held(program, team)
        #: What a coordinator that is here has reserved: each resource with its number.
        self.held = held.of
        self._visits = Visits(scheduler, team, here, held)
        self._limits = TimeLimits(scheduler, cancelling, self._visits, self._begun.stop_waiting)
        self._together = Together(scheduler, self._visits, held, cancelling, self._limits)
        heads = {**self._together.heads(), **Reserving(scheduler, held, here, self._limits).heads()}
        self._outsiders = Outsiders(scheduler, team, here, dice, cancelling, self._limits, held, heads)
        self._place = 0  # where the thread is whose turn it is
        #: What each exit of the engine asks for.
        self._exits: dict[type[Exit], Callable[[Agent, int, Any], None]] = {
            Outside: self._outsiders.carry_out,
            Done: self._done,
            Spent: lambda agent, thread, _: self._turns.last(agent, thread),
            Blocked: self._blocked,
            NoRoom: lambda agent, thread, leave: scheduler.make_room(agent, thread, leave.words),
            Thrown: lambda agent, thread, leave: scheduler.uncaught(agent, thread, leave.place),
        }

    # --- agents come and go ---------------------------------------------------------------------------

    def start(self, member: Member, limits: Limits, generation: int) -> Agent:
        """Create an agent and the thread of its init; it runs at the next `run`."""
        record = self.program.class_index[member.type]
        block = Block.empty(self.program.digest, limits.heap // 8, self.engine.space)
        readings: list[Reading | None] = [None] * len(self.program.core.device_calls)
        agent = Agent(member, block, limits, readings, opened=member.kind == "coordinator")
        agent.fenced = member.id in self._fenced
        self._scheduler.set_clock(agent, 0)
        w = block.w
        w[layout.W_CLASS] = record
        w[layout.W_GENERATION] = generation
        block.visit(self._here)
        self.agents[member.id] = agent
        if not agent.open:
            self.opening[member.id] = agent
        try:
            self._scheduler.with_room(agent, lambda: self._scheduler.born(agent, record))
        except Trap as trap:
            self._scheduler.die(agent, f"LimitException: {trap.message}")
        except Exception as error:
            self._break(agent, 0, error)
        return agent

    def admit(self, member: Member, image: bytes | memoryview, limits: Limits, asleep: float = 0.0) -> Agent:
        """Inject a coordinator that came from another host; raises BlockError when its bytes are not sound.

        `asleep` is for how many seconds it was on its way, as far as its host can tell: its time limits count
        them. It is frozen at its portal call, which is here now, until `go` or `resume`. Another start of it
        that is here goes on no more: of two starts one host never runs both.
        """
        agent = self.restore(member, image, limits, asleep, ON_ITS_WAY)
        self._begun.tidy_up(agent)
        agent.block.w[layout.W_HOPS] += 1
        agent.block.visit(self._here)
        return agent

    def restore(
        self, member: Member, image: bytes | memoryview, limits: Limits, asleep: float = 0.0, why: str = DOWN
    ) -> Agent:
        """As `admit`, of a block that was packed on this very host: it has made no hop since.

        `asleep` is for how many seconds the host was down, as far as it can tell; `why` is for exceptions.
        """
        block = self._soundness.check(image, limits.heap // 8)
        agent = Agent(member, block, limits, [], opened=True, frozen=True, kept=True)
        agent.fenced = member.id in self._fenced
        if (other := self.agents.get(member.id)) is not None:
            other.ended = "dropped"
        self.agents[member.id] = agent
        self._scheduler.set_clock(agent, block.w[layout.W_CLOCK] + int(max(0.0, asleep) * 1e9))
        self._limits.look(agent, why)
        return agent

    def go(self, agent: Agent) -> None:
        """Let a frozen coordinator call its portal; the host may be asked again (`World.may_begin`)."""
        if agent.frozen:
            agent.frozen = False
            w = agent.block.w
            place = w[layout.W_THREADS]
            w[place + THREAD_STATE] = READY
            self._turns.soon(agent, w[place + THREAD_ID])

    def pack(self, agent: Agent) -> memoryview:
        """The bytes of a frozen coordinator, live data only."""
        self._liveness.clear_dead(agent.block)
        compact(agent.block, self.layouts)
        self.note_clock(agent)
        return agent.block.image()

    def note_clock(self, agent: Agent) -> None:
        """Let the block of a coordinator tell the time of now on the coordinator's own clock.

        What was packed earlier and is sent now has waited meanwhile: its time limits count that.
        """
        now = self._scheduler.clock_of(agent)
        agent.block.w[layout.W_CLOCK] = now if now < layout.COUNT_LIMIT else layout.COUNT_LIMIT - 1

    def calling(self, agent: Agent) -> tuple[Member, str] | None:
        """The resource and the portal that a frozen coordinator stands at; None when its proxy is null.

        Of a `together` it is the first call that it wants to begin, or to fetch where it wants to be. The
        portal is '' where it wants to reserve the resource.
        """
        return self._visits.calling(agent)

    def fetches(self, agent: Agent) -> bool:
        """Whether that is a call of a `together` which has begun there."""
        return self._visits.fetches(agent)

    def release(self, agent: Agent) -> None:
        """Forget a coordinator that has left."""
        self._scheduler.release(agent)

    def resume(
        self, agent: Agent, kind: str, message: str, source: str = "", *, recovered: bool = False
    ) -> None:
        """Let a frozen coordinator go on with an exception in the statement that called the portal.

        In a `together` it is that of the calls which cannot begin or be fetched, a ReservedException that of
        the calls of `source` alone; a RestartException is the coordinator's own and is thrown at once, unless
        it is leaving the block already. Who is `recovered` may have done more, also after its time was over
        or after the block: it is told before anything else.
        """
        agent.frozen = False
        head = "" if recovered else self._visits.head(agent)
        if not recovered and self._limits.strike(agent, message):
            return
        if head == "leave" or (head and kind != "RestartException"):
            self._together.failed(agent, only_thread(agent.block), kind, message, source)
        else:
            self.refuse(agent, only_thread(agent.block), kind, message, source)

    def abandon(self, agent: Agent, kind: str, message: str) -> bool:
        """Throw a built-in exception in a coordinator that waits for a portal of this host.

        The portal goes on alone, and what it gives is dropped.

        False, and nothing happens, when it waits for none: when it runs, sleeps, or is frozen.
        """
        if agent.ended or self._visits.head(agent) == "leave":
            return False
        if not self._begun.stop_waiting(agent) and not portals.abandon(self._scheduler, agent):
            return False
        called = self.calling(agent)
        self.refuse(agent, only_thread(agent.block), kind, message, called[0].id if called else "")
        return True

    def goes_on(self, agent: Agent) -> bool:
        """Whether a frozen coordinator that was restored may `go` where it stands, by the same generation.

        It may when it is at its `together` only to fetch or to leave, or at a `reserve`: nothing it did there
        is unknown. Else it must be told by `resume` (RestartException) that its call may have begun.
        """
        return self._visits.goes_on(agent)

    # --- who calls ------------------------------------------------------------------------------------

    def caller(self, resource: Agent, thread: int) -> Agent | Begun | None:
        """The coordinator whose portal call a thread serves; None for a thread of the resource's own.

        Of a call that a `together` has begun it is the record of that: it has the coordinator's `id`,
        `generation`, `fenced` and `ended` as they were at the beginning, wherever that is by now.
        """
        number = resource.block.w[place_of(resource.block, thread) + THREAD_CALL]
        found = self._scheduler.calls.get(number)
        return found if found is None or isinstance(found, Begun) else found[0]

    def is_left(self, resource: Agent, thread: int) -> bool:
        """Whether a thread serves a portal that was taken from its caller, or that the host itself asks."""
        number = resource.block.w[place_of(resource.block, thread) + THREAD_CALL]
        return bool(number) and number not in self._scheduler.calls

    def calls_of_others(self, resource: Agent, agent_id: str) -> bool:
        """Whether a portal call of anybody but that coordinator is under way in a resource that is here.

        One that was taken from its caller (`abandon`) is somebody else's.
        """
        return portals.of_others(self._scheduler, resource, agent_id)

    # --- answers from the world -----------------------------------------------------------------------

    def answer(self, agent: Agent, thread: int, value: DeviceValue, kind: int, device: str) -> None:
        """The value (of a type, by index) of the device instruction a thread waits for, if it still does."""
        if agent.ended or not place_of(agent.block, thread):
            return
        try:
            self._scheduler.complete(
                agent, thread, lambda: word_for(agent.block, self.program, kind, value, device)
            )
        except DeviceError as error:
            self.refuse(agent, thread, error.kind, str(error), error.device)
        except Exception as error:
            self._break(agent, thread, error)

    def refuse(self, agent: Agent, thread: int, kind: str, message: str, source: str = "") -> None:
        """Throw a built-in exception where a waiting thread stands, if it is still there."""
        if agent.ended or not place_of(agent.block, thread):
            return
        if kind == CANCELLED and thread in agent.cancels:
            agent.cancels[thread] = ""
        try:
            self._scheduler.refuse(agent, thread, kind, message, source)
        except Exception as error:
            self._break(agent, thread, error)

    # --- the loop -------------------------------------------------------------------------------------

    def run(self) -> float | None:
        """Give turns until nothing is ready or a round is over.

        Returns the seconds until a thread can run again (0: at once), or None when only the world can
        change that.
        """
        turns, ready = self._turns, self._turns.ready
        if turns.timed:
            self._wake()
        now, long = self._now, SLICE * self.engine.pace
        left, until = ROUND * long, now() + LONGEST
        for _ in range(TURNS):
            if not ready or left <= 0:
                break
            agent, thread = ready.popleft()
            # Where nobody else can become ready, nothing is lost by a long turn.
            alone = not (ready or agent.pollers or agent.blocked or self.attached.meter)
            try:
                left -= self._turn(agent, thread, long if alone else SLICE)
            except Exception as error:
                self._break(agent, thread, error)
            if now() > until:
                break
        return turns.pause()

    def _wake(self) -> None:
        for agent, ring in self._turns.wake():
            try:
                ring()
            except Exception as error:
                self._break(agent, 0, error)

    def _break(self, agent: Agent, thread: int, error: Exception) -> None:
        """A bug of ours in what was done for a thread ends its agent, and nobody else."""
        frame = python_traceback.extract_tb(error.__traceback__)[-1]
        where = f"{frame.filename.rpartition('/')[2]}:{frame.lineno}"
        reason = f"bug in lfield: {type(error).__name__}: {error} ({where})"
        agent.broken = True
        try:
            self._scheduler.die(agent, reason, thread)
        except Exception:
            # Where it stood cannot even be told; whoever waits for it must hear all the same.
            self._scheduler.die(agent, reason)

    def _turn(self, agent: Agent, thread: int, budget: int) -> int:
        """So many instructions of one thread, and whatever its exit asks for; how many it has taken."""
        if agent.ended or agent.frozen:
            return 0
        engine = self.engine
        place = self._place = place_of(agent.block, thread)
        leave = engine.run(agent.block, place, budget, agent.limits, agent.readings)
        used = budget - engine.unused
        if self.attached.meter is not None:
            self.attached.meter(used)
        if agent.polls and engine.asked:
            agent.asked.add(thread)
        if agent.blocked:
            self._scheduler.unblock(agent)
        agent.polled = False
        self._exits[type(leave)](agent, thread, leave)
        if (agent.seen or agent.pollers) and not agent.polled:
            self._scheduler.stir(agent)
        return used

    def _blocked(self, agent: Agent, thread: int, leave: Exit) -> None:
        self._scheduler.set_state(agent, thread, BLOCKED)
        agent.blocked.append(thread)
        if agent.cancels.get(thread):
            agent.blocked.remove(thread)
            self._cancelling.strike(agent, thread)

    def _done(self, agent: Agent, thread: int, leave: Done) -> None:
        scheduler = self._scheduler
        if agent.lines:
            scheduler.flush(agent, thread)
        call = agent.block.w[self._place + THREAD_CALL]
        if call:
            portals.finish(scheduler, agent, thread, call, leave.word)
        elif agent.member.kind == "coordinator":
            agent.ended = "done"
            scheduler.release(agent)
            self._world.ended(agent)
        else:
            scheduler.forget(agent, thread)
            scheduler.open(agent)
