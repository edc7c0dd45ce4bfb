"""The plane as a fake: one for all robots that are on it, whichever host they hang on.

Every host starts the fakes of its own robots. The first that runs serves the plane: a port for each robot, and
one where the other fakes join it, to pass on what is wrong with theirs. The plane is there until everybody has
left it, so it outlives the computer that has begun it.
"""

from __future__ import annotations

import argparse
import asyncio
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial

from lfield.driver import DeviceBinding
from lfield_arena.field import LAYOUTS, Field
from lfield_arena.robot import Robot
from lfield_sim.faults import Fault, Faults, add_fault_option
from lfield_sim.serving import serve_until_told

#: Seconds of a step of the plane, and the longest line.
TICK, LONGEST = 0.01, 4096
#: Where fakes join each plane; its robots have the ports after that, by their numbers.
HOST, PORTS = "127.0.0.1", {"box": 7100, "hunt": 7200}

FAULTS = (
    Fault("weak", 1.0, "the share of its grip that is left", 0.0, 1.0),
    Fault("broken", False, "its motors are off, and it says so"),
    Fault("silent", False, "it does not answer"),
)


class Plane:
    """The plane with its robots and what is wrong with them."""

    def __init__(self, layout: str) -> None:
        self._port, self.field = PORTS[layout], Field.of(LAYOUTS[layout])
        self.robots = {str(number): Robot(self.field, number) for number in self.field.robots}
        self.faults = Faults(FAULTS, list(self.robots))
        self._guests = 0
        self._empty = asyncio.Event()

    def step(self) -> None:
        """Let a tick pass."""
        for number, robot in self.robots.items():
            weak, broken = self.faults.get("weak", number), self.faults.get("broken", number)
            robot.step(TICK, weak=weak, broken=broken)
        self.field.step(TICK)

    async def live(self) -> None:
        """Step for ever."""
        while True:
            await asyncio.sleep(TICK)
            self.step()

    async def serve(self) -> None:
        """Listen at all ports. Raises OSError where the plane is there already."""
        serve = partial(asyncio.start_server, host=HOST, limit=LONGEST)
        await serve(partial(self._talk, self._join), port=self._port)
        for number in self.robots:
            await serve(partial(self._talk, partial(self._answer, number)), port=self._port + int(number))

    async def left(self) -> None:
        """Wait until nobody is connected."""
        while self._guests:
            await self._empty.wait()

    def _join(self, line: str) -> str:
        self.faults.apply([line])
        return "ok"

    def _answer(self, number: str, line: str) -> str:
        return "" if self.faults.get("silent", number) else self.robots[number].answer(line)

    async def _talk(
        self, answer: Callable[[str], str], reader: asyncio.StreamReader, writer: asyncio.StreamWriter
    ) -> None:
        """Serve one guest: the driver of a robot, or a fake that has joined."""
        self._guests += 1
        self._empty.clear()
        try:
            while line := (await reader.readline()).decode("ascii", "replace").strip():
                if said := answer(line):
                    writer.write(f"{said}\n".encode())
        except (OSError, ValueError):
            pass
        finally:
            writer.close()
            self._guests -= 1
            if not self._guests:
                self._empty.set()


class ArenaSim:
    """The fake for `lfield sim arena` and `lfield up --sim`."""

    name = "arena"
    help = "A small robot on a plane with a box or a prey; there is one plane for all robots of this computer."

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Which robot on which plane, and what is wrong with it."""
        parser.add_argument("--plane", default="box", choices=sorted(LAYOUTS), help="what is on it (box)")
        parser.add_argument("--robot", type=int, default=1, choices=range(1, 5), help="its number (1)")
        parser.add_argument("--called", default="", metavar="NAME", help="the name of its binding")
        parser.add_argument("--until-stdin-closes", action="store_true", help="end with who started it")
        add_fault_option(parser)

    def arguments(self, devices: Sequence[DeviceBinding]) -> list[str]:
        """The robot of a binding."""
        device = devices[0]
        plane, robot = device.option("plane"), device.option("robot")
        return ["--plane", plane, "--robot", str(robot), "--called", device.name]

    def run(self, args: argparse.Namespace) -> int:
        """Serve until told to end."""
        return asyncio.run(_serve(args))


async def _serve(args: argparse.Namespace) -> int:
    number, port = str(args.robot), PORTS[args.plane]
    faults = Faults(FAULTS, {number: args.called})
    faults.apply(args.fault)
    plane = Plane(args.plane)
    tasks = [asyncio.create_task(plane.live())]
    with suppress(OSError):
        await plane.serve()
    tasks.append(asyncio.create_task(_join(port, faults, number)))
    ends = args.until_stdin_closes
    await serve_until_told(
        "arena", f"tcp:{HOST}:{port + args.robot}", "", faults, devices={number: args.called},
        until_stdin_closes=ends,
    )  # fmt: skip
    tasks.pop().cancel()
    await plane.left()
    return 0


async def _join(port: int, faults: Faults, number: str) -> None:
    """Tell the plane what is wrong with a robot, and again when it changes."""
    reader, writer = await asyncio.open_connection(HOST, port)
    changed = asyncio.Event()
    faults.watch(changed.set)
    try:
        while True:
            for fault in FAULTS:
                value = str(faults.get(fault.name, number)).lower()
                writer.write(f"{fault.name}@{number}={value}\n".encode())
                await reader.readline()
            await changed.wait()
            changed.clear()
    finally:
        writer.close()


SIM = ArenaSim()
