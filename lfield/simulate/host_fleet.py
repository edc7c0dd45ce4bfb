"""A simulated team: real hosts and guards on models of computers, networks, disks and hardware.

Sockets, pipes, disks, clocks and hardware are models. Links, handshakes, VM, mobility, guards and host
shutdown are the product's code. A seed determines a run completely.
"""

from __future__ import annotations

import hashlib
import io
import random
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from importlib.metadata import EntryPoint

from msgspec import Struct, structs

from lfield import exit_status
from lfield.authority.identity import ALL_RIGHTS, Identity
from lfield.driver.binding import DeviceBinding
from lfield.driver.driver_index import GROUP, DriverIndex
from lfield.errors import JournalError, LfieldError
from lfield.host.core import HostCore
from lfield.host.environment import HostOptions
from lfield.host.host import Host
from lfield.host.logbook import Logbook
from lfield.host.process.host_process import run_until_exit
from lfield.host.process.shutdown_signals import ShutdownSignals
from lfield.host.recording.recording_session import replayed_form
from lfield.host.recording.recording_target import RecordingTarget
from lfield.journal.records import Record
from lfield.mission.mission import Mission, with_installed_drivers
from lfield.net.tcp_transport import TcpTransport
from lfield.net.transport import split_address
from lfield.simulate.computers.event_queue import EventQueue
from lfield.simulate.computers.process_loop import (
    closed_simulations,
    closing_generators,
    release,
    unscanned_heap,
)
from lfield.simulate.computers.simulated_computer import SimulatedComputer, SimulatedProcess
from lfield.simulate.computers.simulated_machine import SimulatedMachine
from lfield.simulate.computers.simulated_network import SimulatedNetwork
from lfield.simulate.hardware import REFERENCE, Hardware, guard
from lfield.simulate.journal_disk import JournalDisk
from lfield.text import log_messages

#: Maximum deviation of clock rates.
CLOCK_DRIFT = 0.01
#: Listening address of every host on its machine.
PORT = 8181
#: Seconds of CPU time per L instruction, and per turn of a thread: seven times those of the reference engine
#: on a desktop computer, as on small robot computers.
INSTRUCTION, TURN = 1e-6, 50e-6

FleetWatcher = Callable[["Fleet"], None]
OnHostStart = Callable[[str, "HostRun"], None]
PlugHardware = Callable[["Fleet", Mission, random.Random], Mission]


class HostRun(Struct, frozen=True):
    """One incarnation of a host: its process and host object."""

    process: SimulatedProcess
    host: Host
    #: The shutdown signals of the host.
    shutdown_signals: ShutdownSignals

    @property
    def core(self) -> HostCore:
        return self.host.core


class FleetOptions(Struct, frozen=True):
    """Options of the hosts of a fleet. Times are in seconds.

    With `lost_after`, hosts exit when all coordinators have ended, as with --until-done. `keeps`: hosts have
    journals. Code takes `slowness` times its usual CPU time. `time_of_day` is that of all computers at the
    start, None for an arbitrary one of each. The rates of their clocks deviate by at most `clock_drift`.
    """

    unreachable_after: float = 10.0
    lost_after: float | None = None
    keeps: bool = True
    slowness: float = 1.0
    time_of_day: float | None = None
    clock_drift: float = CLOCK_DRIFT
    #: The folder for the recordings of the cores.
    record: RecordingTarget | None = None


