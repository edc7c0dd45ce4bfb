"""Runs the mission's host for the service: starts it, restarts it after a crash, adopts and stops it.

The host is a process of its own session, so it continues when its service ends. The next service adopts it.
"""

from __future__ import annotations

import asyncio
import signal
from collections.abc import Callable, Collection
from contextlib import suppress
from typing import NamedTuple, Protocol

from msgspec.structs import replace

from lfield import exit_status
from lfield.clock import Clock
from lfield.errors import LfieldError, OutputFileError
from lfield.event_loop import spawn
from lfield.service import messages
from lfield.service.bundle_store import RunRecord
from lfield.service.restart_policy import RESTART_DELAY, judge
from lfield.service.service_interfaces import AskPeer, MissionProbe, ask_peers
from lfield.text.log_messages import LogLine
from lfield.wire.fields import short_digest, truncate
from lfield.wire.service_messages import COMPLETED, RunInfo, RunPhase, ServiceQuery, ServiceStatus

#: The longest pause between two requests about a missed end, in seconds.
LONGEST_PAUSE = 60.0
#: The status of a host that ended without leaving one: killed, or after a crash of its computer.
KILLED = -9
#: The reason for the end of a host that ran before this boot.
REBOOTED = "this computer was restarted while the mission's host ran"


class ProcessId(NamedTuple):
    """A process: its number, and its start in clock ticks after the boot of the computer."""

    pid: int
    started: int


class HostProcess(NamedTuple):
    """The process of the mission's host, and the bundle that it runs."""

    bundle: bytes
    process: ProcessId


class HostEnd(NamedTuple):
    """The end of a host: its exit status, and the reason that it has left; '' for none."""

    status: int
    reason: str = ""


class HostProcesses(Protocol):
    """Starts and observes processes (`host_processes.HostProcesses`)."""

    @property
    def boot(self) -> str:
        """The id of this boot of the computer."""

    def start(self, bundle: bytes) -> ProcessId:
        """Start the host of a bundle. Raises LfieldError."""

    def find(self) -> HostProcess | None:
        """The host that an earlier service has started, also one that is not recorded; None without one."""

    def is_alive(self, process: ProcessId) -> bool:
        """Whether the process still runs."""

    async def ended(self, process: ProcessId) -> HostEnd:
        """The end of a process, when it has ended."""

    def terminate(self, process: ProcessId) -> None:
        """Request the process to end in order; a second request ends its wait for its devices."""


