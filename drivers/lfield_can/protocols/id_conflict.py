"""Detects two devices with one id. Pure: sent and received messages in, a verdict out.

`IdConflictProbe` is for nodes that answer. Two nodes both answer, so one request gets two answers. Answers
are counted per round; each round requests a subindex that no node has. Requests of other clients are seen on
the bus, and their answers expected. Some adapters echo frames: each round starts with a marker, an abort that
is neither answered nor sent by others, which reveals echoes. Since answers get lost, there are several
rounds, and a single excess frame proves nothing.

`Alternation` is for axes that answer nothing, as with CANSimple. Two axes at different positions send them
alternately, farther apart than any speed explains. A single outlier may be foreign or damaged. Two axes at
one position cannot be distinguished.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Sequence

from lfield_can.protocols.sdo import Key

#: Requested objects, in turn: the identity of the node (CiA 301, 7.5.2.19), which has four subindexes.
PROBED_OBJECTS: Sequence[Key] = [(0x1018, subindex) for subindex in range(0x60, 0x6C)]
#: The object of a round's marker.
MARK: Key = (0x1018, 0x6F)
#: Rounds without an excess answer after which there is one node, and rounds with one that prove a second
#: node. With a quarter of all frames lost, a second node is missed in 1 % of cases.
MIN_ROUNDS, MIN_SURPLUS = 6, 2
#: Rounds without any answer after which the node ignores missing objects.
SILENT = 2
#: Seconds from an answer to the next round, for the second answer.
GAP = 0.02
#: Number of returns to a position within a time (s) that prove two axes.
RETURNS, WITHIN = 6, 1.0
#: Positions that are nearer, in turns of the motor, may be one axis.
APART = 0.05


class IdConflictProbe:
    """The rounds of one check. A late answer counts for its own round.

    Without an excess answer it ends after `min_rounds` rounds.
    """

    def __init__(self, min_rounds: int = MIN_ROUNDS) -> None:
        self._min_rounds = min_rounds
        # By object: requests sent, requests seen, and answers.
        self._requests: dict[Key, int] = {}
        self._bus_requests: Counter[Key] = Counter()
        self._answers: Counter[Key] = Counter()
        self._marker_count = 0

    def next_key(self) -> Key | None:
        """The object of the next round, after its marker; None when the result is known."""
        rounds, surplus = len(self._requests), self._surplus
        unanswered = sum(1 for key in self._requests if not self._answers[key])
        if (
            surplus >= MIN_SURPLUS
            or unanswered >= SILENT
            or rounds >= (len(PROBED_OBJECTS) if surplus else self._min_rounds)
        ):
            return None
        self._requests[PROBED_OBJECTS[rounds]] = 0
        return PROBED_OBJECTS[rounds]

    def on_request(self, key: Key) -> None:
        """Counts a request for an object from here."""
        if key in self._requests:
            self._requests[key] += 1

    def on_bus_request(self, key: Key) -> None:
        """Counts a request on the bus: of another client, or an echo."""
        self._bus_requests[key] += 1

    def on_marker_echo(self) -> None:
        """Counts a received marker: the adapter echoes."""
        self._marker_count += 1

    def on_answer(self, key: Key) -> None:
        """Counts a received answer about an object."""
        self._answers[key] += 1

    @property
    def is_doubled(self) -> bool:
        """Whether a second node is proved."""
        return self._surplus >= MIN_SURPLUS

    @property
    def is_ignored(self) -> bool:
        """Whether no request was answered."""
        return not any(self._answers[key] for key in self._requests)

    @property
    def _surplus(self) -> int:
        return sum(
            1 for key, sent in self._requests.items() if self._answers[key] > self._request_count(key, sent)
        )

    def _request_count(self, key: Key, sent: int) -> int:
        """The number of requests for an object, by all clients."""
        echoed = sent if 2 * self._marker_count > len(self._requests) else 0
        return sent + max(0, self._bus_requests[key] - echoed)


class Alternation:
    """Positions in turns, velocities in turns/s, times in s."""

    def __init__(self) -> None:
        self._last: deque[tuple[float, float, float]] = deque(maxlen=3)
        self._returns: deque[float] = deque(maxlen=RETURNS)

    def on_position(self, position: float, velocity: float, now: float) -> None:
        """Adds a position."""
        self._last.append((position, velocity, now))
        if len(self._last) < 3:
            return
        (first, _, start), (between, _, _), (last, _, _) = self._last
        travel = max(abs(speed) for _, speed, _ in self._last) * (now - start)
        outward, inward = abs(between - first), abs(last - between)
        if min(outward, inward) > APART + 2.0 * travel and abs(last - first) < 0.25 * outward:
            self._returns.append(now)

    def is_proved(self, now: float) -> bool:
        """Whether two axes were detected recently."""
        return len(self._returns) == RETURNS and now - self._returns[0] <= WITHIN

    @property
    def last_return(self) -> float:
        """The time when the last outlier was received; minus infinity for never."""
        return self._returns[-1] if self._returns else float("-inf")
