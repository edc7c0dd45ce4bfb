"""A bench: the driver and simulated vehicles joined in memory, in virtual time."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from functools import partial
from typing import Any

import pytest

from lfield.driver import DeviceError, Placement
from lfield.simulate.jumping_loop import run_jumping
from lfield.testing.driver_bench import DriverBench, bind
from lfield_mavlink import PLUGIN
from lfield_mavlink.driver import MavlinkDriver
from lfield_sim.autopilot.autopilot import FLAVOURS, Autopilot
from lfield_sim.mavlink.link.radio_link import make_faults
from lfield_sim.mavlink.mavlink_fake import STEP, MavlinkFake
from lfield_sim.mavlink.setup_parameters import setup_parameters as set_up_for
from lfield_sim.mavlink.setup_parameters import station


class MemoryLink:
    """One link of the driver. Packets are handed over in the next turn of the loop.

    `cut` links carry nothing, `refused` ones cannot be opened.
    """

    def __init__(self, bench: Bench, number: int, on_data: Callable[[bytes], None]) -> None:
        self.bench, self.number, self.on_data = bench, number, on_data
        self.cut = self.refused = False
        self.sent: list[bytes] = []
        #: Sets the source address of the next packet.
        self.sender: Callable[[str], None] = lambda address: None
        #: Packets that were sent to one address only.
        self.sent_to: list[tuple[str, bytes]] = []

    async def open(self) -> None:
        if self.refused:
            raise DeviceError("endpoint", f"cannot open link {self.number}")

    def send(self, data: bytes) -> None:
        self.sent.append(data)
        self.bench.sent.append(data)
        if not self.cut:
            asyncio.get_running_loop().call_soon(self._deliver, data)

    def send_to(self, data: bytes, address: str) -> None:
        self.sent_to.append((address, data))
        self.send(data)

    def _deliver(self, data: bytes) -> None:
        for fake in self.bench.fakes.values():
            for packet in fake.receive(f"link {self.number}", data):
                self.bench.filter(self, packet)

    def silence_reason(self) -> str:
        return f"nothing on link {self.number}"

    def close(self) -> None:
        pass


class Bench(DriverBench):
    """Fakes and a driver for them; the fakes are set up for their bindings unless a test wants them stock."""

    def __init__(
        self,
        *,
        kind: str = "copter",
        flavour: str = "ardupilot",
        faults: tuple[str, ...] = (),
        limits: dict[str, float] | None = None,
        options: dict[str, Any] | None = None,
        safe_state: str = "land",
        ttl: float = 0.5,
        waivers: tuple[str, ...] = ("device_watchdog", "autonomous_motion"),
        systems: tuple[int, ...] = (1,),
        links: int = 1,
        set_up: bool = True,
        frame: Placement | None = None,
        endpoint: str = "",
        **autopilot: Any,
    ) -> None:
        self.faults = make_faults(*faults, systems=systems)
        vehicle = FLAVOURS[flavour].get(kind, FLAVOURS[flavour]["copter"])
        self.fakes = {
            system: MavlinkFake(Autopilot(vehicle, **autopilot), system=system, faults=self.faults)
            for system in systems
        }
        for fake in self.fakes.values() if set_up else ():
            speed = (limits or {}).get("speed")
            own = (options or {}).get("station") or station(fake.system)
            expected = set_up_for(flavour, vehicle.name, safe_state, ttl, speed, station=own)
            fake.autopilot.parameters.update(expected)
            fake.autopilot.apply_parameters()
        self.autopilot = self.fakes[systems[0]].autopilot
        self.sent: list[bytes] = []
        self.links: list[MemoryLink] = []
        self.refused: set[int] = set()
        #: Delivers a packet of a fake to the driver; a test may replace it.
        self.filter: Callable[[MemoryLink, bytes], None] = lambda link, packet: link.on_data(packet)
        settings = {"system": 1, "kind": kind, "connect": 5.0, "tolerance": 0.5, **(options or {})}
        bindings = [
            bind(
                PLUGIN, agent=f"a{system}", field="fc", safe_state=safe_state,
                endpoint=endpoint or ", ".join(f"udp:127.0.0.1:{port}" for port in range(1, links + 1)),
                ttl=ttl,
                limits=limits or {}, options={**settings, "system": system}, waivers=list(waivers),
                frame=frame,
            )
            for system in systems
        ]  # fmt: skip
        super().__init__(PLUGIN, *bindings, make=self._make_driver, fakes=[self._fly])

    def _make_driver(self, *given: Any) -> MavlinkDriver:
        bench = self

        class OnFakes(MavlinkDriver):
            def _make_link(self, endpoint, on_data):
                link = MemoryLink(bench, len(bench.links), on_data)
                link.refused = link.number in bench.refused
                link.sender = partial(self._from, link.number)
                bench.links.append(link)
                return link

        return OnFakes(*given)

    @property
    def cut(self) -> bool:
        return all(link.cut for link in self.links)

    @cut.setter
    def cut(self, cut: bool) -> None:
        for link in self.links:
            link.cut = cut

    async def _fly(self) -> None:
        while True:
            await asyncio.sleep(STEP)
            for fake in self.fakes.values():
                packets = fake.advance(STEP)
                for link in self.links:
                    for packet in packets if not link.cut else ():
                        self.filter(link, packet)


@pytest.fixture
def bench() -> type[Bench]:
    return Bench


@pytest.fixture
def jumping() -> Callable[[Any], Any]:
    """Runs a coroutine in virtual time."""

    def run(work: Any) -> Any:
        return run_jumping(work)

    return run
