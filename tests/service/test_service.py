"""The service of one robot: its votes and their effects."""

from __future__ import annotations

import asyncio
from hashlib import sha256

import pytest
from service_fakes import (
    NEW,
    OLD,
    SOON,
    WALKER,
    YES,
    Robot,
    ballot,
    run_of,
    running,
    unreachable,
)

from lfield.errors import WireError
from lfield.service.ballots import ActivationState
from lfield.service.bundle_store import ServiceRecord
from lfield.service.restart_policy import RESTART_DELAY
from lfield.service.service import RESOLVE_EVERY
from lfield.wire.service_messages import (
    Ballot,
    MissionCommand,
    ServiceQuery,
    ServiceStatus,
    StageRequest,
    StageResult,
    VoteReport,
)

# --- votes ---------------------------------------------------------------------------------------------


async def test_service_votes_yes_at_rest_and_holds_its_host() -> None:
    robot = await running()
    answer = await robot.propose()
    assert (answer.votes, answer.outcome) == ({"alpha": "yes"}, "open")
    assert robot.files.record.activation.ballot == answer
    assert robot.probe.held
    assert robot.files.record.held
    # The proposed bundle, and the running one, whose coordinators must have ended.
    assert robot.verifications == 2


@pytest.mark.parametrize(
    "reason", ["flying", "walking", "unknown bundle", "bad signature", "restarting", "killed"]
)
async def test_service_votes_no_with_a_reason(reason: str) -> None:
    robot = await running()
    proposal = ballot()
    match reason:
        case "flying":
            robot.probe.motion = "drone is off the ground"
        case "walking":
            robot.probe.waiting = [WALKER]
        case "unknown bundle":
            proposal = ballot(digest=bytes(32))
        case "bad signature":
            robot.files.bundles[NEW] = b"damaged"
        case "restarting":
            robot.processes.end(-11)
            await asyncio.sleep(0.5 * RESTART_DELAY)
        case "killed":
            for _ in range(6):
                robot.processes.end(-11)
                await asyncio.sleep(SOON)
    answer = await robot.propose(proposal)
    assert answer.votes == {"alpha": "no"}
    assert answer.outcome == "aborted"
    assert answer.reasons["alpha"]
    assert not robot.probe.held
    assert robot.files.record.activation.open_ballot is None
    status = await robot.service.answer(ServiceQuery(), "anna")
    assert isinstance(status, ServiceStatus)
    assert bool(status.refusal) is (reason not in ("unknown bundle", "bad signature"))


async def test_takeoff_during_the_hold_leads_to_a_no_vote() -> None:
    robot = await running()

    def take_off() -> None:
        robot.probe.motion = "drone is off the ground"

    robot.probe.on_hold = take_off
    answer = await robot.propose()
    assert answer.votes == {"alpha": "no"}
    assert not robot.probe.held
    assert not robot.files.record.held


async def test_host_that_cannot_be_held_votes_no_and_is_released() -> None:
    robot = await running()
    robot.probe.hold_trouble = robot.probe.release_trouble = "no answer"
    task = asyncio.create_task(robot.service.resolve(unreachable))
    assert (await robot.propose()).votes == {"alpha": "no"}
    assert robot.files.record.held
    # The hold was received after all.
    robot.probe.held, robot.probe.release_trouble = ballot().id, ""
    await asyncio.sleep(2 * RESOLVE_EVERY)
    assert not robot.probe.held
    assert not robot.files.record.held
    task.cancel()


async def test_service_outside_the_ballot_is_not_bound() -> None:
    robot = Robot()
    robot.boot_service()
    with pytest.raises(WireError):
        await robot.propose(ballot(hosts=["bravo"]))
    assert robot.files.record == ServiceRecord(ActivationState(active=OLD))


async def test_closing_query_during_the_hold_leads_to_a_no_vote() -> None:
    robot = await running()
    asking = asyncio.create_task(robot.propose())
    await asyncio.sleep(0.25)
    closed = await robot.query(ballot().id, closes=True)
    assert closed.votes == {"alpha": "no"}
    answer = await asking
    assert answer.votes == {"alpha": "no"}
    assert not robot.probe.held
    assert not robot.files.record.held


async def test_two_concurrent_proposals_get_one_yes_vote() -> None:
    robot = await running()
    answers = await asyncio.gather(robot.propose(ballot(1)), robot.propose(ballot(2, OLD)))
    assert [answer.votes["alpha"] for answer in answers] == ["yes", "no"]
    assert answers[1].reasons["alpha"]
    assert robot.probe.held


