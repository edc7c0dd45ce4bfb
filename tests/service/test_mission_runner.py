"""The mission's host as a process: restarts after crashes, adoption by the next service, stops."""

from __future__ import annotations

import asyncio
import signal

import pytest
from service_fakes import NEW, OLD, FakeProcesses, run_of

from lfield import exit_status
from lfield.errors import OutputFileError
from lfield.service.bundle_store import RunRecord
from lfield.service.mission_runner import REBOOTED, MissionRunner
from lfield.service.restart_policy import MAX_RESTARTS, PERIOD, RESTART_DELAY, judge
from lfield.simulate.jumping_loop import LoopClock

#: Longer than the delay of a restart.
SOON = RESTART_DELAY + 1.0


class Computer:
    """A runner on fake processes, whose record is stored in memory."""

    runner: MissionRunner

    def __init__(self) -> None:
        self.processes, self.disk = FakeProcesses(), RunRecord()
        self.refusal, self.is_full = "", False
        self.boot()

    def boot(self) -> None:
        """Starts another service."""
        self.runner = MissionRunner(self.disk, self.processes, LoopClock(), lambda line: None)
        self.runner.attach(self._store, lambda bundle: self.refusal)

    def _store(self) -> None:
        if self.is_full:
            raise OutputFileError("state.json", "No space left on device")
        self.disk = self.runner.record


async def started_computer() -> Computer:
    computer = Computer()
    await computer.runner.start(OLD)
    return computer


@pytest.mark.parametrize("status", [exit_status.SOFTWARE, exit_status.UNAVAILABLE, -9, -11])
async def test_host_is_restarted_after_a_crash(status: int) -> None:
    computer = await started_computer()
    computer.processes.end(status)
    await asyncio.sleep(0.5 * RESTART_DELAY)
    assert computer.runner.info.phase == "waiting"
    await asyncio.sleep(RESTART_DELAY)
    assert computer.processes.started == [OLD, OLD]
    assert computer.runner.info.phase == "running"
    assert computer.disk == run_of(OLD, 102)


@pytest.mark.parametrize(
    "status",
    [
        exit_status.DONE,
        exit_status.FAILED,
        exit_status.UNSAFE,
        exit_status.UNKNOWN_OUTCOME,
        exit_status.USAGE,
        exit_status.DATA,
        exit_status.NO_INPUT,
        exit_status.NO_OUTPUT,
        exit_status.PROTOCOL,
        exit_status.INTERRUPTED,
    ],
)
async def test_regular_end_is_not_restarted(status: int) -> None:
    computer = await started_computer()
    computer.processes.end(status, "why")
    await asyncio.sleep(SOON)
    assert computer.processes.started == [OLD]
    info = computer.runner.info
    assert (info.phase, info.status, info.reason) == ("ended", status, "why")
    assert computer.disk.bundle == b""
    assert bool(computer.disk.unsafe) is (status == exit_status.UNSAFE)


async def test_host_is_restarted_at_most_five_times_in_ten_minutes() -> None:
    computer = await started_computer()
    for _ in range(MAX_RESTARTS + 1):
        computer.processes.end(-11)
        await asyncio.sleep(SOON)
    assert len(computer.processes.started) == MAX_RESTARTS + 1
    assert computer.runner.info.phase == "ended"
    assert computer.disk.unsafe
    # A start by a person resets the count, and its vehicles are observed again.
    await computer.runner.start(OLD)
    assert not computer.disk.unsafe
    computer.processes.end(-11)
    await asyncio.sleep(SOON)
    assert computer.runner.info.phase == "running"


async def test_rare_crashes_are_always_followed_by_a_restart() -> None:
    computer = await started_computer()
    for _ in range(3 * MAX_RESTARTS):
        await asyncio.sleep(PERIOD / MAX_RESTARTS)
        computer.processes.end(-11)
        await asyncio.sleep(SOON)
    assert computer.runner.info.phase == "running"