class Fleet:
    """The hosts of a mission, all started at the beginning. `seed` determines all random values.

    `watch` is called after every event, and raises AssertionError for a violated invariant; `on_start` with
    each incarnation of a host before it runs. `plug` provides hardware and returns the mission with its
    endpoints.
    """

    def __init__(
        self,
        mission: Mission,
        seed: int = 0,
        watch: FleetWatcher = lambda fleet: None,
        on_start: OnHostStart = lambda name, run: None,
        plug: PlugHardware | None = None,
        options: FleetOptions | None = None,
    ) -> None:
        self._watch, self._on_start, self.options = watch, on_start, options or FleetOptions()
        rng = random.Random(seed)
        self.timeline = EventQueue()
        #: All program output and log lines: seconds, host, text.
        self.log: list[tuple[float, str, str]] = []
        names = mission.team.hosts
        self.machines = {name: self._machine(name, rng) for name in names}
        if self.options.time_of_day is not None:
            for machine in self.machines.values():
                machine.set_time(self.options.time_of_day)
        self.network = SimulatedNetwork(self.timeline, self.machines, rng)
        programs = {"lfield.guard.process": guard}
        self.computers = {
            m.name: SimulatedComputer(m, self.network, programs) for m in self.machines.values()
        }
        self.disks = {name: JournalDisk(random.Random(rng.random())) for name in names}
        #: Hosts that may have acted without any record on their disk. Others are started with the operator's
        #: assertion of a first start, until they have stored something.
        self._known: set[str] = set()
        #: Hardware of any driver, by the names of devices that share it.
        self.hardware: dict[str, Hardware] = {}
        #: Computers that are no hosts of the mission: those of operators and of simulated devices.
        self.stations: list[SimulatedComputer] = []
        plugged = (plug or plug_any_hardware)(self, mission, rng)
        at_simulation = plugged.at(mission.team.at({name: f"{name}:{PORT}" for name in names}))
        self.mission = at_simulation if self.options.record is None else replayed_form(at_simulation)
        #: Running hosts; exit statuses of those that have exited.
        self.runs: dict[str, HostRun] = {}
        self.left: dict[str, int] = {}
        #: Hosts that ended by a bug of lfield; hosts whose disk was replaced.
        self.failed: set[str] = set()
        self.replaced: set[str] = set()
        #: Hosts that never return.
        self.lost_hosts: set[str] = set()
        for name in names:
            with unscanned_heap():
                self.boot(name)

    def _machine(self, name: str, rng: random.Random) -> SimulatedMachine:
        drift = self.options.clock_drift
        rate = 1.0 + rng.uniform(-drift, drift)
        return SimulatedMachine(name, self.timeline, random.Random(rng.random()), rate)

    # --- time -----------------------------------------------------------------------------------------

    @property
    def now(self) -> float:
        """True time, in seconds since the simulation began."""
        return self.timeline.now

    def later(self, seconds: float, event: Callable[[], None]) -> None:
        """Schedule an event after that many seconds."""
        self.timeline.after(seconds, event)

    def run(self, seconds: float) -> None:
        """Run for that many seconds."""
        with closing_generators(), unscanned_heap():
            self.timeline.run(seconds, partial(self._watch, self))

    @property
    def digest(self) -> str:
        """The hash of all output and log lines with their times, which identifies a run."""
        lines = (f"{at:.9f} {host} {text}\n" for at, host, text in self.log)
        return hashlib.sha256("".join(lines).encode()).hexdigest()

    # --- hosts ----------------------------------------------------------------------------------------

    def boot(self, name: str) -> None:
        """Start a host's process, and its computer if off; an earlier incarnation leaves nothing.

        Ignored for a host that is permanently lost.
        """
        if name in self.lost_hosts:
            return
        computer = self.computers[name]
        if not computer.machine.is_on:
            computer.power_on()
        process = computer.start()
        process.await_end(partial(self._ended, name, process))
        process.loop.enter(partial(self._start, name, process))

    def crash(self, name: str) -> None:
        """Kill a host's process, as by SIGKILL."""
        self.runs[name].process.die(-9)

    def stop(self, name: str) -> None:
        """Stop a host, as by SIGTERM."""
        self.runs[name].process.loop.enter(self.runs[name].shutdown_signals.request)

    def power_off(self, name: str) -> None:
        """Power a host's computer off without notice."""
        self.computers[name].power_off()
        self.runs.pop(name, None)

    def lose(self, name: str) -> None:
        """Lose a host's computer permanently, without notice."""
        self.lost_hosts.add(name)
        self.power_off(name)

    @property
    def pages_left(self) -> list[Record]:
        """The disk contents of hosts that are not permanently lost."""
        disks = [disk for name, disk in self.disks.items() if name not in self.lost_hosts]
        return [record for disk in disks for record in disk.records()]

    def close(self) -> None:
        """End all processes at once, and free their memory."""
        for name in self.computers:
            self.power_off(name)
        for station in self.stations:
            station.power_off()
        for computer in [*self.computers.values(), *self.stations]:
            release(computer.machine)
        closed_simulations.collect()

    def lose_disk(self, name: str) -> None:
        """Replace a host's disk by an empty one."""
        self.disks[name].replace()
        self.replaced.add(name)
        self._known.add(name)

    def _start(self, name: str, process: SimulatedProcess) -> None:
        machine, disk, log = self.machines[name], self.disks[name], ProcessLog(self, name, process)
        try:
            journal = disk.open(machine.clock, log.note) if self.options.keeps else None
        except JournalError as error:
            log.note(str(error))
            process.exit(error.exit_status)
            return
        options = HostOptions(
            listen=f"{name}:{PORT}",
            clock=machine.clock,
            rng=random.Random(machine.rng.random()),
            unreachable_after=self.options.unreachable_after,
            journal=journal,
            first_start=name not in self._known and not disk.records(),
            random_bytes=random.Random(f"orders {name} {machine.clock.monotonic()}").randbytes,
            record=self.options.record,
        )
        if not self.options.keeps:
            self._known.add(name)
        transport = TcpTransport(self.mission.max_block, identify=host_at_address, busy=float)
        host = Host(self._mission_on(name), name, transport, Logbook(log, log), options)
        run = self.runs[name] = HostRun(process, host, ShutdownSignals(host.clock))
        host.machine.hooks.attach_meter(
            lambda n: process.loop.compute(self.options.slowness * (TURN + n * INSTRUCTION))
        )
        self._on_start(name, run)
        # Slightly later: the creator of the fleet has all hosts before any of them acts.
        process.loop.soon(lambda: process.loop.create_task(self._run_host(name, run)))

    def _mission_on(self, host: str) -> Mission:
        """The mission as in the process of a host."""
        found = _mission_of(self.mission, host)
        return found if self.options.record is None else replayed_form(found)

    async def _run_host(self, name: str, run: HostRun) -> None:
        try:
            status = await run_until_exit(run.host, run.shutdown_signals, self.options.lost_after)
        except LfieldError as error:
            # Start failed, for instance because a guard died: the service manager retries.
            run.host.note(log_messages.HOST_ENDING_ERROR.line(host=run.host.name, reason=error))
            run.process.exit(error.exit_status)
            return
        if run.host.failure is not None:
            self.failed.add(name)
        if not run.shutdown_signals.first_requested.is_set():
            self.left[name] = status
        run.process.exit(status)

    def _ended(self, name: str, process: SimulatedProcess, _: int) -> None:
        if name in self.runs and self.runs[name].process is process:
            del self.runs[name]

    def restart_ended(self, only: int | None = None) -> None:
        """Restart hosts that exited by themselves, as an operator does.

        `only`: those with this exit status; otherwise all whose mission is not done.
        """
        for name, status in list(self.left.items()):
            if status == only or (only is None and status != exit_status.DONE):
                del self.left[name]
                self.boot(name)

    def add_station(self, name: str, rng: random.Random) -> SimulatedProcess:
        """A process on a computer that is no host, with its own network address."""
        machine = SimulatedMachine(name, self.timeline, rng)
        self.network.join(machine)
        self.stations.append(SimulatedComputer(machine, self.network, {}))
        return self.stations[-1].start()

    # --- links ----------------------------------------------------------------------------------------

    def cut(self, host: str, other: str) -> None:
        """Break the connections of two computers with notice, and block their paths until `heal`."""
        self.network.reset(host, other)
        self.network.silence(host, other)
        self.network.silence(other, host)

    def heal(self, host: str, other: str) -> None:
        """Unblock the paths; waiting data is delivered first."""
        self.network.heal(host, other)
        self.network.heal(other, host)

    def heal_all(self) -> None:
        """Restore all paths and processes, and start all hosts that did not exit by themselves."""
        self.network.heal_all()
        for computer in self.computers.values():
            for process in list(computer.processes):
                process.loop.thaw()
        for name in self.computers:
            if name not in self.runs and name not in self.left:
                self.boot(name)


