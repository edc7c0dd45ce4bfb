"""Observes the mission's host of this computer, through its control socket, and its journals."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing
from pathlib import Path

from lfield.clock import Clock
from lfield.errors import LfieldError, NoListener
from lfield.journal.file_journal import FileJournal
from lfield.journal.journal import FILE_NAME, journal_file
from lfield.journal.journal_loader import JournalOwner
from lfield.journal.journal_lock import machine_id
from lfield.journal.readonly_view import open_read_only
from lfield.journal.records import CoordinatorRecord, Record
from lfield.mission.mission import ON_GROUND
from lfield.net.tcp_transport import TcpTransport
from lfield.operator.client import SNAPSHOT
from lfield.operator.journal_reset import plan_discard
from lfield.operator.observer_link import Request, T, ask_with_retries
from lfield.operator.runs import runs_here
from lfield.operator.team_model.host_model import host_states
from lfield.operator.team_model.team_state import DeviceState, HostState
from lfield.service.service_interfaces import DISCARDED
from lfield.text.suggestions import listed
from lfield.wire.observer_messages import BallotHold, EmergencyStopResult, StartRequest, StartResponse
from lfield.wire.service_messages import UnfinishedCoordinator

#: The oldest telemetry (s) that proves that a vehicle is on the ground, and the largest speed (m/s) of one at
#: rest: speeds of satellite receivers are not exact.
MAX_AGE, REST_SPEED = 5.0, 0.5
#: The number of requests to a host that was just started to start coordinators, and the seconds between two.
START_ATTEMPTS, START_DELAY = 10, 1.0
#: The reasons why a host does not run its mission yet.
STARTING = "it starts: its devices are not open yet"
_STATES: Mapping[str, str] = {
    "RUN": "suspended",
    "PREPARED": "in doubt",
    "IN DOUBT": "in doubt",
    "FROZEN": "leaving",
    "MOVED": "moved",
    "PARKED": "parked",
}


class LocalProbe:
    """See `service.MissionProbe`. `state` is the directory of the journals.

    `vehicles_of` returns the names of this host's vehicles in the bundle of the running host, and `pid` its
    process, 0 without one.
    """

    def __init__(
        self,
        host: str,
        state: Path,
        pid: Callable[[], int],
        vehicles_of: Callable[[], list[str]],
        clock: Clock,
    ) -> None:
        self._host, self._state, self._pid, self._vehicles_of = host, state, pid, vehicles_of
        self._clock = clock

    async def vehicles(self) -> str:
        """See `MissionProbe`."""
        try:
            status = await self._snapshot()
        except LfieldError as error:
            return _no_answer(error)
        devices = status.devices
        try:
            vehicles = self._vehicles_of()
        except LfieldError as error:
            return f"the vehicles of the mission's host are unknown: {error}; 'lfield stop' ends it"
        problems = [_motion(name, devices.get(name)) for name in vehicles]
        problems += [
            f"{name} moves" for name, device in devices.items() if device.telemetry.get("moving") is True
        ]
        return "; ".join(problem for problem in problems if problem)

    async def hold(self, ballot: bytes) -> str:
        """See `MissionProbe`."""
        try:
            answer = await self._ask(_hold(ballot))
        except LfieldError as error:
            return f"it cannot be held: {_no_answer(error)}"
        return "; ".join(f"{name}: {problem}" for name, problem in answer.devices.items() if problem)

    async def release(self) -> str:
        """See `MissionProbe`."""
        try:
            # By its id: an end that arrives late ends no later hold.
            if ballot := (await self._snapshot()).report.ballot:
                await self._ask(_hold(ballot, lift=True))
        except LfieldError as error:
            return f"it cannot be released: {_no_answer(error)}"
        return ""

    async def unfinished(self) -> list[UnfinishedCoordinator]:
        """See `MissionProbe`."""
        coordinators = await asyncio.to_thread(lambda: list(self._in_journals()))
        if not self._pid():
            return coordinators
        try:
            status = await self._snapshot()
        except LfieldError:
            return coordinators
        running = {coordinator.agent: coordinator for coordinator in _in_snapshot(status)}
        return [
            *running.values(),
            *(coordinator for coordinator in coordinators if coordinator.agent not in running),
        ]

    async def is_up(self) -> bool:
        """See `MissionProbe`."""
        try:
            return not (await self._snapshot()).report.starting
        except LfieldError:
            return False

    async def condition(self) -> str:
        """The reason why the running host waits or is paused; '' if it does not."""
        if not self._pid():
            return ""
        try:
            status = await self._snapshot()
        except LfieldError as error:
            return _no_answer(error)
        if status.report.starting:
            return STARTING
        if status.stopped:
            return f"emergency stop ({status.stopped}): 'lfield estop --lift' ends it"
        pauses = (
            ["held until the result of a vote about an activation is known"] if status.held_by_vote else []
        )
        pauses += ["paused: 'lfield resume' continues it"] if status.paused else []
        start = status.report.start
        if pauses or start is None:
            return "; ".join(pauses)
        return start.held or f"{listed(start.agents)} waits for {listed(start.hosts or ['other hosts'])}"

    async def start_without(self, hosts: list[str]) -> str:
        """See `MissionProbe`."""
        request = Request(StartRequest(hosts), StartResponse, 8.0, is_retried=True)
        for _ in range(START_ATTEMPTS):
            try:
                answer = await self._ask(request)
            except LfieldError as error:
                problem = _no_answer(error)
            else:
                problem = answer.trouble
                if answer.waiting is not None:
                    problem = answer.waiting.held or f"waiting for {listed(answer.waiting.hosts)}"
                if not problem:
                    return ""
            await asyncio.sleep(START_DELAY)
        return problem

    async def discard(self, mission: str = "", reason: str = DISCARDED) -> list[str]:
        """See `MissionProbe`. Raises JournalError."""
        ended: list[str] = []
        for found, path in self._journals():
            if mission not in ("", found):
                continue
            owner = JournalOwner(found, self._host, machine_id())
            with closing(FileJournal(path, owner, lambda text: None, self._clock)) as journal:
                plan = plan_discard(self._host, journal.records(), reason)
                await journal.persist(plan.records)
            ended += [record.agent for record in plan.discarded]
        return list(dict.fromkeys(ended))

    # --- the running host -----------------------------------------------------------------------------

    async def _snapshot(self) -> HostState:
        """The state of the running host. Raises LfieldError."""
        batch = await self._ask(SNAPSHOT)
        return host_states({self._host: batch})[self._host]

    async def _ask(self, request: Request[T]) -> T:
        """The answer of the running host. Raises LfieldError."""
        address = await asyncio.to_thread(self._control_socket)
        return await ask_with_retries(TcpTransport(1 << 20), address, request, self._host, None)

    def _control_socket(self) -> str:
        pid = self._pid()
        for run in runs_here():
            if run.manifest.pid == pid and (socket := run.control_socket(self._host)):
                return socket
        raise NoListener(self._host)

    # --- journals -------------------------------------------------------------------------------------

    def _journals(self) -> Iterator[tuple[str, Path]]:
        """The names of missions with a journal of this host, and its file."""
        from urllib.parse import unquote

        for file in sorted(self._state.glob(f"*/{FILE_NAME}")):
            mission = unquote(file.parent.name.rpartition("@")[0])
            if file == journal_file(self._state, mission, self._host):
                yield mission, file

    def _in_journals(self) -> Iterator[UnfinishedCoordinator]:
        for mission, path in self._journals():
            try:
                records = [record for _, record in open_read_only(path).records]
            except LfieldError as error:
                yield UnfinishedCoordinator("?", f"unknown: {error}"[:256], "", mission[:256])
                continue
            yield from _unfinished(records, mission)


def _no_answer(error: LfieldError) -> str:
    """The reason why a host whose process exists does not answer."""
    if isinstance(error, NoListener):
        return "the mission's host accepts no connection now: it starts or ends"
    return f"the mission's host does not answer: {error}"


def _hold(ballot: bytes, *, lift: bool = False) -> Request[EmergencyStopResult]:
    """Holds the mission's host for a ballot, or with `lift` ends the hold."""
    return Request(BallotHold(ballot, lift), EmergencyStopResult, 8.0, is_retried=True)


