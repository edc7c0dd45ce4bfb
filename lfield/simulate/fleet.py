"""A team on simulated computers: its hosts and guards are the real ones, what they stand on is a model.

Sockets, pipes, disks, clocks and hardware are models; links, greetings, machine, mobility, guards and the way
a host ends are what runs on a robot. One seed is one run, to the byte.
"""

from __future__ import annotations

import hashlib
import io
import random
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

from msgspec import structs

from lfield import exits
from lfield.driver.binding import DeviceBinding
from lfield.driver.known import KnownDrivers
from lfield.errors import JournalError, LfieldError
from lfield.host.core import HostCore
from lfield.host.host import Host
from lfield.host.logbook import Logbook
from lfield.host.process.run import live
from lfield.host.process.stop_words import StopWords
from lfield.host.surroundings import Options
from lfield.journal.pages import Page
from lfield.mission.mission import Mission
from lfield.net.tcp import TcpTransport
from lfield.simulate.computers.computer import Computer, Process
from lfield.simulate.computers.loop import generators, release
from lfield.simulate.computers.machines import Machine
from lfield.simulate.computers.network import Network
from lfield.simulate.computers.timeline import Timeline
from lfield.simulate.disk import JournalDisk
from lfield.simulate.hardware import REFERENCE, Hardware, guard
from lfield.simulate.network import resident

#: By how much clocks run fast or slow at most.
CLOCKS = 0.01
#: Where every host listens on its machine.
PORT = 8181
#: Seconds that the machine of L takes for an instruction, and besides for each turn of a thread: seven times
#: what the reference engine takes on a computer on a desk, as small computers of robots do.
INSTRUCTION, TURN = 1e-6, 50e-6

Watch = Callable[["Fleet"], None]
Born = Callable[[str, "Life"], None]
Plug = Callable[["Fleet", Mission, random.Random], Mission]


@dataclass(frozen=True, slots=True)
class Life:
    """One life of one host: its process, and the host itself."""

    process: Process
    host: Host
    #: What it is told when it is to end.
    words: StopWords

    @property
    def core(self) -> HostCore:
        """What decides in it."""
        return self.host.core


