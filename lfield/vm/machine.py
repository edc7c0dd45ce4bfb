"""The machine of one host: its agents and the scheduling of their threads.

A synchronous state machine: the host calls the machine (start, inject, answer, run), and the machine calls
the host's `HostInterface`. `run` returns when no thread is ready, with the time until a thread is ready.
"""

from __future__ import annotations

import random
import traceback as python_traceback
from collections.abc import Callable
from functools import partial
from typing import Any

from lfield.bytecode.program import Program
from lfield.clock import Clock
from lfield.errors import DeviceError
from lfield.manifest import DeviceValue
from lfield.vm import portal_calls
from lfield.vm.agent import CANCELLED, Agent, MachineTeam, MemberTypes, TeamMember
from lfield.vm.cancellation import Cancellation
from lfield.vm.deadlines import HOST_DOWN, IN_TRANSIT, Deadlines
from lfield.vm.engine_interface import (
    BUDGET_EXHAUSTED,
    AgentLimits,
    BudgetExhausted,
    EngineExit,
    Engines,
    HeapExhausted,
    HostCall,
    MonitorBlocked,
    Reading,
    ThreadDone,
    Trap,
    UncaughtThrow,
)
from lfield.vm.hooks import VmHooks
from lfield.vm.host_calls import HostCallDispatcher
from lfield.vm.host_interface import HostInterface
from lfield.vm.host_queries.resource_queries import ResourceQueries
from lfield.vm.host_queries.served_calls import ServedCalls
from lfield.vm.loops.loop_ticks import LoopTicks
from lfield.vm.memory import collector, layout
from lfield.vm.memory.block import Block
from lfield.vm.memory.block_verifier import BlockVerifier
from lfield.vm.memory.layout import BLOCKED, READY, THREAD_CALL, THREAD_ID, THREAD_STATE
from lfield.vm.memory.liveness import Liveness
from lfield.vm.memory.threads import only_thread, place_of
from lfield.vm.memory.word_codec import encode_device_value
from lfield.vm.monitor_waits import MonitorWaits, after_turn
from lfield.vm.person_calls.person_portals import PersonPortals
from lfield.vm.reference import ReferenceEngine
from lfield.vm.reference.unwinder import stop_limit
from lfield.vm.reservations.held_reservations import HeldReservations
from lfield.vm.reservations.reserve_handlers import ReserveHandlers
from lfield.vm.scheduler import Scheduler
from lfield.vm.together.itinerary import CANCELLING_HEADS, Itinerary
from lfield.vm.together.pending_calls import PendingCalls
from lfield.vm.together.together_handlers import TogetherHandlers
from lfield.vm.turns.run_limit import SECONDS_PER_RUN, RunLimit
from lfield.vm.waits.operator_input import OperatorInput
from lfield.vm.waits.sequencing import SequencingHandlers

#: The instructions of a thread's turn.
SLICE = 2000
#: The limits of one call of `run`, after which the host handles its events, in addition to those of
#: `RunLimit`.
SLICES_PER_RUN, TURNS_PER_RUN = 20, 100


