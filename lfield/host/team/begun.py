"""What a host keeps of the calls that a `together` has begun on it: until they are fetched, or never will be.

A call begins when its page is on the disk, and the block of its coordinator with it; what it gives is told
when that is on the disk. Its page goes with, or after, the page of the coordinator that has the result, and
when the start that has begun it is over: it has ended, is barred, or was recovered elsewhere. Pure (decision
49).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence

from msgspec import structs

from lfield.clock import Clock
from lfield.host.team.coordinators import Coordinators
from lfield.host.team.leases import Leases
from lfield.journal.pages import BegunPage, Page, begun_key
from lfield.vm.agent import Agent
from lfield.vm.begun import Beginning, Begun, Key
from lfield.vm.machine import Machine

#: One start of a coordinator.
Start = tuple[str, int]


class BegunPages:
    """The calls that were begun on one host. `mission` is the hash of what it runs (`Hello.mission`).

    `pages` are those of its journal. A host that `keeps` none waits for nothing.
    """

    def __init__(
        self,
        mission: bytes,
        team: Coordinators,
        leases: Leases,
        machine: Machine,
        clock: Clock,
        pages: Iterable[Page],
        *,
        keeps: bool,
    ) -> None:
        self._mission, self._team, self._leases, self._machine = mission, team, leases, machine
        self._clock, self._keeps = clock, keeps
        #: The pages, and the number of the batch in which each was kept last.
        self._pages: dict[Key, tuple[BegunPage, int]] = {}
        for page in pages:
            if isinstance(page, BegunPage) and page.program == mission:
                self._pages[page.agent, page.generation, page.number] = page, 0
        #: The last batch that is on the disk.
        self._on_disk = 0
        #: What has come back, until it is on the disk.
        self._back: deque[tuple[int, Key]] = deque()
        #: What the machine may begin, until it is seen whether it has.
        self._let_go: list[Key] = []
        #: What a coordinator has fetched, until a page of it has that.
        self._fetched: dict[Start, list[Key]] = {}

    def restore(self) -> None:
        """The resources are started: what was under way in an earlier life of this host is lost."""
        self._machine.restore_begun([_begun(page, self._leases) for page, _ in self._pages.values()])

    def woken(self) -> None:
        """The coordinators of this host go on: who was told that its calls may have begun fetches none."""
        told = [
            key for key, (page, _) in self._pages.items() if key[:2] in self._team.told and not page.outcome
        ]
        self._machine.forget_begun(told)
        self._forget(told)

    # --- the machine asks -----------------------------------------------------------------------------

    def begins(self, agent: Agent, calls: Sequence[Beginning]) -> bool:
        """See `World.begins`."""
        if not self._leases.may_begin(agent):
            return False
        keys = [(agent.id, agent.generation, call.number) for call in calls]
        if not self._keeps:
            return True
        if agent.kept and all(self._is_kept(key) for key in keys):
            self._let_go += keys
            return True
        new = [call for key, call in zip(keys, calls, strict=True) if key not in self._pages]
        if new and not self._team.trouble:
            for call in new:
                self._note(agent, call)
        if new:
            self.save(agent)
        return False

    def _is_kept(self, key: Key) -> bool:
        return key in self._pages and self._pages[key][1] <= self._on_disk

    def _note(self, agent: Agent, call: Beginning) -> None:
        page = BegunPage(
            agent.id, agent.generation, call.number, call.resource, call.portal, program=self._mission
        )
        self._put(page)

    def _put(self, page: BegunPage) -> int:
        batch = self._team.keeping.page(page, self._clock.monotonic())
        self._pages[page.agent, page.generation, page.number] = page, batch
        return batch

    def came_back(self, begun: Begun) -> None:
        """See `World.came_back`."""
        if not self._keeps:
            self._machine.kept_result(begun.key)
        elif (found := self._pages.get(begun.key)) and not begun.dropped:
            outcome = "done" if begun.state == "done" else "thrown"
            batch = self._put(structs.replace(found[0], outcome=outcome, parcel=begun.parcel))
            self._back.append((batch, begun.key))

    # --- the disk -------------------------------------------------------------------------------------

    def kept(self, number: int) -> None:
        """All pages up to those of that batch are on the disk: what came back may be told."""
        self._on_disk = number
        while self._back and self._back[0][0] <= number:
            _, key = self._back.popleft()
            # What its start has begun may have been cancelled meanwhile.
            if key in self._pages:
                self._machine.kept_result(key)

    def save(self, agent: Agent) -> bool:
        """As `Coordinators.save`: what it has fetched is in the block that is kept."""
        begins = self._team.save(agent)
        if self._keeps and not self._team.trouble:
            before = self._fetched.pop((agent.id, agent.generation), [])
            self._forget([*before, *self._machine.fetched(agent)])
        return begins

    def leaves(self, agent: Agent) -> None:
        """A coordinator has been packed to be sent: what it has fetched goes when that is kept."""
        if self._keeps and (fetched := self._machine.fetched(agent)):
            self._fetched.setdefault((agent.id, agent.generation), []).extend(fetched)

    def not_kept(self) -> None:
        """The disk takes nothing: what waited for it to begin does not begin any more."""
        waiting = [
            key for key, (page, batch) in self._pages.items() if batch > self._on_disk and not page.outcome
        ]
        self._forget(waiting)

    # --- what is over ---------------------------------------------------------------------------------

    def look(self) -> None:
        """Cancel what was begun by starts that are over, and remove what nobody will fetch."""
        begun_calls = self._machine.begun_calls()
        if not (begun_calls or self._pages or self._fetched or self._let_go):
            return
        for start in list(self._fetched):
            if self._team.mobility.is_sent(*start):
                self._forget(self._fetched.pop(start))
        calls = {call.key for call in begun_calls}
        failed = [key for key in self._let_go if key not in calls and not self._pages[key][0].outcome]
        self._let_go.clear()
        self._forget(failed)
        begun = {key[:2] for key in calls}
        for start in sorted({*begun, *(key[:2] for key in self._pages)}):
            if why := self._over(start):
                self._end(start, why, begun)

    def _over(self, start: Start) -> str:
        """Why nobody will fetch what a start has begun, '' when somebody may."""
        return self._leases.over(*start)

    def _end(self, start: Start, why: str, begun: set[Start]) -> None:
        agent, generation = start
        earlier = [other for other in begun if other[0] == agent and other[1] < generation]
        keys = [key for key in self._pages if key[:2] == start]
        if start in begun and all(self._over(other) for other in earlier):
            self._machine.cancel_begun(agent, generation + 1, why)
        elif start in begun:
            # Of two starts the earlier one goes on.
            self._machine.forget_begun(
                call.key for call in self._machine.begun_calls() if call.key[:2] == start
            )
        self._fetched.pop(start, None)
        self._forget(keys)

    def _forget(self, keys: Iterable[Key]) -> None:
        gone = [key for key in keys if self._pages.pop(key, None)]
        if gone:
            self._team.keeping.forget([begun_key(*key) for key in gone], self._clock.monotonic())


def _begun(page: BegunPage, leases: Leases) -> Begun:
    """A call as the machine has it."""
    return Begun(
        page.agent,
        page.generation,
        page.number,
        page.resource,
        page.portal,
        fenced=page.agent in leases.fenced,
        state=page.outcome or "running",
        parcel=page.parcel,
    )
