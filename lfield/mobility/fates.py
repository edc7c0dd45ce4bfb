"""What became of every coordinator: ended, alive somewhere, lost for certain, or not heard of.

Every host keeps, for each coordinator it has seen, the number of the last transfer it knows of. Numbers only
grow along a coordinator's way, so the record with the highest one says where it went last. It is lost when
there is proof: that host has ended for good, or was restarted since and does not have it, and nobody else is
left who could. A host that is only silent proves nothing: what went there is not heard of.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

from msgspec import structs

from lfield.wire.coordinators import TERMINATED, Known

_ALIVE = ("RUN", "FROZEN", "PREPARED")


@dataclass(frozen=True, slots=True)
class Fate:
    """A coordinator's end: `outcome` is done, died, lost or unheard; `detail` one line.

    `starts` are the generations that are lost, the latest first.
    """

    agent: str
    outcome: str
    detail: str
    starts: tuple[int, ...] = field(default=(), compare=False)


@dataclass(frozen=True, slots=True)
class Absent:
    """The hosts that did not answer, and the lives of those that did.

    `gone` have ended for certain, `unheard` are those that nobody has heard for so many seconds, which is too
    long, `elsewhere` all others: somebody hears them, or did a moment ago. `lives` are the memories of
    the hosts that answered. `kept`: hosts keep journals, so what one had is not lost with it.
    """

    gone: Collection[str] = ()
    unheard: Mapping[str, float] = field(default_factory=dict)
    elsewhere: Collection[str] = ()
    lives: Mapping[str, int] = field(default_factory=dict)
    kept: bool = False


Records = Sequence[Known]


def fates(homes: Mapping[str, str], records: Mapping[str, Records], absent: Absent) -> dict[str, Fate]:
    """The coordinators that have ended, are lost or are not heard of.

    `homes` has the host where each coordinator starts, `records`, for each host that answered, what it knows
    of coordinators. Hosts do not answer at the same moment: see `Judge`.
    """
    found = {}
    for agent, home in homes.items():
        by_host = {host: [r for r in rows if r.agent == agent] for host, rows in records.items()}
        if fate := _Census(agent, by_host, absent).fate(home):
            found[agent] = fate
    return found


def known_fates(homes: Mapping[str, str], records: Records, proven: Collection[str]) -> dict[str, Fate]:
    """The fates that one host knows without asking anybody, from its own records.

    That something was lost says nothing about a later start, so it counts only for the coordinators of which
    somebody has `proven` it just now.
    """
    found = fates(homes, {"": records}, Absent())
    return {
        agent: fate
        for agent, fate in found.items()
        if fate.outcome in TERMINATED or (fate.outcome == "lost" and agent in proven)
    }


class Judge:
    """Holds one census against the one before: what hosts said at different moments may only seem a loss.

    A copy under way may be known to its sender as gone and not yet to its receiver. When the next census
    finds the same transfer missing, its receiver has been asked after it had said that it took it.

    It remembers how far each start had come: who told that may have gone since.
    """

    def __init__(self, homes: Mapping[str, str]) -> None:
        self._homes = homes
        self._before: Mapping[str, Fate] = {}
        self._furthest: dict[tuple[str, int], Known] = {}

    def judge(self, records: Mapping[str, Records], absent: Absent) -> dict[str, Fate]:
        """The fates that are certain now."""
        remembered = {"": list(self._furthest.values())}
        before, self._before = self._before, fates(self._homes, {**remembered, **records}, absent)
        for host, rows in records.items():
            for row in rows:
                self._remember(_as_memory(row, host, absent.lives.get(host, 0)))
        return {agent: fate for agent, fate in self._before.items() if _certain(fate, before.get(agent))}

    def _remember(self, row: Known) -> None:
        key = row.agent, row.generation
        known = self._furthest.get(key)
        if known is None or (known.state != "EXITED" and row.sequence >= known.sequence):
            self._furthest[key] = row


def _as_memory(row: Known, host: str, life: int) -> Known:
    """What a record says later on: of a copy that was alive on a host, that it had come there."""
    if row.state not in _ALIVE:
        return row
    return structs.replace(row, state="MOVED", where=host, receiver_memory=life)


def _certain(fate: Fate, before: Fate | None) -> bool:
    match fate.outcome:
        case "lost":
            return before is not None and (fate, fate.starts) == (before, before.starts)
        case "unheard":
            return before is not None and before.outcome == "unheard"
        case _:
            return True


class _Census:
    """What all hosts that answered know of one coordinator."""

    def __init__(self, agent: str, records: Mapping[str, Records], absent: Absent) -> None:
        self.agent, self.records, self.absent = agent, records, absent

    def fate(self, home: str) -> Fate | None:
        """What became of it; None while it is alive, or may be, at a host that somebody hears.

        One start that is alive settles it. Else the latest counts, and one before it only when that is lost.
        """
        rows = [row for known in self.records.values() for row in known]
        gave_way = {row.generation for row in rows if row.outcome == "superseded"}
        starts = sorted({row.generation for row in rows} - gave_way, reverse=True)
        ended = {row.generation: row for row in rows if row.state == "EXITED" and row.outcome != "lost"}
        if any(
            row.state in _ALIVE for row in rows if row.generation in starts and row.generation not in ended
        ):
            return None
        if not starts:
            return self._never_seen(home, gave_way=bool(gave_way))
        found = [self._start(generation, ended.get(generation)) for generation in starts]
        fate = next((fate for fate in found if fate is None or fate.outcome != "lost"), found[0])
        return replace(fate, starts=tuple(starts)) if fate and fate.outcome == "lost" else fate

    def _start(self, generation: int, ended: Known | None) -> Fate | None:
        return Fate(self.agent, ended.outcome, ended.detail) if ended else self._missing(generation)

    def _never_seen(self, home: str, *, gave_way: bool) -> Fate | None:
        """Nobody who answers knows of a start that goes on."""
        if gave_way:
            return self._nowhere("the start of it that went on is not known to any host")
        if home in self.absent.gone:
            return self._nowhere(f"its host {home} is gone")
        return self._unheard(home, f"it starts on {home}, and") if home in self.absent.unheard else None

    def _missing(self, generation: int) -> Fate | None:
        """A start that nobody has who answers: where did it go last?"""
        known = {host: [r for r in rows if r.generation == generation] for host, rows in self.records.items()}
        rows = [row for records in known.values() for row in records]
        for row in rows:
            if row.state == "EXITED":
                # Of this start there is proof; since then its host may have started it again.
                return self._nowhere(row.detail)
        last = max(rows, key=lambda row: row.sequence)
        where, way = last.where, f"it went to {last.where} (transfer {last.sequence})"
        if where in self.absent.gone:
            return self._nowhere(f"{way}, which is gone")
        if where in self.absent.unheard:
            return self._unheard(where, f"{way}, and")
        there = known.get(where)
        if there is None or any(row.sequence >= last.sequence for row in there):
            return None
        if self.absent.lives.get(where) == last.receiver_memory:
            # It is on its way into that very life, or waits there for the devices to open.
            return None
        return self._nowhere(f"{way}, which was restarted")

    def _nowhere(self, how: str) -> Fate | None:
        """It is lost, unless it has gone on from there to a host that does not answer."""
        if self.absent.elsewhere:
            return None
        if self.absent.kept:
            return Fate(
                self.agent, "unheard", f"{how}; what that host has kept of it goes on when it is up again"
            )
        if self.absent.unheard:
            return self._unheard(min(self.absent.unheard), f"{how}, but it may have gone on from there, and")
        return Fate(self.agent, "lost", how)

    def _unheard(self, host: str, how: str) -> Fate:
        seconds = self.absent.unheard[host]
        return Fate(self.agent, "unheard", f"{how} {host} has not been heard for {seconds:.0f} s")
