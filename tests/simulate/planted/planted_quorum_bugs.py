"""What makes leases and fences safe, each left out: a judge must find the copy that acts beside another."""

from __future__ import annotations

import math
import random
from collections.abc import Collection
from dataclasses import replace
from typing import Any

from planted_bugs import Bug, Patch

from lfield.host.team.keeping import Keeping
from lfield.host.team.leases import Leases
from lfield.journal.pages import Fence
from lfield.mobility.effects import Effect, Persist
from lfield.quorum.core import Quorum
from lfield.quorum.lease import Lease
from lfield.quorum.members import Members
from lfield.quorum.recovery import Recoveries
from lfield.simulate.seeds import Draws
from lfield.simulate.stories.drawing import split
from lfield.simulate.stories.story import Story, doubted, parted
from lfield.simulate.weather import Fault
from lfield.vm.agent import Agent
from lfield.wire.quorum import Ack, Heartbeat

#: The seed of `parted` that finds `the_fence_is_not_on_disk`: at 7.5 s the former holder of a coordinator
#: meets a host that had promised it to another one, and was restarted since.
MEETING = 12
#: By which breaches they may be found.
TWO_ACT = frozenset({"I1", "I4", "start"})


def an_acknowledgement_without_the_fence(patch: Patch) -> None:
    _answers(patch, lambda self, host, message: [])


def fences_told_once_and_lost_with_their_link(patch: Patch) -> None:
    told: set[tuple[int, str, int]] = set()

    def fences(self: Quorum, host: str, message: Heartbeat) -> list[Any]:
        news = (id(self), host, self.fences.digest)
        known = message.fences == self.fences.digest or news in told
        told.add(news)
        return [] if known else self.fences.all

    _answers(patch, fences)


def interrupted(seed: int) -> Story:
    """The story of `parted` in which those who must not meet do; their link is slow at first, and breaks."""
    story, met = parted(MEETING), 7.1 + random.Random(f"interrupted {seed}").uniform(0.0, 0.4)
    slow = Fault(met, "slow", "h2", "h0", 0.5, 1.0)
    return replace(story, aimed=(slow, replace(slow, at=met + 0.5, kind="reset")))


def _answers(patch: Patch, fences: Any) -> None:
    """Heartbeats are acknowledged with these fences."""
    on_heartbeat = Quorum._on_heartbeat

    def answers(self: Quorum, host: str, message: Heartbeat, now: float) -> list[Any]:
        told = fences(self, host, message)
        effects = on_heartbeat(self, host, message, now)
        return [
            type(e)(e.host, Ack(message.life, message.number, told))
            if isinstance(getattr(e, "message", None), Ack)
            else e
            for e in effects
        ]

    patch.setattr(Quorum, "_on_heartbeat", answers)


def no_wait_after_the_promises(patch: Patch) -> None:
    patch.setattr(Members, "wait", property(lambda self: 0.0))


def a_wait_that_is_shorter_than_the_lease(patch: Patch) -> None:
    patch.setattr(Members, "wait", property(lambda self: 0.1 * self.lease))


def the_fence_is_not_on_disk(patch: Patch) -> None:
    """As on a disk, but its page is never written."""
    put = Keeping.put

    def forgets(self: Keeping, effects: Any, now: float) -> list[Effect]:
        kept = [e for e in effects if not (isinstance(e, Persist) and isinstance(e.page, Fence))]
        return put(self, kept, now)

    patch.setattr(Keeping, "put", forgets)


def the_promises_of_a_minority(patch: Patch) -> None:
    begin = Recoveries.__init__

    class Few(Members):
        def is_majority(self, names: Collection[str]) -> bool:
            return bool(self.names.intersection(names))

    def with_few(self: Recoveries, members: Members, *more: Any) -> None:
        begin(self, Few(members.names, members.here, members.lease), *more)

    patch.setattr(Recoveries, "__init__", with_few)


def the_first_acknowledgement_is_enough(patch: Patch) -> None:
    """Of two groups of a team each goes on with the lease, as long as one other of its group answers."""

    def count(self: Lease) -> None:
        times = sorted(self._acknowledged.values(), reverse=True)
        if not self._alone and len(times) >= self._members.majority - self._members.counts_itself:
            self.until = times[0] + self._members.lease

    patch.setattr(Lease, "_count", count)


def running_without_a_lease(patch: Patch) -> None:
    def may_act(self: Quorum, agent: str, generation: int, now: float) -> bool:
        return not self.barred(agent, generation)

    def until(self: Leases, caller: Agent, device: str) -> float:
        return math.inf

    patch.setattr(Quorum, "may_act", may_act)
    patch.setattr(Leases, "until", until)
    patch.setattr(Leases, "_lost", lambda self: None)


def _bug(plant: Any, why: str, seed: int, draws: Draws = doubted) -> Bug:
    return Bug(plant, why, TWO_ACT, seed, draws)


QUORUM_BUGS = [
    _bug(
        an_acknowledgement_without_the_fence,
        "a host that nobody heard for a while is given a lease by those who have barred what runs there",
        361,
    ),
    _bug(
        no_wait_after_the_promises,
        "whoever has promised has given a lease a moment ago, and may not know that it still holds",
        12,
    ),
    _bug(a_wait_that_is_shorter_than_the_lease, "what is left of a lease after the wait is too much", 12),
    _bug(the_promises_of_a_minority, "who is cut off promises itself whatever it likes", 31),
    _bug(
        the_first_acknowledgement_is_enough,
        "of more than three members a minority that hears itself keeps its lease",
        74,
        split,
    ),
    _bug(running_without_a_lease, "who is cut off works on while others go on", 101),
    _bug(
        fences_told_once_and_lost_with_their_link,
        "the one acknowledgement that carried the fence was lost with its link",
        10,
        interrupted,
    ),
    # Greetings and acknowledgements would tell whoever forgot: it is found where those who know never meet.
    _bug(
        the_fence_is_not_on_disk,
        "whoever has promised is started again, and gives a lease to what it has barred",
        12,
        parted,
    ),
]