class Machine:
    """The agents of one host, and the parts that serve them.

    `view` is the team as this host sees it. A Python exception, a bug of lfield, ends the agent in whose turn
    it occurred, with a report. `engines` creates the engine that runs the program, by default the reference
    engine. `hooks` are attached to the machine.
    """

    def __init__(
        self,
        program: Program,
        view: MachineTeam,
        host: HostInterface,
        clock: Clock,
        rng: random.Random,
        engines: Engines | None = None,
        hooks: VmHooks | None = None,
    ) -> None:
        self.program, self.team, self.hooks = program, view.members, hooks or VmHooks()
        self._own_host, self._fenced, self._now = view.own_host, view.fenced, clock.monotonic
        self._limit = self.hooks.run_limit or RunLimit(clock.monotonic)
        incarnation = 1 + view.incarnation % (layout.START_LIMIT - 1)
        self._scheduler = scheduler = Scheduler(
            program, incarnation, host, clock, portal_calls.fail, engines or ReferenceEngine, self.hooks
        )
        #: The agents on this host, by id, and the agents whose `init` has not reached its first pause.
        self.agents, self.opening = scheduler.agents, scheduler.opening
        self.engine, self.layouts, self._turns = scheduler.engine, scheduler.layouts, scheduler.run_queue
        self.operator_input = OperatorInput(scheduler)
        cancelling = self._cancellation = Cancellation(scheduler, self.operator_input)
        self._liveness = Liveness(program, scheduler.layouts)
        self.resource_queries = ResourceQueries(scheduler)
        #: The portal calls that are served here.
        self.served_calls = ServedCalls(scheduler)
        types = MemberTypes(view.members)
        self._verifier = BlockVerifier(program, scheduler.layouts, types, self.engine.space)
        calls = self.pending_calls = PendingCalls(scheduler, cancelling, self._verifier)
        self.person_portals = PersonPortals(scheduler, cancelling)
        self.held_reservations = held = HeldReservations(program, view.members)
        self.itinerary = Itinerary(scheduler, view.members, view.own_host, held)
        limits = self._deadlines = Deadlines(scheduler, cancelling, self.itinerary, calls.stop_waiting)
        self._together = TogetherHandlers(scheduler, self.itinerary, held, cancelling, limits)
        parts = (
            *(self.operator_input, MonitorWaits(scheduler), LoopTicks(scheduler, cancelling)),
            *(self._together, ReserveHandlers(scheduler, held, view.own_host, limits)),
            SequencingHandlers(scheduler, view.members, view.own_host, limits),
        )
        heads = {head: handler for part in parts for head, handler in part.handlers().items()}
        self._host_calls = HostCallDispatcher(scheduler, view, rng, cancelling, limits, held, heads)
        self._place = 0  # the place of the thread of this turn
        #: The handler of each engine exit.
        self._exits: dict[type[EngineExit], Callable[[Agent, int, Any], None]] = {
            HostCall: self._host_calls.dispatch,
            ThreadDone: self._done,
            BudgetExhausted: lambda agent, thread, _: self._turns.push_back(agent, thread),
            MonitorBlocked: self._blocked,
            HeapExhausted: lambda agent, thread, out: scheduler.collect_and_retry(agent, thread, out.words),
            UncaughtThrow: lambda agent, thread, leave: scheduler.uncaught(agent, thread, leave.place),
        }

    # --- arrival and departure of agents --------------------------------------------------------------

    def start(self, member: TeamMember, limits: AgentLimits, generation: int) -> Agent:
        """Create an agent and the thread of its init; it runs at the next `run`."""
        record = self.program.class_index[member.type]
        block = Block.empty(self.program.digest, limits.heap // 8, self.engine.space)
        readings: list[Reading | None] = [None] * len(self.program.core.device_calls)
        agent = Agent(member, block, limits, readings, is_fenced=member.id in self._fenced)
        self._scheduler.set_clock(agent, 0)
        w = block.w
        w[layout.W_CLASS], w[layout.W_GENERATION] = record, generation
        block.append_trail(self._own_host)
        self.agents[member.id] = agent
        if not agent.open:
            self.opening[member.id] = agent
        create = partial(self._scheduler.create_agent_object, agent, record)
        try:
            self._scheduler.run_with_collection(agent, create)
        except Trap as trap:
            self._scheduler.die(agent, f"LimitException: {trap.message}")
        except Exception as error:
            self._fail_agent(agent, 0, error)
        return agent

    def inject(
        self, member: TeamMember, image: bytes | memoryview, limits: AgentLimits, downtime: float = 0.0
    ) -> Agent:
        """End of a hop: inject a coordinator from another host; raises BlockError for invalid bytes.

        `downtime` is its transit time in seconds, as far as its host knows; its time limits include this
        time. The coordinator is suspended at its portal call, which is here, until `unfreeze` or `resume`.
        Another start of the coordinator on this host ends: a host never runs two starts of one coordinator.
        """
        agent = self.restore(member, image, limits, downtime, IN_TRANSIT)
        if self._scheduler.pending_calls:
            self.pending_calls.cancel_unneeded(agent)
        agent.block.w[layout.W_HOPS] += 1
        agent.block.append_trail(self._own_host)
        if self.hooks.on_arrival is not None:
            self.hooks.on_arrival(agent)
        return agent

    def restore(
        self,
        member: TeamMember,
        image: bytes | memoryview,
        limits: AgentLimits,
        downtime: float = 0.0,
        late_reason: str = HOST_DOWN,
    ) -> Agent:
        """As `inject`, for a block that was packed on this host and has made no hop since.

        `downtime` is the time in seconds for which the host was down; `late_reason` is the reason of a delay,
        for exceptions.
        """
        block = self._verifier.check(image, limits.heap // 8)
        age = block.w[layout.W_CLOCK] + int(max(0.0, downtime) * 1e9)
        agent = Agent(
            member,
            block,
            limits,
            [],
            is_fenced=member.id in self._fenced,
            is_restored=True,
            offset=age - round(self._now() * 1e9),
        )
        if (other := self.agents.get(member.id)) is not None:
            other.end("dropped")
        self.agents[member.id] = agent
        if self.program.has_limits:
            self._deadlines.on_arrival(agent, late_reason)
        return agent

    def unfreeze(self, agent: Agent, *, is_persisted: bool = False) -> None:
        """Let a suspended coordinator call its portal: see `HostInterface.may_start_call`.

        `is_persisted`: its present block is on disk, or at its sender.
        """
        if agent.frozen:
            agent.resume(is_persisted=is_persisted)
            w = agent.block.w
            place = w[layout.W_THREADS]
            w[place + THREAD_STATE] = READY
            self._turns.push_ready_front(agent, w[place + THREAD_ID])

    def pack(self, agent: Agent) -> memoryview:
        """The bytes of a suspended coordinator for a hop, live data only."""
        block = agent.block
        self._liveness.clear_dead(block)
        # Most visits leave no garbage.
        if not block.packed == block.top <= collector.SMALL_BLOCK_WORDS:
            collector.compact(block, self.layouts)
        self.store_clock(agent)
        return block.image()

    def store_clock(self, agent: Agent) -> None:
        """Store the present time of the coordinator's own clock in its block.

        A block that was packed earlier and is sent now has waited since then, and its time limits include
        this wait.
        """
        now = round((self.hooks.fresh_time or self._now)() * 1e9) + agent.offset
        agent.block.w[layout.W_CLOCK] = now if now < layout.COUNT_LIMIT else layout.COUNT_LIMIT - 1

    def drop(self, agent: Agent) -> None:
        """Remove a coordinator that was stopped, or has ended elsewhere."""
        agent.end("dropped")
        self._scheduler.release(agent)

    def stop_coordinator(self, agent: Agent, reason: str) -> None:
        """End a coordinator here as by a limit around its `init`; the call may have to be repeated."""
        if not agent.ended and (word := stop_limit(agent.block, self.program)):
            self._deadlines.stop(agent, word, reason)

    def release(self, agent: Agent) -> None:
        """Remove a coordinator that has left."""
        self._scheduler.release(agent)

    def resume(
        self, agent: Agent, kind: str, message: str, source: str = "", *, recovered: bool = False
    ) -> None:
        """Resume a suspended coordinator with an exception at the statement that called the portal.

        In a `together` the exception applies to the calls that cannot start or be fetched; a
        ReservedException applies only to the calls of `source`; a RestartException applies to the coordinator
        and is thrown at once, unless the coordinator is already leaving the block. A coordinator that was
        `recovered` may have executed more, also after its time limit or after the block: this exception
        precedes any other.
        """
        agent.resume()
        head = "" if recovered else self.itinerary.head(agent)
        if not recovered and self._deadlines.expire(agent, message):
            return
        if head in CANCELLING_HEADS or (head and kind != "RestartException"):
            self._together.on_failed(agent, only_thread(agent.block), kind, message, source)
        else:
            self.throw_builtin(agent, only_thread(agent.block), kind, message, source)

    def detach_caller(self, agent: Agent, kind: str, message: str) -> bool:
        """Throw a built-in exception in a coordinator that waits for a portal of this host, whose result is
        then dropped. Returns False, without effect, if it waits for no portal: it runs, sleeps, or is
        suspended.
        """
        if agent.ended or self.itinerary.head(agent) in CANCELLING_HEADS:
            return False
        if not (self.pending_calls.stop_waiting(agent) or portal_calls.detach_caller(self._scheduler, agent)):
            return False
        called = self.itinerary.current_target(agent)
        self.throw_builtin(agent, only_thread(agent.block), kind, message, called[0].id if called else "")
        return True

    # --- results of host calls ------------------------------------------------------------------------

    def answer(self, agent: Agent, thread: int, value: DeviceValue, kind: int, device: str) -> None:
        """Pass a value (of a type, by index) to a thread that still waits for a device instruction."""
        if agent.ended or not place_of(agent.block, thread):
            return
        word = partial(encode_device_value, agent.block, self.program, kind, value, device)
        try:
            self._scheduler.complete(agent, thread, word)
        except DeviceError as error:
            self.throw_builtin(agent, thread, error.kind, str(error), error.device)
        except Exception as error:
            self._fail_agent(agent, thread, error)

    def throw_builtin(self, agent: Agent, thread: int, kind: str, message: str, source: str = "") -> None:
        """Throw a built-in exception at the position of a waiting thread, if it still exists."""
        if agent.ended or not place_of(agent.block, thread):
            return
        if kind == CANCELLED and thread in agent.pending_cancels:
            agent.pending_cancels[thread] = ""
        try:
            self._scheduler.throw_builtin(agent, thread, kind, message, source)
        except Exception as error:
            self._fail_agent(agent, thread, error)

    # --- the loop -------------------------------------------------------------------------------------

    def run(self) -> float | None:
        """Run threads until none is ready or a limit of this call is reached.

        Returns the seconds until a thread can run again (0: at once), or None when only an external event can
        make one ready.
        """
        turns, ready = self._turns, self._turns.ready
        if turns.timers or turns.alarms:
            self._wake()
        stopwatch, long = self._limit.stopwatch, SLICE * self.engine.pace
        remaining, until = SLICES_PER_RUN * long, stopwatch() + SECONDS_PER_RUN
        for number in range(1, TURNS_PER_RUN + 1):
            if not ready or remaining <= 0:
                break
            agent, thread = ready.popleft()
            # If no other thread can become ready, a long turn delays no thread.
            others = ready or agent.pollers or agent.blocked or agent.monitor_waits
            is_alone = not (others or self.hooks.meter)
            try:
                remaining -= self._turn(agent, thread, long if is_alone else SLICE, number)
            except Exception as error:
                self._fail_agent(agent, thread, error)
            if stopwatch() > until:
                self._limit.on_time_over(number)
                break
        return turns.seconds_until_due() if ready or turns.timers or turns.alarms else None

    def _wake(self) -> None:
        for agent, ring in self._turns.pop_due():
            try:
                ring()
            except Exception as error:
                self._fail_agent(agent, 0, error)

    def _fail_agent(self, agent: Agent, thread: int, error: Exception) -> None:
        """End the agent, and only this agent, because of a bug of lfield in a turn of its thread."""
        frame = python_traceback.extract_tb(error.__traceback__)[-1]
        where = f"{frame.filename.rpartition('/')[2]}:{frame.lineno}"
        reason = f"bug in lfield: {type(error).__name__}: {error} ({where})"
        try:
            self._scheduler.die(agent, reason, thread, broken=True)
        except Exception:
            # The stack cannot be printed, but the callers must still get their exception.
            self._scheduler.die(agent, reason, broken=True)

    def _turn(self, agent: Agent, thread: int, budget: int, number: int) -> int:
        """Run at most `budget` instructions of a thread in the turn `number` of a run; returns their
        number.
        """
        if agent.ended or agent.frozen:
            return 0
        engine, block = self.engine, agent.block
        place = self._place = (block.index_threads() if block.places is None else block.places).get(thread, 0)
        budget = self._limit.budgets.get(number, budget)
        leave = engine.run(block, place, budget, agent.limits, agent.readings)
        used = budget - engine.unused_budget
        if leave is BUDGET_EXHAUSTED and used < budget:
            self._limit.on_early_end(number, used)
        if self.hooks.meter is not None:
            self.hooks.meter(used)
        if agent.poll_counts and engine.has_read_external:
            agent.outward_pollers.add(thread)
        if agent.blocked:
            self._scheduler.unblock(agent)
        self._exits[type(leave)](agent, thread, leave)
        if agent.monitor_waits:
            after_turn(self._turns, agent, thread, leave)
        if (agent.last_polled_image or agent.pollers) and not agent.end_turn():
            self._scheduler.recheck_pollers(agent)
        return used

    def _blocked(self, agent: Agent, thread: int, leave: EngineExit) -> None:
        self._scheduler.set_state(agent, thread, BLOCKED)
        agent.blocked.append(thread)
        if agent.pending_cancels.get(thread):
            agent.blocked.remove(thread)
            self._cancellation.deliver(agent, thread)

    def _done(self, agent: Agent, thread: int, leave: ThreadDone) -> None:
        scheduler = self._scheduler
        if agent.lines:
            scheduler.flush(agent, thread)
        if call := agent.block.w[self._place + THREAD_CALL]:
            portal_calls.finish(scheduler, agent, thread, call, leave.word)
        elif agent.member.kind == "coordinator":
            scheduler.finish(agent)
        else:
            scheduler.forget(agent, thread)
            scheduler.open(agent)