class MissionRunner:
    """The mission's host. `record` is durable: `store` is called after each change of it."""

    def __init__(
        self, record: RunRecord, processes: HostProcesses, clock: Clock, note: Callable[[LogLine], None]
    ) -> None:
        self._record, self._processes, self._clock, self.note = record, processes, clock, note
        self._store: Callable[[], None] = lambda: None
        self._refusal: Callable[[bytes], str] = lambda bundle: ""
        self._info = RunInfo()
        self._process: ProcessId | None = None
        self._restarts: list[float] = []
        self._supervision: asyncio.Task[None] | None = None
        self._is_stopping = False
        #: The `unsafe` of the record before the host was launched; None if unknown.
        self._unsafe_before: str | None = None
        #: The reason why the host before the running one has failed, '' for none.
        self.last_failure = ""
        #: Whether the mission may have ended on other hosts while no host ran here.
        self.may_have_missed_end = False

    def attach(self, store: Callable[[], None], refusal: Callable[[bytes], str]) -> None:
        """Set the functions that store the record, and that return the reason why a bundle may not start."""
        self._store, self._refusal = store, refusal

    @property
    def record(self) -> RunRecord:
        """The stored record."""
        return self._record

    @property
    def info(self) -> RunInfo:
        """The state of the host."""
        return self._info

    @property
    def process(self) -> ProcessId | None:
        """The process of the host, None if it does not run."""
        return self._process

    @property
    def is_running(self) -> bool:
        """Whether the process of the host exists."""
        return self._process is not None

    async def start(self, bundle: bytes, order: bytes = b"") -> None:
        """Start the host of a bundle; no effect if it runs. Raises LfieldError."""
        if self._process is not None:
            return
        # A restart that waits would refuse, or start the host a second time.
        await self._cancel_restart()
        self._restarts.clear()
        self.last_failure, self.may_have_missed_end = "", False
        self._launch(bundle, order)
        self._supervision = spawn(self._supervise())

    def adopt(self) -> None:
        """Supervise the host that an earlier service has started, if it still runs."""
        record = self._record
        if record.unsafe:
            self._set_phase("ended", record.unsafe)
        recorded = ProcessId(record.pid, record.started)
        is_of_this_boot = record.boot == self._processes.boot
        if record.pid and is_of_this_boot and self._processes.is_alive(recorded):
            self._supervise_running(HostProcess(record.bundle, recorded))
        elif (found := self._processes.find()) is not None:
            # The service has ended before it stored the number of the process, or its state was deleted.
            self._supervise_running(found)
        elif not record.bundle:
            return
        elif not is_of_this_boot:
            # A vehicle may fly on without its computer.
            self._keep(replace(record, unsafe=REBOOTED))
            self._interrupt(REBOOTED)
        elif not record.pid:
            self._interrupt("the service has ended while it started the host")
        else:
            self._set_phase("waiting", "it has ended while no service ran", record.bundle)
            self._supervision = spawn(self._supervise_ended(recorded))

    def _supervise_running(self, host: HostProcess) -> None:
        bundle, self._process = host
        self._unsafe_before, self.may_have_missed_end = None, True
        order = self._record.order if bundle == self._record.open_run else b""
        self._keep(RunRecord(bundle, self._processes.boot, *self._process, open_run=bundle, order=order))
        self._set_phase("running", "", bundle)
        self.note(messages.HOST_ADOPTED.line(bundle=short_digest(bundle), pid=self._process.pid))
        self._supervision = spawn(self._supervise())

    async def stop(self, reason: str, checked: str = "") -> None:
        """End the host in order: its devices come to rest first. Returns when it has ended.

        `checked` is the `unsafe` of the record that the operator knew: its vehicles are at rest now.
        """
        self._is_stopping = True
        try:
            if self._process is not None:
                self._set_phase("stopping", reason)
                self._processes.terminate(self._process)
                if self._supervision is not None:
                    await asyncio.gather(self._supervision, return_exceptions=True)
            else:
                await self._cancel_restart()
        finally:
            self._is_stopping = False
        self._forget(unsafe="" if self._record.unsafe == checked else self._record.unsafe)
        self._set_phase("stopped", reason)

    def end_run(self) -> None:
        """Record that no coordinator of the last run exists any more. Raises OutputFileError."""
        if self._record.open_run:
            self._set_record(replace(self._record, open_run=b""))

    async def _cancel_restart(self) -> None:
        if self._supervision is not None:
            self._supervision.cancel()
            await asyncio.gather(self._supervision, return_exceptions=True)

    def terminate_again(self) -> None:
        """End a stopping host's wait for its devices."""
        if self._process is not None:
            self._processes.terminate(self._process)

    def detach(self) -> None:
        """Stop observing the host, which continues after the end of the service."""
        if self._supervision is not None:
            self._supervision.cancel()

    async def _supervise(self) -> None:
        """Restart the host after crashes, until it ends for good."""
        while self._process is not None:
            process = self._process
            end = await self._processes.ended(process)
            self._process = None
            if not await self._restarts_after(end):
                return

    async def _supervise_ended(self, process: ProcessId) -> None:
        """Handle a host that has ended while no service ran."""
        if await self._restarts_after(await self._processes.ended(process)):
            await self._supervise()

    async def _restarts_after(self, end: HostEnd) -> bool:
        """Start the host again if its end was a crash; returns whether it runs."""
        now = self._clock.monotonic()
        bundle = self._record.bundle
        verdict = judge(end.status, end.reason, self._restarts, now)
        digest = short_digest(bundle)
        self.note(messages.HOST_ENDED.line(bundle=digest, status=end.status, reason=verdict.reason))
        if end.status < 0 or end.status == exit_status.UNSAFE:
            # The vehicles may still move. The next host observes them, or an operator confirms that they
            # rest.
            unsafe = truncate(verdict.reason)
            if end.status == -signal.SIGTERM and self._unsafe_before is not None:
                # The host handles SIGTERM before it opens devices, so this ends only a host without open
                # devices.
                unsafe = self._unsafe_before
            self._keep(replace(self._record, unsafe=unsafe))
        if self._is_stopping:
            return False
        if end.status in COMPLETED:
            self._keep(replace(self._record, open_run=b""))
        if not verdict.restarts or (refusal := self._refusal(bundle)):
            self._forget()
            reason = _not_restarted(verdict.reason, refusal) if verdict.restarts else verdict.reason
            self._set_phase("ended", reason, bundle, end.status)
            return False
        self.last_failure, self.may_have_missed_end = verdict.reason, True
        self._set_phase("waiting", verdict.reason, bundle, end.status)
        self.note(messages.HOST_RESTART.line(bundle=digest, seconds=RESTART_DELAY, reason=verdict.reason))
        await asyncio.sleep(RESTART_DELAY)
        self._restarts.append(self._clock.monotonic())
        if refusal := self._refusal(bundle):
            self._interrupt(_not_restarted(verdict.reason, refusal))
            return False
        try:
            self._launch(bundle, self._record.order)
        except LfieldError as error:
            self._interrupt(str(error))
            return False
        return True

    def _launch(self, bundle: bytes, order: bytes) -> None:
        """Store that the host should run, then start it. Raises LfieldError."""
        before = self._idle_record(self._record.unsafe)
        self._unsafe_before = before.unsafe
        run = RunRecord(bundle, self._processes.boot, open_run=bundle, order=order)
        self._set_record(replace(run, unsafe=before.unsafe))
        try:
            self._process = self._processes.start(bundle)
        except BaseException:
            self._keep(before)
            raise
        # Without its number the next service finds the process by its command line.
        pid, started = self._process
        self._keep(replace(run, pid=pid, started=started))
        self._set_phase("running", "", bundle)
        self.note(messages.HOST_STARTED.line(bundle=short_digest(bundle), pid=self._process.pid))

    def _interrupt(self, reason: str) -> None:
        bundle = self._record.bundle
        self._forget()
        self._set_phase("interrupted", reason, bundle)
        self.note(messages.HOST_INTERRUPTED.line(reason=reason))

    def _forget(self, unsafe: str | None = None) -> None:
        """Store that no host should run."""
        self._keep(self._idle_record(self._record.unsafe if unsafe is None else unsafe))

    def _idle_record(self, unsafe: str) -> RunRecord:
        return RunRecord(unsafe=unsafe, open_run=self._record.open_run, order=self._record.order)

    def _keep(self, record: RunRecord) -> None:
        """Store a record that is true in any case. On a full disk an older one stays, and the next service
        finds that its process has ended."""
        with suppress(OutputFileError):
            if self._record != record:
                self._set_record(record)
        self._record = record

    def _set_record(self, record: RunRecord) -> None:
        before, self._record = self._record, record
        try:
            self._store()
        except BaseException:
            self._record = before
            raise

    def _set_phase(
        self, phase: RunPhase, reason: str, bundle: bytes | None = None, status: int | None = None
    ) -> None:
        last = self._info.status if status is None else status
        bundle = self._info.bundle if bundle is None else bundle
        self._info = RunInfo(bundle, phase, reason, self._clock.time(), last, self._record.order)


