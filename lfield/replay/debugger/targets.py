"""Targets of searches in the debugger: statements of a thread, lines, portal calls, hops, events, values."""

from __future__ import annotations

from collections.abc import Callable, Collection

from lfield.host.effects import CallDevice, Effect
from lfield.replay.debugger.expressions import AWAY, NO_VALUE
from lfield.replay.debugger.moment import Moment, Phase, Target, ThreadKey
from lfield.replay.debugger.statement_table import SourceLine
from lfield.wire.events import Event

#: The events of one turn that are compared: their number, and their bytes.
MAX_EVENTS, MAX_EVENT_BYTES = 100_000, 16 << 20
_NONE: frozenset[int] = frozenset()


class StepTarget:
    """The next statement of a logical thread. `key` is the thread at the start, `depth` its depth.

    `deepest` is the largest depth of the frame that is accepted, None for any. With `other_than`, the
    statement is on another line, or in another frame.
    """

    stops: frozenset[int] | None = None

    def __init__(
        self,
        key: ThreadKey,
        depth: int = 0,
        deepest: int | None = None,
        other_than: SourceLine | None = None,
    ) -> None:
        self._key, self._depth, self._deepest, self._other_than = key, depth, deepest, other_than

    def start(self, moment: Moment) -> None:
        """Has no effect: this target does not compare moments."""

    def is_met(self, moment: Moment) -> bool:
        """See `Target`."""
        running = moment.running
        if running is None or running.logical != self._key.logical:
            return False
        # From a portal only to the same portal, or back to its coordinator: others run at the same time.
        is_portal = self._key.agent != self._key.logical
        if is_portal and running != self._key and running.agent != running.logical:
            return False
        if self._deepest is not None and moment.depth > self._deepest:
            return False
        return self._other_than is None or moment.depth != self._depth or moment.line != self._other_than

    def moved_to(self, moment: Moment) -> StepTarget:
        """The same kind of step from a statement that has met this one."""
        assert moment.running is not None
        deepest = None if self._deepest is None else moment.depth
        return StepTarget(moment.running, moment.depth, deepest, moment.line)

    def to_any_line(self) -> StepTarget:
        """The step to the next statement of the same thread, in the same frames."""
        return StepTarget(self._key, self._depth, self._deepest)


class StatementTarget:
    """The next statement of any thread, or only of those of a logical thread, or of coordinators."""

    stops: frozenset[int] | None = None

    def __init__(self, logical: str = "", *, coordinators: bool = False) -> None:
        self._logical, self._coordinators = logical, coordinators

    def start(self, moment: Moment) -> None:
        """Has no effect: this target does not compare moments."""

    def is_met(self, moment: Moment) -> bool:
        """See `Target`."""
        running = moment.running
        if running is None or self._logical not in ("", running.logical):
            return False
        return not self._coordinators or moment.agents[running.agent].member.kind == "coordinator"


class InstructionTarget:
    """Any of some statements, by first instruction, if `condition` holds: breakpoints, portals."""

    def __init__(
        self, stops: frozenset[int], condition: Callable[[Moment], bool] | None = None, logical: str = ""
    ) -> None:
        self.stops: frozenset[int] | None = stops
        self._stops, self._condition, self._logical = stops, condition, logical

    def start(self, moment: Moment) -> None:
        """Has no effect: this target does not compare moments."""

    def is_met(self, moment: Moment) -> bool:
        """See `Target`."""
        running = moment.running
        if running is None or moment.pc not in self._stops:
            return False
        if self._logical not in ("", running.logical):
            return False
        return self._condition is None or self._condition(moment)


class HopTarget:
    """A coordinator, or that with an id, has arrived from another host, or was just sent to one."""

    stops: frozenset[int] | None = _NONE

    def __init__(self, agent: str = "") -> None:
        self._agent = agent
        self._hops: dict[str, int] = {}

    def start(self, moment: Moment) -> None:
        """See `Target`."""
        self._hops = _hops(moment)

    def is_met(self, moment: Moment) -> bool:
        """See `Target`."""
        before, self._hops = self._hops, _hops(moment)
        # A coordinator that starts here has made no hop.
        return any(
            hops and hops != before.get(name, 0)
            for name, hops in self._hops.items()
            if self._agent in ("", name)
        )


