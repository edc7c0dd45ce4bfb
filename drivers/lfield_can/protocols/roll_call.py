"""Whether one node or two answer to a node id. Pure: requests and answers in, keys to ask about out.

Each of two nodes answers every request, so what was asked about once is answered twice. Answers are counted
for each round of one set-up. Each round asks about a subindex that no node has and no tool reads: the answers
of a node to the requests of a vendor's tool or a PLC are about other objects, and count for nothing. Answers
get lost, so there are several rounds, and a single frame too many proves nothing.
"""

from __future__ import annotations

from collections.abc import Sequence

from lfield_can.protocols.sdo import Key

#: What is asked about, in turn: of the identity of the node (CiA 301, 7.5.2.19), which has four subindexes.
ASKED: Sequence[Key] = [(0x1018, subindex) for subindex in range(0x60, 0x6C)]
#: Rounds without any answer too many after which there is one node, and rounds with one too many that prove
#: a second node. With a quarter of all frames lost, a second node is missed once in a hundred times.
FEWEST, PROOF = 6, 2
#: Rounds without any answer after which nothing can be known: it ignores what it does not have.
SILENT = 2
#: Seconds from an answer to the next round, in which the second answer comes.
GAP = 0.02


class RollCall:
    """The rounds of one set-up. A late answer counts for its own round."""

    def __init__(self) -> None:
        self._requests: dict[Key, int] = {}
        self._answers: dict[Key, int] = {}

    def next_key(self) -> Key | None:
        """What to ask about in the next round; None when enough is known."""
        done, surplus = len(self._requests), self._surplus
        unanswered = sum(1 for key in self._requests if not self._answers.get(key))
        if surplus >= PROOF or unanswered >= SILENT or done >= (len(ASKED) if surplus else FEWEST):
            return None
        self._requests[ASKED[done]] = 0
        return ASKED[done]

    def on_request(self, key: Key) -> None:
        """An object was asked about."""
        if key in self._requests:
            self._requests[key] += 1

    def on_answer(self, key: Key) -> None:
        """An answer about an object came."""
        self._answers[key] = self._answers.get(key, 0) + 1

    @property
    def is_doubled(self) -> bool:
        """Whether a second node is proved."""
        return self._surplus >= PROOF

    @property
    def _surplus(self) -> int:
        return sum(1 for key, asked in self._requests.items() if self._answers.get(key, 0) > asked)
