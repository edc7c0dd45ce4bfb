"""What a host finds in its journal at its start, and what waits for that journal later. Pure.

Effects of one coordinator keep their order, so what was decided later never overtakes what it rests on; other
coordinators do not wait. Pages that nothing depends on go along with the next ones that something does.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Iterable, Mapping

from msgspec import structs

from lfield.bytecode.encoding import encode
from lfield.clock import Clock
from lfield.journal.pages import (
    BegunPage,
    BundlePage,
    CopyPage,
    Key,
    Page,
    Paused,
    ProgramPage,
    Run,
    Starts,
    Stopped,
    key_of,
)
from lfield.mission.mission import Mission
from lfield.mobility.copies import Copy
from lfield.mobility.effects import (
    Began,
    Departed,
    Effect,
    Finished,
    Go,
    InDoubt,
    Note,
    Persist,
    Resume,
    Send,
    SendTransfer,
    Supersede,
)
from lfield.wire.coordinators import TERMINATED, Known

#: The longest that a page waits for company, in seconds.
SOON = 1.0


#: Of so many starts of each coordinator it is remembered how they ended; every run makes one.
ENDINGS = 8


class Keeping:
    """The pages and effects of one host that are waiting. `first` goes along with the first that are due."""

    def __init__(self, first: Iterable[Page] = ()) -> None:
        self._pages: dict[Key, Page] = {key_of(page): page for page in first}
        #: The pages that nobody needs any more.
        self._gone: set[Key] = set()
        #: The number of the batch that pages go into now.
        self._number = 1
        self._behind: dict[str, deque[tuple[int, Effect]]] = {}
        self._urgent = False
        #: When pages that could wait are to be given, None without any; seconds on the host's clock.
        self.due: float | None = None

    def put(self, effects: Iterable[Effect], now: float) -> list[Effect]:
        """Effects of mobility, in their order: those that need not wait."""
        ready: list[Effect] = []
        for effect in effects:
            if isinstance(effect, Persist):
                self.page(effect.page, now, soon=effect.soon)
                if not effect.soon:
                    self._behind.setdefault(effect.agent, deque()).append((self._number, effect))
            elif isinstance(effect, Supersede | Finished):
                # What stops a copy needs no disk: until then it would run on, though it has ended here.
                self._forget(effect.agent, effect.generation)
                ready.append(effect)
            elif waiting := self._behind.get(_agent(effect)):
                waiting.append((waiting[-1][0], effect))
            else:
                ready.append(effect)
        return ready

    def _forget(self, agent: str, generation: int) -> None:
        """A start is stopped: nothing that waits lets it go on, or go. What is told of it is told."""
        if waiting := self._behind.get(agent):
            told = (entry for entry in waiting if _generation(entry[1]) != generation)
            self._behind[agent] = deque(told)

    def holds_back(self, agent: str) -> bool:
        """Whether something that a coordinator has to do waits for the disk."""
        return agent in self._behind

    def on_record(self, rows: Iterable[Known], here: str) -> list[Known]:
        """What other hosts are told: a start that terminated here, on `here`, runs until that is on disk.

        After a crash it would go on here. If others knew of the termination, a majority could have it on
        disk by then, and it would be final.
        """
        return [self._on_record(row, here) for row in rows]

    def _on_record(self, row: Known, here: str) -> Known:
        ended = row.state == "EXITED" and row.where == here and row.outcome in TERMINATED
        if not ended or not self._waits_to_end(row.agent, row.generation):
            return row
        return structs.replace(row, state="RUN", where="", outcome="", detail="")

    def _waits_to_end(self, agent: str, generation: int) -> bool:
        """Whether the page that says how this start has ended waits for the disk."""
        waiting = (effect.page for _, effect in self._behind.get(agent, ()) if isinstance(effect, Persist))
        pages = (page for page in waiting if isinstance(page, CopyPage))
        return any(page.generation == generation and page.state == "EXITED" for page in pages)

    def page(self, page: Page, now: float, *, soon: bool = False) -> int:
        """A page to keep; the number of its batch."""
        self._pages[key_of(page)] = page
        self._gone.discard(key_of(page))
        self._urgent = self._urgent or not soon
        return self._batch(now)

    def forget(self, keys: Iterable[Key], now: float) -> int:
        """Nobody needs these pages any more, once those before are kept; the number of their batch."""
        for key in keys:
            self._pages.pop(key, None)
            self._gone.add(key)
        return self._batch(now)

    def _batch(self, now: float) -> int:
        if self.due is None:
            self.due = now + SOON
        return self._number

    def take(self, now: float) -> tuple[int, list[Page], list[Key]] | None:
        """The next batch, if one is due: its number, what is to be kept, what is to be removed."""
        if not self._urgent and (self.due is None or now < self.due):
            return None
        pages, keys = list(self._pages.values()), sorted(self._gone)
        self._pages, self._gone = {}, set()
        number, self._number = self._number, self._number + 1
        self._urgent, self.due = False, None
        return number, pages, keys

    def kept(self, number: int) -> list[Effect]:
        """All batches up to this one are on the disk: what need not wait any more."""
        ready: list[Effect] = []
        for agent, waiting in list(self._behind.items()):
            while waiting and waiting[0][0] <= number:
                _, effect = waiting.popleft()
                if not isinstance(effect, Persist):
                    ready.append(effect)
            if not waiting:
                del self._behind[agent]
        return ready


def explanation(mission: Mission, digest: bytes) -> ProgramPage:
    """What explains the blocks of a mission to whoever looks into the journal."""
    team = mission.team
    members, types = tuple(m.id for m in team.members), tuple(m.type for m in team.members)
    return ProgramPage(digest, encode(mission.program), members, types, tuple(team.hosts))


class Recovery:
    """The pages of a host's journal; `mission` is the hash of what it runs now (`Hello.mission`), and
    `bundle` the digest of the bundle that it is from, b"" without one.

    A coordinator of another mission stays parked: it waits for its own program and deployment.
    """

    def __init__(self, pages: Iterable[Page], mission: bytes, bundle: bytes = b"") -> None:
        pages = list(pages)
        copies = [page for page in pages if isinstance(page, CopyPage)]
        ended = _outdated(copies)
        old = {key_of(page) for page in ended}
        needed = {mission, *(page.program for page in copies)}
        over = {(page.agent, page.generation) for page in copies if page.state == "EXITED"}
        #: Starts that ended so long ago that nobody asks any more, what those have begun that have ended, and
        #: programs of which no block is left.
        self.outdated: list[Page] = [
            *ended,
            *(p for p in pages if isinstance(p, BegunPage) and (p.agent, p.generation) in over),
            *(page for page in pages if isinstance(page, ProgramPage) and page.digest not in needed),
        ]
        self.copies = [
            page for page in copies if key_of(page) not in old and (not page.block or page.program == mission)
        ]
        #: What belongs to another program or deployment.
        self.parked = [page for page in copies if page.block and page.program != mission]
        #: Whether there is what explains the blocks of this mission.
        self.explained = any(isinstance(page, ProgramPage) and page.digest == mission for page in pages)
        #: Whether somebody has paused this host.
        self.paused = any(page.on for page in pages if isinstance(page, Paused))
        #: Why an emergency stop bars the devices of this host, '' when none does.
        self.stopped = next((page.reason for page in pages if isinstance(page, Stopped)), "")
        #: The last start that was made here, None when none is on record.
        self.starts = next((page.count for page in pages if isinstance(page, Starts)), None)
        #: Whether the run that was begun here earlier goes on.
        self.goes_on = any(page.open for page in pages if isinstance(page, Run))
        #: The starts that ended before this bundle was begun here.
        self._earlier = {(page.agent, page.generation) for page in copies if page.state == "EXITED"}
        if BundlePage(bundle) in pages:
            self._earlier = set()

    def over(self, coordinators: Collection[str], known: Iterable[Known]) -> bool:
        """Whether the mission has ended, as far as is heard here: every coordinator of the team, in this run.

        One that has not come here yet may be under way all the same, wherever its home is.
        """
        rows = [row for row in known if (row.agent, row.generation) not in self._earlier]
        ended = {row.agent for row in rows if row.state == "EXITED"}
        return ended.issuperset(coordinators) and all(row.state == "EXITED" for row in rows)

    def why_not(self, agent: str, known: Iterable[Known]) -> str:
        """Why a coordinator of this host is not started anew, '' if nothing is against it."""
        rows = [row for row in known if row.agent == agent]
        if any(page.agent == agent for page in self.parked):
            return "waits for the program and deployment that it belongs to"
        for row in rows:
            if row.state in ("FROZEN", "PREPARED", "IN DOUBT", "MOVED"):
                return f"went to {row.where}" if row.where else "waits for whoever goes on with it"
            if row.state == "RUN":
                return "goes on"
        last = max(rows, key=lambda row: row.generation, default=None)
        # An earlier one ended in an earlier run: the start that is on record was not made.
        if last and self.goes_on and last.generation >= (self.starts or 0):
            return f"has ended ({last.outcome}) in the run that goes on here; --fresh begins another one"
        return ""


def _outdated(copies: Iterable[CopyPage]) -> list[CopyPage]:
    """The endings of each coordinator but the last few."""
    found: dict[str, list[CopyPage]] = {}
    for page in copies:
        if page.state == "EXITED":
            found.setdefault(page.agent, []).append(page)
    return [
        page
        for pages in found.values()
        for page in sorted(pages, key=lambda page: page.generation)[:-ENDINGS]
    ]


def asleep(times: Mapping[Key, float], clock: Clock, copy: Copy) -> float:
    """For how many seconds a coordinator lay on the disk, as far as the wall clock tells; else 0.

    `times` says in Unix time when each page was kept.
    """
    kept = times.get(Key("copy", copy.agent, copy.generation))
    return 0.0 if kept is None else max(0.0, clock.time() - kept)


def _generation(effect: Effect) -> int | None:
    """The start of which an effect needs the copy in the machine; None for any other effect."""
    match effect:
        case SendTransfer():
            return effect.header.generation
        case Began() | Go() | Resume() | Departed() | InDoubt():
            return effect.generation
        case _:
            return None


def _agent(effect: Effect) -> str:
    """The coordinator that an effect is about."""
    match effect:
        case Send():
            return getattr(effect.message, "agent", "")
        case SendTransfer():
            return effect.header.agent
        case Note():
            return ""
        case _:
            return effect.agent
