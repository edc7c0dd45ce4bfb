"""A model of the mission of one robot: its vehicle, its journal, and the process of its host.

The host flies its vehicle for coordinators that start here, move to other robots, and end. It is no real
host: only what the service observes and orders is modelled. Vehicle and journal survive the processes.
"""

from __future__ import annotations

import asyncio
import itertools
import random
from collections.abc import Callable, Mapping, Sequence
from functools import partial

from lfield import exit_status
from lfield.service.mission_runner import HostEnd, HostProcess, ProcessId
from lfield.simulate.computers.process_loop import ProcessLoop
from lfield.simulate.computers.simulated_computer import SimulatedComputer, SimulatedProcess
from lfield.simulate.computers.simulated_network import SimulatedNetwork
from lfield.wire.service_messages import UnfinishedCoordinator
from simulation_testing.services.service_disk import ProcessKilled

#: Seconds between two steps of a host, until it runs, and of a landing.
STEP, STARTUP, LANDING = (0.2, 2.0), (0.1, 1.5), (0.5, 5.0)
#: Seconds of transit of a request, and of its answer. One of this many answers is lost.
LATENCY, LOST_ANSWERS = (0.005, 0.4), 30
#: Seconds between two checks whether a process has ended.
POLL = 0.25
#: Parts of all steps in which a coordinator takes off, lands, moves to another robot, ends; ends in flight.
TAKES_OFF, LANDS, MOVES, ENDS, LEFT_IN_THE_AIR = 0.4, 0.3, 0.15, 0.3, 0.15
#: Parts of all starts with a new coordinator, and of all steps without one in which a host ends.
NEW_COORDINATOR, LEAVES = 0.6, 0.02

#: Called with a robot and a bundle: a coordinator acts there; a host is started there.
OnAction = Callable[[str, bytes], None]