class MissedEnd:
    """Requests from the other hosts whether the mission has ended while the host of this computer did not
    run.

    These hosts do not link with it any more. The requests become rarer while the answer is that it has not.
    """

    def __init__(self, runner: MissionRunner, probe: MissionProbe, clock: Clock) -> None:
        self._runner, self._probe, self._now = runner, probe, clock.monotonic
        #: The process that the requests are about, and the times of the first and the next request.
        self._process: ProcessId | None = None
        self._first = self._next = 0.0

    async def find(self, ask: AskPeer, hosts: Collection[str]) -> str:
        """One of the `hosts` of the mission on which its run has ended as a whole; '' if none is known."""
        runner, now = self._runner, self._now()
        process, order = runner.process, runner.record.order
        if process is None or not order or not runner.may_have_missed_end:
            return ""
        if process != self._process:
            self._process, self._first, self._next = process, now, now
        if now < self._next or not await self._probe.is_up():
            return ""
        self._next = now + min(LONGEST_PAUSE, now - self._first)
        answers = await ask_peers(ask, hosts, ServiceQuery())
        statuses = [answer for answer in answers if isinstance(answer, ServiceStatus)]
        ended = [status.host for status in statuses if status.run.has_completed and status.run.order == order]
        if not ended:
            return ""
        runner.note(messages.MISSED_END.line(host=ended[0]))
        return ended[0]


def _not_restarted(end: str, refusal: str) -> str:
    """The reason why a host has ended and was not restarted; valid also when the refusal no longer
    applies.
    """
    return truncate(f"{end}; not restarted then: {refusal}; 'lfield start' continues it")