def _unfinished(records: list[Record], mission: str) -> Iterator[UnfinishedCoordinator]:
    """The newest start of each coordinator that has not ended."""
    newest: dict[str, CoordinatorRecord] = {}
    for record in records:
        if isinstance(record, CoordinatorRecord) and (
            record.agent not in newest or record.generation > newest[record.agent].generation
        ):
            newest[record.agent] = record
    for record in newest.values():
        if record.state in _STATES:
            state = "in doubt" if record.doubt else _STATES[record.state]
            yield UnfinishedCoordinator(record.agent, state, record.target, mission[:256])


def _in_snapshot(host: HostState) -> Iterator[UnfinishedCoordinator]:
    report = host.report
    newest = {
        known.agent: known
        for known in sorted(report.coordinators, key=lambda coordinator: coordinator.generation)
    }
    for known in newest.values():
        if known.state == "RUN":
            yield UnfinishedCoordinator(known.agent, "running", host.host, "")
        elif known.state in _STATES:
            yield UnfinishedCoordinator(known.agent, _STATES[known.state], known.where, "")
    waiting = report.start.agents if report.start is not None else []
    for agent in waiting:
        if agent not in newest:
            yield UnfinishedCoordinator(agent, "waiting to start", host.host, "")
    for parked in report.journal.parked if report.journal is not None else []:
        yield UnfinishedCoordinator(parked.agent, "parked", parked.where, "")


def _motion(name: str, device: DeviceState | None) -> str:
    """The reason why a vehicle is not known to be at rest on the ground; '' if it is."""
    if device is None or device.telemetry_age is None or device.telemetry_age > MAX_AGE:
        return f"{name} does not report whether it is on the ground"
    match device.telemetry.get(ON_GROUND):
        case True:
            speed = device.telemetry.get("groundSpeed")
            moves = isinstance(speed, int | float) and speed > REST_SPEED
            return f"{name} moves at {speed:.1f} m/s" if moves else ""
        case False:
            return f"{name} is off the ground"
    return f"{name} has not reported whether it is on the ground"
