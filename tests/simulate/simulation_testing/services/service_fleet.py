"""A team of services on simulated computers: the product's service, server, runner, ballots and transport.

Network, disks, clocks and the mission of each robot are models. A seed determines a run completely.
"""

from __future__ import annotations

import hashlib
import random
import tempfile
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path
from typing import Any

from lfield.authority.admission_policy import AdmissionPolicy
from lfield.event_loop import spawn
from lfield.mission import bundle
from lfield.mission.loader import load_mission
from lfield.net.tcp_transport import TcpTransport
from lfield.service.mission_runner import MissionRunner
from lfield.service.server import ServiceServer
from lfield.service.service import Service
from lfield.service.service_process import MAX_BLOCK, ask_peer
from lfield.simulate.computers.event_queue import EventQueue
from lfield.simulate.computers.process_loop import closed_simulations, closing_generators, release
from lfield.simulate.computers.simulated_computer import SimulatedComputer, SimulatedProcess
from lfield.simulate.computers.simulated_machine import SimulatedMachine
from lfield.simulate.computers.simulated_network import SimulatedNetwork
from lfield.simulate.host_fleet import CLOCK_DRIFT, host_at_address
from lfield.wire.service_messages import BundleInfo
from simulation_testing.services.push_judge import PushJudge
from simulation_testing.services.robot_mission import ModelProbe, ModelProcesses, RobotMission
from simulation_testing.services.service_disk import OpenServiceDisk, ProcessKilled, ServiceDisk

#: The port of every service, and the number of different bundles.
PORT, VERSIONS = 8182, 4
#: Seconds until the service manager restarts a service that has ended.
RESTART = (0.3, 4.0)

_PROGRAM = """
resource Post {{ init(string[] arg) {{ }} portal stamp() emit int {{ return {number}; }} }}
coordinator Walker {{ init(string[] arg) {{ findPost()[0].stamp(); }} }}
"""


