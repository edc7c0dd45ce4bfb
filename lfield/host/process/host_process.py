"""Runs one host as a process: until its mission ends, a stop is requested, or the parent process ends."""

from __future__ import annotations

import asyncio
import gc
import signal
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, NoReturn

from lfield import exit_status
from lfield.authority.admission_policy import AdmissionPolicy
from lfield.clock import SystemClock
from lfield.driver.binding import longest_rest
from lfield.errors import RecordingError
from lfield.host.environment import HostOptions
from lfield.host.host import Host
from lfield.host.inputs import HostExited, LineEntered
from lfield.host.logbook import JsonLogbook, Logbook
from lfield.host.process.credentials import (
    HostCredentials,
    admission_for,
    require_credentials,
    require_signature,
)
from lfield.host.process.mission_completion import wait_until_done
from lfield.host.process.operator_terminal import read_standard_input
from lfield.host.process.parent_pipe import ParentPipe
from lfield.host.process.run_result import RunResult, failure_reason, known_hops
from lfield.host.process.shutdown_signals import ShutdownSignals, install_signal_handlers
from lfield.host.recording.recording_session import replayed_form
from lfield.host.recording.recording_target import RecordingTarget
from lfield.journal.journal import Journal
from lfield.mission.access.signed_bundle import signing_time
from lfield.mission.mission import Mission
from lfield.net.tcp_transport import TcpTransport
from lfield.net.tls import TlsIdentity
from lfield.net.zenoh.host_transport import HostTransport
from lfield.replication.locate.outcomes import CoordinatorOutcome
from lfield.text import log_messages

if TYPE_CHECKING:
    from lfield.host.stop_orders.datagram_shell import OrderCredentials

#: Seconds of stopping after which the log names the reason of the wait.
FLUSH_TIMEOUT = 1.0
#: Additional seconds, beyond those of its devices, for a failed host to end in order.
LAST_RESORT = 10.0


async def run_host(
    mission: Mission,
    name: str,
    *,
    listen: str = "",
    control_socket: str = "",
    dump: Path | None = None,
    unreachable_after: float | None = None,
    lost_after: float | None = None,
    credentials: HostCredentials | None = None,
    parent_pipe: bool = False,
    result_fd: int | None = None,
    journal: Journal | None = None,
    first_start: bool = False,
    engine: str = "",
    as_json: bool = False,
    record: RecordingTarget | None = None,
) -> int:
    """Run a host; returns the exit status (exit_status.py). With `lost_after` None the host runs until it is
    stopped.

    `journal` is closed at the end; without one the host starts its coordinators after the reports of all
    hosts. `control_socket` is the address for local commands. `engine` selects the engine, overriding the
    bindings. The `RunResult` of the host is written to `result_fd`. Without `credentials` the host serves
    local commands only. `as_json` writes the log as JSON lines to stdout. `record` is the destination of its
    recording. Raises AddressError, DevicesError and KeysError when it cannot start.
    """
    clock = SystemClock()
    logbook = JsonLogbook(name, clock) if as_json else Logbook()
    identity, mission = _identity(mission, name, listen, credentials, journal, logbook)
    mission, record = _recorded_form(mission, record, name, logbook)
    bound = unreachable_after or mission.bindings.unreachable_after
    host_options = HostOptions(
        identity.address,
        dump,
        bound,
        control_socket,
        journal=journal,
        first_start=first_start,
        clock=clock,
        engine=engine or mission.bindings.engine,
        admission=identity.admission,
        orders=identity.orders,
        stopwatch=time.thread_time,
        on_failure=_end_by_force_after(mission),
        record=record,
    )
    # CPU time of programs that a message wakes is not charged to the sender of the message.
    tcp = TcpTransport(mission.max_block, identity.tls, exempt=lambda: host.core.run_seconds)
    host = Host(mission, name, transport := HostTransport(tcp), logbook, host_options)
    transport.log_to(host.note)
    signals = ShutdownSignals(host.clock)
    install_signal_handlers(signals)
    if parent_pipe:
        _watch_parent(host, signals)
    elif name in mission.reading_hosts:
        read_standard_input(lambda text: host.dispatch(LineEntered(text)))
    ended = partial(_write_result, host, result_fd)
    return await run_until_exit(host, signals, lost_after, _freeze_gc, ended)


def _write_result(host: Host, result_fd: int | None, status: int) -> None:
    if result_fd is not None:
        hops = known_hops(host.mobility.known_states())
        RunResult(hops, failure_reason(status, host.logbook.errors), status).write(result_fd)


def _watch_parent(host: Host, signals: ShutdownSignals) -> None:
    """Read the supervision pipe: hosts that have exited, lines of input, and the end of the parent."""
    stop = partial(signals.request, is_repeatable=False)
    ParentPipe(
        sys.stdin.fileno(),
        lambda exited: host.dispatch(HostExited(exited)),
        stop,
        lambda text: host.dispatch(LineEntered(text)),
    )


def _recorded_form(
    mission: Mission, record: RecordingTarget | None, name: str, logbook: Logbook
) -> tuple[Mission, RecordingTarget | None]:
    """The mission to run, and the destination of its recording. The recorder does not prevent a start."""
    if record is None:
        return mission, None
    try:
        return replayed_form(mission), record
    except RecordingError as error:
        logbook.note(log_messages.HOST_RECORDING_ENDED.line(host=name, reason=error))
        return mission, None


class _Identity(NamedTuple):
    """The listening address of a host, its keys, and its admission policy."""

    address: str
    tls: TlsIdentity | None
    admission: AdmissionPolicy
    orders: OrderCredentials | None


