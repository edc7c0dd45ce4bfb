"""Checks the output of programs about their blocks of concurrent calls (`scenarios/crew_programs.py`).

A crew that is recovered on another host returns to an earlier block: its later actions are lost. An exception
must report that before the crew continues.

No piece of work starts twice or before its record is durable, and none is reported before its result is
durable. No piece outlives its block: the end of all pieces, the time limit, or its start of the crew, once
the host of the piece has fenced that start.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

from lfield.journal.records import CoordinatorRecord, FenceRecord, PendingCallRecord, Record
from lfield.replication.transfer.generations import is_recovery
from lfield.simulate.host_fleet import HostRun
from lfield.vm.agent import Agent
from lfield.vm.memory.layout import THREAD_ID
from lfield.vm.memory.threads import threads
from lfield.vm.pending_call import CallKey
from simulation_testing.invariants.breaches import Breaches

#: Seconds for which a piece of work may run after its limit: its process may have been suspended twice.
SLACK = 15.0
#: Seconds for which a piece may run after its host has fenced its start.
SOON = 1.0


@dataclass(slots=True, eq=False)
class _Piece:
    """One piece of work: its starts and their times, its start of the crew, and its end."""

    starts: int = 0
    at: float = 0.0
    generation: int = 0
    given: bool = False


@dataclass(slots=True, eq=False)
class _Block:
    """One block: its time limit in seconds, its pieces, and its outcome, '' before the end."""

    limit: float = 0.0
    how: str = ""
    pieces: defaultdict[int, _Piece] = field(default_factory=lambda: defaultdict(_Piece))


class BlockChecks:
    """The blocks of all crews. `newest_at` gives the newest start of an agent that had continued before a
    time.

    `pages` gives the records on the disk of a host, None for a host without a journal.
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
        #: The start of each life of a crew, and the lives that were informed of a recovery.
        self._at: defaultdict[str, int] = defaultdict(int)
        self._durable: set[tuple[str, int]] = set()
        #: The number of pieces that began, of blocks that were closed since a host was restarted, and of
        #: closed blocks of
        #: each agent since the end of the faults.
        self.started = self.restarts = 0
        self.closed: defaultdict[str, int] = defaultdict(int)
        #: The highest start of a crew that the journal of a host fences, and the time of the fence.
        self._barred: dict[tuple[str, str], tuple[int, float]] = {}

    def check_disks(self, kept: Iterable[tuple[str, Record]]) -> None:
        """Check the records on the disks of all hosts."""
        for host, page in kept:
            if not isinstance(page, FenceRecord | CoordinatorRecord) or not is_recovery(page.generation):
                continue
            if page.generation > self._barred.get((host, page.agent), (0, 0.0))[0]:
                self._barred[host, page.agent] = page.generation, self._now()

    def on_healed(self) -> None:
        """The faults are over."""
        self.closed.clear()

    def has_any(self, agent: str, generation: int) -> bool:
        """Whether a start of an agent has begun any piece."""
        return (agent, generation) in self._started_for

    def on_output(self, life: HostRun, agent: Agent, text: list[str]) -> bool:
        """Handle an output line of a program; whether it is about a block."""
        match text:
            case ["opens" | "closes" | "told" as what, who, number, *more]:
                self._on_crew_output(life.core.name, agent, what, (who, int(number)), more)
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

    def _observe_start(self, who: str, generation: int, number: int) -> bool:
        """Record that a start is at this block; returns false if a later start has continued."""
        if generation > self._at[who]:
            if is_recovery(generation):
                later = [key for key in self._blocks if key[0] == who and key[1] > number]
                for key in later:
                    del self._blocks[key]
            self._at[who] = generation
        return generation == self._at[who]

    # --- output of crews ------------------------------------------------------------------------------

    def _on_crew_output(
        self, host: str, agent: Agent, what: str, key: tuple[str, int], more: list[str]
    ) -> None:
        (agent_id, number), start = key, agent.generation
        # A later start has not opened its blocks before.
        if not self._observe_start(agent_id, start, number - 1 if what == "opens" else number):
            return
        if what == "told" or more[0] == "restarted":
            self._durable.add((agent_id, start))
        elif is_recovery(start) and (agent_id, start) not in self._durable:
            found = (
                f"start {start} of {agent_id} {what} block {number}, and was not told that it is recovered"
            )
            self._breaches.add("I4", (host,), found)
        if what == "opens":
            self._blocks[key].limit = float(more[0])
        elif what == "closes":
            self._closes(host, agent, key, more[0], more[1:])

    def _closes(self, host: str, agent: Agent, key: tuple[str, int], how: str, given: list[str]) -> None:
        block, (agent_id, number) = self._blocks[key], key
        block.how = how
        self.closed[agent.id] += 1
        self.restarts += how == "restarted"
        if how == "won":
            self._check_winner(host, key, given)
        if how != "came-back":
            return
        expected = [str(10 * number + piece) for piece in range(len(given))]
        if given != expected:
            found = f"block {number} of {agent_id} came back with {' '.join(given)}, not {' '.join(expected)}"
            self._breaches.add("I4", (host,), found)
        for piece in range(len(given)):
            if not block.pieces[piece].given:
                found = f"block {number} of {agent_id} came back, and piece {piece} has not come to its end"
                self._breaches.add("I4", (host,), found)

    def _check_winner(self, host: str, key: tuple[str, int], given: list[str]) -> None:
        """A racer has the result of one piece, which has ended."""
        block, (agent_id, number) = self._blocks[key], key
        won = [piece for piece, result in enumerate(given) if result != "-1"]
        if [given[piece] for piece in won] != [str(10 * number + piece) for piece in won] or len(won) != 1:
            self._breaches.add("I4", (host,), f"block {number} of {agent_id} was won with {' '.join(given)}")
        elif not block.pieces[won[0]].given:
            found = f"block {number} of {agent_id} was won by piece {won[0]}, which has not come to its end"
            self._breaches.add("I4", (host,), found)

    # --- output of resources --------------------------------------------------------------------------

    def _sets(self, life: HostRun, resource: Agent, key: tuple[str, int], number: int) -> None:
        self.started += 1
        (agent_id, block), host = key, life.core.name
        name = agent_id.partition(".")[0]
        generation, what = (
            max(_callers(life, resource, name), default=0),
            f"piece {number} of block {block} of {agent_id}",
        )
        if not generation:
            # The caller was detached before the first line of the portal.
            return
        self._started_for.add((name, generation))
        if generation < self._newest_at(name, self._now()):
            self._breaches.add("I1", (host,), f"{what} began for start {generation}; a later goes on")
            return
        self._observe_start(agent_id, generation, block)
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

    def _steps(self, life: HostRun, resource: Agent, key: tuple[str, int], number: int) -> None:
        block, piece = self._blocks[key], self._blocks[key].pieces[number]
        name, now = key[0].partition(".")[0], self._now()
        what = f"piece {number} of block {key[1]} of {key[0]} goes on"
        if piece.generation not in _callers(life, resource, name):
            # The caller was detached: the portal may command nothing, and no agent waits for it.
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

    def _outlives(self, life: HostRun, found: str) -> None:
        self._breaches.add("outlives", (life.core.name,), found)

    # --- observations of the machine ------------------------------------------------------------------

    def on_result_durable(self, life: HostRun, key: CallKey) -> None:
        """The result of a call may be fetched from now on: its host reports it as durable."""
        pages = self._pages(life.core.name)
        if pages is not None and not any(
            isinstance(page, PendingCallRecord)
            and (page.agent, page.generation, page.number) == key
            and page.outcome
            for page in pages
        ):
            found = f"what call {key[2]} of {key[0]} gave is told, and it is on no disk"
            self._breaches.add("told", (life.core.name,), found)


def _callers(life: HostRun, resource: Agent, name: str) -> set[int]:
    """The starts of an agent that a resource serves now."""
    block, machine = resource.block, life.core.machine
    callers = (machine.served_calls.caller(resource, block.w[place + THREAD_ID]) for place in threads(block))
    return {caller.generation for caller in callers if caller and caller.id == name}