@cache
def bundle_version(robots: int, version: int) -> bytes:
    """The bytes of one version of the bundle of a team."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "mission.dL"
        path.with_suffix(".L").write_text(_PROGRAM.format(number=1000 + version), encoding="utf-8")
        lines = [f"//Post:p{number}@h{number}\n" for number in range(robots)]
        path.write_text("".join(lines) + "//Walker:w@h0\n", encoding="utf-8")
        return bundle.encode(load_mission(path, simulate=True))


@cache
def verified(data: bytes) -> BundleInfo:
    """The bundle in some bytes, which has no signature here. Raises BundleError."""
    mission = bundle.decode(data)
    # The model of a mission starts coordinators on every robot.
    homes = {f"walker {host}": host for host in mission.team.hosts}
    return BundleInfo(bundle.contents(data).digest, mission.name, coordinators=homes)


class ServiceFleet:
    """The services of robots h0, h1 and so on, all started at the beginning."""

    def __init__(self, robots: int, seed: int) -> None:
        rng = random.Random(f"services {seed}")
        self.timeline = EventQueue()
        self.robots = [f"h{number}" for number in range(robots)]
        self.addresses = {name: f"{name}:{PORT}" for name in self.robots}
        machines = {name: self.new_machine(name, rng) for name in self.robots}
        self.network = SimulatedNetwork(self.timeline, machines, rng)
        self.computers = {m.name: SimulatedComputer(m, self.network, {}) for m in machines.values()}
        self.stations: list[SimulatedComputer] = []
        self.judge = PushJudge(lambda: self.timeline.now)
        self.disks = {name: ServiceDisk(name, self.judge.on_save) for name in self.robots}
        missions = self.judge.missions
        for name, computer in self.computers.items():
            judge = self.judge
            missions[name] = RobotMission(
                name, computer, missions, judge.on_act, judge.on_start, judge.on_release
            )
        #: Processes of services that run; log lines with their times.
        self.services: dict[str, SimulatedProcess] = {}
        self.log: list[tuple[float, str, str]] = []
        for name in self.robots:
            self.start_service(name)

    def new_machine(self, name: str, rng: random.Random) -> SimulatedMachine:
        """A machine whose clock is fast or slow."""
        rate = 1.0 + rng.uniform(-CLOCK_DRIFT, CLOCK_DRIFT)
        return SimulatedMachine(name, self.timeline, random.Random(rng.random()), rate)

    @property
    def now(self) -> float:
        """True time in seconds."""
        return self.timeline.now

    @property
    def digest(self) -> str:
        """The hash of all log lines with their times."""
        lines = (f"{at:.9f} {name} {text}\n" for at, name, text in self.log)
        return hashlib.sha256("".join(lines).encode()).hexdigest()

    def later(self, event: Callable[[], None]) -> None:
        """Schedule an event after the present one."""
        self.timeline.after(0.0, event)

    def run(self, seconds: float) -> None:
        """Run for `seconds`, or until a breach."""
        with closing_generators():
            self.timeline.run(seconds, self._pause_at_breach)

    def _pause_at_breach(self) -> None:
        if self.judge.breaches:
            self.timeline.pause()

    def close(self) -> None:
        """End all processes at once, and free their memory."""
        for computer in (*self.computers.values(), *self.stations):
            computer.power_off()
            release(computer.machine)
        closed_simulations.collect()

    def note(self, name: str, text: str) -> None:
        """Write a log line."""
        self.log.append((self.now, name, text))

    # --- services -------------------------------------------------------------------------------------

    def start_service(self, name: str) -> None:
        """Start the service of a robot that is on, unless it runs."""
        computer = self.computers[name]
        if name in self.services or not computer.machine.is_on:
            return
        process = self.services[name] = computer.start()
        process.await_end(partial(self._on_service_end, name, process))
        process.loop.set_exception_handler(partial(self._on_exception, name))
        process.loop.enter(lambda: spawn(self._serve(name, process)))

    def kill_service(self, name: str) -> None:
        """Kill the service of a robot, as by SIGKILL; its host continues."""
        if name in self.services:
            self.services[name].die(-9)

    def kill_host(self, name: str) -> None:
        """Kill the mission's host of a robot."""
        if (host := self.judge.missions[name].host) is not None:
            host.process.die(-9)

    def power_off(self, name: str) -> None:
        """A robot is without power, without notice."""
        self.services.pop(name, None)
        self.computers[name].power_off()
        self.judge.missions[name].on_power_off()

    def power_on(self, name: str) -> None:
        """A robot has power again."""
        if not self.computers[name].machine.is_on:
            self.computers[name].power_on()
            self.start_service(name)

    def _on_service_end(self, name: str, process: SimulatedProcess, _: int) -> None:
        if self.services.get(name) is process:
            del self.services[name]
            if self.disks[name].kills_host:
                self.disks[name].kills_host = False
                self.kill_host(name)
            rng = self.computers[name].machine.rng
            self.timeline.after(rng.uniform(*RESTART), partial(self.start_service, name))

    def _on_exception(self, name: str, loop: Any, context: dict[str, Any]) -> None:
        error = context.get("exception")
        if not isinstance(error, ProcessKilled):
            self.judge.breaches.add("exception", (name,), f"{context['message']}: {error!r}")

    async def _serve(self, name: str, process: SimulatedProcess) -> None:
        """As `service_process.run_service`."""
        disk, clock = self.disks[name], process.loop.clock
        rng, mission = random.Random(process.computer.machine.rng.random()), self.judge.missions[name]
        record = disk.load()
        transport = TcpTransport(MAX_BLOCK, identify=host_at_address, busy=float)
        processes = ModelProcesses(mission, process.loop)
        runner = MissionRunner(record.run, processes, clock, partial(self.note, name))
        probe = ModelProbe(mission, process.loop)
        files = OpenServiceDisk(disk, process)
        service = Service(name, record, files, runner, probe, verified, clock)
        server = ServiceServer(name, service, transport, clock, rng, AdmissionPolicy())
        service.adopt()
        await server.listen(self.addresses[name])
        await service.resolve(partial(ask_peer, transport, self.addresses))
