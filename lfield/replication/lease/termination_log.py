"""Termination log: known terminations of coordinators, and terminations that must not be stored yet. Sans-IO.

A termination is final once a majority of the members has it on disk: every majority of promises then contains
a member that refuses. A member that promised a recovery before it learns of the termination is in no such
majority; if this member stored the termination at once, it could become final while the recovery starts. The
member therefore informs the proposer, and waits until the recovery has started or its promise has expired
(`PROMISE_LIFETIME`). All answers of the member carry the waiting terminations.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from hashlib import blake2b

from msgspec import Struct, structs

from lfield.replication.lease.effects import CheckpointStore, Effect, RecordTermination, SendQuorumMessage
from lfield.replication.lease.quorum_members import CLOCK_DRIFT, FencingTokens, QuorumMembers
from lfield.wire.coordinator_messages import TERMINAL, Terminated
from lfield.wire.fields import MAX_LABEL, truncate
from lfield.wire.quorum_messages import Promise

#: A failover may start up to this many leases after its proposal. This includes a host stalled for a minute;
#: no termination waits that long while the proposer answers.
PROMISE_LIFETIME = 40.0


class PromisedFence(Struct):
    """A recovery as start `fence` that this member has promised to `host` ('' if this host is no longer
    known).

    The recovery may start until `valid_until`, in seconds on this host's clock.
    """

    fence: int
    host: str
    valid_until: float


class TerminationLog:
    """The terminations of `agents` that one host knows; `fences` are its fencing tokens."""

    def __init__(
        self, members: QuorumMembers, agents: Collection[str], copies: CheckpointStore, fences: FencingTokens
    ) -> None:
        self._members, self._copies, self._fences = members, copies, fences
        self._agents = dict.fromkeys(sorted(agents))
        #: Promises of this incarnation, and possible ones of earlier incarnations, whose fences are in the
        #: journal.
        self._promised: dict[str, PromisedFence] = {}
        self._waiting: dict[str, Terminated] = {}
        #: Fences from the journal that are not in `_promised` yet.
        self._restored = {agent: fences.token_of(agent) for agent in self._agents if fences.token_of(agent)}

    def start(self, now: float) -> None:
        """Assume that the promise of each fence in the journal, made by an earlier incarnation, may still be
        used.
        """
        restored, self._restored = self._restored, {}
        for agent, fence in restored.items():
            if agent not in self._promised:
                self.on_promise_given(agent, fence, "", now)

    # --- known terminations ---------------------------------------------------------------------------

    def termination_of(self, agent: str) -> Terminated | None:
        """The newest known termination of a coordinator, on disk or not; None without one."""
        saved = self._copies.checkpoint(agent)
        termination = saved.ended if saved is not None else None
        waits = self._waiting.get(agent)
        if termination is None or (waits is not None and waits.generation > termination.generation):
            return waits
        return termination

    def covering_termination(self, agent: str, generation: int) -> Terminated | None:
        """The termination of that start or a later start, which forbids a resumption from its checkpoints."""
        ended = self.termination_of(agent) if agent in self._agents else None
        return ended if ended is not None and ended.generation >= generation else None

    @property
    def all(self) -> list[Terminated]:
        """The newest termination of each coordinator, with reasons shortened."""
        return [structs.replace(ended, detail=truncate(ended.detail, MAX_LABEL)) for ended in self._known]

    @property
    def _known(self) -> Iterator[Terminated]:
        return (ended for agent in self._agents if (ended := self.termination_of(agent)) is not None)

    @property
    def digest(self) -> int:
        """A digest that is equal for equal sets of fences and terminations."""
        known = [f"{ended.agent} {ended.generation}" for ended in self._known]
        if not known:
            return self._fences.digest
        text = "\n".join([str(self._fences.digest), *known])
        return int.from_bytes(blake2b(text.encode(), digest_size=8).digest(), "big") >> 1

    # --- waiting terminations -------------------------------------------------------------------------

    def on_promise_given(self, agent: str, fence: int, host: str, now: float) -> None:
        """This host has promised `host` to let it recover an agent as start `fence`."""
        self._promised[agent] = PromisedFence(
            fence, host, now + CLOCK_DRIFT * PROMISE_LIFETIME * self._members.lease
        )

    def is_delayed(self, ended: Terminated, now: float) -> bool:
        """Whether a termination must wait here before it is stored."""
        agent = ended.agent
        if agent not in self._agents or ended.outcome not in TERMINAL:
            return False
        self.start(now)
        promised = self._promised.get(agent)
        if promised is None or ended.generation >= promised.fence or now >= promised.valid_until:
            return False
        known = self._waiting.get(agent)
        if known is None or known.generation < ended.generation:
            self._waiting[agent] = ended
        return True

    def tick(self, now: float) -> list[Effect]:
        """Send waiting terminations to proposers, and store terminations that need not wait any more."""
        effects: list[Effect] = []
        for agent, ended in list(self._waiting.items()):
            promised = self._promised.get(agent)
            if promised is None or now >= promised.valid_until or ended.generation >= promised.fence:
                effects += self.release(agent)
            elif promised.host:
                effects.append(SendQuorumMessage(promised.host, self.refusing_promise(ended, promised.fence)))
        return effects

    def on_acknowledged(self, host: str, ended: Terminated) -> list[Effect]:
        """A host has acknowledged a termination: a recovery that was promised to this host has started or
        never will.
        """
        promised, waits = self._promised.get(ended.agent), self._waiting.get(ended.agent)
        if promised is None or promised.host != host or waits is None:
            return []
        return self.release(ended.agent) if ended.generation >= waits.generation else []

    def release(self, agent: str) -> list[Effect]:
        """Stop delaying the termination of an agent."""
        ended = self._waiting.pop(agent, None)
        return [] if ended is None else [RecordTermination(ended)]

    def refusing_promise(self, ended: Terminated, generation: int) -> Promise:
        """The refusal sent to a proposer that would recover a terminated coordinator."""
        return Promise(ended.agent, generation, self._fences.token_of(ended.agent), None, ended)
