"""Quorum membership and fencing tokens of a team. Sans-IO."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from hashlib import blake2b

from lfield.wire.quorum_messages import FencedRecord

#: Waits exceed a lease by this factor: two clock rates differ by at most 2 % (1.01 / 0.99).
CLOCK_DRIFT = 1.03
#: Heartbeats per lease.
HEARTBEATS_PER_LEASE = 4


class QuorumMembers:
    """The voting members; `own_name` is this host, which need not be a member. `lease` is in seconds."""

    def __init__(
        self, names: Collection[str], own_name: str, lease: float, *, knows_promises: bool = True
    ) -> None:
        self.own_name, self.lease = own_name, lease
        self.names = frozenset(names)
        self.others = sorted(self.names - {own_name})
        self.majority = len(self.names) // 2 + 1
        #: Whether this host knows all promises that it may have made. Its own vote counts only if it does.
        self.knows_promises = knows_promises

    def confirm_promises(self, *, known: bool) -> None:
        """Set whether this host knows all promises that it may have made."""
        self.knows_promises = known

    @property
    def grace_period(self) -> float:
        """Seconds after which every lease granted before has expired."""
        return CLOCK_DRIFT * self.lease

    @property
    def heartbeat_interval(self) -> float:
        """Seconds between two heartbeats."""
        return self.lease / HEARTBEATS_PER_LEASE

    @property
    def is_voter(self) -> bool:
        """Whether this host is one of the voting members."""
        return self.knows_promises and self.own_name in self.names

    def is_majority(self, names: Collection[str]) -> bool:
        return len(self.names.intersection(names)) >= self.majority


class FencingTokens:
    """The fencing token of each agent: no start with a lower generation may run.

    Tokens only rise. `known` are the tokens in the journal.
    """

    def __init__(self, known: Mapping[str, int]) -> None:
        self._known = dict(known)
        self._digest: int | None = None

    def token_of(self, agent: str) -> int:
        """The token of an agent; 0 without one."""
        return self._known.get(agent, 0)

    def rejects(self, agent: str, generation: int) -> bool:
        """Whether this start is fenced, on any host."""
        return generation < self._known.get(agent, 0)

    def advance(self, agent: str, generation: int) -> bool:
        """Raise a token. Returns whether it changed."""
        if generation <= self.token_of(agent):
            return False
        self._known[agent], self._digest = generation, None
        return True

    @property
    def all(self) -> list[FencedRecord]:
        """Every token, by agent."""
        return [FencedRecord(agent, generation) for agent, generation in sorted(self._known.items())]

    @property
    def digest(self) -> int:
        """A digest that is equal exactly for equal sets of tokens."""
        if self._digest is None:
            self._digest = _digest(self.all)
        return self._digest


def _digest(fences: Iterable[FencedRecord]) -> int:
    text = "\n".join(f"{fence.agent} {fence.generation}" for fence in fences)
    return int.from_bytes(blake2b(text.encode(), digest_size=8).digest(), "big") >> 1
