"""`--until-done` in a simulation: a host asks the others what became of the coordinators, then leaves.

The same as in host/process/until_done.py, on virtual time.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

from lfield.host.core import HostCore
from lfield.mobility.fates import Fate, Judge, known_fates
from lfield.simulate.fleet import Fleet, Life
from lfield.wire.messages import Known

#: As in host/process/until_done.py, in seconds.
ASK_EVERY, ANSWER_WITHIN, LINGER, FRESH = 0.5, 1.0, 2.0, 1.5


@dataclass(frozen=True, slots=True)
class Verdict:
    """What a host has said of a coordinator, and when."""

    at: float
    host: str
    fate: Fate


class UntilDone:
    """From now on all hosts of a fleet wait until all coordinators have a fate, and if they `leave`, go then.

    `verdicts` are what they have said.
    """

    def __init__(self, fleet: Fleet, lost_after: float, *, leave: bool = False) -> None:
        self.fleet, self.lost_after, self.leave = fleet, lost_after, leave
        self.verdicts: list[Verdict] = []
        team = fleet.mission.team
        self.homes = {member.id: team.hosts[member.host] for member in team.coordinators}
        fleet.on_boot = self._watch
        for name, life in fleet.lives.items():
            self._watch(name, life)

    def _watch(self, name: str, life: Life) -> None:
        _Watch(self, name, life)


class _Watch:
    """One life of one host."""

    def __init__(self, all: UntilDone, name: str, life: Life) -> None:
        self._all, self._fleet, self._name, self._life = all, all.fleet, name, life
        self._homes, self._judge = all.homes, Judge(all.homes)
        self._answers: dict[str, Sequence[Known]] = {}
        self._since = 0.0
        self._later(ASK_EVERY, self._look)

    @property
    def _core(self) -> HostCore:
        return self._life.core

    def _later(self, seconds: float, event: Callable[[], None]) -> None:
        self._fleet.later(seconds, partial(self._fleet.enter, self._name, self._life, event))

    def _look(self) -> None:
        found = self._known(self._since)
        self._since = self._fleet.clock.now - FRESH
        if self._homes.keys() == found.keys():
            self._over(found)
        elif self._core.hearsay.whole and not self._core.mobility.lost:
            self._later(ASK_EVERY, self._look)
        else:
            self._ask()

    def _known(self, since: float) -> dict[str, Fate]:
        return known_fates(self._homes, self._core.mobility.knowledge(), self._core.mobility.proven(since))

    def _ask(self) -> None:
        self._answers = {}
        for other in self._fleet.mission.team.hosts:
            self._fleet.send(self._name, other, partial(self._asked, self._answers))
        self._later(ANSWER_WITHIN, self._hold)

    def _asked(self, answers: dict[str, Sequence[Known]], near: str, far: str) -> None:
        known = self._fleet.lives[far].core.mobility.knowledge()
        self._fleet.send(far, near, partial(self._answered, answers, known))

    def _answered(self, answers: dict[str, Sequence[Known]], known: list[Known], near: str, far: str) -> None:
        answers[near] = known
        self._fleet.enter(far, self._fleet.lives[far], partial(self._fleet.lives[far].core.told, near, known))

    def _hold(self) -> None:
        """The census is in."""
        known = self._answers | {self._name: self._core.mobility.knowledge()}
        bound = max(self._all.lost_after, self._fleet.unreachable_after)
        absent = self._core.hearsay.absent(known, self._fleet.clock.now, self._all.lost_after, bound)
        found = self._judge.judge(known, absent) | self._known(self._fleet.clock.now - FRESH)
        if self._homes.keys() == found.keys():
            self._over(found)
        else:
            self._later(ASK_EVERY, self._look)

    def _over(self, found: dict[str, Fate]) -> None:
        self._all.verdicts += [Verdict(self._fleet.clock.now, self._name, fate) for fate in found.values()]
        self._core.pass_on(found.values())
        if self._all.leave:
            self._later(LINGER, partial(self._fleet.leave, self._name))
        else:
            # It stays to be judged again.
            self._later(LINGER, self._look)
