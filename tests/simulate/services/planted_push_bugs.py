"""Former and plausible bugs of the service as patches of the real code: the judge must find each."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass

import pytest
from msgspec.structs import replace

from lfield.errors import OutputFileError
from lfield.service import ballots, service
from lfield.service.ballots import ActivationState
from lfield.service.mission_runner import MissionRunner
from lfield.service.service import Service
from lfield.service.service_interfaces import AskPeer
from lfield.wire.service_messages import BallotOutcome, BallotState, Vote
from simulation_testing.services.robot_mission import ModelProbe, RobotMission

Patch = pytest.MonkeyPatch


@dataclass(frozen=True)
class PushBug:
    """A bug: its planting function, its description, the breaches that reveal it, and a seed that finds it.

    If `seed` no longer finds the bug, the `within` scenarios from 0 on are searched.
    """

    plant: Callable[[Patch], None]
    broken: str
    breaches: frozenset[str]
    seed: int
    within: int = 300

    @property
    def name(self) -> str:
        return self.plant.__name__


def a_vote_is_sent_before_it_is_stored(patch: Patch) -> None:
    def store(self: Service, changed: ActivationState) -> None:
        if changed == self._activation:
            return
        self._bound_since = None if changed.open_ballot is None else self._clock.monotonic()
        self._activation = changed

        def save() -> None:
            with suppress(OutputFileError):
                self._store_run()

        asyncio.get_running_loop().call_later(0.5, save)

    patch.setattr(Service, "_store_activation", store)


def a_bound_host_restarts_its_mission(patch: Patch) -> None:
    patch.setattr(Service, "_start_refusal", lambda self, bundle: "")


def a_query_that_closes_a_ballot_changes_the_vote(patch: Patch) -> None:
    def close(state: ActivationState, id: bytes) -> ActivationState:
        if state.ballot is not None and state.ballot.id == id and state.ballot.outcome == "open":
            state = replace(state, ballot=None)
        return replace(state, closed=(*state.closed, id)) if id not in state.closed else state

    patch.setattr(ballots, "close", close)


def a_majority_activates(patch: Patch) -> None:
    def outcome(hosts: Iterable[str], votes: Mapping[str, Vote]) -> BallotOutcome:
        every = list(hosts)
        if "no" in votes.values():
            return "aborted"
        return "activated" if 2 * sum(vote == "yes" for vote in votes.values()) > len(every) else "open"

    patch.setattr(ballots, "ballot_outcome", outcome)


def unknown_votes_count_as_yes(patch: Patch) -> None:
    def outcome(hosts: Iterable[str], votes: Mapping[str, Vote]) -> BallotOutcome:
        return "aborted" if "no" in votes.values() else "activated"

    patch.setattr(ballots, "ballot_outcome", outcome)


def a_held_host_is_not_released(patch: Patch) -> None:
    async def release(self: Service) -> None:
        self._set_held(False)

    patch.setattr(Service, "_release", release)


def votes_of_earlier_ballots_are_forgotten(patch: Patch) -> None:
    def known(state: ActivationState, id: bytes) -> BallotState | None:
        return state.ballot if state.ballot is not None and state.ballot.id == id else None

    patch.setattr(ballots, "_known", known)


def a_host_is_not_held_for_its_vote(patch: Patch) -> None:
    async def hold(self: Service, ballot: bytes) -> str:
        return ""

    patch.setattr(Service, "_hold", hold)


def a_host_votes_without_a_check_after_its_hold(patch: Patch) -> None:
    refusal = Service._refusal

    async def once(self: Service, digest: bytes | None, hosts: Sequence[str] = ()) -> str:
        if self._held:
            return ""
        return await refusal(self, digest, hosts)

    patch.setattr(Service, "_refusal", once)


def a_crashed_host_counts_as_at_rest(patch: Patch) -> None:
    async def motion(self: Service) -> str:
        return await self._probe.vehicles() if self._runner.is_running else ""

    patch.setattr(Service, "_motion", motion)


def an_old_bundle_is_restarted_after_an_activation(patch: Patch) -> None:
    refusal = Service._start_refusal
    end = Service._end_other_bundle

    async def end_running(self: Service) -> None:
        if self._runner.is_running:
            await end(self)

    patch.setattr(Service, "_end_other_bundle", end_running)
    patch.setattr(Service, "_start_refusal", lambda self, bundle: refusal(self, self._activation.active))


def a_host_whose_number_was_not_stored_is_forgotten(patch: Patch) -> None:
    adopt = MissionRunner.adopt

    def adopt_known(self: MissionRunner) -> None:
        if self._record.bundle and not self._record.pid:
            self._interrupt("the service has ended while it started the host")
        else:
            adopt(self)

    patch.setattr(MissionRunner, "adopt", adopt_known)


def an_open_ballot_is_never_closed(patch: Patch) -> None:
    patch.setattr(service, "CLOSE_AFTER", math.inf)


def a_result_is_not_carried_out_after_a_restart(patch: Patch) -> None:
    async def settle(self: Service) -> None:
        """Do nothing."""

    patch.setattr(Service, "settle", settle)


def a_hold_ends_before_the_result(patch: Patch) -> None:
    ask = Service._ask_for_votes

    async def release_and_ask(self: Service, bound: BallotState, peers: AskPeer) -> None:
        async with self._lock:
            await self._release()
        await ask(self, bound, peers)

    patch.setattr(Service, "_ask_for_votes", release_and_ask)


def a_resume_of_a_person_ends_the_hold_of_a_vote(patch: Patch) -> None:
    order = RobotMission.order_pause

    def order_all(self: RobotMission, *, on: bool) -> bool:
        done = order(self, on=on)
        self.held = self.held if on or not done else b""
        return done

    patch.setattr(RobotMission, "order_pause", order_all)


def the_end_of_a_vote_ends_the_pause_of_a_person(patch: Patch) -> None:
    release = ModelProbe.release

    async def release_all(self: ModelProbe) -> str:
        self._mission.is_paused = False
        return await release(self)

    patch.setattr(ModelProbe, "release", release_all)


def coordinators_of_left_out_robots_are_forgotten(patch: Patch) -> None:
    patch.setattr(Service, "_unaccounted", lambda self, hosts: "")


PUSH_BUGS = (
    PushBug(
        a_vote_is_sent_before_it_is_stored,
        "a vote is sent before it is on disk: a killed service votes again, and differently",
        frozenset({"activated without a yes", "two outcomes"}),
        0,
    ),
    PushBug(
        a_bound_host_restarts_its_mission,
        "a host starts its mission although the result of its ballot is unknown",
        frozenset({"start while bound", "start of another bundle"}),
        3,
    ),
    PushBug(
        a_query_that_closes_a_ballot_changes_the_vote,
        "a query with `closes` replaces a vote that was stored",
        frozenset({"vote changed", "outcome changed", "two outcomes", "activated without a yes"}),
        45,
    ),
    PushBug(
        a_majority_activates,
        "a majority of votes activates a bundle",
        frozenset({"activated without a yes", "two outcomes"}),
        2,
    ),
    PushBug(
        unknown_votes_count_as_yes,
        "a host activates a bundle without the votes of the other hosts",
        frozenset({"activated without a yes", "two outcomes"}),
        0,
    ),
    PushBug(
        a_held_host_is_not_released,
        "a host that was held for a ballot stays held after its result",
        frozenset({"still held"}),
        24,
    ),
    PushBug(
        votes_of_earlier_ballots_are_forgotten,
        "a host closes an earlier ballot on whose proposal it has voted yes",
        frozenset({"vote changed", "outcome changed", "two outcomes", "activated without a yes"}),
        7,
    ),
    PushBug(
        a_host_is_not_held_for_its_vote,
        "a host votes yes and can start coordinators until the result",
        frozenset({"yes without hold", "yes without rest"}),
        4,
    ),
    PushBug(
        a_host_votes_without_a_check_after_its_hold,
        "a vehicle takes off between the check and the hold of a vote",
        frozenset({"yes without rest"}),
        51,
    ),
    PushBug(
        a_crashed_host_counts_as_at_rest,
        "a host without a process votes yes while its vehicle is in the air",
        frozenset({"yes without rest", "yes without hold"}),
        220,
    ),
    PushBug(
        an_old_bundle_is_restarted_after_an_activation,
        "a restart after a crash runs a bundle that is not active any more",
        frozenset({"start of another bundle"}),
        233,
    ),
    PushBug(
        a_host_whose_number_was_not_stored_is_forgotten,
        "a service that was killed while it started a host does not find its process",
        frozenset({"two hosts", "yes without hold", "yes without rest"}),
        2,
    ),
    PushBug(
        an_open_ballot_is_never_closed,
        "hosts that have not voted are never asked to vote no",
        frozenset({"no decision"}),
        2,
    ),
    PushBug(
        a_result_is_not_carried_out_after_a_restart,
        "a service that was killed after it stored a result does not carry it out",
        frozenset({"still held", "old bundle runs"}),
        225,
    ),
    PushBug(
        a_hold_ends_before_the_result,
        "a host is released while the result of its ballot is unknown",
        frozenset({"released while bound"}),
        7,
    ),
    PushBug(
        a_resume_of_a_person_ends_the_hold_of_a_vote,
        "a person resumes a mission, and its host can arm although it has voted",
        frozenset({"acts while bound", "yes without hold"}),
        58,
        within=600,
    ),
    PushBug(
        the_end_of_a_vote_ends_the_pause_of_a_person,
        "a pause of a person ends with the vote of the robot",
        frozenset({"acts while paused", "pause changed"}),
        21,
    ),
    PushBug(
        coordinators_of_left_out_robots_are_forgotten,
        "robots activate a bundle while a coordinator of the mission runs on a robot that is left out",
        frozenset({"yes with a coordinator elsewhere"}),
        55,
    ),
)