class RobotMission:
    """The mission of one robot. `team` has those of all robots by name, also of this one."""

    def __init__(
        self,
        robot: str,
        computer: SimulatedComputer,
        team: Mapping[str, RobotMission],
        on_act: OnAction,
        on_start: OnAction,
        on_release: Callable[[str], None],
    ) -> None:
        self.robot, self.computer, self._team = robot, computer, team
        self.on_act, self.on_start, self.on_release = on_act, on_start, on_release
        self.rng = random.Random(computer.machine.rng.random())
        self.is_airborne = False
        #: The journal: the unfinished coordinators known to this robot, with their places, and whether an
        #: operator has paused the mission.
        self.unfinished: dict[str, str] = {}
        self.is_paused = False
        #: The ballot that holds the host, b"" for none. It is in the memory of its process.
        self.held = b""
        #: The bundle that was started last, until its mission has ended or was discarded, or every robot has
        #: voted that no coordinator of it exists.
        self.open_run = b""
        #: Running hosts by process number; the ends of the other hosts.
        self.hosts: dict[int, ModelHost] = {}
        self.ends: dict[int, int] = {}
        self.boots = self._coordinators = 0
        self._numbers = itertools.count(1)

    @property
    def host(self) -> ModelHost | None:
        """The running host."""
        return next(iter(self.hosts.values()), None)

    @property
    def rests(self) -> bool:
        """Whether no coordinator may act, start or arrive."""
        return self.is_paused or bool(self.held)

    @property
    def is_at_rest(self) -> bool:
        """Whether the vehicle is on the ground and no coordinator is unaccounted for."""
        return not self.is_airborne and not self.unfinished

    def start_host(self, bundle: bytes) -> int:
        """Start the host of a bundle; returns its process number."""
        self.on_start(self.robot, bundle)
        self.open_run = bundle
        process = self.computer.start()
        # Not its real process number, which depends on earlier scenarios.
        number = next(self._numbers)
        host = self.hosts[number] = ModelHost(self, bundle, process)
        process.await_end(partial(self._on_end, number))
        process.loop.soon(lambda: process.loop.create_task(host.run()), self.rng.uniform(*STARTUP))
        return number

    def on_power_off(self) -> None:
        """The robot and its vehicle lose power."""
        self.hosts.clear()
        self.is_airborne, self.held = False, b""
        self.boots += 1

    def order_pause(self, *, on: bool) -> bool:
        """An operator pauses the mission, or resumes it; returns whether the order was executed."""
        if self.host is None or not self.host.is_up:
            return False
        self.is_paused = on
        return True

    def new_coordinator(self) -> None:
        """A coordinator starts here."""
        self._coordinators += 1
        self.unfinished[f"walker {self.robot} {self._coordinators}"] = self.robot

    def move(self, agent: str, bundle: bytes, network: SimulatedNetwork) -> None:
        """A coordinator moves to another robot whose host runs and does not rest."""
        there = self._team[self.rng.choice(sorted(self._team))]
        reachable = not network.paths.silences(self.robot, there.robot) and there.computer.machine.is_on
        host = there.host
        if there is self or not reachable or there.rests or host is None or host.bundle != bundle:
            return
        there.unfinished[agent] = there.robot
        self.unfinished[agent] = there.robot

    def receive_ends(self, network: SimulatedNetwork) -> None:
        """Other robots report which coordinators have ended there, or have returned."""
        for agent, place in list(self.unfinished.items()):
            there = self._team[place]
            if there is self or network.paths.silences(self.robot, place) or not there.computer.machine.is_on:
                continue
            if (known := there.unfinished.get(agent)) is None:
                del self.unfinished[agent]
            else:
                self.unfinished[agent] = known

    def starts_elsewhere(self, robots: Sequence[str]) -> list[str]:
        """The coordinators that have started on some other robots and have not ended there."""
        return [
            agent
            for robot in robots
            for agent in self._team[robot].unfinished
            if agent.startswith(f"walker {robot} ")
        ]

    def _on_end(self, pid: int, status: int) -> None:
        del self.hosts[pid]
        self.held = b""
        self.open_run = b"" if status == exit_status.DONE else self.open_run
        self.ends[pid] = status
        if self.is_airborne:
            # Its guard lands the vehicle, unless a next host flies it.
            self.computer.machine.timeline.after(self.rng.uniform(*LANDING), self._land_alone)

    def _land_alone(self) -> None:
        if not self.hosts:
            self.is_airborne = False


class ModelHost:
    """One process of the host of a bundle."""

    def __init__(self, mission: RobotMission, bundle: bytes, process: SimulatedProcess) -> None:
        self._mission, self.bundle, self.process = mission, bundle, process
        self.is_up = self.is_stopping = False

    async def run(self) -> None:
        """Fly until it is stopped or has nothing to do."""
        mission, rng = self._mission, self._mission.rng
        if not mission.unfinished and rng.random() < NEW_COORDINATOR:
            mission.new_coordinator()
        self.is_up = True
        while True:
            await asyncio.sleep(rng.uniform(*STEP))
            if self.is_stopping or (not mission.unfinished and rng.random() < LEAVES):
                await asyncio.sleep(rng.uniform(*LANDING) if mission.is_airborne else 0.0)
                mission.is_airborne = False
                self.process.exit(exit_status.INTERRUPTED if self.is_stopping else exit_status.DONE)
                return
            mission.receive_ends(self.process.computer.network)
            here = [agent for agent, place in mission.unfinished.items() if place == mission.robot]
            if mission.rests or not here:
                mission.is_airborne = mission.is_airborne and rng.random() > LANDS
            else:
                self._act(rng.choice(here))

    def _act(self, agent: str) -> None:
        mission, chance = self._mission, self._mission.rng.random()
        mission.on_act(mission.robot, self.bundle)
        if mission.is_airborne:
            mission.is_airborne = chance > LANDS
            if chance > 1.0 - LEFT_IN_THE_AIR:
                # Its coordinator has ended: the vehicle stays for a while.
                del mission.unfinished[agent]
        elif chance < TAKES_OFF:
            mission.is_airborne = True
        elif chance < TAKES_OFF + MOVES:
            mission.move(agent, self.bundle, self.process.computer.network)
        elif chance < TAKES_OFF + MOVES + ENDS:
            del mission.unfinished[agent]


