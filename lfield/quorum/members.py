"""The members of a team, which give leases and promises; and the fences that they have promised. Pure."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from hashlib import blake2b

from lfield.wire.quorum import Barred

#: A wait is longer than a lease by so much: the rates of two clocks differ by 2 % at most (1.01 / 0.99).
DRIFT = 1.03
#: A lease is asked for again so many times in its length.
BEATS = 4


class Members:
    """The members; `here` is the host that looks, which may be none. `lease` is in seconds."""

    def __init__(self, names: Collection[str], here: str, lease: float) -> None:
        self.here, self.lease = here, lease
        self.names = frozenset(names)
        self.others = sorted(self.names - {here})
        self.majority = len(self.names) // 2 + 1
        #: Whether this host knows all that it may have promised: else nothing counts that it grants itself.
        self.remembers = True

    @property
    def wait(self) -> float:
        """After so many seconds here, no lease is left that was given before."""
        return DRIFT * self.lease

    @property
    def beat(self) -> float:
        """Seconds from one heartbeat to the next."""
        return self.lease / BEATS

    @property
    def counts_itself(self) -> bool:
        """Whether this host is one of those that grant it a lease, or promise it something."""
        return self.remembers and self.here in self.names

    def is_majority(self, names: Collection[str]) -> bool:
        """Whether these members are more than half."""
        return len(self.names.intersection(names)) >= self.majority


class Fences:
    """What one host knows: for each agent the generation before which no start may run.

    They only rise. `known` are those that the journal has kept.
    """

    def __init__(self, known: Mapping[str, int]) -> None:
        self._known = dict(known)
        self._digest: int | None = None

    def of(self, agent: str) -> int:
        """Starts below this number may not run; 0 for no fence."""
        return self._known.get(agent, 0)

    def bars(self, agent: str, generation: int) -> bool:
        """Whether this start may not run any more, wherever it is."""
        return generation < self._known.get(agent, 0)

    def raise_to(self, agent: str, generation: int) -> bool:
        """A fence was made; whether that is news."""
        if generation <= self.of(agent):
            return False
        self._known[agent], self._digest = generation, None
        return True

    @property
    def all(self) -> list[Barred]:
        """Every fence, by agent."""
        return [Barred(agent, generation) for agent, generation in sorted(self._known.items())]

    @property
    def digest(self) -> int:
        """A number that is the same for whoever knows the same, and for nobody else."""
        if self._digest is None:
            self._digest = _digest(self.all)
        return self._digest


def _digest(fences: Iterable[Barred]) -> int:
    text = "\n".join(f"{fence.agent} {fence.generation}" for fence in fences)
    return int.from_bytes(blake2b(text.encode(), digest_size=8).digest(), "big") >> 1
