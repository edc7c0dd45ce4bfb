"""Checks the promises of the services of a team, from their disks and the actions of robots."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from lfield.service import ballots
from lfield.service.bundle_store import ServiceRecord
from lfield.wire.service_messages import Ballot, BallotOutcome, BallotState, Vote
from simulation_testing.invariants.breaches import Breaches
from simulation_testing.services.robot_mission import RobotMission


class PushJudge:
    """The judge of one team. `now` is true time in seconds."""

    def __init__(self, now: Callable[[], float]) -> None:
        self.breaches = Breaches(now)
        self.missions: dict[str, RobotMission] = {}
        self.records: dict[str, ServiceRecord] = {}
        #: Every ballot on which a host has voted, in the order of the first votes, with the states that
        #: hosts know.
        self.ballots: dict[bytes, Ballot] = {}
        self.outcomes: dict[bytes, BallotOutcome] = {}
        #: Called at the next vote for a ballot of a robot.
        self.at_vote: dict[str, Callable[[], None]] = {}
        #: The robots whose missions an operator has paused.
        self.paused: set[str] = set()
        self._votes: dict[tuple[str, bytes], Vote] = {}
        #: The last ballot that was activated, by robot: an activation is the time of the last yes.
        self._activated: dict[str, Ballot] = {}
        self.counts = dict.fromkeys(("yes", "no", "activated", "aborted", "starts", "acts"), 0)

    # --- disks ----------------------------------------------------------------------------------------

    def on_save(self, robot: str, before: ServiceRecord, after: ServiceRecord) -> None:
        """The state of a robot is stored now."""
        self.records[robot] = after
        found, was = after.activation.ballot, before.activation.ballot
        if found is not None and found.ballot is not None:
            self.ballots.setdefault(found.id, found.ballot)
        self._check_votes_kept(robot, after)
        if before.run.unsafe and not after.run.unsafe and not after.run.bundle:
            # An operator has checked the vehicle.
            self.missions[robot].is_airborne = False
        if found is None or found.ballot is None:
            return
        if was is None or was.id != found.id:
            self.counts[found.votes[robot]] += 1
            if found.votes[robot] == "yes":
                self._on_yes(robot, before, found.ballot)
        if found.outcome != "open":
            self._on_outcome(robot, found)

    def _check_votes_kept(self, robot: str, after: ServiceRecord) -> None:
        for id in self.ballots:
            known = ballots.answer(after.activation, robot, id)
            if (vote := known.votes.get(robot)) is None:
                continue
            first = self._votes.setdefault((robot, id), vote)
            if vote != first:
                self.breaches.add("vote changed", (robot,), f"it has voted {first}, and answers {vote}")

    def _on_yes(self, robot: str, before: ServiceRecord, ballot: Ballot) -> None:
        mission = self.missions[robot]
        self.at_vote.pop(robot, lambda: None)()
        if ballot.digest != before.activation.active:
            if not mission.is_at_rest:
                state = "flies" if mission.is_airborne else f"has coordinators {[*mission.unfinished]}"
                self.breaches.add("yes without rest", (robot,), f"it {state} at its vote")
            others = [host for host in self.missions if host not in ballot.hosts]
            if mission.open_run and (agents := mission.starts_elsewhere(others)):
                self.breaches.add("yes with a coordinator elsewhere", (robot,), f"{agents} may still run")
            if mission.host is not None and not mission.held:
                self.breaches.add("yes without hold", (robot,), "its host can start anything")
        if all(self._votes.get((host, ballot.id)) == "yes" for host in ballot.hosts):
            self._activated |= dict.fromkeys(ballot.hosts, ballot)
            for host in ballot.hosts:
                if self.missions[host].open_run != ballot.digest:
                    self.missions[host].open_run = b""

    def _on_outcome(self, robot: str, found: BallotState) -> None:
        assert found.ballot is not None
        self.counts[found.outcome] += found.id not in self.outcomes
        first = self.outcomes.setdefault(found.id, found.outcome)
        if first != found.outcome:
            self.breaches.add("two outcomes", (robot,), f"{found.outcome}, and elsewhere {first}")
        if found.outcome == "activated":
            for host in found.ballot.hosts:
                if (vote := self._votes.get((host, found.id))) != "yes":
                    self.breaches.add("activated without a yes", (robot, host), f"{host} has voted {vote}")

    # --- hosts ----------------------------------------------------------------------------------------

    def on_start(self, robot: str, bundle: bytes) -> None:
        """The host of a bundle is started."""
        self.counts["starts"] += 1
        activation = self.records.get(robot, ServiceRecord()).activation
        if activation.open_ballot is not None:
            self.breaches.add("start while bound", (robot,), "its ballot has no result")
        if bundle != activation.active:
            self.breaches.add("start of another bundle", (robot,), "its bundle is not active there")
        if self.missions[robot].host is not None:
            self.breaches.add("two hosts", (robot,), "a host runs already")

    def on_release(self, robot: str) -> None:
        """The service releases the host of a robot, which may arm again."""
        if self._is_bound(robot):
            self.breaches.add("released while bound", (robot,), "it has voted, and does not know the result")

    def _is_bound(self, robot: str) -> bool:
        """Whether a robot has voted for another bundle, and does not know the result."""
        activation = self.records.get(robot, ServiceRecord()).activation
        bound = activation.open_ballot
        return bound is not None and bound.ballot is not None and bound.ballot.digest != activation.active

    def on_act(self, robot: str, bundle: bytes) -> None:
        """A coordinator acts on a robot: no other robot of the same activation may run another bundle."""
        self.counts["acts"] += 1
        if robot in self.paused:
            self.breaches.add("acts while paused", (robot,), "an operator has paused it, and not resumed it")
        if self._is_bound(robot):
            # Its vehicle can leave the ground.
            self.breaches.add("acts while bound", (robot,), "it has voted, and does not know the result")
        own = self._activated.get(robot)
        if own is None:
            return
        for other, mission in self.missions.items():
            other_bundle = self._activated.get(other)
            if (
                other == robot
                or other_bundle is None
                or robot not in other_bundle.hosts
                or other not in own.hosts
            ):
                continue
            host = mission.host
            if host is not None and host.bundle != bundle and not mission.rests and mission.unfinished:
                self.breaches.add("two bundles", (robot, other), "two bundles run within one mission")

    # --- the end --------------------------------------------------------------------------------------

    @property
    def undecided(self) -> list[str]:
        """The robots that are bound by a ballot, or have not carried out its result."""
        return [
            robot
            for robot, record in self.records.items()
            if record.activation.open_ballot is not None
            or (record.held and self.missions[robot].host is not None)
            or record.run.bundle not in (b"", record.activation.active)
        ]

    def check_settled(self, running: Mapping[str, bool]) -> None:
        """All robots were connected for long enough. `running` has those whose services run."""
        for robot, mission in self.missions.items():
            record = self.records.get(robot, ServiceRecord())
            if record.activation.open_ballot is not None:
                self.breaches.add("no decision", (robot,), "a ballot is still open")
            if mission.host is not None and mission.held:
                self.breaches.add("still held", (robot,), "no ballot binds it, and its host is held")
            if mission.is_paused is not (robot in self.paused):
                self.breaches.add("pause changed", (robot,), "not by an operator")
            last = self._activated.get(robot)
            if last is not None and record.activation.active != last.digest:
                self.breaches.add("activation lost", (robot,), "it does not know the last activation")
            if mission.host is not None and mission.host.bundle != record.activation.active:
                self.breaches.add("old bundle runs", (robot,), "another bundle is active")
            if not running[robot]:
                self.breaches.add("service ended", (robot,), "its service does not run")
