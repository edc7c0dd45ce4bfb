"""A bench for the Dynamixel driver: a port in memory that is connected to the fake chain."""

from __future__ import annotations

import asyncio
from functools import partial
from typing import Any

from lfield.testing.driver_bench import DriverBench, bind
from lfield_dynamixel import PLUGIN
from lfield_dynamixel.driver import DynamixelDriver
from lfield_sim.dynamixel.ax_series import make_servo
from lfield_sim.dynamixel.servo_chain import ServoChain
from lfield_sim.dynamixel.servo_model import model_named

BAUD = 1_000_000
#: The delay before an answer in seconds: the factory setting.
RETURN_DELAY = 500e-6
START = 1000.0


class MemoryPort:
    """A port that is connected to the fake. Replies arrive after their transmission time."""

    baud, latency = BAUD, 0.0

    def __init__(self, chain: ServoChain) -> None:
        self.chain, self.plugged = chain, True
        self.sent: list[tuple[float, bytes]] = []

    def join(self, endpoint: str, events: Any, note: Any) -> MemoryPort:
        """Return this port. The driver calls this method instead of the constructor of its own port."""
        self.events = events
        return self

    def open(self) -> None:
        pass

    def write(self, data: bytes) -> bool:
        if not self.plugged:
            return False
        loop = asyncio.get_running_loop()
        self.sent.append((loop.time(), data))
        for reply in self.chain.receive(data, loop.time(), BAUD):
            loop.call_at(reply.at, self._deliver, reply.data)
        return True

    def _deliver(self, data: bytes) -> None:
        if self.plugged:
            self.events.received(data)

    def unplug(self) -> None:
        self.plugged = False
        self.events.lost("/dev/ttyTEST is gone (it was unplugged)")

    def plug(self) -> None:
        self.plugged = True
        self.events.back()

    def close(self) -> None:
        pass


class Bench(DriverBench):
    """A chain of simulated servos, and a driver with one device for all of them. `extra` adds devices."""

    def __init__(
        self, *ids: int, fake: str = "XL330-M288", limits=None, safe_state="torque_hold", ttl=0.5,
        extra=(), waivers=(), **options: Any,
    ) -> None:  # fmt: skip
        servo_ids = ids or (1,)
        servos = [make_servo(model_named(fake), START) for _ in servo_ids]
        for number, servo in zip(servo_ids, servos, strict=True):
            servo.start_with(number, BAUD, servo.protocol, RETURN_DELAY)
        self.servos = dict(zip(servo_ids, servos, strict=True))
        self.port = MemoryPort(ServoChain(servos))
        group = len(servo_ids) > 1
        self.binding = bind(
            PLUGIN, "DynamixelGroup" if group else "Dynamixel", agent="alpha", field="joint",
            endpoint=f"serial:/dev/null:{BAUD}", safe_state=safe_state, ttl=ttl, limits=limits or {},
            options={**({"ids": list(servo_ids)} if group else {"id": servo_ids[0]}), **options},
            waivers=list(waivers),
        )  # fmt: skip
        make = partial(DynamixelDriver, make_port=self.port.join)
        super().__init__(PLUGIN, self.binding, *extra, make=make)

    @property
    def chain(self) -> ServoChain:
        return self.port.chain

    @property
    def sent(self) -> list[tuple[float, bytes]]:
        """The packets that the driver has sent, with their times."""
        return self.port.sent

    def fault(self, *texts: str) -> None:
        self.chain.faults.apply(texts)


def call(device: Any, instruction: str, *arguments: object) -> Any:
    """Execute an instruction in the same way as the guard."""
    return device.execute(instruction, arguments)