class Fleet:
    """The hosts of a mission, all up at the beginning. Everything that is left to chance comes from `seed`.

    `watch` is called after every event, and raises AssertionError for what must never be; `born` with every
    life of a host before anything happens in it. With `lost_after` hosts end when all coordinators have, as
    with --until-done. They keep journals, unless told not to. `plug` says what
    hardware there is, and gives the mission with its endpoints. Code takes `slowness` times the processor
    time that it usually takes. Times are in seconds.
    """

    def __init__(
        self,
        mission: Mission,
        seed: int = 0,
        watch: Watch = lambda fleet: None,
        unreachable_after: float = 10.0,
        lost_after: float | None = None,
        keeps: bool = True,
        born: Born = lambda name, life: None,
        plug: Plug | None = None,
        slowness: float = 1.0,
    ) -> None:
        self._watch, self._born, self.keeps = watch, born, keeps
        self._slowness = slowness
        self._unreachable_after, self._lost_after = unreachable_after, lost_after
        dice = random.Random(seed)
        self.timeline = Timeline()
        #: Every line of program output and of the logs: seconds, host, text.
        self.log: list[tuple[float, str, str]] = []
        names = mission.team.hosts
        self.machines = {name: self._machine(name, dice) for name in names}
        self.network = Network(self.timeline, self.machines, dice)
        programs = {"lfield.guard.process": guard}
        self.computers = {m.name: Computer(m, self.network, programs) for m in self.machines.values()}
        self.disks = {name: JournalDisk(random.Random(dice.random())) for name in names}
        #: The hosts that may have done something of which their disk has nothing. Whoever set the team up
        #: says of any other that it is started for the first time, until it has kept something.
        self._known: set[str] = set()
        #: What any driver drives, by the names of devices that share it.
        self.hardware: dict[str, Hardware] = {}
        self.mission = (plug or plug_any_hardware)(self, mission, dice).at(
            mission.team.at({name: f"{name}:{PORT}" for name in names})
        )
        #: The hosts that run now; the exit statuses of those that have ended by themselves.
        self.lives: dict[str, Life] = {}
        self.left: dict[str, int] = {}
        #: The hosts that ended because of a bug of ours; those whose disk was replaced.
        self.failed: set[str] = set()
        self.replaced: set[str] = set()
        #: Those that never come back.
        self.gone: set[str] = set()
        #: Computers that are no hosts of the mission, such as an operator's.
        self.stations: list[Computer] = []
        for name in names:
            self.boot(name)

    def _machine(self, name: str, dice: random.Random) -> Machine:
        rate = 1.0 + dice.uniform(-CLOCKS, CLOCKS)
        return Machine(name, self.timeline, random.Random(dice.random()), rate)

    # --- time -----------------------------------------------------------------------------------------

    @property
    def now(self) -> float:
        """True time, in seconds since the simulation began."""
        return self.timeline.now

    def later(self, seconds: float, event: Callable[[], None]) -> None:
        """Let something happen after so many seconds."""
        self.timeline.after(seconds, event)

    def run(self, seconds: float) -> None:
        """Let time go on for so long."""
        with generators():
            self.timeline.run(seconds, partial(self._watch, self))

    @property
    def digest(self) -> str:
        """What tells one run from another: the hash of all that was said, and when."""
        lines = (f"{at:.9f} {host} {text}\n" for at, host, text in self.log)
        return hashlib.sha256("".join(lines).encode()).hexdigest()

    # --- hosts ----------------------------------------------------------------------------------------

    def boot(self, name: str) -> None:
        """Start a host's process, and its computer if that is off; nothing is left of an earlier life.

        What is gone for good stays so.
        """
        if name in self.gone:
            return
        computer = self.computers[name]
        if not computer.machine.on:
            computer.power_on()
        process = computer.start()
        process.on_end = partial(self._ended, name, process)
        process.loop.enter(partial(self._begin, name, process))

    def crash(self, name: str) -> None:
        """Kill a host's process, as by SIGKILL."""
        self.lives[name].process.die(-9)

    def stop(self, name: str) -> None:
        """Tell a host to end, as by SIGTERM."""
        self.lives[name].process.loop.enter(self.lives[name].words.say)

    def power_off(self, name: str) -> None:
        """Its computer is gone with all that runs there, and tells nobody."""
        self.computers[name].power_off()
        self.lives.pop(name, None)

    def lose(self, name: str) -> None:
        """Its computer is gone for good, and tells nobody."""
        self.gone.add(name)
        self.power_off(name)

    @property
    def pages_left(self) -> list[Page]:
        """What is on the disks of those hosts that are not gone for good."""
        return [page for name, disk in self.disks.items() if name not in self.gone for page in disk.pages()]

    def close(self) -> None:
        """End all that runs, at once, and free its memory."""
        for name in self.computers:
            self.power_off(name)
        for station in self.stations:
            station.power_off()
        for computer in [*self.computers.values(), *self.stations]:
            release(computer.machine)

    def lose_disk(self, name: str) -> None:
        """Its disk is replaced by an empty one."""
        self.disks[name].replace()
        self.replaced.add(name)
        self._known.add(name)

    def _begin(self, name: str, process: Process) -> None:
        machine, disk, book = self.machines[name], self.disks[name], Book(self, name, process)
        try:
            journal = disk.open(machine.clock, book.note) if self.keeps else None
        except JournalError as error:
            book.note(str(error))
            process.exit(error.exit_status)
            return
        options = Options(
            listen=f"{name}:{PORT}",
            clock=machine.clock,
            dice=random.Random(machine.dice.random()),
            unreachable_after=self._unreachable_after,
            journal=journal,
            first_start=name not in self._known and not disk.pages(),
            draw=random.Random(f"orders {name} {machine.clock.monotonic()}").randbytes,
        )
        if not self.keeps:
            self._known.add(name)
        transport = TcpTransport(self.mission.max_block, resident=resident, busy=float)
        host = Host(self.mission, name, transport, Logbook(book, book), options)
        life = self.lives[name] = Life(process, host, StopWords(host.clock))
        host.machine.attached.meter = lambda n: process.loop.compute(
            self._slowness * (TURN + n * INSTRUCTION)
        )
        self._born(name, life)
        # A moment later: whoever makes a team of hosts has it before any of them does anything.
        process.loop.soon(lambda: process.loop.create_task(self._live(name, life)))

    async def _live(self, name: str, life: Life) -> None:
        try:
            status = await live(life.host, life.words, self._lost_after)
        except LfieldError as error:
            # It could not even start, as when a guard died meanwhile: whoever keeps it up tries again.
            life.host.note(str(error))
            life.process.exit(error.exit_status)
            return
        if life.host.failure is not None:
            self.failed.add(name)
        if not life.words.first.is_set():
            self.left[name] = status
        life.process.exit(status)

    def _ended(self, name: str, process: Process, _: int) -> None:
        if name in self.lives and self.lives[name].process is process:
            del self.lives[name]

    def recall(self, only: int | None = None) -> None:
        """Start those again that gave up and ended by themselves, as whoever looks after the team does.

        `only` those that ended with this status; without it all whose mission is not done.
        """
        for name, status in list(self.left.items()):
            if status == only or (only is None and status != exits.DONE):
                del self.left[name]
                self.boot(name)

    def station(self, name: str, dice: random.Random) -> Process:
        """A process on a computer that is no host, with a network address of its own."""
        machine = Machine(name, self.timeline, dice)
        self.network.join(machine)
        self.stations.append(Computer(machine, self.network, {}))
        return self.stations[-1].start()

    # --- links ----------------------------------------------------------------------------------------

    def cut(self, one: str, other: str) -> None:
        """Break what connects two computers, both are told, and let nothing through until `heal`."""
        self.network.reset(one, other)
        self.network.silence(one, other)
        self.network.silence(other, one)

    def heal(self, one: str, other: str) -> None:
        """Let everything through again, and first what has waited."""
        self.network.heal(one, other)
        self.network.heal(other, one)

    def heal_all(self) -> None:
        """All ways speak, all processes run, and all hosts that did not end by themselves are up."""
        self.network.heal_all()
        for computer in self.computers.values():
            for process in list(computer.processes):
                process.loop.thaw()
        for name in self.computers:
            if name not in self.lives and name not in self.left:
                self.boot(name)


