"""The service of one robot: ballots without a decision, full disks, and kills between any two saves."""

from __future__ import annotations

import asyncio

import pytest
from service_fakes import (
    NEW,
    OLD,
    SOON,
    YES,
    Robot,
    ServiceKilled,
    ballot,
    run_of,
    running,
    unreachable,
)

from lfield.errors import OutputFileError
from lfield.service.ballots import ActivationState, propose
from lfield.service.bundle_store import ServiceRecord
from lfield.service.mission_runner import ProcessId
from lfield.service.service import CLOSE_AFTER, REPORT_EVERY, RESOLVE_EVERY
from lfield.simulate.jumping_loop import run_jumping
from lfield.wire.service_messages import (
    BallotState,
    MissionCommand,
    Vote,
    VoteQuery,
    VoteReport,
)

# --- ballots without a decision ------------------------------------------------------------------------


class Bravo:
    """The service of the other host."""

    def __init__(self) -> None:
        self.queries: list[VoteQuery] = []
        self.state = ActivationState()

    async def ask(self, host: str, query: VoteQuery) -> BallotState:
        self.queries.append(query)
        assert host == "bravo"
        vote: dict[str, Vote] = {"bravo": "no" if query.closes else "yes"}
        return BallotState(query.id, None, vote if query.closes or self.state.ballot else {}, {}, "open")


async def test_bound_host_asks_the_others_until_the_result_is_known() -> None:
    robot, bravo = Robot(), Bravo()
    await running(robot)
    await robot.propose()
    task = asyncio.create_task(robot.service.resolve(bravo.ask))
    await asyncio.sleep(3 * RESOLVE_EVERY)
    assert robot.service.activation.open_ballot is not None
    bravo.state = propose(bravo.state, "bravo", ballot(), "")
    await asyncio.sleep(2 * RESOLVE_EVERY)
    assert robot.service.activation.active == NEW
    assert not any(query.closes for query in bravo.queries)
    query_count = len(bravo.queries)
    await asyncio.sleep(CLOSE_AFTER)
    assert len(bravo.queries) == query_count
    task.cancel()


async def test_bound_host_closes_a_ballot_after_half_a_minute() -> None:
    robot, bravo = Robot(), Bravo()
    await running(robot)
    await robot.propose()
    task = asyncio.create_task(robot.service.resolve(bravo.ask))
    await asyncio.sleep(CLOSE_AFTER + 2 * RESOLVE_EVERY)
    assert bravo.queries[-1].closes
    assert robot.service.activation.open_ballot is None
    assert robot.service.activation.active == OLD
    assert not robot.probe.held
    assert "service-ballot-open" in robot.codes
    task.cancel()


async def test_open_ballot_is_logged_periodically() -> None:
    robot = await running()
    await robot.propose()
    task = asyncio.create_task(robot.service.resolve(unreachable))
    await asyncio.sleep(CLOSE_AFTER + 2 * REPORT_EVERY - 10.0)
    assert robot.codes.count("service-ballot-open") == 2
    await asyncio.sleep(REPORT_EVERY)
    assert robot.codes.count("service-ballot-open") == 3
    task.cancel()


async def test_restarted_service_still_asks_the_others() -> None:
    robot, bravo = Robot(), Bravo()
    await running(robot)
    await robot.propose()
    robot.kill_service()
    robot.boot_service()
    await robot.service.settle()
    assert robot.probe.held
    bravo.state = propose(bravo.state, "bravo", ballot(), "")
    task = asyncio.create_task(robot.service.resolve(bravo.ask))
    await asyncio.sleep(2 * RESOLVE_EVERY)
    assert robot.service.activation.active == NEW
    assert not robot.runner.is_running
    task.cancel()


# --- full disks ----------------------------------------------------------------------------------------


async def test_full_disk_before_the_vote_changes_nothing() -> None:
    robot = await running()
    before = robot.files.record
    robot.files.is_full = True
    with pytest.raises(OutputFileError):
        await robot.propose()
    assert robot.files.record == before
    assert robot.service.activation == before.activation
    assert not robot.probe.held
    assert (await robot.query(ballot().id)).votes == {}
    with pytest.raises(OutputFileError):
        await robot.query(ballot().id, closes=True)
    assert (await robot.query(ballot().id)).votes == {}
    # The error is shown until there is space again.
    for _ in range(2):
        assert "No space left on device" in (await robot.status()).refusal
    assert robot.codes.count("service-state-error") == 1
    robot.files.is_full = False
    assert (await robot.status()).refusal == ""
    assert (await robot.propose()).votes == {"alpha": "yes"}