async def test_activating_the_active_bundle_changes_nothing() -> None:
    robot = await running()
    robot.probe.motion = "drone is off the ground"
    await robot.propose(ballot(digest=OLD))
    await robot.service.answer(VoteReport(ballot().id, YES), "anna")
    assert robot.runner.is_running
    assert not robot.probe.held
    assert robot.service.activation.active == OLD
    assert robot.service.activation.previous == b""


async def test_file_stored_by_another_desk_is_confirmed() -> None:
    robot = Robot()
    robot.boot_service()
    file = sha256(b"new").digest()
    for _ in range(2):
        answer = await robot.service.answer(StageRequest(NEW, file), "anna")
        assert answer == StageResult(NEW)
    # Another file of the same bundle, with another signature, is not stored.
    other = await robot.service.answer(StageRequest(NEW, bytes(32)), "anna")
    assert isinstance(other, StageResult)
    assert other.trouble


def _without_bravo(number: int = 1) -> Ballot:
    """A ballot of `push --without bravo`, or of a mission without bravo."""
    return ballot(number, hosts=["alpha"])


@pytest.mark.parametrize("state", ["runs", "stopped", "killed service"])
async def test_coordinator_of_an_excluded_host_is_unaccounted_for(state: str) -> None:
    """The coordinator has never been on this host, so only the deployment shows that it may exist."""
    robot = await running()
    if state != "runs":
        await robot.command(MissionCommand("stop"))
    if state == "killed service":
        robot.kill_service()
        robot.boot_service()
    answer = await robot.propose(_without_bravo())
    assert answer.votes == {"alpha": "no"}
    assert "pilot of bravo" in answer.reasons["alpha"]
    assert "walker" not in answer.reasons["alpha"]
    assert robot.service.activation.active == OLD
    await robot.command(MissionCommand("stop", discards=True))
    assert (await robot.propose(_without_bravo(2))).outcome == "activated"


@pytest.mark.parametrize("status", [0, 1])
async def test_ended_run_needs_no_excluded_host(status: int) -> None:
    robot = await running()
    robot.processes.end(status)
    await asyncio.sleep(SOON)
    assert (await robot.propose(_without_bravo())).outcome == "activated"


async def test_unstarted_or_accounted_run_needs_no_excluded_host() -> None:
    robot = Robot()
    robot.boot_service()
    assert (await robot.propose(_without_bravo())).outcome == "activated"
    await robot.start()
    assert (await robot.propose(ballot(2, OLD))).votes == {"alpha": "yes"}
    await robot.service.on_votes(ballot(2).id, {"bravo": "yes"})
    assert (await robot.propose(_without_bravo(3))).outcome == "activated"


# --- effects of a vote ---------------------------------------------------------------------------------


async def test_bound_host_neither_starts_nor_restarts() -> None:
    robot = await running()
    await robot.propose()
    robot.processes.end(-11)
    await asyncio.sleep(SOON)
    assert robot.processes.started == [OLD]
    assert (await robot.start()).trouble
    assert robot.processes.started == [OLD]
    # The next service does not vote either.
    robot.kill_service()
    robot.boot_service()
    await asyncio.sleep(SOON)
    assert (await robot.start()).trouble
    assert robot.processes.started == [OLD]


async def test_host_is_resumed_after_an_abort() -> None:
    robot = await running()
    await robot.propose()
    await robot.service.on_votes(ballot().id, {"bravo": "no"})
    assert robot.runner.is_running
    assert not robot.probe.held
    assert not robot.files.record.held
    robot.processes.end(-11)
    await asyncio.sleep(SOON)
    assert robot.processes.started == [OLD, OLD]


@pytest.mark.parametrize("moment", ["before", "after"])
async def test_pause_by_a_person_stays_after_an_abort(moment: str) -> None:
    robot = await running()
    robot.probe.paused = moment == "before"
    await robot.propose()
    assert robot.probe.held == ballot().id
    robot.probe.paused = True
    await robot.service.on_votes(ballot().id, {"bravo": "no"})
    assert (robot.probe.paused, robot.probe.held) == (True, b"")


async def test_host_restarted_during_the_vote_votes_no() -> None:
    """The new process is not held."""
    robot = await running()

    def restart() -> None:
        robot.processes.end(-11)

    robot.probe.on_hold = restart
    robot.probe.delay = SOON
    assert (await robot.propose()).votes == {"alpha": "no"}
    assert robot.processes.started == [OLD, OLD]


async def test_host_that_crashed_while_held_is_not_held_later() -> None:
    robot = await running()
    task = asyncio.create_task(robot.service.resolve(unreachable))
    await robot.propose()
    robot.processes.end(-11)
    await asyncio.sleep(SOON)
    await robot.service.on_votes(ballot().id, {"bravo": "no"})
    await robot.start()
    await asyncio.sleep(2 * RESOLVE_EVERY)
    assert not robot.probe.held
    assert not robot.files.record.held
    task.cancel()


