"""One order for the turns of several hosts, whose clocks may be off by years.

The monotonic clock of each recording gets an offset to a common time. The wall clock of its start gives a
first guess. A hop bounds it: a coordinator arrives after it was sent. Hops in both directions enclose the
offset of two hosts, and so does the opening of their link, which both notice within LINK_TOLERANCE. For a
guess outside of these bounds, both have opened their link at the same time, if hops permit that.
"""

from __future__ import annotations

import heapq
import math
from collections import defaultdict
from collections.abc import Iterator, Sequence
from itertools import permutations
from typing import Any, NamedTuple

from lfield.host.inputs import Linked, TransferArrived
from lfield.host.recording.effect_summary import decode_effects
from lfield.host.recording.host_records import TurnRecord
from lfield.replay.host_recording import HostRecording, Turn

#: The longest time between the opening of a link on its two hosts, in seconds.
LINK_TOLERANCE = 5.0
_SENT = b"SendTransfer"


class TransferKey(NamedTuple):
    """A transfer: the coordinator, the generation of its start, the sequence number of the attempt, and the
    receiver."""

    agent: str
    generation: int
    sequence: int
    receiver: str


class TurnPlace(NamedTuple):
    """A turn: the number of its recording, its own number, and its time on the clock of its host."""

    part: int
    turn: int
    at: float


class OrderedTurn(NamedTuple):
    """A turn in the order of the team; `at` is its common time in seconds since 1970."""

    part: int
    number: int
    at: float
    record: Turn


