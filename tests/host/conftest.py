"""A fleet in one process: hosts on one event loop in virtual time, joined by the in-memory network."""

from __future__ import annotations

import asyncio
import io
import random
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest
from memory_network import MemoryNetwork
from msgspec.structs import replace

from lfield.host.environment import HostOptions
from lfield.host.host import Host
from lfield.host.logbook import Logbook
from lfield.manifest import Observation
from lfield.mission.bindings import MissionStart
from lfield.mission.loader import load_mission
from lfield.mission.mission import ON_GROUND, Mission
from lfield.simulate.journal_disk import JournalDisk
from lfield.simulate.jumping_loop import LoopClock, run_jumping

#: Seconds of virtual time until a test fails.
TIMEOUT = 60.0


class Running:
    """A host that was started, with its output and log."""

    def __init__(self, host: Host, out: io.StringIO, err: io.StringIO) -> None:
        self.host, self._out, self._err = host, out, err
        self.starting: asyncio.Task[None] | None = None

    @property
    def output(self) -> list[str]:
        return self._out.getvalue().splitlines()

    @property
    def log(self) -> str:
        return self._err.getvalue()

    def holds(self, agent: str) -> bool:
        return agent in self.host.machine.agents


class Fleet:
    """The hosts of missions in a folder. `max_block` is the largest block of a link."""

    def __init__(self, folder: Path, max_block: int = 1 << 20) -> None:
        self.folder = folder
        self.network = MemoryNetwork(LoopClock(), max_block=max_block, on_pending=self._pending)
        self.running: list[Running] = []
        # Each run of a test draws the same numbers; two starts of one host draw different ones.
        self._rng = random.Random(0)
        #: The disk of each host that keeps a journal; see `make`.
        self.disks: dict[str, JournalDisk] = {}

    def mission(
        self,
        program: str,
        deployment: str,
        devices: str = "",
        name: str = "mission",
        *,
        capabilities: str = "",
        access: str = "",
        simulate: bool = False,
        without: tuple[str, ...] = (),
    ) -> Mission:
        """Write the files of a mission and read them as `lfield up` does; no start waits for `without`."""
        self.folder.mkdir(exist_ok=True)
        files = {
            ".L": program,
            ".dL": deployment,
            ".devices.yaml": devices,
            ".capabilities.yaml": capabilities,
            ".access.yaml": access,
        }
        for ending, text in files.items():
            if text:
                (self.folder / (name + ending)).write_text(text)
        mission = load_mission(self.folder / f"{name}.dL", simulate=simulate)
        return mission.with_bindings(replace(mission.bindings, start=MissionStart(without)))

    def make(self, mission: Mission, name: str, *, address: str = "", **options: Any) -> Running:
        """A host, not yet started. With `keeps` it has a journal, on its disk."""
        out, err = io.StringIO(), io.StringIO()
        listen = address or mission.team.addresses[mission.team.number(name)]
        options.setdefault("first_start", True)
        if options.pop("keeps", False):
            disk = self.disks.setdefault(name, JournalDisk(random.Random(name)))
            options["journal"] = disk.open(LoopClock(), err.write)
        rng = random.Random(self._rng.random())
        options = {"rng": rng, "random_bytes": rng.randbytes, **options}
        made = HostOptions(listen, clock=options.pop("clock", None) or LoopClock(), **options)
        transport = self.network.transport(name)
        running = Running(Host(mission, name, transport, Logbook(out, err), made), out, err)
        self.running.append(running)
        return running

    def on_the_ground(self, running: Running) -> None:
        """Each vehicle of a host reports that it is on the ground, as a start requires."""
        host, guards = running.host, running.host.guards
        landed = {device.name: {ON_GROUND: True} for device in host.mission.devices_of(host.name)}
        guards.__class__ = type("OnTheGround", (type(guards),), {"telemetry": landed})
        last = guards.last
        guards.last = lambda device, quantity: (
            Observation(True, host.clock.monotonic()) if quantity == ON_GROUND else last(device, quantity)
        )

    async def up(self, mission: Mission, *names: str, **options: Any) -> list[Running]:
        """Start hosts at the same time; all hosts of the deployment by default."""
        started = [self.make(mission, name, **options) for name in names or mission.team.hosts]
        await asyncio.gather(*(running.host.start() for running in started))
        return started

    async def until(self, condition: Callable[[], Any]) -> None:
        """Let virtual time pass until the condition is true."""
        async with asyncio.timeout(TIMEOUT):
            while not condition():
                await asyncio.sleep(0.01)

    async def ended(self, agent: str) -> str:
        """The outcome of a coordinator, as soon as any host has it."""
        outcomes: list[str] = []

        def known() -> bool:
            outcomes[:] = [
                known.outcome
                for running in self.running
                for known in running.host.mobility.known_states()
                if known.agent == agent and known.state == "EXITED"
            ]
            return bool(outcomes)

        await self.until(known)
        return outcomes[0]

    async def stop(self) -> None:
        for running in self.running:
            await running.host.stop()

    def _pending(self) -> None:
        loop = asyncio.get_running_loop()
        due = self.network.next_due()
        assert due is not None
        loop.call_at(due, self.network.run)


@pytest.fixture
def fleet(tmp_path: Path):
    """`fleet(scenario)` runs a coroutine function with a Fleet in virtual time, then stops its hosts."""

    def run(scenario: Callable[[Fleet], Awaitable[None]], **options: Any) -> Fleet:
        async def main() -> Fleet:
            made = Fleet(tmp_path / "mission", **options)
            try:
                await scenario(made)
            finally:
                await made.stop()
            return made

        return run_jumping(main())

    return run


@pytest.fixture
def runner(fleet):
    """Tests that are coroutine functions get a Fleet: `async def test(team, /)`."""
    return fleet
