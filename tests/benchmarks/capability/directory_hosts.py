"""The processes of the figure `directory`: one host of a large team, and all the others in one process.

    directory_hosts.py host FOLDER SWING SECONDS      prints what it took: seconds of processor, and seconds
    directory_hosts.py others FOLDER SWING SECONDS    prints the bytes from the host, to it, and seconds

The host is a real one but for its devices: telemetry swings with time. The others have real links and real
directories, and say what real hosts would.
"""

from __future__ import annotations

import asyncio
import math
import random
import sys
import time
from pathlib import Path
from typing import Any
from unittest import mock

from lfield.capability.directory.agent_directory import AgentDirectory
from lfield.capability.directory.directory_delta import AgentCondition, AttributeSample
from lfield.clock import SystemClock
from lfield.devices.device_guards import DeviceGuards
from lfield.event_loop import run
from lfield.host.directory_updates.directory_codec import DirectoryCodec
from lfield.host.environment import HostOptions
from lfield.host.host import Host
from lfield.host.logbook import Logbook
from lfield.host.team_directory import SAMPLE_EVERY
from lfield.hybrid_clock import HybridClock
from lfield.manifest import Observation
from lfield.mission.loader import load_mission
from lfield.mission.mission import Mission
from lfield.net import framed_link
from lfield.net.framed_link import FramedLink
from lfield.net.link_manager import LinkManager
from lfield.net.link_owner import TeamAddresses
from lfield.net.tcp_transport import TcpTransport
from lfield.net.transport import Link
from lfield.wire.coordinator_messages import Transfer
from lfield.wire.messages import Control, Hello, Message

#: Seconds between the last link and the measurement.
SETTLE = 3.0


def telemetry(swing: float) -> float:
    """A number that is another one in every second, unless `swing` is 0."""
    return 0.5 + swing * math.sin(time.monotonic())


async def measured_host(mission: Mission, swing: float, seconds: float) -> None:
    """The first host of the mission, with devices that only report."""

    async def opened(self: DeviceGuards, devices: Any, recording: Any = None) -> None:
        pass

    def last(self: DeviceGuards, device: str, quantity: str) -> Observation:
        number = telemetry(swing)
        value = number if quantity == "battery" else (number, number, number)
        return Observation(value, time.monotonic() - 0.05)

    with mock.patch.multiple(DeviceGuards, open=opened, last=last, trouble=lambda self, device: None):
        team = mission.team
        options = HostOptions(team.addresses[0])
        host = Host(mission, team.hosts[0], TcpTransport(mission.max_block), Logbook(), options)
        await host.start()
        while len(host.peers.incarnations) < len(team.hosts) - 1:
            await asyncio.sleep(0.1)
        await asyncio.sleep(SETTLE)
        processor, start = time.process_time(), time.monotonic()
        await asyncio.sleep(seconds)
        print(time.process_time() - processor, time.monotonic() - start, flush=True)
        known = sum(
            len(candidate.unknown) == 0 for candidate in host.core.directory.directory.all_candidates()
        )
        print(known, flush=True)


class Other:
    """One of the other hosts."""

    def __init__(self, mission: Mission, number: int, swing: float) -> None:
        team, self._mission, self._swing = mission.team, mission, swing
        self._name, self._first = team.hosts[number], team.hosts[0]
        self._clock, self.hybrid_clock = SystemClock(), HybridClock(0.0, 0.0)
        self._phase = SAMPLE_EVERY * number / len(team.hosts)
        addresses = [team.addresses[0], team.addresses[number]]
        transport = TcpTransport(mission.max_block)
        hosts = TeamAddresses({self._first: 0, self._name: 1}, addresses, 1, [self._first])
        self.peers = LinkManager(self, transport, self._clock, random.Random(number), hosts)
        assert mission.registry is not None
        agents = mission.team.deployed
        self._directory = AgentDirectory(mission.registry, agents, self._name, self.peers, self._clock)
        self._reports = DirectoryCodec(mission.registry, agents)

    async def start(self) -> None:
        """Listen, and report from now on."""
        await self.peers.open(self._mission.team.addresses[self._mission.team.number(self._name)])
        asyncio.get_running_loop().call_later(self._phase, self._tell)

    def _tell(self) -> None:
        for agent in self._directory.own_agents:
            value, now = telemetry(self._swing), self._clock.monotonic()
            samples = {name: AttributeSample(value, now - 0.05, now) for name in self._directory.live(agent)}
            self._directory.set_own(agent, AgentCondition(samples=samples))
        news = self._directory.next_delta()
        if news is not None:
            self.peers.send(self._first, self._reports.encode(news, self._clock.monotonic()))
        asyncio.get_running_loop().call_later(SAMPLE_EVERY, self._tell)

    def hello(self) -> Hello:
        """As a host of the mission says it."""
        mission = self._mission
        assert mission.registry is not None
        program, team = mission.program.digest, mission.team.deployment
        return Hello("host", self._name, 1, program, team, mission.max_block, [], mission.registry.digest)

    def on_linked(self, hello: Hello) -> None:
        """The measured host knows all there is."""
        news = self._directory.full_delta()
        if news is not None:
            self.peers.send(hello.host, self._reports.encode(news, self._clock.monotonic()))

    def on_unlinked(self, host: str, *, quietly: bool) -> None:
        """Nothing is to be done."""

    def desired_hosts(self) -> list[str]:
        """It has a link with the measured host only."""
        return [self._first]

    def on_message(self, host: str, message: Control, link: Link) -> None:
        """What the measured host reports is not looked at."""

    def on_transfer(self, host: str, header: Transfer, block: memoryview) -> None:
        """No coordinator ever comes."""

    def on_oversize(self, host: str, header: Transfer, size: int) -> None:
        """No coordinator ever comes."""

    def note(self, text: str) -> None:
        """For whoever looks for a mistake here."""
        print(f"{self._name}: {text}", file=sys.stderr)


async def other_hosts(mission: Mission, swing: float, seconds: float) -> None:
    """All hosts but the first, which count what comes and goes."""
    came = went = 0
    receive, encoded = FramedLink.received, framed_link.encode

    def received(self: FramedLink, data: Any) -> None:
        nonlocal came
        came += len(data)
        receive(self, data)

    def encode(message: Message) -> bytes:
        nonlocal went
        data = encoded(message)
        went += len(data)
        return data

    with (
        mock.patch.object(FramedLink, "received", received),
        mock.patch.object(framed_link, "encode", encode),
    ):
        others = [Other(mission, number, swing) for number in range(1, len(mission.team.hosts))]
        for other in others:
            await other.start()
        while not all(other.peers.incarnations for other in others):
            await asyncio.sleep(0.1)
        await asyncio.sleep(SETTLE)
        before, start = (came, went), time.monotonic()
        await asyncio.sleep(seconds)
        print(came - before[0], went - before[1], time.monotonic() - start, flush=True)
        await asyncio.sleep(seconds)


def main() -> None:
    """Be one of the two."""
    role, folder, swing, seconds, *maps = sys.argv[1:]
    mission = load_mission(Path(folder) / "large.dL", maps=maps, simulate=True)
    work = measured_host if role == "host" else other_hosts
    run(work(mission, float(swing), float(seconds)))


if __name__ == "__main__":
    main()