def _identity(
    mission: Mission,
    name: str,
    listen: str,
    credentials: HostCredentials | None,
    journal: Journal | None,
    logbook: Logbook,
) -> tuple[_Identity, Mission]:
    """The identity that follows from the credentials, and the mission with its verified signature.

    Raises KeysError.
    """
    if credentials is None:
        require_credentials(name, mission.team.hosts)
        return _Identity("", None, AdmissionPolicy(), None), mission
    # Both imports load cryptography, which a host without keys does not need.
    from lfield.authority.order_signing.order_signatures import CertificateCache, OrderSigner
    from lfield.host.stop_orders.datagram_shell import OrderCredentials

    certificates = CertificateCache(credentials.keys.authority)
    times = journal.times.values() if journal else ()
    signed = partial(signing_time, mission.release, credentials.keys.authority)
    verified = certificates.on_tls_verified
    tls, admission = admission_for(credentials, name, SystemClock(), times, verified, signed)
    release, reason = require_signature(mission, credentials, admission, journal.records() if journal else ())
    if reason:
        logbook.note(log_messages.BUNDLE_KEPT.line(bundle=release.short, reason=reason))
    orders = OrderCredentials(OrderSigner(credentials.keys), certificates, credentials.keys.authority)
    address = listen or mission.team.addresses[mission.team.number(name)]
    return _Identity(address, tls, admission, orders), replace(mission, release=release)


async def run_until_exit(
    host: Host,
    signals: ShutdownSignals,
    lost_after: float | None,
    started: Callable[[], None] = lambda: None,
    ended: Callable[[int], None] = lambda status: None,
) -> int:
    """Run a host until its mission ends, a stop is requested or it fails; returns the exit status.

    `started` is called when the host is up, `ended` with the status before the journal says that the run has
    ended: a service would begin a new run after a host that was killed in between.
    """
    asyncio.get_running_loop().set_exception_handler(host.on_unhandled)
    run = asyncio.ensure_future(_run_mission(host, lost_after, started))
    stopped = asyncio.ensure_future(signals.first_requested.wait())
    failed = asyncio.ensure_future(host.failed.wait())

    def status(unsafe: dict[str, str]) -> int:
        if unsafe:
            return exit_status.UNSAFE
        if host.failure is not None:
            return host.failure.exit_status
        if run.cancelled():
            # Without --until-done only a stop request ends it.
            return exit_status.DONE if lost_after is None else exit_status.INTERRUPTED
        return run.result()

    def on_rest(unsafe: dict[str, str]) -> None:
        if unsafe or host.failure is not None or run.cancelled() or run.exception() is None:
            ended(status(unsafe))

    try:
        await asyncio.wait([run, stopped, failed], return_when=asyncio.FIRST_COMPLETED)
    finally:
        for task in (run, stopped, failed):
            task.cancel()
        await asyncio.gather(run, stopped, failed, return_exceptions=True)
        unsafe = await _stop(host, signals, on_rest)
    if unsafe:
        _log_other_failures(run, host)
    return status(unsafe)


def _end_by_force_after(mission: Mission) -> Callable[[], None]:
    """Have the kernel end this process if it cannot end in order, as without memory."""
    bound = longest_rest(mission.bindings.all) + LAST_RESORT

    def arm() -> None:
        signal.setitimer(signal.ITIMER_REAL, bound)

    return arm


async def _stop(
    host: Host, signals: ShutdownSignals, on_rest: Callable[[dict[str, str]], None]
) -> dict[str, str]:
    """Stop the host; returns the devices that were not confirmed at rest in their safe states."""
    signals.call_on_second(host.guards.stop_waiting)
    report = asyncio.get_running_loop().call_later(
        FLUSH_TIMEOUT, host.note, log_messages.WAITING_FOR_REST.line(host=host.name)
    )
    try:
        return await host.stop(on_rest)
    finally:
        report.cancel()


def _log_other_failures(run: asyncio.Future[int], host: Host) -> None:
    """Log other failures when the exit status says that a device is not safe."""
    if not run.cancelled() and (error := run.exception()) is not None:
        host.note(log_messages.HOST_ENDING_ERROR.line(host=host.name, reason=error))


def _freeze_gc() -> None:
    """Exclude loaded objects from Python's garbage collector, which would otherwise delay hops."""
    gc.collect()
    gc.freeze()


async def _run_mission(host: Host, lost_after: float | None, started: Callable[[], None]) -> int:
    """Start the host, and wait for the end of the mission; forever if `lost_after` is None."""
    await host.start()
    started()
    if lost_after is None:
        await _wait_forever()
    return exit_status.most_severe(
        _outcome_status(host, outcome) for outcome in await wait_until_done(host, lost_after)
    )


def _outcome_status(host: Host, outcome: CoordinatorOutcome) -> int:
    """The exit status for an outcome; the log has the outcomes that other hosts could not report."""
    match outcome.outcome:
        case "done":
            return exit_status.DONE
        case "unheard":
            host.note(log_messages.AGENT_UNREACHABLE.line(agent=outcome.agent, reason=outcome.detail))
            return exit_status.UNKNOWN_OUTCOME
        case "lost":
            host.note(log_messages.AGENT_LOST.line(agent=outcome.agent, reason=outcome.detail))
        case "died" if host.broken_agents.get(outcome.agent):
            return exit_status.SOFTWARE
    return exit_status.FAILED


async def _wait_forever() -> NoReturn:
    while True:
        await asyncio.get_running_loop().create_future()