class TeamOrder:
    """The turns of some recordings in one order.

    `sends` and `arrivals` have the turns of the hops, `offsets` the addition to the clock of each recording.
    """

    def __init__(self, parts: Sequence[HostRecording]) -> None:
        self.parts = parts
        self.sends: dict[TransferKey, TurnPlace] = {}
        self.arrivals: dict[TransferKey, list[TurnPlace]] = defaultdict(list)
        #: The time when each recording has met an incarnation.
        self._meetings: dict[tuple[int, int], float] = {}
        for number, part in enumerate(parts):
            self._index(number, part)
        self.offsets = self._align()

    def __iter__(self) -> Iterator[OrderedTurn]:
        """All turns; an arrival follows its departure, if that is recorded."""
        streams = [iter(part.turns_from(0)) for part in self.parts]
        heads: list[tuple[float, int]] = []
        waiting: dict[int, tuple[int, Turn]] = {}
        for number, stream in enumerate(streams):
            self._advance(number, stream, waiting, heads)
        done: set[TransferKey] = set()
        held: list[tuple[float, int]] = []
        while heads or held:
            if not heads:
                # The clocks contradict each other: the earliest waiting turn is next.
                held.sort()
                heapq.heappush(heads, held.pop(0))
                forced = True
            else:
                forced = False
            at, number = heapq.heappop(heads)
            turn, record = waiting[number]
            if not forced and self._is_early(number, record, done):
                held.append((at, number))
                continue
            yield OrderedTurn(number, turn, at, record)
            if departures_in(record):
                done.update(departures_in(record))
                heads.extend(held)
                held.clear()
                heapq.heapify(heads)
            self._advance(number, streams[number], waiting, heads)

    def _advance(
        self,
        number: int,
        stream: Iterator[tuple[int, Turn]],
        waiting: dict[int, tuple[int, Turn]],
        heads: list[tuple[float, int]],
    ) -> None:
        if (following := next(stream, None)) is not None:
            waiting[number] = following
            heapq.heappush(heads, (following[1].at + self.offsets[number], number))

    def _is_early(self, number: int, record: Turn, done: set[TransferKey]) -> bool:
        hop = arrival_in(self.parts[number].host, record)
        return hop is not None and hop in self.sends and hop not in done

    # --- offsets --------------------------------------------------------------------------------------

    def _index(self, number: int, part: HostRecording) -> None:
        for turn, record in part.turns_from(0):
            place = TurnPlace(number, turn, record.at)
            for hop in departures_in(record):
                self.sends.setdefault(hop, place)
            if (arrived := arrival_in(part.host, record)) is not None:
                self.arrivals[arrived].append(place)
            if isinstance(record, TurnRecord) and isinstance(record.entry, Linked):
                self._meetings.setdefault((number, record.entry.hello.incarnation), record.at)

    def _align(self) -> list[float]:
        guesses = [part.start.wall - part.start.at for part in self.parts]
        bounds = self._bounds()
        offsets: dict[int, float] = {}
        for root in range(len(self.parts)):
            if root in offsets:
                continue
            offsets[root] = guesses[root]
            queue = [root]
            while queue:
                aligned = queue.pop(0)
                for other in range(len(self.parts)):
                    if other in offsets or (aligned, other) not in bounds:
                        continue
                    low, high = bounds[aligned, other]
                    guess = guesses[other] - guesses[aligned]
                    opened = self._opened_at(aligned, other)
                    offsets[other] = offsets[aligned] + _within(guess, low, high, opened)
                    queue.append(other)
        return [offsets[number] for number in range(len(self.parts))]

    def _bounds(self) -> dict[tuple[int, int], tuple[float, float]]:
        """For each pair of recordings, the lowest and the highest offset of the second to the first."""
        low: dict[tuple[int, int], float] = {}
        for hop, sent in self.sends.items():
            for arrived in self.arrivals.get(hop, ()):
                pair = sent.part, arrived.part
                low[pair] = max(low.get(pair, -math.inf), sent.at - arrived.at)
        bounds_by_pair: dict[tuple[int, int], tuple[float, float]] = {}
        for part, other in {*low, *((b, a) for a, b in low)}:
            bounds_by_pair[part, other] = (
                low.get((part, other), -math.inf),
                -low.get((other, part), -math.inf),
            )
        for part, other in permutations(range(len(self.parts)), 2):
            if (opened := self._opened_at(part, other)) is None:
                continue
            bounds = opened - LINK_TOLERANCE, opened + LINK_TOLERANCE
            previous = bounds_by_pair.get((part, other), (-math.inf, math.inf))
            both = max(bounds[0], previous[0]), min(bounds[1], previous[1])
            bounds_by_pair[part, other] = both if both[0] <= both[1] else previous
        return bounds_by_pair

    def _opened_at(self, part: int, other: int) -> float | None:
        """The offset of `other` at which both opened their link at the same time; None without a link."""
        met = self._meetings.get((part, self.parts[other].start.incarnation))
        met_other = self._meetings.get((other, self.parts[part].start.incarnation))
        return None if met is None or met_other is None else met - met_other


def departures_in(record: Turn) -> list[TransferKey]:
    """The hops that a turn has sent."""
    if not isinstance(record, TurnRecord) or _SENT not in record.effects:
        return []
    return [_hop(effect) for effect in decode_effects(record.effects) if effect[0] == "SendTransfer"]


def arrival_in(host: str, record: Turn) -> TransferKey | None:
    """The hop that arrived with a turn of a host; None for any other turn."""
    if not isinstance(record, TurnRecord) or not isinstance(record.entry, TransferArrived):
        return None
    header = record.entry.header
    return TransferKey(header.agent, header.generation, header.sequence, host)


def _hop(effect: list[Any]) -> TransferKey:
    _, receiver, agent, generation, sequence, *_ = effect
    return TransferKey(agent, generation, sequence, receiver)


def _within(guess: float, low: float, high: float, opened: float | None) -> float:
    """The guess if the bounds permit it, else the nearest bound to the other one, or their middle."""
    if low <= guess <= high:
        return guess
    if opened is not None and low <= high:
        return min(max(opened, low), high)
    if math.isinf(low) or math.isinf(high) or low > high:
        return low if guess < low else high
    return (low + high) / 2.0
