"""What leases and fences rest on, taken away one by one: the judge must see each."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from msgspec import structs
from quorum_copies import Copy, Ends
from quorum_host import Life

from lfield.quorum.core import Quorum
from lfield.quorum.effects import Effect, Tell
from lfield.quorum.lease import Lease
from lfield.quorum.members import Members
from lfield.quorum.recovery import Attempt, Recoveries
from lfield.quorum.terminations import Terminations
from lfield.wire.quorum import Ack, Heartbeat, Propose, Sought

Patch = pytest.MonkeyPatch


def resumes_after_the_point_of_no_return(patch: Patch) -> None:
    def ask(self: Life, agent: str, copy: Copy) -> None:
        self.copies[agent] = replace(copy, state="RUN")

    patch.setattr(Life, "_ask", ask)


def acknowledges_without_the_fence(patch: Patch) -> None:
    heartbeat = Quorum._on_heartbeat

    def bare(self: Quorum, host: str, message: Heartbeat, now: float) -> list[Effect]:
        heartbeat(self, host, message, now)
        return [Tell(host, Ack(message.life, message.number, []))]

    patch.setattr(Quorum, "_on_heartbeat", bare)


def does_not_wait(patch: Patch) -> None:
    patch.setattr(Members, "wait", 0.0)


def waits_less_than_a_lease(patch: Patch) -> None:
    patch.setattr(Members, "wait", property(lambda self: 0.7 * self.lease))


def has_no_fence_on_disk(patch: Patch) -> None:
    patch.setattr(Life, "keep_fence", lambda self, agent, generation: None)


def goes_on_with_promises_of_a_minority(patch: Patch) -> None:
    propose = Recoveries._propose

    def hasty(self: Recoveries, agent: str, attempt: Attempt, now: float) -> list[Effect]:
        effects = propose(self, agent, attempt, now)
        attempt.phase, attempt.due = "waiting", now + self._members.wait
        return effects

    patch.setattr(Recoveries, "_propose", hasty)
    patch.setattr(Recoveries, "_has_heard_enough", lambda self, attempt, now: now >= attempt.enough)


def runs_without_a_lease(patch: Patch) -> None:
    patch.setattr(Lease, "holds", lambda self, now: True)
    patch.setattr(Life, "until", math.inf)


def tells_fences_once(patch: Patch) -> None:
    heartbeat = Quorum._on_heartbeat

    def once(self: Quorum, host: str, message: Heartbeat, now: float) -> list[Effect]:
        told = self.__dict__.setdefault("told", {}).setdefault((host, message.life), set())
        heartbeat(self, host, message, now)
        news = [fence for fence in self.fences.all if fence not in told]
        told.update(news)
        return [Tell(host, Ack(message.life, message.number, news))]

    patch.setattr(Quorum, "_on_heartbeat", once)


def asks_nobody_first(patch: Patch) -> None:
    patch.setattr(Recoveries, "_has_heard_enough", lambda self, attempt, now: True)


def promises_in_spite_of_a_known_termination(patch: Patch) -> None:
    on_propose, sought = Quorum._on_propose, Quorum._sought

    def promises(self: Quorum, host: str, message: Propose, now: float) -> list[Effect]:
        return on_propose(self, host, structs.replace(message, start=2**62), now)

    def silent(self: Quorum, agent: str, now: float) -> Sought:
        return structs.replace(sought(self, agent, now), ended=None)

    patch.setattr(Quorum, "_on_propose", promises)
    patch.setattr(Quorum, "_sought", silent)
    patch.setattr(Terminations, "all", property(lambda self: []))


def knows_nothing_of_a_termination(patch: Patch) -> None:
    patch.setattr(Ends, "saved", lambda self, agent, copy: None)