async def test_host_stays_held_until_it_ends_after_an_activation() -> None:
    robot = await running()
    await robot.propose()
    robot.processes.obeys = False
    ending = asyncio.create_task(robot.service.on_votes(ballot().id, {"bravo": "yes"}))
    await asyncio.sleep(30.0)
    assert robot.processes.terminated == [101]
    assert robot.probe.held
    robot.processes.end(0)
    await ending
    assert not robot.files.record.held


async def test_service_with_deleted_state_releases_a_held_host() -> None:
    robot = await running()
    await robot.propose()
    robot.kill_service()
    robot.files.record = ServiceRecord()
    robot.boot_service()
    await robot.service.settle()
    assert not robot.probe.held


async def test_activation_ends_the_host_of_another_bundle() -> None:
    robot = await running()
    await robot.propose()
    await robot.service.answer(VoteReport(ballot().id, {"bravo": "yes"}), "anna")
    assert robot.service.activation.active == NEW
    assert robot.processes.terminated == [101]
    assert not robot.runner.is_running
    assert not robot.files.record.held
    await robot.start()
    assert robot.processes.started == [OLD, NEW]


async def test_host_of_the_old_bundle_is_not_restarted() -> None:
    """The service and the host were killed between the record of the result and the end of the host."""
    robot = await running()
    robot.kill_service()
    robot.processes.end(-9)
    robot.files.record = ServiceRecord(ActivationState(active=NEW, earlier=(OLD,)), run_of(OLD, 101))
    robot.boot_service()
    await asyncio.sleep(SOON)
    assert robot.processes.started == [OLD]


async def test_start_is_refused_for_an_inactive_bundle() -> None:
    robot = Robot()
    robot.boot_service()
    assert (await robot.command(MissionCommand("start", NEW))).trouble
    assert robot.processes.started == []
    result = await robot.command(MissionCommand("start", OLD, without=["bravo"]))
    assert (result.trouble, result.run.phase) == ("", "running")
    assert robot.probe.without == ["bravo"]
    robot = Robot(active=b"")
    robot.boot_service()
    assert (await robot.start()).trouble


async def test_start_without_an_unknown_host_is_refused() -> None:
    robot = Robot()
    robot.boot_service()
    result = await robot.command(MissionCommand("start", OLD, without=["carol"]))
    assert (bool(result.trouble), result.run.phase) == (True, "stopped")
    assert robot.processes.started == []


async def test_stop_sent_before_a_kill_does_not_confirm_rest() -> None:
    robot = await running()
    voting = asyncio.create_task(robot.propose())
    stopping = asyncio.create_task(robot.command(MissionCommand("stop")))
    await asyncio.sleep(0.05)
    robot.processes.end(-9)
    assert (await stopping).trouble
    await voting
    await robot.service.on_votes(ballot().id, {"bravo": "no"})
    assert (await robot.propose(ballot(2))).votes == {"alpha": "no"}
    # The next stop is sent by an operator who has read the answer.
    answer = await robot.command(MissionCommand("stop"))
    assert (answer.trouble, answer.checked) == ("", "killed by signal 9")
    assert (await robot.propose(ballot(3))).votes == {"alpha": "yes"}


async def test_stop_with_discard_ends_parked_coordinators() -> None:
    robot = await running()
    robot.probe.waiting = [WALKER]
    result = await robot.command(MissionCommand("stop"))
    assert (result.run.phase, result.discarded) == ("stopped", [])
    assert (await robot.propose()).votes == {"alpha": "no"}
    result = await robot.command(MissionCommand("stop", discards=True))
    assert result.discarded == ["walker"]
    assert (await robot.propose(ballot(2))).votes == {"alpha": "yes"}


async def test_service_with_deleted_state_keeps_its_host_and_votes_no() -> None:
    robot = await running()
    robot.kill_service()
    robot.files.record = ServiceRecord()
    robot.probe.motion = "its vehicles are unknown"
    robot.boot_service()
    task = asyncio.create_task(robot.service.resolve(unreachable))
    await asyncio.sleep(2 * RESOLVE_EVERY)
    assert robot.processes.alive == {101: OLD}
    answer = await robot.propose()
    assert (answer.votes, answer.reasons) == ({"alpha": "no"}, {"alpha": "its vehicles are unknown"})
    await robot.command(MissionCommand("stop"))
    assert not robot.processes.alive
    assert (await robot.propose(ballot(2))).votes == {"alpha": "yes"}
    task.cancel()
