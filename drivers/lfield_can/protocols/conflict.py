"""Whether one device or two have an id. Pure: what is sent and heard in, a verdict out.

`RollCall` is for nodes that answer. Each of two nodes answers every request, so what was asked about once
is answered twice. Answers are counted for each round of one set-up. Each round asks about a subindex that no
node has. A vendor's tool or a PLC that asks about the same one is heard on the bus, and its answer is
expected, too. Some adapters return what is sent: each round begins with a mark, an abort that no node answers
and nobody else sends, so that own requests are not taken for those of others. Answers get lost, so there are
several rounds, and a single frame too many proves nothing.

`Alternation` is for axes that answer nothing, as those of CANSimple. Two that stand apart send two places in
turn, farther from each other than any speed explains. A single frame that does not fit is a foreign one, or a
damaged one, and proves nothing. Two axes at one place cannot be told apart.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Sequence

from lfield_can.protocols.sdo import Key

#: What is asked about, in turn: of the identity of the node (CiA 301, 7.5.2.19), which has four subindexes.
ASKED: Sequence[Key] = [(0x1018, subindex) for subindex in range(0x60, 0x6C)]
#: What the mark of a round is about.
MARK: Key = (0x1018, 0x6F)
#: Rounds without any answer too many after which there is one node, and rounds with one too many that prove
#: a second node. With a quarter of all frames lost, a second node is missed once in a hundred times.
FEWEST, PROOF = 6, 2
#: Rounds without any answer after which nothing can be known: it ignores what it does not have.
SILENT = 2
#: Seconds from an answer to the next round, in which the second answer comes.
GAP = 0.02
#: So many returns to a place within so many seconds prove two axes.
RETURNS, WITHIN = 6, 1.0
#: Places that are nearer, in turns of the motor, may be one axis.
APART = 0.05


class RollCall:
    """The rounds of one set-up, or of one look. A late answer counts for its own round.

    Without any answer too many it ends after `fewest` rounds.
    """

    def __init__(self, fewest: int = FEWEST) -> None:
        self._fewest = fewest
        # By object: requests that were sent, requests that were heard, and answers.
        self._requests: dict[Key, int] = {}
        self._heard: Counter[Key] = Counter()
        self._answers: Counter[Key] = Counter()
        self._marks = 0

    def next_key(self) -> Key | None:
        """What to ask about in the next round, after its mark; None when enough is known."""
        done, surplus = len(self._requests), self._surplus
        unanswered = sum(1 for key in self._requests if not self._answers[key])
        if surplus >= PROOF or unanswered >= SILENT or done >= (len(ASKED) if surplus else self._fewest):
            return None
        self._requests[ASKED[done]] = 0
        return ASKED[done]

    def on_request(self, key: Key) -> None:
        """An object was asked about from here."""
        if key in self._requests:
            self._requests[key] += 1

    def on_heard_request(self, key: Key) -> None:
        """A request was heard on the bus: somebody else's, or what was sent from here."""
        self._heard[key] += 1

    def on_heard_mark(self) -> None:
        """A mark was heard: the adapter returns what is sent."""
        self._marks += 1

    def on_answer(self, key: Key) -> None:
        """An answer about an object came."""
        self._answers[key] += 1

    @property
    def is_doubled(self) -> bool:
        """Whether a second node is proved."""
        return self._surplus >= PROOF

    @property
    def is_ignored(self) -> bool:
        """Whether no question was answered."""
        return not any(self._answers[key] for key in self._requests)

    @property
    def _surplus(self) -> int:
        return sum(1 for key, sent in self._requests.items() if self._answers[key] > self._asked(key, sent))

    def _asked(self, key: Key, sent: int) -> int:
        """How often an object was asked about, by anybody."""
        returned = sent if 2 * self._marks > len(self._requests) else 0
        return sent + max(0, self._heard[key] - returned)


class Alternation:
    """Positions in turns, velocities in turns/s, times in s."""

    def __init__(self) -> None:
        self._last: deque[tuple[float, float, float]] = deque(maxlen=3)
        self._returns: deque[float] = deque(maxlen=RETURNS)

    def on_position(self, position: float, velocity: float, now: float) -> None:
        """One more position."""
        self._last.append((position, velocity, now))
        if len(self._last) < 3:
            return
        (first, _, begun), (between, _, _), (last, _, _) = self._last
        way = max(abs(speed) for _, speed, _ in self._last) * (now - begun)
        there, back = abs(between - first), abs(last - between)
        if min(there, back) > APART + 2.0 * way and abs(last - first) < 0.25 * there:
            self._returns.append(now)

    def is_proved(self, now: float) -> bool:
        """Whether two axes were heard lately."""
        return len(self._returns) == RETURNS and now - self._returns[0] <= WITHIN

    @property
    def last_return(self) -> float:
        """When the last position came that did not fit; minus infinity for never."""
        return self._returns[-1] if self._returns else float("-inf")
