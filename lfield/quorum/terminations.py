"""What one host knows of coordinators that have terminated, and what it may not yet write down. Pure.

A termination is final once a majority of the members has it on disk: every majority of promises then
contains a member that knows it, and refuses. A member that has promised a recovery before it hears of the
termination is in none of those majorities: were it to write the termination down at once, that could become
final while the recovery begins. So it tells the proposer, and waits until the recovery has begun or cannot
begin any more (`VALID`). All its answers carry what waits here, too.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from hashlib import blake2b

from msgspec import structs

from lfield.quorum.effects import Copies, Effect, Tell, Terminate
from lfield.quorum.members import DRIFT, Fences, Members
from lfield.wire.coordinators import TERMINAL, Ended
from lfield.wire.fields import MAX_LABEL, clip
from lfield.wire.quorum import Promise

#: An attempt to recover may begin the new start for so many leases after its proposal, and never later. That
#: is long enough for a host that was stopped for a minute; nothing waits for it while the proposer answers.
VALID = 40.0


@dataclass(slots=True)
class Promised:
    """A recovery as start `fence` that this member has promised to `host` ('' when it is not known any more).

    It may begin until `until`, in seconds on the own clock.
    """

    fence: int
    host: str
    until: float


class Terminations:
    """The terminations that one host knows, of `agents`. `fences` are those that it knows."""

    def __init__(self, members: Members, agents: Collection[str], copies: Copies, fences: Fences) -> None:
        self._members, self._copies, self._fences = members, copies, fences
        self._agents = dict.fromkeys(sorted(agents))
        #: What this host has promised, and may have promised in an earlier life: that is in its journal.
        self._promised: dict[str, Promised] = {}
        self._waiting: dict[str, Ended] = {}
        #: The fences that the journal has kept and that are not in `_promised` yet.
        self._kept = {agent: fences.of(agent) for agent in self._agents if fences.of(agent)}

    def begin(self, now: float) -> None:
        """What an earlier life of this host has promised may still begin: its journal has the fences."""
        kept, self._kept = self._kept, {}
        for agent, fence in kept.items():
            if agent not in self._promised:
                self.promise(agent, fence, "", now)

    # --- what is known --------------------------------------------------------------------------------

    def of(self, agent: str) -> Ended | None:
        """The newest termination of a coordinator that is known here, on disk or not; None for none."""
        saved = self._copies.saved(agent)
        kept = saved.ended if saved is not None else None
        waits = self._waiting.get(agent)
        if kept is None or (waits is not None and waits.generation > kept.generation):
            return waits
        return kept

    def covers(self, agent: str, generation: int) -> Ended | None:
        """Why nobody may go on from a block of that start: it, or a later one, has terminated."""
        ended = self.of(agent) if agent in self._agents else None
        return ended if ended is not None and ended.generation >= generation else None

    @property
    def all(self) -> list[Ended]:
        """The newest termination of each coordinator, with short reasons."""
        return [structs.replace(ended, detail=clip(ended.detail, MAX_LABEL)) for ended in self._known]

    @property
    def _known(self) -> Iterator[Ended]:
        return (ended for agent in self._agents if (ended := self.of(agent)) is not None)

    @property
    def digest(self) -> int:
        """A number that is the same for whoever knows the same fences and terminations."""
        known = [f"{ended.agent} {ended.generation}" for ended in self._known]
        if not known:
            return self._fences.digest
        text = "\n".join([str(self._fences.digest), *known])
        return int.from_bytes(blake2b(text.encode(), digest_size=8).digest(), "big") >> 1

    # --- what waits -----------------------------------------------------------------------------------

    def promise(self, agent: str, fence: int, host: str, now: float) -> None:
        """This host has promised `host` that it may recover an agent as start `fence`."""
        self._promised[agent] = Promised(fence, host, now + DRIFT * VALID * self._members.lease)

    def is_delayed(self, ended: Ended, now: float) -> bool:
        """Whether a termination must not come to the disk now; then it waits here."""
        agent = ended.agent
        if agent not in self._agents or ended.outcome not in TERMINAL:
            return False
        self.begin(now)
        promised = self._promised.get(agent)
        if promised is None or ended.generation >= promised.fence or now >= promised.until:
            return False
        known = self._waiting.get(agent)
        if known is None or known.generation < ended.generation:
            self._waiting[agent] = ended
        return True

    def tick(self, now: float) -> list[Effect]:
        """Tell proposers what waits, and write down what need not wait any more."""
        effects: list[Effect] = []
        for agent, ended in list(self._waiting.items()):
            promised = self._promised.get(agent)
            if promised is None or now >= promised.until or ended.generation >= promised.fence:
                effects += self.release(agent)
            elif promised.host:
                effects.append(Tell(promised.host, self.refusal(ended, promised.fence)))
        return effects

    def conceded(self, host: str, ended: Ended) -> list[Effect]:
        """A host knows of a termination: if it was promised a recovery, that has begun or never will."""
        promised, waits = self._promised.get(ended.agent), self._waiting.get(ended.agent)
        if promised is None or promised.host != host or waits is None:
            return []
        return self.release(ended.agent) if ended.generation >= waits.generation else []

    def release(self, agent: str) -> list[Effect]:
        """What has waited need not wait any more."""
        ended = self._waiting.pop(agent, None)
        return [] if ended is None else [Terminate(ended)]

    def refusal(self, ended: Ended, generation: int) -> Promise:
        """The answer to whoever proposes to recover a coordinator that has terminated."""
        return Promise(ended.agent, generation, self._fences.of(ended.agent), None, ended)