def plug_any_hardware(fleet: Fleet, mission: Mission, rng: random.Random) -> Mission:
    """The mission with each device replaced by one of this simulation."""
    endpoints: dict[str, str] = {}
    for (host, *_), devices in buses_of(mission).items():
        hardware = Hardware(fleet.timeline, random.Random(rng.random()))
        endpoint = f"virtual:{devices[0].endpoint}"
        fleet.machines[host].hardware[endpoint] = hardware
        fleet.hardware[devices[0].name] = hardware
        endpoints |= {device.name: endpoint for device in devices}
    simulated = {
        name: replace(driver, reference=REFERENCE) for name, driver in mission.drivers.by_driver.items()
    }
    return replace(at_endpoints(mission, endpoints), drivers=DriverIndex(simulated))


def _mission_of(mission: Mission, host: str) -> Mission:
    """The mission as `lfield up` gives it to a host, with the drivers of its devices installed."""
    entries = [
        EntryPoint(driver.name, driver.reference, GROUP) for driver in mission.drivers.by_driver.values()
    ]
    return with_installed_drivers(mission, host, entries)


def host_at_address(address: str) -> Identity:
    """The host at a simulated address, which cannot be forged and contains its name."""
    return Identity("host", split_address(address)[0], ALL_RIGHTS)