def _hops(moment: Moment) -> dict[str, int]:
    return {name: each.hops for name, each in moment.agents.items() if each.member.kind == "coordinator"}


class EventTarget:
    """An event of the event log, of one of some kinds if any are given, and of an agent if one is named."""

    stops: frozenset[int] | None = _NONE

    def __init__(self, kinds: Collection[str] = (), agent: str = "") -> None:
        self._kinds, self._agent = frozenset(kinds), agent
        self._last = 0

    def start(self, moment: Moment) -> None:
        """See `Target`."""
        moment.core.recorder.drain()
        self._last = moment.core.recorder.event_log.latest

    def is_met(self, moment: Moment) -> bool:
        """See `Target`."""
        # Events of hops are made later.
        moment.core.recorder.drain()
        log = moment.core.recorder.event_log
        if log.latest == self._last:
            return False
        (found, _), self._last = log.after(self._last, MAX_EVENTS, MAX_EVENT_BYTES), log.latest
        return any(self._is_searched(event) for event in found)

    def _is_searched(self, event: Event) -> bool:
        if self._kinds and event.kind not in self._kinds:
            return False
        return self._agent in ("", getattr(event.what, "agent", None))


class EffectTarget:
    """A turn has an effect of one of some classes: calls of devices, output, messages."""

    stops: frozenset[int] | None = _NONE

    def __init__(self, kinds: tuple[type[Effect], ...] = (CallDevice,)) -> None:
        self._kinds = kinds

    def start(self, moment: Moment) -> None:
        """Has no effect: this target does not compare moments."""

    def is_met(self, moment: Moment) -> bool:
        """See `Target`."""
        return moment.phase is Phase.END and any(isinstance(each, self._kinds) for each in moment.effects)


class ConditionTarget:
    """A condition that did not hold becomes true. `value` returns None without a value.

    `value` returns AWAY while the coordinator is on another host: an arrival is no change.
    `of_readings`: the condition depends on readings of devices only.
    """

    def __init__(self, value: Callable[[Moment], object], *, of_readings: bool = False) -> None:
        self._value, self.of_readings = value, of_readings
        self.stops: frozenset[int] | None = _NONE if of_readings else None
        self._held: object = None

    def start(self, moment: Moment) -> None:
        """See `Target`."""
        self._held = self._value(moment)

    def is_met(self, moment: Moment) -> bool:
        """See `Target`."""
        before, self._held = self._held, self._value(moment)
        return self._held is True and before is not True and before is not AWAY


class ChangeTarget:
    """A value changes. `value` returns NO_VALUE without a value, which is no change.

    `value` returns AWAY while the coordinator is on another host: its value at its arrival is no change.
    `of_readings`: the value depends on readings of devices only.
    """

    def __init__(self, value: Callable[[Moment], object], *, of_readings: bool = False) -> None:
        self._value, self.of_readings = value, of_readings
        self.stops: frozenset[int] | None = _NONE if of_readings else None
        self._known: object = NO_VALUE

    def start(self, moment: Moment) -> None:
        """See `Target`."""
        self._known = self._value(moment)

    def is_met(self, moment: Moment) -> bool:
        """See `Target`."""
        value = self._value(moment)
        if value is NO_VALUE:
            return False
        known, self._known = self._known, value
        if known is NO_VALUE or known is AWAY or value is AWAY:
            return False
        return type(known) is not type(value) or known != value


def is_of_readings(target: Target) -> bool:
    """Whether a target depends on readings of devices only, which are in the records of a recording."""
    return isinstance(target, ConditionTarget | ChangeTarget) and target.of_readings


class AnyTarget:
    """Any of several targets, such as a step or a breakpoint. `met` are those of the last match."""

    def __init__(self, targets: Collection[Target]) -> None:
        self._targets = tuple(targets)
        self.met: tuple[Target, ...] = ()
        stops: frozenset[int] | None = _NONE
        for each in targets:
            stops = None if stops is None or each.stops is None else stops | each.stops
        self.stops = stops

    def start(self, moment: Moment) -> None:
        """See `Target`."""
        for each in self._targets:
            each.start(moment)

    def is_met(self, moment: Moment) -> bool:
        """See `Target`."""
        found = tuple(each for each in self._targets if each.is_met(moment))
        self.met = found or self.met
        return bool(found)
