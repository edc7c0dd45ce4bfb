"""The time-travel debugger: a position in the recordings of a team, moved forwards and backwards.

The front ends (terminal, Debug Adapter Protocol, page) use this class only, and the types of its results.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

from msgspec import Struct

from lfield.errors import UsageError
from lfield.host.effects import CallDevice
from lfield.replay.debugger.device_readings import DeviceReading, device_readings
from lfield.replay.debugger.expressions import AWAY, WatchExpression, WatchScope
from lfield.replay.debugger.frames import (
    StackFrame,
    coordinator_key,
    display_key,
    followed_places,
    frame_places,
    live_agents,
    reader_of,
    stack_of,
    state_name,
    thread_keys,
)
from lfield.replay.debugger.host_timeline import MAX_EVENT_BYTES
from lfield.replay.debugger.moment import Moment, Target, ThreadKey, thread_key
from lfield.replay.debugger.targets import (
    AnyTarget,
    ChangeTarget,
    ConditionTarget,
    EffectTarget,
    EventTarget,
    HopTarget,
    InstructionTarget,
    StatementTarget,
    StepTarget,
)
from lfield.replay.debugger.team_timeline import Place, TeamTimeline
from lfield.replay.debugger.value_tree import Variable
from lfield.text.suggestions import choice
from lfield.wire.events import KINDS, Event


class ThreadInfo(Struct, frozen=True):
    """A thread of the team: its position and its activity."""

    key: ThreadKey
    host: str
    recording: int
    state: str

    @property
    def name(self) -> str:
        """A coordinator's id, or AGENT#THREAD."""
        key = self.key
        return key.agent if key.agent == key.logical else f"{key.agent}#{key.thread}"


class Breakpoint(Struct, frozen=True):
    """A line, and the condition that must hold there."""

    file: str
    line: int
    condition: WatchExpression | None = None