def buses_of(mission: Mission) -> Mapping[tuple[str, str, str], Sequence[DeviceBinding]]:
    """The devices of a mission by host, driver and endpoint: buses of two hosts may share a name."""
    hosts = {member.id: mission.team.hosts[member.host] for member in mission.team.members}
    buses: dict[tuple[str, str, str], list[DeviceBinding]] = {}
    for device in mission.bindings.all:
        buses.setdefault((hosts[device.agent], *device.bus), []).append(device)
    return buses


def at_endpoints(mission: Mission, endpoints: Mapping[str, str]) -> Mission:
    """The mission with its devices, by name, at other endpoints."""
    bound = {
        agent: {field: structs.replace(d, endpoint=endpoints[d.name]) for field, d in fields.items()}
        for agent, fields in mission.bindings.devices.items()
    }
    return mission.with_bindings(structs.replace(mission.bindings, devices=bound))


class ProcessLog(io.StringIO):
    """Both output streams of a host's process, written to the simulation's log."""

    def __init__(self, fleet: Fleet, name: str, process: SimulatedProcess) -> None:
        super().__init__()
        self._fleet, self._name, self._process = fleet, name, process

    def write(self, text: str) -> int:
        """Write a part of either stream."""
        if not self._process.loop.dead:
            self._fleet.log.append((self._fleet.now, self._name, text))
        return len(text)

    def note(self, text: str) -> None:
        """Write a log line."""
        self.write(f"{text}\n")


def copies(fleet: Fleet) -> Mapping[tuple[str, int], list[str]]:
    """The hosts on which each start of each coordinator can run now: agent and generation, host names."""
    found: dict[tuple[str, int], list[str]] = {}
    for name, run in fleet.runs.items():
        for agent in run.core.machine.agents.values():
            if agent.member.kind == "coordinator" and not agent.frozen and not agent.ended:
                found.setdefault((agent.id, agent.generation), []).append(name)
    return found
