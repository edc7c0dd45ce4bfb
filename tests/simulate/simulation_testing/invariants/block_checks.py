"""What programs say of their blocks of calls that are begun together (`scenarios/crew_programs.py`).

A crew that is recovered elsewhere goes back to a block: what came after that is lost to it. It must be told
so before it goes on.

No piece of work begins twice, none begins before its page is on the disk, none is told of before its result
is there, and none outlives its block: not when all have come back, not its time limit, and not the start
that has begun it, once its own host bars that.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

from lfield.journal.records import CoordinatorRecord, FenceRecord, PendingCallRecord, Record
from lfield.replication.transfer.generations import is_recovery
from lfield.simulate.host_fleet import HostLife
from lfield.vm.agent import Agent
from lfield.vm.memory.layout import THREAD_ID
from lfield.vm.memory.threads import threads
from lfield.vm.pending_call import CallKey
from simulation_testing.invariants.breaches import Breaches

#: So many seconds after its limit a piece of work may still be seen: its process may have stood still, twice.
SLACK = 15.0
#: And so many after its host has barred its start.
SOON = 1.0


@dataclass(slots=True, eq=False)
class _Piece:
    """One piece of work: how often it began, when last, for which start, and whether it came to its end."""

    starts: int = 0
    at: float = 0.0
    generation: int = 0
    given: bool = False


@dataclass(slots=True, eq=False)
class _Block:
    """One block: its time limit in seconds, its pieces, and how it was closed, '' before."""

    limit: float = 0.0
    how: str = ""
    pieces: defaultdict[int, _Piece] = field(default_factory=lambda: defaultdict(_Piece))


class BlockChecks:
    """The blocks of all crews. `newest_at` says which start of an agent was the last to go on before a time.

    `pages` gives what is on the disk of a host, None of one that keeps nothing.
    """

    def __init__(
        self,
        breaches: Breaches,
        now: Callable[[], float],
        newest_at: Callable[[str, float], int],
        pages: Callable[[str], Iterable[Record] | None],
    ) -> None:
        self._breaches, self._now, self._newest_at, self._pages = breaches, now, newest_at, pages
        self._blocks: defaultdict[tuple[str, int], _Block] = defaultdict(_Block)
        self._started_for: set[tuple[str, int]] = set()
        #: Which start of it each life of a crew is at, and which were told that they are recovered.
        self._at: defaultdict[str, int] = defaultdict(int)
        self._durable: set[tuple[str, int]] = set()
        #: How many pieces began, how many blocks were closed since a host was started again, and how many of
        #: each agent were closed, since the weather.
        self.started = self.restarts = 0
        self.closed: defaultdict[str, int] = defaultdict(int)
        #: Up to which start, and since when, the journal of a host bars a crew.
        self._barred: dict[tuple[str, str], tuple[int, float]] = {}

    def check_disks(self, kept: Iterable[tuple[str, Record]]) -> None:
        """See what is on the disks of all hosts."""
        for host, page in kept:
            if not isinstance(page, FenceRecord | CoordinatorRecord) or not is_recovery(page.generation):
                continue
            if page.generation > self._barred.get((host, page.agent), (0, 0.0))[0]:
                self._barred[host, page.agent] = page.generation, self._now()

    def on_healed(self) -> None:
        """The weather is over."""
        self.closed.clear()

    def has_any(self, agent: str, generation: int) -> bool:
        """Whether a start of an agent has begun anything."""
        return (agent, generation) in self._started_for

    def on_output(self, life: HostLife, agent: Agent, text: list[str]) -> bool:
        """A program has written a line; whether it is about a block."""
        match text:
            case ["opens" | "closes" | "told" as what, who, number, *more]:
                self._crew_says(life.core.name, agent, what, (who, int(number)), more)
            case ["sets", who, number, piece]:
                self._sets(life, agent, (who, int(number)), int(piece))
            case ["steps", who, number, piece]:
                self._steps(life, agent, (who, int(number)), int(piece))
            case ["gives", who, number, piece]:
                self._blocks[who, int(number)].pieces[int(piece)].given = True
            case ["leaves", *_] | [_, "failed,", "and", "its", "future", *_]:
                pass
            case _:
                return False
        return True

    def _goes_on(self, who: str, generation: int, number: int) -> bool:
        """A start of it is at this block; whether it is no older one than another that has gone on."""
        if generation > self._at[who]:
            if is_recovery(generation):
                later = [key for key in self._blocks if key[0] == who and key[1] > number]
                for key in later:
                    del self._blocks[key]
            self._at[who] = generation
        return generation == self._at[who]

    # --- what crews say -------------------------------------------------------------------------------

    def _crew_says(self, host: str, agent: Agent, what: str, key: tuple[str, int], more: list[str]) -> None:
        (who, number), start = key, agent.generation
        # What a later start opens it has not opened before.
        if not self._goes_on(who, start, number - 1 if what == "opens" else number):
            return
        if what == "told" or more[0] == "restarted":
            self._durable.add((who, start))
        elif is_recovery(start) and (who, start) not in self._durable:
            found = f"start {start} of {who} {what} block {number}, and was not told that it is recovered"
            self._breaches.add("I4", (host,), found)
        if what == "opens":
            self._blocks[key].limit = float(more[0])
        elif what == "closes":
            self._closes(host, agent, key, more[0], more[1:])

    def _closes(self, host: str, agent: Agent, key: tuple[str, int], how: str, given: list[str]) -> None:
        block, (who, number) = self._blocks[key], key
        block.how = how
        self.closed[agent.id] += 1
        self.restarts += how == "restarted"
        if how == "won":
            self._check_winner(host, key, given)
        if how != "came-back":
            return
        wanted = [str(10 * number + piece) for piece in range(len(given))]
        if given != wanted:
            found = f"block {number} of {who} came back with {' '.join(given)}, not {' '.join(wanted)}"
            self._breaches.add("I4", (host,), found)
        for piece in range(len(given)):
            if not block.pieces[piece].given:
                found = f"block {number} of {who} came back, and piece {piece} has not come to its end"
                self._breaches.add("I4", (host,), found)

    def _check_winner(self, host: str, key: tuple[str, int], given: list[str]) -> None:
        """A racer has the result of one piece, which has come to its end."""
        block, (who, number) = self._blocks[key], key
        won = [piece for piece, result in enumerate(given) if result != "-1"]
        if [given[piece] for piece in won] != [str(10 * number + piece) for piece in won] or len(won) != 1:
            self._breaches.add("I4", (host,), f"block {number} of {who} was won with {' '.join(given)}")
        elif not block.pieces[won[0]].given:
            found = f"block {number} of {who} was won by piece {won[0]}, which has not come to its end"
            self._breaches.add("I4", (host,), found)

    # --- what resources say ---------------------------------------------------------------------------

    def _sets(self, life: HostLife, resource: Agent, key: tuple[str, int], number: int) -> None:
        self.started += 1
        (who, block), host = key, life.core.name
        name = who.partition(".")[0]
        generation, what = (
            max(_callers(life, resource, name), default=0),
            f"piece {number} of block {block} of {who}",
        )
        if not generation:
            # It was taken from its caller before it came to its first line.
            return
        self._started_for.add((name, generation))
        if generation < self._newest_at(name, self._now()):
            self._breaches.add("I1", (host,), f"{what} began for start {generation}; a later goes on")
            return
        self._goes_on(who, generation, block)
        piece = self._blocks[key].pieces[number]
        piece.starts, piece.at, piece.generation = piece.starts + 1, self._now(), generation
        if piece.starts > 1:
            self._breaches.add("I4", (host,), f"{what} began again, on {resource.id}")
        pages = self._pages(host)
        if pages is not None and not any(
            isinstance(page, PendingCallRecord)
            and (page.agent, page.generation, page.resource) == (name, generation, resource.id)
            for page in pages
        ):
            self._breaches.add("begun", (host,), f"{what} began on {resource.id}, and no page says so")

    def _steps(self, life: HostLife, resource: Agent, key: tuple[str, int], number: int) -> None:
        block, piece = self._blocks[key], self._blocks[key].pieces[number]
        name, now = key[0].partition(".")[0], self._now()
        what = f"piece {number} of block {key[1]} of {key[0]} goes on"
        if piece.generation not in _callers(life, resource, name):
            # It was taken from its caller: it may command nothing, and nobody waits for it.
            return
        if block.how == "came-back":
            self._outlives(life, f"{what}, and its block has all results")
        if now > piece.at + block.limit + SLACK:
            self._outlives(
                life, f"{what}, {now - piece.at:.1f} s after it began under a limit of {block.limit} s"
            )
        barred, since = self._barred.get((life.core.name, name), (0, now))
        if piece.generation < barred and now > since + SOON:
            self._outlives(life, f"{what} for start {piece.generation}, and its host bars that")

    def _outlives(self, life: HostLife, found: str) -> None:
        self._breaches.add("outlives", (life.core.name,), found)

    # --- what is seen of the machine ------------------------------------------------------------------

    def on_result_durable(self, life: HostLife, key: CallKey) -> None:
        """What a call gave may be fetched from now on: its host says that it is kept."""
        pages = self._pages(life.core.name)
        if pages is not None and not any(
            isinstance(page, PendingCallRecord)
            and (page.agent, page.generation, page.number) == key
            and page.outcome
            for page in pages
        ):
            found = f"what call {key[2]} of {key[0]} gave is told, and it is on no disk"
            self._breaches.add("told", (life.core.name,), found)


def _callers(life: HostLife, resource: Agent, name: str) -> set[int]:
    """The starts of an agent that a resource works for now."""
    block, machine = resource.block, life.core.machine
    callers = (machine.served_calls.caller(resource, block.w[place + THREAD_ID]) for place in threads(block))
    return {caller.generation for caller in callers if caller and caller.id == name}