class ModelProcesses:
    """See `HostProcesses`: hosts as the service in one process starts and observes them."""

    def __init__(self, mission: RobotMission, loop: ProcessLoop) -> None:
        self._mission, self._loop = mission, loop

    @property
    def boot(self) -> str:
        """The id of this boot of the computer."""
        return f"boot {self._mission.boots}"

    def start(self, bundle: bytes) -> ProcessId:
        """Start the host of a bundle."""
        if self._loop.dead:
            raise ProcessKilled
        return ProcessId(self._mission.start_host(bundle), 1)

    def find(self) -> HostProcess | None:
        """The process of the host that an earlier service has started."""
        hosts = self._mission.hosts.items()
        return next((HostProcess(host.bundle, ProcessId(pid, 1)) for pid, host in hosts), None)

    def is_alive(self, process: ProcessId) -> bool:
        """Whether the process still runs."""
        return process.pid in self._mission.hosts

    async def ended(self, process: ProcessId) -> HostEnd:
        """The end of a process, when it has ended."""
        while self.is_alive(process):
            await asyncio.sleep(POLL)
        return HostEnd(self._mission.ends.get(process.pid, -9))

    def terminate(self, process: ProcessId) -> None:
        """Ask it to end regularly."""
        if not self._loop.dead and (host := self._mission.hosts.get(process.pid)) is not None:
            host.is_stopping = True


class ModelProbe:
    """See `MissionProbe`: requests arrive at the host late, and some answers are lost."""

    def __init__(self, mission: RobotMission, loop: ProcessLoop) -> None:
        self._mission, self._loop = mission, loop

    async def _request(self) -> str:
        """Returns why the host does not answer; '' when the request has arrived."""
        await asyncio.sleep(self._mission.rng.uniform(*LATENCY))
        if self._loop.dead:
            raise ProcessKilled
        host = self._mission.host
        return "" if host is not None and host.is_up else "the mission's host does not answer"

    async def _answer(self, value: str) -> str:
        await asyncio.sleep(self._mission.rng.uniform(*LATENCY))
        return value if self._mission.rng.randrange(LOST_ANSWERS) else "no answer within 8 s"

    async def vehicles(self) -> str:
        """Why the vehicle is not at rest."""
        if problem := await self._request():
            return problem
        return await self._answer("its vehicle is off the ground" if self._mission.is_airborne else "")

    async def unfinished(self) -> list[UnfinishedCoordinator]:
        """The coordinators in the journal."""
        await self._request()
        found = [
            UnfinishedCoordinator(agent, "running" if place == self._mission.robot else "moved", place, "m")
            for agent, place in self._mission.unfinished.items()
        ]
        await self._answer("")
        return found

    async def hold(self, ballot: bytes) -> str:
        """Hold the host."""
        if problem := await self._request():
            return problem
        self._mission.held = ballot
        return await self._answer("")

    async def release(self) -> str:
        """End the hold of the host for any ballot."""
        ballot = self._mission.held
        if problem := await self._request():
            return problem
        if ballot and self._mission.held == ballot:
            self._mission.held = b""
            self._mission.on_release(self._mission.robot)
        return await self._answer("")

    async def is_up(self) -> bool:
        """Whether the host is up."""
        return not await self._request()

    async def condition(self) -> str:
        """Why the host waits."""
        return ""

    async def start_without(self, hosts: list[str]) -> str:
        """The model waits for no other host."""
        return ""

    async def discard(self, mission: str = "", reason: str = "") -> list[str]:
        """End the coordinators in the journal of a host that does not run."""
        await self._request()
        ended = list(self._mission.unfinished)
        self._mission.unfinished.clear()
        self._mission.open_run = b""
        return ended
