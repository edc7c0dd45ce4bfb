"""The shell of one host: sockets, guards, timers and the log around a core that decides.

`dispatch` passes each input to the core, runs it, and executes its effects. An exception there is a bug of
lfield: the host stops sending heartbeats to its guards, which make the devices safe, logs it and ends.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable, Collection
from random import Random
from typing import TYPE_CHECKING, Any, cast

from msgspec.structs import replace

from lfield.devices.device_guards import DeviceGuards
from lfield.devices.guard_process import STOPPING
from lfield.devices.jitter_measurement import require_timely
from lfield.errors import AddressError, DeviceError, HostFailure
from lfield.host import inputs
from lfield.host.context import HostContext
from lfield.host.core import HostCore
from lfield.host.effects import (
    AnswerPersonCall,
    CallDevice,
    CancelCall,
    DumpAgent,
    Effect,
    MakeDeviceSafe,
    OpenLink,
    PersistRecords,
    WriteLog,
    WriteLogOnce,
    WriteOutput,
)
from lfield.host.engine_provider import select_engine
from lfield.host.environment import HostEnvironment, HostOptions
from lfield.host.events.event_recorder import EventRecorder
from lfield.host.failures.agent_dump import write_agent_dump
from lfield.host.failures.host_failures import HostFailures
from lfield.host.journal_writer import JournalWriter
from lfield.host.logbook import Logbook
from lfield.host.observer_sessions import ObserverSessions
from lfield.host.recording.core_turns import CoreTurns, HostEventClock
from lfield.host.recording.recording_session import RecordingSession, RunIdentity
from lfield.host.status import status_of
from lfield.manifest import DeviceValue
from lfield.mission.mission import Mission
from lfield.net.link_manager import LinkManager
from lfield.net.link_owner import TeamAddresses
from lfield.net.transport import Link, Transport
from lfield.replication.membership.overlay import Overlay
from lfield.replication.transfer.core import Mobility
from lfield.replication.transfer.effects import Send, SendTransfer
from lfield.text import log_messages
from lfield.vm.machine import Machine
from lfield.vm.turns.run_limit import RunLimit
from lfield.wire.coordinator_messages import Transfer
from lfield.wire.messages import Control, Hello
from lfield.wire.observer_messages import Status
from lfield.wire.order_messages import RelayedAnswer, RelayedOrder

if TYPE_CHECKING:
    from lfield.host.stop_orders.datagram_shell import DatagramShell

#: Seconds for which a starting host waits for the first reports of the other hosts before it starts its
#: coordinators: a coordinator that is alive elsewhere must not be started twice. Longer than the interval
#: between two dials.
INITIAL_CONTACT_TIMEOUT = 1.5
#: Receives the answer to an input.
ResultCallback = Callable[[object], None]


class Host:
    """A host; `name` is its name in the deployment."""

    def __init__(
        self, mission: Mission, name: str, transport: Transport, logbook: Logbook, options: HostOptions
    ) -> None:
        self.mission, self.name, self.options = mission, name, options
        self.team, self.logbook, self.clock = mission.team, logbook, options.clock
        self.started, self._turns = self.clock.monotonic(), CoreTurns(self.clock)
        self._turns.start_turn()
        self.recorder = EventRecorder(HostEventClock(self._turns), self.note)
        self.hybrid_clock = self.recorder.hybrid_clock
        own_number, team, clock = self.team.number(name), self.team, self.clock
        overlay = Overlay(team.hosts, own_number, is_full_mesh=mission.registry is not None)
        addresses, neighbours = team.addresses, overlay.neighbours
        hosts = TeamAddresses(team.numbers, addresses, own_number, neighbours, mission.has_live_values)
        self.peers = LinkManager(self, transport, clock, options.rng, hosts, options.admission)
        self.guards = DeviceGuards(
            mission.drivers, clock, self.note, silence=mission.bindings.silence, has_progressed=self.step,
            on_event=self.recorder.on_device_event,
            on_lock_out=lambda device, reason: self._observers.order_executor.on_lock_out(device, reason),
        )  # fmt: skip
        self.journal_writer = JournalWriter(
            options.journal,
            lambda number: self.dispatch(inputs.BatchDurable(number)),
            lambda reason: self.dispatch(inputs.BatchFailed(reason)),
            lambda problem: self.dispatch(inputs.DiskSpaceChanged(problem)),
        )
        run = RunIdentity(self.clock.time(), options.random_bytes)
        self._recording = RecordingSession(options.record, mission, run, self.note)
        self.core = HostCore(self._context(overlay))
        self._recording.attach(self.core, self._turns, options.engine)
        self._turns.end_turn()
        #: Passes an input to the core without running it; returns the answer.
        self.apply = self._turns.apply
        core, flush = self.core, self.journal_writer.flush
        self._observers = ObserverSessions(
            core, self.guards, self.peers, self.dispatch, self.status, self.note, flush
        )
        self._datagrams = self._order_datagrams(transport)
        self.broken_agents: dict[str, bool] = {}  # agents that died here; True if due to a bug of lfield
        self._failures = HostFailures(name, options.on_failure, self.recorder, self.note)
        #: Set when the host has failed.
        self.failed, self.changed = self._failures.failed, asyncio.Event()
        self._loop, self.address, self._due = asyncio.get_running_loop(), "", 0.0
        self._timer: asyncio.TimerHandle | asyncio.Handle | None = None
        self._pending: deque[tuple[inputs.HostInput | None, ResultCallback | None]] = deque()
        self._is_dispatching = self._stopped = self._has_resources = False
        options.admission.serve(self.is_mission_active, mission.access.denied_rights, self.note)

    def _context(self, overlay: Overlay) -> HostContext:
        """The environment that the parts of the core share."""
        options, writer, monotonic = self.options, self.journal_writer, self.clock.monotonic
        recording, seed = self._recording, options.rng.getrandbits(64)
        recording.set_seed(seed)
        return HostContext(
            self.mission, self.name, options.rng.getrandbits(62) + 1, self._turns,
            recording.environment(HostEnvironment(self.peers, self.guards), self._turns), Random(seed),
            options.unreachable_after, overlay, self.recorder,
            writer.journal_id, writer.records, writer.times,
            select_engine(options.engine, self.note, monotonic), recording.random_bytes(options.random_bytes),
            options.stopwatch or monotonic, RunLimit(monotonic), self._turns.read_fresh,
        )  # fmt: skip

    def _order_datagrams(self, transport: Transport) -> DatagramShell | None:
        keys, admission = self.options.orders, self.options.admission
        if keys is None:
            return None
        # This import loads cryptography, which a host without keys does not need.
        from lfield.host.stop_orders.datagram_shell import order_datagrams

        stops = self._observers.order_executor
        return order_datagrams(keys, transport, admission, self.core, stops, self.peers, self.fail)

    @property
    def machine(self) -> Machine:
        """The agents that are here."""
        return self.core.machine

    @property
    def mobility(self) -> Mobility:
        """The records of coordinators, and the transfer protocol."""
        return self.core.mobility

    # --- life cycle -----------------------------------------------------------------------------------

    async def start(self) -> None:
        """Listen, open the devices, start the resources, query the other hosts, start the coordinators.

        Raises AddressError and DevicesError; then no device has moved.
        """
        self.address = await self.peers.open(self.options.listen)
        await self._open_control_socket(self.options.control_socket)
        devices = self.mission.devices_of(self.name)
        self._observers.order_executor.restore_emergency_stop()
        await require_timely(self.guards.lateness.limit, devices, self.clock)
        await self.guards.open(devices, self._recording.for_guards())
        await self._observers.order_executor.restore_pause()
        unsaved = "simulation" if self.mission.world == "fakes" else "none"
        journal = "stored" if self.journal_writer.journal_id else unsaved
        self.note(log_messages.HOST_LISTENING.line(host=self.name, address=self.address, journal=journal))
        if line := self.options.admission.clock_warning():
            self.note(line)
        self.journal_writer.delete(self.core.coordinators.recovery.outdated)
        self.journal_writer.poll_disk_space()
        self.dispatch(inputs.ResourcesStart(self.options.first_start))
        self._has_resources = True
        if not self.core.has_coordinators:
            return
        await self.peers.wait_for_initial_contact(INITIAL_CONTACT_TIMEOUT)
        self.dispatch(inputs.CoordinatorsStart(self.options.first_start))
        await self.journal_writer.flush()

    async def _open_control_socket(self, path: str) -> None:
        """Open the control socket; the host also runs without it."""
        try:
            if path:
                await self.peers.open_control_socket(path)
        except AddressError as error:
            self.note(log_messages.NO_CONTROL_SOCKET.line(host=self.name, reason=error))

    async def stop(self, on_rest: Callable[[dict[str, str]], None] = lambda unsafe: None) -> dict[str, str]:
        """Make the devices safe, wait until they are at rest, then close all files. No agent runs meanwhile.

        Returns the devices that were not confirmed at rest, also passed to `on_rest` first.
        """
        if self._stopped:
            return {}
        if self.failure is None:
            self.recorder.on_host_stopping("", STOPPING)
        self.dispatch(inputs.AgentsHalt())
        unsafe = await self.guards.close()
        for name, reason in unsafe.items():
            self.note(log_messages.DEVICE_NOT_SAFE.line(device=name, reason=reason))
        await self._observers.linger_for_observers()
        on_rest(unsafe)
        self.dispatch(inputs.RunEnds())
        self._observers.subscriptions.flush_and_close()
        await self.journal_writer.close()
        self._stopped = True
        self._recording.close(self.clock.monotonic())
        if self._timer:
            self._timer.cancel()
        self.peers.close()
        if self._datagrams is not None:
            self._datagrams.close()
        self.logbook.close()
        return unsafe

    # --- dispatch -------------------------------------------------------------------------------------

    def step(self) -> bool:
        """Run the core; returns False after a failure. Guards get a heartbeat only after a completed turn."""
        self.dispatch()
        return self._failures.failure is None

    def dispatch(
        self, entry: inputs.HostInput | None = None, on_result: ResultCallback | None = None
    ) -> None:
        """Pass an input to the core, or none, and run it; `on_result` gets the result of `HostInput.enter`.

        An input caused by an effect waits until all effects are executed.
        """
        if self._stopped or self._failures.failure:
            return
        self._pending.append((entry, on_result))
        if self._is_dispatching:
            return
        self._is_dispatching = True
        try:
            while self._pending:
                entry, on_result = self._pending.popleft()
                found, pause, effects = self._turns.run(entry)
                if on_result is not None:
                    on_result(found)
                for effect in effects:
                    self._execute(effect)
            if self.logbook.pending:
                self.logbook.flush()
            if (flight := self._turns.flight) is not None and flight.complete_turn():
                self._recording.write_due(self.clock.monotonic())
            self._schedule_step(pause)
        except Exception as error:
            self.fail(error)
        finally:
            self._is_dispatching = False

    def _schedule_step(self, pause: float | None) -> None:
        """Schedule the next turn after `pause` seconds; an earlier timer is kept."""
        if pause is None:
            return
        due = self._loop.time() + pause
        if self._timer is not None:
            if self._due <= due:
                return
            self._timer.cancel()
        self._due = due
        self._timer = self._loop.call_at(due, self._wake) if pause else self._loop.call_soon(self._wake)

    def _wake(self) -> None:
        self._timer = None
        self.step()

    def fail(self, error: BaseException) -> None:
        """Handle a bug in the host itself: no agent runs any more, and the process ends."""
        self._failures.fail(error)

    @property
    def failure(self) -> HostFailure | None:
        """The reason why the host has failed, None if it has not."""
        return self._failures.failure

    def on_unhandled(self, loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        """The loop's exception handler: for exceptions in tasks or callbacks outside the core."""
        self._failures.on_unhandled(context, self.peers.log_once)

    def _execute(self, effect: Effect) -> None:
        match effect:
            case SendTransfer():
                self.peers.send_transfer(effect.host, effect.header, effect.block)
            case Send():
                self.peers.send(effect.host, effect.message)
            case WriteOutput():
                self.logbook.write(effect.text, effect.agent)
            case WriteLog():
                (self.logbook.note if effect.is_recorded else self.note)(effect.text, lines=effect.lines)
            case WriteLogOnce():
                self.peers.log_once(effect.text)
            case CallDevice():
                self._call_device(effect)
            case CancelCall():
                self.guards.cancel(effect.agent.id, effect.thread)
            case PersistRecords():
                self.journal_writer.persist(effect)
            case MakeDeviceSafe():
                self.recorder.on_orphaned_devices(effect.reason, effect.users)
                self.guards.make_safe(effect.device, effect.reason, effect.state)
            case AnswerPersonCall():
                self._observers.on_call_result(effect.result)
            case OpenLink():
                self.peers.require_link(effect.host)
            case DumpAgent():
                self.broken_agents[effect.agent.id] = effect.agent.broken
                if self.options.dump:
                    self.note(write_agent_dump(self.mission, self.name, effect.agent, self.options.dump))
            case _:
                self.changed.set()

    def _call_device(self, request: CallDevice) -> None:
        def answered(value: DeviceValue | DeviceError) -> None:
            if isinstance(value, DeviceError):
                error = value.device, value.reason, value.kind
                self.dispatch(inputs.DeviceAnswered(request.number, None, error))
            else:
                self.dispatch(inputs.DeviceAnswered(request.number, value))

        call, agent = request.call, request.agent.id
        try:
            self.guards.call(
                agent, call.field, call.instruction, request.values, answered, request.until, request.thread
            )
        except DeviceError as error:
            answered(error)

    # --- Owner of the links ---------------------------------------------------------------------------

    def hello(self) -> Hello:
        return replace(self.core.hello(), run=self._recording.run.id)

    def on_linked(self, hello: Hello) -> None:
        """A link with a host opened."""
        self._recording.on_hello(hello.run)
        self.dispatch(inputs.Linked(hello))

    def on_link_refused(self, host: str, reason: str, bundle: bytes) -> None:
        """No link with a host can be made; '' as the reason: a link is possible again."""
        self.dispatch(inputs.LinkRejected(host, reason, bundle))

    def on_unlinked(self, host: str, *, quietly: bool) -> None:
        """The link with a host closed."""
        self.dispatch(inputs.Unlinked(host, quietly))

    def desired_hosts(self) -> Collection[str]:
        """The hosts that need links with this host now."""
        return cast("set[str]", self.apply(inputs.LinksPlanned()))

    def on_transfer(self, host: str, header: Transfer, block: memoryview) -> None:
        """A coordinator arrived."""
        self.dispatch(inputs.TransferArrived(host, header, block))

    def on_oversize(self, host: str, header: Transfer, size: int) -> None:
        """A coordinator with an oversized block arrived."""
        self.dispatch(inputs.OversizeArrived(host, header, size))

    def on_message(self, host: str, message: Control, link: Link) -> None:
        """A message arrived; `host` is '' for an observer."""
        if isinstance(message, RelayedOrder | RelayedAnswer) and self._datagrams is not None:
            self._datagrams.on_relayed(host, message)
        elif not host:
            self._observers.on_message(message, link)
        else:
            self.dispatch(inputs.MessageArrived(host, message))

    def is_mission_active(self) -> bool:
        """Whether a device is in use here, or a coordinator runs that is neither paused nor stopped."""
        guards = self.guards
        in_use = [device.name for device in self.mission.devices_of(self.name) if not device.is_sensor]
        if any(name not in guards.latched or guards.moving.get(name) for name in in_use):
            return True
        held = self.core.coordinators.paused or self.core.coordinators.stopped
        return not held and any(known.state != "EXITED" for known in self.mobility.known_states())

    def note(self, line: log_messages.LogLine, *, lines: bool = False) -> None:
        """Write a log line; the output of a program may have several `lines`."""
        self.recorder.on_log_line(line)
        self.logbook.note(line, lines=lines)

    # --- status ---------------------------------------------------------------------------------------

    def status(self) -> Status:
        """The status of this host that `lfield ps` shows."""
        self.apply(inputs.DirectorySampled())
        clock, journal = self.clock, self.journal_writer.journal
        uptime, error = clock.monotonic() - self.started, self.options.admission.persist_error
        found = status_of(self.core, self.peers, self.guards, journal, self.address, uptime, clock, error)
        return found if self._has_resources else replace(found, starting=True)
