"""Agent record of a host: the agent's block and the host's data about it."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from typing import Final, Literal, overload

from msgspec import Struct, field

from lfield.vm.engine_interface import AgentLimits, Reading
from lfield.vm.memory import layout
from lfield.vm.memory.block import Block

#: The state of a thread that has left the monitor in a `wait until`: the thread waits, waits and is woken
#: regularly, or checks its condition.
WAITS, POLLS, EVALUATES = 1, 2, 3

#: The report of a coordinator that has ended because of a stop.
STOPPED: Final = "stopped"
#: The type of an agent; 'unknown' if a deployment was read without its program, for queries only.
AgentKind = Literal["resource", "coordinator", "unknown"]


#: The exceptions for a cancelled call and for a suppressed loop.
CANCELLED = "CancelledException"


class TeamMember(Struct, frozen=True):
    """An agent of the team as known to every host; its number is its position in the deployment."""

    number: int
    id: str
    type: str
    kind: AgentKind
    host: int
    arguments: tuple[str, ...] = ()
    #: Whether this coordinator does not start with its host, because another coordinator starts it.
    is_startable: bool = False


class MachineTeam(Struct, frozen=True):
    """The team as seen by one host.

    `members` are all agents of the deployment in order, `own_host` the number of the host, `incarnation` this
    run of the host. Coordinators in `fenced` may be recovered elsewhere: their portal calls need the host's
    permission.
    """

    members: Sequence[TeamMember]
    own_host: int
    incarnation: int
    fenced: Collection[str] = ()


class MemberTypes(Sequence[str]):
    """The types of agents by number: a view, so that a machine does no work per agent of the team."""

    def __init__(self, members: Sequence[TeamMember]) -> None:
        self._members = members

    @overload
    def __getitem__(self, number: int) -> str: ...

    @overload
    def __getitem__(self, number: slice) -> Sequence[str]: ...

    def __getitem__(self, number: int | slice) -> str | Sequence[str]:
        found = self._members[number]
        return found.type if isinstance(found, TeamMember) else MemberTypes(found)

    def __len__(self) -> int:
        return len(self._members)


class ResourceLoops(Struct):
    """The loops of a resource. Ids of threads are keys, names and reasons are for messages."""

    #: The threads of the loops by their method's index.
    threads: dict[int, int]
    #: The time when the loops started, in ns of the resource.
    started: int = 0
    #: The threads whose bodies are suppressed, with the reason.
    suppressed: dict[int, str] = field(default_factory=dict)
    #: The threads whose bodies control the devices, with the names of their loops.
    controlling: dict[int, str] = field(default_factory=dict)
    #: By kind of report and loop: the time of the last line, and the number of lines omitted since then.
    reported: dict[tuple[str, str], tuple[float, int]] = field(default_factory=dict)

    def start(self, now: int) -> None:
        """The first tick of all loops is due, at this time in ns of the resource."""
        self.started = now

    def has(self, thread: int) -> bool:
        """Whether `thread` is the thread of a loop."""
        return thread in self.threads.values()

    def end_tick(self, thread: int) -> None:
        """The body of a loop has ended: the loop is not suppressed any more, and controls no device."""
        self.suppressed.pop(thread, None)
        self.controlling.pop(thread, None)

    def refusal(self, thread: int) -> tuple[str, str]:
        """The exception for an acting device instruction of a thread, and its reason; '' if permitted."""
        if thread in self.suppressed:
            return CANCELLED, self.suppressed[thread]
        if self.controlling and not self.has(thread):
            name = next(iter(self.controlling.values()))
            return "DeviceException", f"the loop {name} controls the devices now"
        return "", ""


class Agent:
    """An agent on this host. All its execution state is in `block`."""

    #: The end of the agent, '' while it is here. For an agent that died, `report` has the reason and a line
    #: per call, and `broken` says whether a bug of lfield was the cause.
    ended = ""
    report = ""
    broken = False
    #: The number of portals of the agent that have returned.
    served = 0
    #: The block after the last polling thread, empty when another thread has run since.
    last_polled_image = b""
    #: Whether the thread of this turn polls.
    has_polled = False
    #: Whether this resource is reserved. Set by the host, which then decides (`HostInterface.may_serve`)
    #: before each portal of the resource starts.
    reserved = False
    #: The next check of the time limits, on the host's clock.
    alarm = math.inf
    #: Whether an expired limit could not be thrown yet.
    overdue = False
    #: The message that is thrown when the call returns that a limit has cancelled ...
    expiry_message = ""
    #: ... and the time when this limit expired, in ns of the agent's clock.
    expired_at = 0
    #: Resource of the last departure ...
    called_resource = ""
    #: ... and its portal, by index; -1 for none.
    called_portal = -1
    #: The reason why an expired limit was thrown late.
    lateness_reason = ""
    #: Threads of a resource that have left its monitor in a `wait until`, each with its state.
    monitor_waits: dict[int, int] = {}
    #: The reason why a departure that would arrive late was refused.
    unreachable_reason = ""
    #: The loops of a resource; None without any.
    loops: ResourceLoops | None = None
    #: Whether this coordinator waits here for the first of several calls ...
    waits_for_any = False
    #: ... and the numbers of calls on other hosts that have ended, as these hosts report.
    ended_elsewhere: frozenset[int] = frozenset()
    #: The reason why this coordinator is being stopped; '' if it is not.
    stop_reason = ""

    # The fields are set one by one, and rare ones are in the class, because every hop creates an instance.
    def __init__(
        self,
        member: TeamMember,
        block: Block,
        limits: AgentLimits,
        readings: list[Reading | None],
        *,
        is_fenced: bool = False,
        is_restored: bool = False,
        offset: int = 0,
    ) -> None:
        self.member, self.block, self.limits = member, block, limits
        #: Telemetry by device call, maintained by the host; empty for coordinators.
        self.readings = readings
        #: False until the init of a resource reaches its first pause: calls wait in `waiting`.
        self.open = member.kind == "coordinator"
        #: Whether the agent may be recovered elsewhere: its portal calls need the host's permission.
        self.fenced = is_fenced
        #: Whether the agent is suspended until its host decides, at a hop or a portal call.
        self.frozen = is_restored
        #: Whether this coordinator is at a portal call and its present block is on disk.
        self.is_persisted = is_restored
        #: The offset, in ns, of the coordinator's clock of time limits from the host's monotonic clock.
        self.offset = offset
        #: The id of the agent in the deployment.
        self.id = member.id
        #: Callers, and loops of the resource, that wait until the resource is open, each with the thread.
        self.waiting: list[tuple[Agent, int]] = []
        #: Threads that wait for the monitor of the agent.
        self.blocked: list[int] = []
        #: Output of threads since their last newline.
        self.lines: dict[int, str] = {}
        #: Consecutive yields per thread; above a limit the thread polls.
        self.poll_counts: dict[int, int] = {}
        #: Polling threads that read state outside the block.
        self.outward_pollers: set[int] = set()
        #: Polling threads that are parked.
        self.pollers: set[int] = set()
        #: The newest copy of each coordinator that a resource has served: generation and sequence.
        self.newest_callers: dict[str, tuple[int, int]] = {}
        #: Threads of a resource whose calls are cancelled, each with the reason that is to be thrown, ''
        #: after the throw.
        self.pending_cancels: dict[int, str] = {}
        #: Calls of the `together` whose results the agent has fetched here since the host's last query.
        self.fetched: list[tuple[str, int, int]] = []

    # --- start and end --------------------------------------------------------------------------------

    def add_loops(self, threads: dict[int, int]) -> None:
        """Let the threads of the loops, by method, wait until the resource is open."""
        self.loops = ResourceLoops(threads)
        self.waiting += [(self, thread) for thread in threads.values()]

    def is_own_loop(self, caller: Agent, thread: int) -> bool:
        """Whether a waiting thread belongs to a loop of this resource, and not to a call."""
        return caller is self and self.loops is not None and self.loops.has(thread)

    def finish_init(self, now: int) -> list[tuple[Agent, int]]:
        """Open the resource: its init has reached its first pause, at a time in ns. Returns the threads that
        waited.
        """
        self.open = True
        if self.loops is not None:
            self.loops.start(now)
        return self.drain_waiting()

    def drain_waiting(self) -> list[tuple[Agent, int]]:
        """Remove and return the calls that wait until the resource is open."""
        waiting, self.waiting = self.waiting, []
        return waiting

    def remove_waiting(self, caller: Agent, thread: int) -> bool:
        """Remove a call that waits until the resource is open; false if it does not wait."""
        if found := (caller, thread) in self.waiting:
            self.waiting.remove((caller, thread))
        return found

    def end(self, outcome: str, report: str = "") -> None:
        """End the agent: 'done' or 'dropped'. An agent ends once."""
        self.ended, self.report = self.ended or outcome, self.report or report

    def mark_stopping(self, reason: str) -> None:
        """Mark the coordinator as being stopped, for that reason."""
        self.stop_reason = reason

    def die(self, report: str, *, broken: bool) -> None:
        """End the agent by an exception, with its report; `broken` if a bug of lfield was the cause."""
        self.report, self.broken, self.ended = report, broken, "died"

    # --- hops and portal calls ------------------------------------------------------------------------

    def freeze(self) -> None:
        """Suspend the agent until the host decides."""
        self.frozen = True

    def resume(self, *, is_persisted: bool = False) -> None:
        """End the suspension. `is_persisted`: the present block is on disk or at the sender."""
        self.frozen, self.unreachable_reason = False, ""
        self.is_persisted = self.is_persisted or is_persisted

    def depart_for(self, resource: str, portal: int) -> None:
        """Suspend the agent until the host decides: it calls a portal (by index) on another host."""
        self.frozen, self.called_resource, self.called_portal = True, resource, portal

    def refuse_departure(self, reason: str) -> None:
        """Let the coordinator wait until its time limit expires, because it would arrive too late."""
        self.unreachable_reason = reason

    def wait_for_any(self) -> None:
        """Let the coordinator wait here for the first of several calls."""
        self.waits_for_any = True

    def stop_waiting_for_any(self, ended: Collection[int] = ()) -> bool:
        """End the wait for the first of several calls, and return whether there was one; `ended` are numbers
        of calls that have ended.
        """
        waited, self.waits_for_any = self.waits_for_any, False
        self.ended_elsewhere |= frozenset(ended)
        return waited

    def invalidate_image(self) -> None:
        """Mark the block on disk as outdated: the next portal call with side effects needs a new one."""
        self.is_persisted = False

    def start_call_of(self, caller: Agent) -> None:
        """Record that a portal starts for a coordinator, whose older copies are then refused."""
        w = caller.block.w
        self.newest_callers[caller.id] = w[layout.W_GENERATION], w[layout.W_SEQUENCE]
        caller.is_persisted = False

    def count_served(self) -> None:
        """Count a portal that has ended."""
        self.served += 1

    def mark_reserved(self, *, is_reserved: bool) -> None:
        """Set whether a coordinator has reserved the resource."""
        self.reserved = is_reserved

    def drain_fetched(self) -> list[tuple[str, int, int]]:
        """Remove and return the calls whose results the coordinator has fetched here."""
        fetched, self.fetched = self.fetched, []
        return fetched

    # --- threads --------------------------------------------------------------------------------------

    def drain_blocked(self) -> list[int]:
        """Remove and return the threads that wait for the monitor."""
        blocked, self.blocked = self.blocked, []
        return blocked

    def note_poll(self) -> None:
        """Record that the thread of this turn polls."""
        self.has_polled = True

    def end_turn(self) -> bool:
        """End a turn; returns whether its thread has polled."""
        polled, self.has_polled = self.has_polled, False
        return polled

    def remember_poll(self, image: bytes) -> None:
        """Store the block after the turn of a polling thread."""
        self.last_polled_image = image

    def drain_pollers(self) -> list[int]:
        """Remove and return the parked threads in order: the block may have changed."""
        pollers, self.pollers, self.last_polled_image = self.pollers, set(), b""
        return sorted(pollers)

    def start_monitor_wait(self, thread: int, state: int) -> None:
        """Record that a thread has left the monitor until a condition holds."""
        if not self.monitor_waits:
            # The dictionary is rare, so not every instance has one.
            self.monitor_waits = {}
        self.monitor_waits[thread] = state

    # --- time limits ----------------------------------------------------------------------------------

    def set_age(self, age: int, now: int) -> None:
        """Set the clock of the agent to `age` at the host's time `now`, both in ns."""
        self.offset = age - now

    def set_alarm(self, at: float = math.inf) -> None:
        """Set the next check of the time limits on the host's clock, in seconds; no argument: none."""
        self.alarm = at

    def mark_overdue(self, reason: str = "") -> None:
        """Record that a limit has expired that cannot be thrown yet, with the reason."""
        self.overdue, self.lateness_reason = True, reason or self.lateness_reason

    def clear_overdue(self) -> None:
        """Record that no expired limit is left that could not be thrown."""
        self.overdue = False

    def explain_lateness(self, reason: str = "") -> str:
        """Replace the reason for a late exception; returns the earlier one."""
        earlier, self.lateness_reason = self.lateness_reason, reason
        return earlier

    def cancel_call(self, expired_at: int, message: str) -> None:
        """Record that a limit that expired at this time (ns) cancels the call; the message is thrown when the
        call ends.
        """
        self.expired_at, self.expiry_message = expired_at, message

    def on_throw(self) -> None:
        """Record that an exception is thrown in the agent: its block changes, and it awaits no cancelled call
        any more.
        """
        self.is_persisted, self.expiry_message = False, ""

    @property
    def hops(self) -> int:
        """The number of migrations."""
        return self.block.w[layout.W_HOPS]

    @property
    def generation(self) -> int:
        """The generation of the agent's start."""
        return self.block.w[layout.W_GENERATION]

    @property
    def sequence(self) -> int:
        """The number of the last migration attempt."""
        return self.block.w[layout.W_SEQUENCE]
