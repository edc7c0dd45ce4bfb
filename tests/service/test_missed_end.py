"""A host killed at the end of its mission: its service learns of the end from services of other hosts."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable

import pytest
from coroutine_tests import scenario
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
#: Time until the other hosts are first asked after a restart.
SOON = RESTART_DELAY + 2 * RESOLVE_EVERY
DONE = RunInfo(OLD, "ended", "", 0.0, exit_status.DONE, ORDER)


class Bravo:
    """The service of the other host, which has run `run`."""

    def __init__(self, run: RunInfo) -> None:
        self.run, self.queries = run, 0

    async def ask(self, host: str, query: VoteQuery | ServiceQuery) -> BallotState | ServiceStatus:
        if host != "bravo":
            raise AddressError(host, "a service does not ask itself")
        assert isinstance(query, ServiceQuery)
        self.queries += 1
        return ServiceStatus(host, __version__, OLD, b"", [], self.run, None, [], "", 0.0)


def run_with(steps: Callable[[Robot], Awaitable[None]], bravo: Bravo) -> None:
    """Runs `steps` with a robot whose host was started by an order, and whose service asks bravo."""

    async def whole() -> None:
        robot = Robot()
        robot.boot_service()
        await robot.command(MissionCommand("start", order=ORDER))
        task = asyncio.create_task(robot.service.resolve(bravo.ask))
        await steps(robot)
        task.cancel()

    run_jumping(whole())


@pytest.mark.parametrize("status", [exit_status.DONE, exit_status.FAILED])
def test_restarted_host_stops_when_its_run_ended_on_another_host(status: int) -> None:
    async def steps(robot: Robot) -> None:
        robot.processes.end(KILLED)
        robot.probe.waiting = [WALKER]
        await asyncio.sleep(SOON)
        assert robot.processes.started == [OLD, OLD]
        assert robot.processes.terminated == [102]
        assert robot.runner.info.phase == "stopped"
        assert "bravo" in robot.runner.info.reason
        assert "service-missed-end" in robot.codes
        # No coordinator prevents an activation, and no check by a person is required.
        assert robot.files.record.run.open_run == b""
        assert (await robot.status()).refusal == ""

    run_with(steps, Bravo(RunInfo(OLD, "ended", "", 0.0, status, ORDER)))


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
def test_other_run_states_do_not_stop_the_host(run: RunInfo) -> None:
    bravo = Bravo(run)

    async def steps(robot: Robot) -> None:
        robot.processes.end(KILLED)
        await asyncio.sleep(10 * SOON)
        assert bravo.queries
        assert robot.processes.terminated == []
        assert robot.runner.is_running

    run_with(steps, bravo)


def test_host_without_a_restart_asks_no_other_service() -> None:
    bravo = Bravo(DONE)

    async def steps(robot: Robot) -> None:
        await asyncio.sleep(10 * SOON)
        assert bravo.queries == 0
        assert robot.runner.is_running

    run_with(steps, bravo)


@scenario(run_with, Bravo(DONE))
async def test_host_is_not_stopped_before_it_is_up(robot: Robot, /) -> None:
    """A host that is not up would not bring its devices to rest."""
    robot.probe.is_starting = True
    robot.processes.end(KILLED)
    await asyncio.sleep(SOON)
    assert robot.processes.terminated == []
    robot.probe.is_starting = False
    await asyncio.sleep(SOON)
    assert robot.processes.terminated == [102]


@scenario(run_with, Bravo(RunInfo()))
async def test_order_is_known_after_a_service_restart(robot: Robot, /) -> None:
    robot.kill_service()
    robot.boot_service()
    assert robot.runner.record.order == ORDER
    task = asyncio.create_task(robot.service.resolve(Bravo(DONE).ask))
    await asyncio.sleep(SOON)
    assert robot.processes.terminated == [101]
    task.cancel()


def test_queries_to_other_services_become_less_frequent() -> None:
    bravo = Bravo(RunInfo(OLD, "running", order=ORDER))

    async def steps(robot: Robot) -> None:
        robot.processes.end(KILLED)
        await asyncio.sleep(600.0)
        at_first = bravo.queries
        assert 600.0 / LONGEST_PAUSE < at_first < 20
        await asyncio.sleep(600.0)
        assert bravo.queries - at_first <= 600.0 / LONGEST_PAUSE

    run_with(steps, bravo)


def test_new_order_is_not_ended_by_an_earlier_run() -> None:
    bravo = Bravo(DONE)

    async def steps(robot: Robot) -> None:
        robot.processes.end(KILLED)
        await asyncio.sleep(SOON)
        await robot.command(MissionCommand("start", order=OTHER))
        await asyncio.sleep(SOON)
        robot.processes.end(KILLED)
        await asyncio.sleep(SOON)
        # The previous run has ended, the current one has not.
        assert robot.runner.is_running
        assert robot.runner.info.order == OTHER

    run_with(steps, bravo)


def test_host_continues_without_an_answer() -> None:
    async def steps() -> None:
        robot = Robot()
        robot.boot_service()
        await robot.command(MissionCommand("start", order=ORDER))
        task = asyncio.create_task(robot.service.resolve(unreachable))
        robot.processes.end(KILLED)
        await asyncio.sleep(10 * SOON)
        assert robot.runner.is_running
        task.cancel()

    run_jumping(steps())