@pytest.mark.parametrize(
    ("status", "earlier", "restarts"),
    [
        (exit_status.SOFTWARE, [], True),
        (exit_status.UNAVAILABLE, [], True),
        (-9, [], True),
        (-9, [100.0 - PERIOD] * MAX_RESTARTS, True),
        (-9, [100.1 - PERIOD] * MAX_RESTARTS, False),
        (-9, [100.1 - PERIOD] * (MAX_RESTARTS - 1), True),
        (exit_status.DONE, [], False),
        (exit_status.UNSAFE, [], False),
        (exit_status.DATA, [], False),
        (exit_status.INTERRUPTED, [], False),
        (77, [], False),
    ],
)
def test_restart_policy_by_status_and_earlier_restarts(
    status: int, earlier: list[float], restarts: bool
) -> None:
    verdict = judge(status, "", earlier, 100.0)
    assert verdict.restarts is restarts
    assert verdict.reason


async def test_next_service_adopts_a_running_host() -> None:
    computer = await started_computer()
    computer.runner.detach()
    computer.boot()
    computer.runner.adopt()
    assert computer.runner.is_running
    assert computer.processes.started == [OLD]
    computer.processes.end(-11)
    await asyncio.sleep(SOON)
    assert computer.processes.started == [OLD, OLD]


@pytest.mark.parametrize(("status", "starts"), [(-9, 2), (exit_status.DONE, 1), (exit_status.UNSAFE, 1)])
async def test_host_that_ended_without_a_service_is_judged_by_its_result(status: int, starts: int) -> None:
    computer = await started_computer()
    computer.runner.detach()
    computer.processes.end(status)
    computer.boot()
    computer.runner.adopt()
    assert not computer.runner.is_running
    assert computer.runner.info.phase == "waiting"
    await asyncio.sleep(SOON)
    assert len(computer.processes.started) == starts


async def test_host_without_a_stored_process_id_is_found() -> None:
    """The service ended, or its disk was full, between the start of the process and the record of it."""
    computer = await started_computer()
    computer.runner.detach()
    computer.disk = run_of(OLD)
    computer.boot()
    computer.runner.adopt()
    assert computer.runner.is_running
    assert computer.disk == run_of(OLD, 101)
    computer.runner.detach()
    computer.processes.end(0)
    computer.disk = run_of(OLD)
    computer.boot()
    computer.runner.adopt()
    assert computer.runner.info.phase == "interrupted"
    assert computer.disk == RunRecord(open_run=OLD)


@pytest.mark.parametrize(
    "record",
    [RunRecord(), run_of(NEW, 55), run_of(NEW, 55, "an earlier boot")],
    ids=["deleted", "of a backup", "of an earlier boot"],
)
async def test_unrecorded_host_is_adopted_and_no_second_one_starts(record: RunRecord) -> None:
    computer = await started_computer()
    computer.runner.detach()
    computer.disk = record
    computer.boot()
    computer.runner.adopt()
    await asyncio.sleep(SOON)
    assert computer.disk == run_of(OLD, 101)
    assert (computer.runner.info.phase, computer.runner.info.bundle) == ("running", OLD)
    await computer.runner.stop("stopped by anna")
    assert computer.processes.started == [OLD]
    assert not computer.processes.alive
    assert computer.disk == RunRecord(open_run=OLD)


async def test_reboot_interrupts_the_mission() -> None:
    computer = await started_computer()
    computer.runner.detach()
    computer.processes.boot = "second boot"
    # Another process now has the same id.
    computer.processes.alive[101] = b""
    computer.boot()
    computer.runner.adopt()
    await asyncio.sleep(SOON)
    assert computer.runner.info.phase == "interrupted"
    assert not computer.runner.is_running
    assert computer.processes.started == [OLD]
    # A vehicle may have been in the air: a person must check.
    assert computer.disk == RunRecord(unsafe=REBOOTED, open_run=OLD)


async def test_stop_ends_the_host_and_is_stored() -> None:
    computer = await started_computer()
    await computer.runner.start(OLD)
    assert computer.processes.started == [OLD]
    await computer.runner.stop("stopped by anna")
    assert computer.processes.terminated == [101]
    info = computer.runner.info
    assert (info.phase, info.reason) == ("stopped", "stopped by anna")
    assert computer.disk == RunRecord(open_run=OLD)
    await asyncio.sleep(SOON)
    assert computer.processes.started == [OLD]
    await computer.runner.start(NEW)
    assert computer.processes.started == [OLD, NEW]


