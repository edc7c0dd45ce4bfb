"""The recordings of a team in one order of time: the receipt of a coordinator never precedes its departure.

The clocks of the hosts may differ by years, and in rate. `TeamOrder` determines the offsets of the clocks.
Then each host is moved later where a coordinator would otherwise arrive before it has left.
"""

from __future__ import annotations

import math
from array import array
from bisect import bisect_left, bisect_right
from collections import deque
from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

from lfield.bytecode.program import Program
from lfield.errors import RecordingError
from lfield.mission.mission import Mission
from lfield.replay.debugger.host_timeline import HostTimeline, Step
from lfield.replay.debugger.moment import Moment, Target
from lfield.replay.debugger.statement_table import StatementTable
from lfield.replay.debugger.targets import StepTarget, is_of_readings
from lfield.replay.host_recording import HostRecording
from lfield.replay.team_order import TeamOrder, TransferKey

#: A coordinator arrives at least this much after its departure, in seconds.
MIN_TRANSIT = 1e-6
#: The lengths of the intervals that are searched one after another, in seconds: the first, the longest.
FIRST_INTERVAL, LONGEST_INTERVAL = 0.1, 30.0


class Place(NamedTuple):
    """A position: the number of a recording, a turn in it, and a moment of that turn."""

    recording: int
    turn: int
    step: int = 0


class TeamTimeline:
    """Recordings of hosts of one mission. Times are in seconds since the first recorded turn.

    Raises RecordingError if there are no turns.
    """

    def __init__(self, recordings: Sequence[HostRecording], mission: Mission) -> None:
        self.mission = mission
        self.table = StatementTable(mission.program)
        self.hosts = [HostTimeline(each, mission, self.table) for each in recordings if each.turns]
        if not self.hosts:
            raise RecordingError("there are no recorded turns")
        order = TeamOrder([host.recording for host in self.hosts])
        #: The corrected time of each turn of each recording.
        self.times = _corrected_times(self.hosts, order)
        #: The hops: the coordinator that arrives, by recording and turn.
        self.arrivals = {
            (place.part, place.turn): hop.agent for hop, places in order.arrivals.items() for place in places
        }

    @property
    def program(self) -> Program:
        """The program of the mission."""
        return self.mission.program

    def watch_progress(self, on_progress: Callable[[float], None]) -> None:
        """Set the function that is called with the time that a search or another move has reached.

        The function may raise SearchCancelled: then the position is unchanged.
        """
        for host, times in zip(self.hosts, self.times, strict=True):
            host.watch_progress(partial(_report, on_progress, times))

    # --- order ----------------------------------------------------------------------------------------

    @property
    def start(self) -> Place:
        """The first position."""
        number = min(range(len(self.hosts)), key=lambda each: (self.times[each][0], each))
        return Place(number, 0)

    @property
    def end(self) -> Place:
        """The last position: after the last turn."""
        number = max(range(len(self.hosts)), key=lambda each: (self.times[each][-1], each))
        return Place(number, self.hosts[number].turns)

    @property
    def duration(self) -> float:
        """The time of the last turn, in seconds."""
        return max(times[-1] for times in self.times)

    def time_of(self, place: Place) -> float:
        """The time of a position; that of the end is the time of the last turn."""
        times = self.times[place.recording]
        return times[min(place.turn, len(times) - 1)]

    def order_of(self, place: Place) -> tuple[float, int, int, int]:
        """A key that sorts positions."""
        times = self.times[place.recording]
        at = times[place.turn] if place.turn < len(times) else math.nextafter(times[-1], math.inf)
        return at, place.recording, place.turn, place.step

    def place_at(self, seconds: float) -> Place:
        """The position of the first turn that is not earlier than a time; the end if there is none."""
        found = [
            Place(number, turn)
            for number, times in enumerate(self.times)
            if (turn := bisect_left(times, seconds)) < len(times)
        ]
        return min(found, key=self.order_of, default=self.end)

    def turn_after(self, recording: int, place: Place) -> int:
        """The number of the first turn of another recording that is later than a position."""
        if recording == place.recording:
            return place.turn
        at, own = self.order_of(place)[:2]
        times = self.times[recording]
        return bisect_right(times, at) if recording < own else bisect_left(times, at)

    def is_running(self, recording: int, place: Place) -> bool:
        """Whether the time of a position is within a recording."""
        return self.times[recording][0] <= self.time_of(place) <= self.times[recording][-1]

    # --- states ---------------------------------------------------------------------------------------

    def moment_at(self, place: Place) -> tuple[Moment, Place]:
        """The moment at a position, and the position with its number in the turn."""
        moment, step = self.hosts[place.recording].moment_at(place[1:])
        return moment, place._replace(step=step)

    def moment_of(self, recording: int, place: Place) -> Moment:
        """The state of another host at the time of a position; it is valid until the next call."""
        return self.hosts[recording].rest_at(self.turn_after(recording, place))

    def arrival_at(self, place: Place) -> str:
        """The coordinator that arrives with the turn of a position; '' for none."""
        return self.arrivals.get((place.recording, place.turn), "")

    # --- search ---------------------------------------------------------------------------------------

    def find(self, target: Target, place: Place, *, backward: bool = False) -> Place | None:
        """The next moment after a position, or the last one before it, that meets a target."""
        # Readings are found without a replay, so that a long interval costs little.
        at, length = self.time_of(place), math.inf if is_of_readings(target) else FIRST_INTERVAL
        low = high = at
        while low >= 0.0 if backward else high <= self.duration:
            if backward:
                high, low = low, self._busy_until(low) - length
            else:
                low, high = high, self._busy_from(high) + length
            if found := self._find_within(target, place, low, high, backward=backward):
                return found
            length = min(2.0 * length, LONGEST_INTERVAL)
        return None

    def find_line_start(self, step: StepTarget, place: Place) -> Place | None:
        """The beginning of the line that a thread was on before a position; None at its first line.

        A step forward stops there. From within a line the result is the beginning of that line. `step` is the
        step to another line.
        """
        before = self.find(step, place, backward=True)
        start = self.find(step.to_any_line(), self.start if before is None else before)
        if start is not None and self.order_of(start) < self.order_of(place):
            return start
        if before is None:
            return None
        step = step.moved_to(self.moment_at(before)[0])
        return self.find(step.to_any_line(), self.find(step, before, backward=True) or self.start)

    def _busy_from(self, at: float) -> float:
        """The time of the first turn that is not earlier than a time: clocks that are off leave long gaps."""
        following = (times[n] for times in self.times if (n := bisect_left(times, at)) < len(times))
        return min(following, default=at)

    def _busy_until(self, at: float) -> float:
        """The time of the last turn that is earlier than a time."""
        return max((times[n - 1] for times in self.times if (n := bisect_left(times, at))), default=at)

    def _find_within(
        self, target: Target, place: Place, low: float, high: float, *, backward: bool
    ) -> Place | None:
        """The best match in the turns of a half-open interval of time, before or after a position.

        The interval at the position includes all turns of its time.
        """
        matches: list[Place] = []
        for number, (host, times) in enumerate(zip(self.hosts, self.times, strict=True)):
            first, stop = bisect_left(times, low), bisect_left(times, high)
            after: Step = (first, -1)
            before: Step = (stop, -1)
            own = (place.turn, place.step)
            if backward and high == self.time_of(place):
                before = own if number == place.recording else (self.turn_after(number, place), -1)
            elif not backward and low == self.time_of(place):
                after = own if number == place.recording else (self.turn_after(number, place), -1)
            if after < before and (step := host.find(target, after, before, last=backward)):
                matches.append(Place(number, *step))
        choose = max if backward else min
        return choose(matches, key=self.order_of, default=None)