class Debugger:
    """Debugs the recordings of `team`. Its position is `place`; it follows the thread `focus`.

    Every method that moves returns whether it has found its target; otherwise the place is unchanged.
    """

    def __init__(self, team: TeamTimeline) -> None:
        self.team = team
        self.place = team.start
        #: The thread that the steps and expressions are about; None before the first one is chosen.
        self.focus: ThreadKey | None = None
        self.breakpoints: list[Breakpoint] = []
        self._moment: Moment | None = None
        self._moment_place: Place | None = None

    # --- the present position -------------------------------------------------------------------------

    @property
    def seconds(self) -> float:
        """The time of the position, since the start of the recordings."""
        return self.team.time_of(self.place)

    @property
    def host(self) -> str:
        """The host of the position."""
        return self.team.hosts[self.place.recording].recording.host

    @property
    def first_difference(self) -> int | None:
        """The turn from which on the state of this host is not that of the recording; None before it."""
        found = self.team.hosts[self.place.recording].divergence
        return None if found is None or self.place.turn < found[0] else found[0]

    @property
    def moment(self) -> Moment:
        """The state of the host of the position."""
        if self._moment is None or self._moment_place != self.place:
            self._moment, self.place = self.team.moment_at(self.place)
            self._moment_place = self.place
        return self._moment

    def moment_of(self, recording: int) -> Moment:
        """The state of any host at this time; that of another one is valid until the next call."""
        return (
            self.moment if recording == self.place.recording else self.team.moment_of(recording, self.place)
        )

    @property
    def running(self) -> list[int]:
        """The recordings of hosts that run at this time, that of the position first."""
        own = self.place.recording
        others = (n for n in range(len(self.team.hosts)) if n != own and self.team.is_running(n, self.place))
        return [own, *others]

    # --- threads, stacks, values ----------------------------------------------------------------------

    def threads(self) -> list[ThreadInfo]:
        """The threads of all hosts. A coordinator in transit is on the host where its newest copy is."""
        copies: dict[ThreadKey, tuple[tuple[int, int, bool], ThreadInfo]] = {}
        for recording in self.running:
            moment = self.moment_of(recording)
            agents = live_agents(moment)
            for key in thread_keys(moment):
                agent = agents[key.agent]
                copy = agent.generation, agent.hops, not agent.frozen
                if key not in copies or copy > copies[key][0]:
                    info = ThreadInfo(key, moment.core.name, recording, state_name(moment, key))
                    copies[key] = copy, info
        return [info for _, info in copies.values()]

    def find_thread(self, name: str) -> ThreadInfo | None:
        """A thread by its name, or by the id of its agent."""
        known = self.threads()
        exact = (each for each in known if each.name == name)
        return next(exact, next((each for each in known if each.key.agent == name), None))

    def choose(self, key: ThreadKey) -> None:
        """Follow another thread."""
        self.focus = key

    def stack(self, key: ThreadKey | None = None) -> list[StackFrame]:
        """The frames of a thread, by default of the followed one; innermost first."""
        return self._stack(key)[1]

    def _stack(self, key: ThreadKey | None = None) -> tuple[Moment, list[StackFrame]]:
        chosen = key or self.focus
        if chosen is None:
            return self.moment, []
        if frames := stack_of(self.moment, chosen):
            return self.moment, frames
        # When a thread of a portal ends, its coordinator is followed.
        coordinator = "" if key else chosen.logical
        found = [each for each in self.threads() if each.key == chosen or each.key.agent == coordinator]
        if not found:
            return self.moment, []
        info = next((each for each in found if each.key == chosen), found[0])
        moment = self.moment_of(info.recording)
        return moment, stack_of(moment, info.key)

    def variables(self, frame: StackFrame) -> list[Variable]:
        """The named variables of a frame, with `this`."""
        return reader_of(self._moment_with(frame), frame.key.agent).locals(frame.frame)

    def parts(self, frame: StackFrame, variable: Variable) -> list[Variable]:
        """The fields or elements of a variable of a frame."""
        return reader_of(self._moment_with(frame), frame.key.agent).parts(variable)

    def _moment_with(self, frame: StackFrame) -> Moment:
        if frame.host == self.host:
            return self.moment
        hosts = (number for number in self.running if self.team.hosts[number].recording.host == frame.host)
        return self.moment_of(next(hosts, self.place.recording))

    def readings(self) -> list[DeviceReading]:
        """The readings of the devices of all hosts, as known to their cores."""
        return [each for number in self.running for each in device_readings(self.moment_of(number))]

    def events(self, count: int) -> list[Event]:
        """The last events of the host of the position, at most so many."""
        moment = self.moment
        recorder = moment.core.recorder
        recorder.drain()
        log = recorder.event_log
        found, _ = log.after(max(0, log.latest - count), count, MAX_EVENT_BYTES)
        if len(found) < count and moment.origin:
            host = self.team.hosts[self.place.recording]
            found = [*host.events_before(moment.origin, count - len(found)), *found]
        return found

    def evaluate(self, text: str, frame: StackFrame | None = None) -> tuple[object, Variable | None]:
        """The value of an expression in a frame and those below it, and the variable if it names one.

        Raises UsageError for a mistake in it, ValueUnknown where it has no value.
        """
        moment, frames = self._stack(None if frame is None else frame.key)
        if frame in frames:
            frames = frames[frames.index(frame) :]
        scope = WatchScope(moment, [(each.key.agent, each.frame) for each in frames], self.readings)
        expression = WatchExpression(text)
        if (found := expression.variable(scope)) is not None:
            return scope.plain(found), scope.described(text, found)
        return expression.value(scope), None

    # --- moves ----------------------------------------------------------------------------------------

    def go_to(self, place: Place) -> None:
        """Move to a position."""
        self.place = place

    def go_to_time(self, seconds: float) -> None:
        """Move to the first turn that is not earlier than a time."""
        self.go_to(self.team.place_at(seconds))

    def search(self, target: Target, *, backward: bool = False) -> bool:
        """Move to the next or last moment that meets a target, and follow the thread that runs there."""
        found = self.team.find(target, self.place, backward=backward)
        return found is not None and self._arrive(found, target)

    def _arrive(self, found: Place, target: Target) -> bool:
        """Move to the result of a search, and follow the thread that runs there."""
        self.go_to(found)
        if self.moment.running is not None:
            self.focus = display_key(self.moment, self.moment.running)
        elif (arrived := self.team.arrival_at(found)) and isinstance(target, HopTarget):
            self.focus = coordinator_key(self.moment, arrived) or self.focus
        elif isinstance(target, EffectTarget) and (call := self._device_call) is not None:
            key = thread_key(self.moment.core, call.agent.id, call.thread)
            self.focus = display_key(self.moment, key)
        return True

    @property
    def _device_call(self) -> CallDevice | None:
        """The first call of a device in this turn."""
        return next((each for each in self.moment.effects if isinstance(each, CallDevice)), None)

    def enter(self) -> bool:
        """Move to the first statement of a coordinator, or of any thread if there is none."""
        return self.search(StatementTarget(coordinators=True)) or self.search(StatementTarget())

    def step(self, *, backward: bool = False) -> bool:
        """Move by one statement of the followed thread, into calls and portals."""
        return self.search(self._step(None, by_line=False), backward=backward)

    def step_line(self, *, backward: bool = False) -> bool:
        """Move to another line of the followed thread, into calls and portals; backward to its beginning."""
        return self._step_by_line(None, backward=backward)

    def step_over(self, *, backward: bool = False) -> bool:
        """Move to another line in this frame or a calling one; backward to its beginning."""
        top = self._top
        return self._step_by_line(top.depth if top else None, backward=backward)

    def _step_by_line(self, deepest: int | None, *, backward: bool) -> bool:
        step = self._step(deepest, by_line=True)
        if not backward or not isinstance(step, StepTarget):
            return self.search(step, backward=backward)
        found = self.team.find_line_start(step, self.place)
        return found is not None and self._arrive(found, step)

    def step_out(self, *, backward: bool = False) -> bool:
        """Move to a statement of the calling frame: backward to that of the call."""
        frames = self.stack() if self.focus is not None else []
        if len(frames) == 1 and not frames[0].key.has_caller:
            return False
        deepest = frames[0].depth - 1 if frames else None
        return self.search(self._step(deepest, by_line=False), backward=backward)

    def resume(self, *, backward: bool = False) -> bool:
        """Move to the next breakpoint."""
        return self.search(AnyTarget([self.target_of(each) for each in self.breakpoints]), backward=backward)

    @property
    def _top(self) -> StackFrame | None:
        frames = self.stack() if self.focus is not None else []
        return frames[0] if frames else None

    def _step(self, deepest: int | None, *, by_line: bool) -> Target:
        if self.focus is None:
            return StatementTarget()
        top = self._top
        if top is None:
            # A coordinator is somewhere else in time; the thread of a resource has ended.
            is_coordinator = self.focus.agent == self.focus.logical
            return StatementTarget(self.focus.logical if is_coordinator else "")
        return StepTarget(top.key, top.depth, deepest, top.line if by_line else None)

    # --- breakpoints and other targets ----------------------------------------------------------------

    def add_breakpoint(self, breakpoint: Breakpoint) -> None:
        """Add a breakpoint for `resume`."""
        self.breakpoints.append(breakpoint)

    def remove_breakpoint(self, breakpoint: Breakpoint) -> None:
        """Remove a breakpoint."""
        self.breakpoints.remove(breakpoint)

    def replace_breakpoints(self, breakpoints: list[Breakpoint]) -> None:
        """Set all breakpoints."""
        self.breakpoints = breakpoints

    def target_of(self, breakpoint: Breakpoint) -> Target:
        """The target: the statements of a line, if its condition holds."""
        condition = breakpoint.condition
        check = None if condition is None else _holds(condition)
        return InstructionTarget(self.team.table.at_line(breakpoint.file, breakpoint.line), check)

    def portal_target(self) -> Target:
        """The target: the start of any portal call."""
        return InstructionTarget(self.team.table.portals)

    def hop_target(self, agent: str = "") -> Target:
        """The target: the arrival of a coordinator. Raises UsageError for an unknown one."""
        known = [member.id for member in self.team.mission.team.coordinators]
        if agent and agent not in known:
            raise UsageError(f"there is no coordinator '{agent}'; {choice(agent, known, 'coordinators:')}")
        return HopTarget(agent)

    def event_target(self, kinds: Iterable[str] = ()) -> Target:
        """The target: an event of some kinds (events.md), or of any. Raises UsageError for another."""
        kinds = tuple(kinds)
        for kind in kinds:
            if kind not in KINDS:
                raise UsageError(f"there is no event of the kind '{kind}'; {choice(kind, KINDS, 'kinds:')}")
        return EventTarget(kinds)

    def device_target(self) -> Target:
        """The target: the call of a device instruction."""
        return EffectTarget()

    def condition(self, text: str) -> WatchExpression:
        """An expression that can be true or false, and has names of this mission. Raises UsageError."""
        expression = WatchExpression(text)
        if not expression.may_be_condition:
            raise UsageError(f"'{text}' is no condition: write a comparison, as battery < 0.3")
        self._require_known(expression)
        return expression

    def condition_target(self, text: str) -> Target:
        """The target: a condition becomes true. Raises UsageError."""
        expression = self.condition(text)
        value = self._value_of(expression, expression.value_or_none)
        return ConditionTarget(value, of_readings=self._is_of_readings(expression))

    def change_target(self, text: str) -> Target:
        """The target: the value of an expression changes. Raises UsageError."""
        expression = WatchExpression(text)
        self._require_known(expression)
        value = self._value_of(expression, expression.content)
        return ChangeTarget(value, of_readings=self._is_of_readings(expression))

    def _require_known(self, expression: WatchExpression) -> None:
        """Raises UsageError for a name that has no meaning in this mission at any time."""
        calls = self.team.program.core.device_calls
        known = {
            *self.team.table.variables,
            *(member.id for member in self.team.mission.team.members),
            *(name for call in calls for name in (call.field, call.instruction)),
            "this",
        }
        for name in sorted(expression.names - known):
            raise UsageError(f"'{name}' is no variable or reading of this mission")

    def _is_of_readings(self, expression: WatchExpression) -> bool:
        return bool(expression.names) and not expression.names & self.team.table.variables

    def _value_of(
        self, expression: WatchExpression, read: Callable[[WatchScope], object]
    ) -> Callable[[Moment], object]:
        focus, top = self.focus, self._top
        is_of_program = expression.names <= self.team.table.variables
        if self._is_of_readings(expression):
            # Of two readings with that name, that of the agent which is shown now.
            agent = "" if top is None else top.key.agent
            return lambda moment: read(WatchScope(moment, agent=agent))

        def value(moment: Moment) -> object:
            frames = [] if focus is None else followed_places(moment, focus)
            return AWAY if is_of_program and not frames else read(WatchScope(moment, frames))

        return value


def _holds(condition: WatchExpression) -> Callable[[Moment], bool]:
    def holds(moment: Moment) -> bool:
        running = moment.running
        frames = [] if running is None else frame_places(moment, display_key(moment, running))
        return condition.value_or_none(WatchScope(moment, frames)) is True

    return holds