async def test_disk_that_fills_during_the_hold_prevents_the_vote() -> None:
    robot = await running()

    def fill() -> None:
        robot.files.is_full = True

    robot.probe.on_hold = fill
    with pytest.raises(OutputFileError):
        await robot.propose()
    assert (await robot.query(ballot().id)).votes == {}
    assert not robot.probe.held
    task = asyncio.create_task(robot.service.resolve(unreachable))
    await asyncio.sleep(2 * RESOLVE_EVERY)
    robot.files.is_full = False
    await asyncio.sleep(2 * RESOLVE_EVERY)
    assert not robot.files.record.held
    assert not task.done()
    task.cancel()


async def test_full_disk_after_the_vote_delays_the_result() -> None:
    robot, bravo = Robot(), Bravo()
    await running(robot)
    await robot.propose()
    robot.files.is_full = True
    with pytest.raises(OutputFileError):
        await robot.service.answer(VoteReport(ballot().id, YES), "anna")
    assert robot.service.activation.open_ballot is not None
    assert robot.probe.held
    task = asyncio.create_task(robot.service.resolve(bravo.ask))
    bravo.state = propose(bravo.state, "bravo", ballot(), "")
    await asyncio.sleep(2 * RESOLVE_EVERY)
    assert robot.service.activation.open_ballot is not None
    robot.files.is_full = False
    await asyncio.sleep(2 * RESOLVE_EVERY)
    assert robot.service.activation.active == NEW
    assert not robot.runner.is_running
    task.cancel()


# --- kills ---------------------------------------------------------------------------------------------


async def push_and_start(robot: Robot, *, activates: bool) -> None:
    """A complete push, and the start of the active bundle."""
    await robot.start()
    await robot.propose()
    await robot.service.on_votes(ballot().id, {"bravo": "yes" if activates else "no"})
    await robot.command(MissionCommand("stop"))
    await robot.start()


async def saves_of(*, activates: bool) -> int:
    robot = Robot()
    robot.boot_service()
    await push_and_start(robot, activates=activates)
    return robot.files.saves


@pytest.mark.parametrize("activates", [True, False], ids=["activated", "aborted"])
def test_kill_before_or_after_each_save_leaves_a_consistent_state(activates: bool) -> None:
    async def killed_at(moment: float) -> None:
        robot = Robot()
        robot.boot_service()

        def kill(at: float) -> None:
            if at == moment:
                raise ServiceKilled

        robot.files.on_save = kill
        with pytest.raises(ServiceKilled):
            await push_and_start(robot, activates=activates)
        robot.files.on_save = lambda at: None
        robot.kill_service()
        voted = robot.files.record.activation.open_ballot is not None
        alive = dict(robot.processes.alive)
        robot.boot_service()
        # A running host is supervised again, for every moment of the kill.
        assert robot.runner.is_running is bool(alive)
        await robot.service.settle()
        assert bool(robot.probe.held) is (voted and bool(alive)), moment
        assert robot.files.record.held is voted or not alive
        await robot.propose()
        await robot.service.on_votes(ballot().id, {"bravo": "yes" if activates else "no"})
        assert robot.service.activation.open_ballot is None
        assert robot.service.activation.active == (NEW if activates else OLD)
        await robot.service.settle()
        assert set(robot.processes.alive.values()) <= {robot.service.activation.active}
        assert len(robot.processes.alive) <= 1
        await robot.start()
        await robot.service.settle()
        assert list(robot.processes.alive.values()) == [robot.service.activation.active]
        assert not robot.probe.held
        assert not robot.files.record.held

    async def scenario() -> None:
        saves = await saves_of(activates=activates)
        assert saves > 5
        for save in range(1, saves + 1):
            for after in (0.0, 0.5):
                await killed_at(save + after)

    run_jumping(scenario())


async def test_process_record_survives_reuse_of_the_process_id() -> None:
    robot = await running()
    assert not robot.processes.is_alive(ProcessId(101, 1))
    robot.kill_service()
    robot.files.record = ServiceRecord(ActivationState(active=OLD), run_of(OLD, 101))
    robot.processes.end(0)
    robot.boot_service()
    await asyncio.sleep(SOON)
    assert not robot.runner.is_running