def _report(on_progress: Callable[[float], None], times: Sequence[float], turn: int) -> None:
    on_progress(times[min(turn, len(times) - 1)])


# --- clocks -----------------------------------------------------------------------------------------------


def _corrected_times(hosts: Sequence[HostTimeline], order: TeamOrder) -> list[array[float]]:
    found = []
    for host, offset, shift in zip(hosts, order.offsets, _shifts(order), strict=True):
        times = array("d")
        for (start, added), (stop, _) in zip(shift, [*shift[1:], (host.turns, 0.0)], strict=True):
            times.extend(at + offset + added for at in host.ats[start:stop])
        found.append(times)
    first = min(times[0] for times in found)
    return [array("d", (at - first for at in times)) for times in found]


def _shifts(order: TeamOrder) -> list[list[tuple[int, float]]]:
    """For each recording the turns from which it is moved later, with the total shift."""
    shifts = [[(0, 0.0)] for _ in order.parts]
    events: list[list[tuple[int, bool, TransferKey, float]]] = [[] for _ in order.parts]
    for hop, sent in order.sends.items():
        events[sent.part].append((sent.turn, True, hop, sent.at))
    for hop, places in order.arrivals.items():
        for place in places:
            events[place.part].append((place.turn, False, hop, place.at))
    waiting = [deque(sorted(each)) for each in events]
    departed: dict[TransferKey, float] = {}
    # An arrival waits until the time of its departure is known.
    is_changed = True
    while is_changed:
        changes = [_shift(order, n, shifts[n], queue, departed) for n, queue in enumerate(waiting)]
        is_changed = any(changes)
    return shifts


def _shift(
    order: TeamOrder,
    number: int,
    shifts: list[tuple[int, float]],
    waiting: deque[tuple[int, bool, TransferKey, float]],
    departed: dict[TransferKey, float],
) -> bool:
    """Process the transfers of a recording as far as possible; returns false if there is none."""
    count = len(waiting)
    while waiting:
        turn, is_departure, hop, at = waiting[0]
        at += order.offsets[number] + shifts[-1][1]
        if is_departure:
            departed[hop] = at
        elif hop in order.sends:
            if hop not in departed:
                break
            late = departed[hop] + MIN_TRANSIT - at
            if late > 0.0:
                shifts.append((turn, shifts[-1][1] + late))
        waiting.popleft()
    return len(waiting) < count