@pytest.mark.parametrize("status", [-11, exit_status.UNAVAILABLE])
async def test_stop_cancels_a_pending_restart(status: int) -> None:
    computer = await started_computer()
    computer.processes.end(status)
    await asyncio.sleep(0.5 * RESTART_DELAY)
    await computer.runner.stop("stopped by anna")
    await asyncio.sleep(SOON)
    assert computer.processes.started == [OLD]
    assert computer.runner.info.phase == "stopped"
    assert computer.disk.bundle == b""
    # A vehicle that it flew when it was killed may still fly.
    assert bool(computer.disk.unsafe) is (status < 0)


async def test_checked_stop_clears_the_unsafe_state() -> None:
    computer = await started_computer()
    computer.processes.end(exit_status.UNSAFE)
    await asyncio.sleep(SOON)
    computer.boot()
    computer.runner.adopt()
    assert computer.runner.info.phase == "ended"
    await computer.runner.stop("stopped by anna", checked=computer.disk.unsafe)
    assert computer.disk == RunRecord(open_run=OLD)


async def test_host_killed_during_a_stop_is_recorded_as_unsafe() -> None:
    computer = Computer()
    computer.processes.obeys = False
    await computer.runner.start(OLD)
    stopping = asyncio.create_task(computer.runner.stop("stopped by anna"))
    await asyncio.sleep(1.0)
    assert computer.runner.info.phase == "stopping"
    computer.processes.end(-9)
    await stopping
    assert (computer.disk.bundle, bool(computer.disk.unsafe)) == (b"", True)


async def test_host_stopped_before_opening_devices_is_safe() -> None:
    """A host handles SIGTERM early: the signal ends only a host that has just been started."""
    computer = Computer()
    computer.processes.obeys = False
    for before, after in ((0, ""), (-9, "killed by signal 9")):
        await computer.runner.start(OLD)
        if before:
            computer.processes.end(before)
            await asyncio.sleep(SOON)
        stopping = asyncio.create_task(computer.runner.stop("stopped by anna"))
        await asyncio.sleep(1.0)
        computer.processes.end(-signal.SIGTERM)
        await stopping
        # A vehicle that an earlier host flew may still fly.
        assert computer.disk.unsafe == after


async def test_refusal_ends_restarts() -> None:
    computer = await started_computer()
    computer.refusal = "a ballot is open"
    computer.processes.end(-11)
    await asyncio.sleep(SOON)
    assert computer.processes.started == [OLD]
    computer.refusal = ""
    await computer.runner.start(OLD)
    computer.processes.end(-11)
    await asyncio.sleep(0.5 * RESTART_DELAY)
    # Also a refusal during the delay of the restart.
    computer.refusal = "a ballot is open"
    await asyncio.sleep(SOON)
    assert computer.processes.started == [OLD, OLD]
    assert computer.runner.info.phase == "interrupted"
    # The end of the process, the refusal, and the remedy.
    reason = computer.runner.info.reason
    assert "a ballot is open" in reason
    assert "lfield start" in reason


async def test_host_does_not_start_before_its_record_is_stored() -> None:
    computer = Computer()
    computer.is_full = True
    with pytest.raises(OutputFileError):
        await computer.runner.start(OLD)
    assert computer.processes.started == []
    assert computer.runner.record == RunRecord()


async def test_full_disk_interrupts_restarts_and_the_service_continues() -> None:
    computer = await started_computer()
    computer.is_full = True
    computer.processes.end(-11)
    await asyncio.sleep(SOON)
    assert computer.processes.started == [OLD]
    assert computer.runner.info.phase == "interrupted"
    computer.is_full = False
    await computer.runner.start(OLD)
    assert computer.runner.info.phase == "running"


async def test_stop_with_a_full_disk_ends_the_host() -> None:
    computer = await started_computer()
    computer.is_full = True
    await computer.runner.stop("stopped by anna")
    assert computer.runner.info.phase == "stopped"
    assert not computer.processes.alive
    # The next service finds that its process ended regularly.
    computer.is_full = False
    computer.boot()
    computer.runner.adopt()
    await asyncio.sleep(SOON)
    assert computer.processes.started == [OLD]


async def test_process_that_cannot_be_started_is_not_recorded() -> None:
    computer = Computer()
    computer.processes.trouble = OutputFileError("host.result", "Permission denied")
    with pytest.raises(OutputFileError):
        await computer.runner.start(OLD)
    assert computer.disk == RunRecord()
    assert not computer.runner.is_running
