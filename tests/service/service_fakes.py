"""A service with disk, processes and mission in memory."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Collection
from dataclasses import dataclass, field
from hashlib import sha256

from lfield.errors import AddressError, BundleError, OutputFileError
from lfield.service.ballots import ActivationState
from lfield.service.bundle_store import RunRecord, ServiceRecord
from lfield.service.mission_runner import HostEnd, HostProcess, MissionRunner, ProcessId
from lfield.service.restart_policy import RESTART_DELAY
from lfield.service.service import Service
from lfield.simulate.jumping_loop import LoopClock
from lfield.text.log_messages import LogLine
from lfield.wire.bundle_pieces import Piece, piece_of
from lfield.wire.service_messages import (
    Ballot,
    BallotState,
    BundleInfo,
    CommandResult,
    MissionCommand,
    Proposal,
    ServiceQuery,
    ServiceStatus,
    UnfinishedCoordinator,
    Vote,
    VoteQuery,
)

HOSTS = ["alpha", "bravo"]
#: The coordinators of the mission, and where they start.
HOMES = {"walker": "alpha", "pilot": "bravo"}
OLD, NEW = (sha256(name).digest() for name in (b"old", b"new"))
SOON = RESTART_DELAY + 1.0
YES: dict[str, Vote] = dict.fromkeys(HOSTS, "yes")
WALKER = UnfinishedCoordinator("walker", "parked", "bravo", "patrol")


class ServiceKilled(BaseException):
    """The service ends here, as after SIGKILL."""


def ballot(number: int = 1, digest: bytes = NEW, hosts: list[str] = HOSTS) -> Ballot:
    return Ballot(number.to_bytes(16), digest, hosts, "anna")


class FakeProcesses:
    """See `HostProcesses`. The processes of one computer, which survive a service."""

    def __init__(self) -> None:
        self.boot = "first boot"
        self.started: list[bytes] = []
        #: The bundle of each process, b"" for a process other than a host.
        self.alive: dict[int, bytes] = {}
        self.ends: dict[int, asyncio.Future[HostEnd]] = {}
        self.on_change: Callable[[], None] = lambda: None
        #: Raised by the next starts.
        self.trouble: Exception | None = None
        self.terminated: list[int] = []
        #: Whether a process ends after a termination request.
        self.obeys = True

    def start(self, bundle: bytes) -> ProcessId:
        if self.trouble is not None:
            raise self.trouble
        self.on_change()
        self.started.append(bundle)
        pid = 100 + len(self.started)
        self.alive[pid] = bundle
        self.ends[pid] = asyncio.get_running_loop().create_future()
        return ProcessId(pid, 7 * pid)

    def find(self) -> HostProcess | None:
        hosts = [(pid, bundle) for pid, bundle in self.alive.items() if bundle]
        return next((HostProcess(bundle, ProcessId(pid, 7 * pid)) for pid, bundle in hosts), None)

    def is_alive(self, process: ProcessId) -> bool:
        return process.pid in self.alive and process.started == 7 * process.pid

    async def ended(self, process: ProcessId) -> HostEnd:
        return await asyncio.shield(self.ends[process.pid])

    def terminate(self, process: ProcessId) -> None:
        self.terminated.append(process.pid)
        if process.pid in self.alive and self.obeys:
            self.end(0, "", process.pid)

    def end(self, status: int, reason: str = "", pid: int = 0) -> None:
        """Ends a process, by default the only one."""
        pid = pid or next(iter(self.alive))
        del self.alive[pid]
        self.on_change()
        self.ends[pid].set_result(HostEnd(status, reason))


class FakeFiles:
    """See `ServiceFiles`. `on_save` is called before each save with its number, after it with 0.5 more."""

    def __init__(self) -> None:
        self.record = ServiceRecord()
        self.bundles: dict[bytes, bytes] = {}
        self.pieces: dict[int, bytes] = {}
        self.saves = 0
        self.is_full = False
        self.on_save: Callable[[float], None] = lambda at: None

    def save(self, record: ServiceRecord) -> None:
        if self.is_full:
            raise OutputFileError("state.json", "No space left on device")
        self.saves += 1
        self.on_save(self.saves)
        self.record = record
        self.on_save(self.saves + 0.5)

    def stored(self) -> list[bytes]:
        return list(self.bundles)

    def read(self, digest: bytes) -> bytes | None:
        return self.bundles.get(digest)

    def add(self, digest: bytes, data: bytes, kept: list[bytes]) -> None:
        self.bundles[digest] = data

    def start_upload(self, file: bytes, under_way: Collection[bytes]) -> None:
        self.pieces = {}

    def missing(self, file: bytes, first: int, pieces: list[Piece]) -> list[int]:
        return [
            first + n
            for n, piece in enumerate(pieces)
            if first + n not in self.pieces or piece_of(self.pieces[first + n]) != piece
        ]

    def put(self, file: bytes, number: int, data: bytes) -> None:
        self.pieces[number] = data

    def joined(self, file: bytes) -> bytes:
        return b"".join(data for _, data in sorted(self.pieces.items()))

    def drop(self, file: bytes) -> None:
        self.pieces.clear()


@dataclass
class FakeProbe:
    """See `MissionProbe`: the state of the mission on this computer."""

    motion: str = ""
    waiting: list[UnfinishedCoordinator] = field(default_factory=list)
    #: Whether a person has paused the host; the ballot that holds it, b"" for none.
    paused: bool = False
    held: bytes = b""
    hold_trouble: str = ""
    release_trouble: str = ""
    without: list[str] = field(default_factory=list)
    is_starting: bool = False
    #: Seconds for an answer about the vehicles.
    delay: float = 0.1
    #: Called when a hold has been requested, before it is answered.
    on_hold: Callable[[], None] = lambda: None

    def on_process(self) -> None:
        """The process has ended, or another one was started, which is not held."""
        self.held = b""

    async def vehicles(self) -> str:
        await asyncio.sleep(self.delay)
        return self.motion

    async def unfinished(self) -> list[UnfinishedCoordinator]:
        await asyncio.sleep(0.1)
        return self.waiting

    async def hold(self, ballot: bytes) -> str:
        await asyncio.sleep(0.1)
        self.held = b"" if self.hold_trouble else ballot
        self.on_hold()
        return self.hold_trouble

    async def release(self) -> str:
        await asyncio.sleep(0.1)
        self.held = self.held if self.release_trouble else b""
        return self.release_trouble

    async def is_up(self) -> bool:
        return not self.is_starting

    async def condition(self) -> str:
        return "paused" if self.paused else ""

    async def start_without(self, hosts: list[str]) -> str:
        self.without = hosts
        return ""

    async def discard(self, mission: str = "", reason: str = "") -> list[str]:
        names, self.waiting = [each.agent for each in self.waiting], []
        return names


class Robot:
    """One computer with its disk, processes and mission; `boot_service` starts its service (again)."""

    service: Service
    runner: MissionRunner

    def __init__(self, active: bytes = OLD, host: str = "alpha") -> None:
        self.host = host
        self.files, self.processes, self.probe = FakeFiles(), FakeProcesses(), FakeProbe()
        self.processes.on_change = self.probe.on_process
        self.files.bundles = {OLD: b"old", NEW: b"new"}
        self.files.record = ServiceRecord(ActivationState(active=active))
        self.log: list[LogLine] = []
        #: How often a bundle was verified.
        self.verifications = 0

    def boot_service(self) -> Service:
        clock = LoopClock()
        record = self.files.record
        self.runner = MissionRunner(record.run, self.processes, clock, self.log.append)
        self.service = Service(self.host, record, self.files, self.runner, self.probe, self._verify, clock)
        self.service.adopt()
        return self.service

    def _verify(self, data: bytes) -> BundleInfo:
        self.verifications += 1
        if data not in (b"old", b"new"):
            raise BundleError("it is no bundle")
        return BundleInfo(sha256(data).digest(), data.decode(), hosts=HOSTS, coordinators=HOMES)

    def kill_service(self) -> None:
        """Kill the service; only the state on disk remains."""
        self.runner.detach()

    # --- messages of desks and other services ----------------------------------------------------------

    async def propose(self, proposal: Ballot | None = None) -> BallotState:
        answer = await self.service.answer(Proposal(proposal or ballot()), "anna")
        assert isinstance(answer, BallotState)
        return answer

    async def query(self, id: bytes, *, closes: bool = False) -> BallotState:
        answer = await self.service.answer(VoteQuery(id, closes), "bravo")
        assert isinstance(answer, BallotState)
        return answer

    async def command(self, command: MissionCommand) -> CommandResult:
        answer = await self.service.answer(command, "anna")
        assert isinstance(answer, CommandResult)
        return answer

    async def status(self) -> ServiceStatus:
        answer = await self.service.answer(ServiceQuery(), "anna")
        assert isinstance(answer, ServiceStatus)
        return answer

    async def start(self) -> CommandResult:
        return await self.command(MissionCommand("start"))

    @property
    def codes(self) -> list[str]:
        """The codes of the log lines."""
        return [line.code for line in self.log]


async def unreachable(host: str, query: VoteQuery | ServiceQuery) -> BallotState:
    raise AddressError(host, "no answer")


def run_of(bundle: bytes, pid: int = 0, boot: str = "first boot") -> RunRecord:
    return RunRecord(bundle, boot, pid, 7 * pid, open_run=bundle)


async def running(robot: Robot | None = None) -> Robot:
    """A robot whose service and mission have been started."""
    robot = robot or Robot()
    robot.boot_service()
    await robot.start()
    assert robot.runner.is_running
    return robot
