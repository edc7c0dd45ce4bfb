"""Dynamic node ids: the allocator of a bus (specification, 6. Application level functions). Pure.

A node without an id sends its unique id in three anonymous messages of 6, 6 and 4 bytes; each is answered
with all bytes so far, the last with its id. A unique id of a binding gets the node id of that binding, so
nothing is stored; any other gets the highest free id.
"""

from __future__ import annotations

from collections.abc import Mapping

from msgspec import Struct

from lfield_can.drone_can.messages import ALLOCATION, Values, decode, encode

#: Bytes of a unique id, and of the parts in which it is sent.
UNIQUE_ID, PARTS = 16, (6, 6, 4)
#: Seconds between two parts (FOLLOWUP_TIMEOUT_MS).
FOLLOWUP = 0.5
#: Seconds to detect the ids in use before the first is assigned: a node sends its status every second.
LEARNING = 1.5
HIGHEST = 125


class Answer(Struct, frozen=True):
    """Data of an answer; `node` is the id that it assigns, 0 for none yet."""

    data: bytes
    node: int = 0


class Allocator:
    """Assigns node ids. `bound` are the node ids in bindings, by unique id."""

    def __init__(self, bound: Mapping[bytes, int], reserved: frozenset[int], now: float) -> None:
        self._assigned: dict[bytes, int] = dict(bound)
        self._reserved = reserved | frozenset(bound.values())
        self._in_use: set[int] = set()
        self._start = now
        self._query, self._received_at = b"", now

    def on_node(self, node: int) -> None:
        """Records a node on the bus: its id is not assigned to another."""
        self._in_use.add(node)

    def on_request(self, data: bytes, now: float) -> Answer | None:
        """The answer to an anonymous request; None if it is ignored."""
        if (decoded := decode(ALLOCATION, data)) is None or now - self._start < LEARNING:
            return None
        values, part = decoded
        if now - self._received_at > FOLLOWUP:
            self._query = b""
        if values["is_first"]:
            self._query = b""
        stage = {0: 0, 6: 1, 12: 2}.get(len(self._query), 0)
        if len(part) != PARTS[stage] or bool(values["is_first"]) is not (stage == 0):
            return None
        self._query, self._received_at = self._query + part, now
        if len(self._query) < UNIQUE_ID:
            return self._answer(0)
        node = self._node_for(self._query, int(values["node"]))
        answer = self._answer(node) if node else None
        self._query = b""
        return answer

    def _node_for(self, unique_id: bytes, preferred: int) -> int:
        """The id of a node; 0 if all are in use."""
        if (assigned := self._assigned.get(unique_id, 0)) != 0:
            return assigned
        used = self._in_use | self._reserved | set(self._assigned.values())
        upwards = range(preferred, HIGHEST + 1) if preferred else range(0)
        candidates: list[int] = [*upwards, *range(HIGHEST, 0, -1)]
        for node in candidates:
            if node not in used:
                self._assigned[unique_id] = node
                return node
        return 0

    def _answer(self, node: int) -> Answer:
        values: Values = {"node": node}
        return Answer(encode(ALLOCATION, values, self._query), node)