def plug_any_hardware(fleet: Fleet, mission: Mission, dice: random.Random) -> Mission:
    """The mission with a device of this simulation in the place of each; its driver is that of any device."""
    endpoints: dict[str, str] = {}
    for (host, *_), devices in buses_of(mission).items():
        made = Hardware(fleet.timeline, random.Random(dice.random()))
        endpoint = f"virtual:{devices[0].endpoint}"
        fleet.machines[host].hardware[endpoint] = made
        fleet.hardware[devices[0].name] = made
        endpoints |= {device.name: endpoint for device in devices}
    simulated = {
        name: replace(driver, reference=REFERENCE, files={})
        for name, driver in mission.drivers.by_driver.items()
    }
    return replace(at_endpoints(mission, endpoints), drivers=KnownDrivers(simulated))


def buses_of(mission: Mission) -> Mapping[tuple[str, str, str], Sequence[DeviceBinding]]:
    """The devices of a mission by host, driver and endpoint: two hosts have two buses of one name."""
    hosts = {member.id: mission.team.hosts[member.host] for member in mission.team.members}
    buses: dict[tuple[str, str, str], list[DeviceBinding]] = {}
    for device in mission.bindings.all:
        buses.setdefault((hosts[device.agent], *device.bus), []).append(device)
    return buses


def at_endpoints(mission: Mission, endpoints: Mapping[str, str]) -> Mission:
    """The mission with its devices, by their names, at other endpoints."""
    bound = {
        agent: {field: structs.replace(d, endpoint=endpoints[d.name]) for field, d in fields.items()}
        for agent, fields in mission.bindings.devices.items()
    }
    return replace(mission, bindings=replace(mission.bindings, devices=bound))


class Book(io.StringIO):
    """Both streams of a host's process, into the log of the simulation."""

    def __init__(self, fleet: Fleet, name: str, process: Process) -> None:
        super().__init__()
        self._fleet, self._name, self._process = fleet, name, process

    def write(self, text: str) -> int:
        """A piece of either."""
        if not self._process.loop.dead:
            self._fleet.log.append((self._fleet.now, self._name, text))
        return len(text)

    def note(self, text: str) -> None:
        """A line of the log."""
        self.write(f"{text}\n")


def copies(fleet: Fleet) -> Mapping[tuple[str, int], list[str]]:
    """The hosts on which each start of each coordinator can run now: agent and generation, host names."""
    found: dict[tuple[str, int], list[str]] = {}
    for name, life in fleet.lives.items():
        for agent in life.core.machine.agents.values():
            if agent.member.kind == "coordinator" and not agent.frozen and not agent.ended:
                found.setdefault((agent.id, agent.generation), []).append(name)
    return found
