"""A host that is killed when its mission ends: its service learns of the end from those of other hosts."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable

import pytest
from service_fakes import OLD, WALKER, Robot, unreachable

from lfield import __version__, exit_status
from lfield.errors import AddressError
from lfield.service.mission_runner import LONGEST_PAUSE
from lfield.service.restart_policy import RESTART_DELAY
from lfield.service.service import RESOLVE_EVERY
from lfield.simulate.jumping_loop import run_jumping
from lfield.wire.service_messages import (
    BallotState,
    MissionCommand,
    RunInfo,
    ServiceQuery,
    ServiceStatus,
    VoteQuery,
)

ORDER, OTHER = b"o" * 16, b"n" * 16
KILLED = -9
#: In which the other hosts are asked for the first time after a restart.
SOON = RESTART_DELAY + 2 * RESOLVE_EVERY
DONE = RunInfo(OLD, "ended", "", 0.0, exit_status.DONE, ORDER)


class Bravo:
    """The service of the other host, which has run `run`."""

    def __init__(self, run: RunInfo) -> None:
        self.run, self.queries = run, 0

    async def ask(self, host: str, query: VoteQuery | ServiceQuery) -> BallotState | ServiceStatus:
        if host != "bravo":
            raise AddressError(host, "its own service is not asked")
        assert isinstance(query, ServiceQuery)
        self.queries += 1
        return ServiceStatus(host, __version__, OLD, b"", [], self.run, None, [], "", 0.0)


def tell(story: Callable[[Robot], Awaitable[None]], bravo: Bravo) -> None:
    """Run a story of a robot whose host was started by an order, and whose service asks bravo."""

    async def whole() -> None:
        robot = Robot()
        robot.boot_service()
        await robot.command(MissionCommand("start", order=ORDER))
        task = asyncio.create_task(robot.service.resolve(bravo.ask))
        await story(robot)
        task.cancel()

    run_jumping(whole())


@pytest.mark.parametrize("status", [exit_status.DONE, exit_status.FAILED])
def test_a_restarted_host_is_stopped_when_its_run_has_ended_on_another_host(status: int) -> None:
    async def story(robot: Robot) -> None:
        robot.processes.end(KILLED)
        robot.probe.waiting = [WALKER]
        await asyncio.sleep(SOON)
        assert robot.processes.started == [OLD, OLD]
        assert robot.processes.terminated == [102]
        assert robot.runner.info.phase == "stopped"
        assert "bravo" in robot.runner.info.reason
        assert "service-missed-end" in robot.codes
        # No coordinator of it forbids an activation, and nothing has to be checked.
        assert robot.files.record.run.open_run == b""
        assert (await robot.status()).refusal == ""

    tell(story, Bravo(RunInfo(OLD, "ended", "", 0.0, status, ORDER)))


@pytest.mark.parametrize(
    "run",
    [
        RunInfo(OLD, "ended", "", 0.0, exit_status.DONE, OTHER),
        RunInfo(OLD, "ended", "", 0.0, exit_status.DONE),
        RunInfo(OLD, "ended", "", 0.0, exit_status.UNKNOWN_OUTCOME, ORDER),
        RunInfo(OLD, "ended", "", 0.0, KILLED, ORDER),
        RunInfo(OLD, "running", "", 0.0, exit_status.DONE, ORDER),
        RunInfo(OLD, "stopped", "", 0.0, exit_status.DONE, ORDER),
    ],
    ids=["another run", "unknown run", "unknown outcome", "killed", "running", "stopped"],
)
def test_no_other_end_is_a_proof(run: RunInfo) -> None:
    bravo = Bravo(run)

    async def story(robot: Robot) -> None:
        robot.processes.end(KILLED)
        await asyncio.sleep(10 * SOON)
        assert bravo.queries
        assert robot.processes.terminated == []
        assert robot.runner.is_running

    tell(story, bravo)


def test_a_host_that_was_not_restarted_asks_nothing() -> None:
    bravo = Bravo(DONE)

    async def story(robot: Robot) -> None:
        await asyncio.sleep(10 * SOON)
        assert bravo.queries == 0
        assert robot.runner.is_running

    tell(story, bravo)


def test_a_host_is_not_stopped_before_it_is_up() -> None:
    """It would not have brought its devices to rest."""

    async def story(robot: Robot) -> None:
        robot.probe.is_starting = True
        robot.processes.end(KILLED)
        await asyncio.sleep(SOON)
        assert robot.processes.terminated == []
        robot.probe.is_starting = False
        await asyncio.sleep(SOON)
        assert robot.processes.terminated == [102]

    tell(story, Bravo(DONE))


def test_the_order_is_known_after_a_restart_of_the_service() -> None:
    async def story(robot: Robot) -> None:
        robot.kill_service()
        robot.boot_service()
        assert robot.runner.record.order == ORDER
        task = asyncio.create_task(robot.service.resolve(Bravo(DONE).ask))
        await asyncio.sleep(SOON)
        assert robot.processes.terminated == [101]
        task.cancel()

    tell(story, Bravo(RunInfo()))


def test_the_longer_a_mission_continues_the_less_often_others_are_asked() -> None:
    bravo = Bravo(RunInfo(OLD, "running", order=ORDER))

    async def story(robot: Robot) -> None:
        robot.processes.end(KILLED)
        await asyncio.sleep(600.0)
        at_first = bravo.queries
        assert 600.0 / LONGEST_PAUSE < at_first < 20
        await asyncio.sleep(600.0)
        assert bravo.queries - at_first <= 600.0 / LONGEST_PAUSE

    tell(story, bravo)


def test_a_new_order_begins_anew() -> None:
    bravo = Bravo(DONE)

    async def story(robot: Robot) -> None:
        robot.processes.end(KILLED)
        await asyncio.sleep(SOON)
        await robot.command(MissionCommand("start", order=OTHER))
        await asyncio.sleep(SOON)
        robot.processes.end(KILLED)
        await asyncio.sleep(SOON)
        # Its last run has ended, this one has not.
        assert robot.runner.is_running
        assert robot.runner.info.order == OTHER

    tell(story, bravo)


def test_without_an_answer_the_host_continues() -> None:
    async def story() -> None:
        robot = Robot()
        robot.boot_service()
        await robot.command(MissionCommand("start", order=ORDER))
        task = asyncio.create_task(robot.service.resolve(unreachable))
        robot.processes.end(KILLED)
        await asyncio.sleep(10 * SOON)
        assert robot.runner.is_running
        task.cancel()

    run_jumping(story())
