"""A simulated robot: a server for its driver. All simulated robots share one plane."""

from __future__ import annotations

import argparse
import asyncio
from collections.abc import Sequence
from contextlib import suppress

from lfield.driver import DeviceBinding
from lfield.errors import AddressError, UsageError
from lfield_arena.field import LAYOUTS
from lfield_arena.plane import CHECK_INTERVAL, HOST, LONGEST, PORTS, Plane, PlaneAccess, open_plane
from lfield_arena.referee import REFEREE
from lfield_arena.world import World
from lfield_sim.fake_server import serve_until_stopped
from lfield_sim.faults import Fault, Faults, add_fault_option

#: Seconds to wait until the drivers have disconnected.
DISCONNECT_TIMEOUT = 5.0

FAULTS = (
    Fault("weak", 1.0, "the remaining share of its grip", 0.0, 1.0),
    Fault("broken", False, "its motors are off, which it reports"),
    Fault("silent", False, "it does not answer"),
)


class Radio:
    """Connects the driver of a robot to the plane, with fault injection."""

    def __init__(self, plane: PlaneAccess, number: str, faults: Faults) -> None:
        self._plane, self._number, self._faults = plane, number, faults
        self._tasks: set[asyncio.Task[None]] = set()
        self._drivers = 0
        faults.watch(self._on_faults_changed)
        self._on_faults_changed()

    async def talk(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Serves a driver: one answer line for each request line."""
        self._drivers += 1
        try:
            while line := (await reader.readline()).decode("ascii", "replace").strip():
                answer = await self._plane.ask(f"{self._number} {line}")
                if not self._faults.get("silent", self._number):
                    writer.write(f"{answer}\n".encode())
        except (OSError, ValueError):
            pass
        finally:
            writer.close()
            self._drivers -= 1

    async def wait_for_disconnect(self) -> None:
        """Waits until all drivers are disconnected: the guard of a killed host still stops its robot."""
        with suppress(TimeoutError):
            async with asyncio.timeout(DISCONNECT_TIMEOUT):
                while self._drivers:
                    await asyncio.sleep(CHECK_INTERVAL)

    def _on_faults_changed(self) -> None:
        task = asyncio.get_running_loop().create_task(self._send_faults())
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _send_faults(self) -> None:
        weak, broken = self._faults.get("weak", self._number), self._faults.get("broken", self._number)
        # If the plane is lost, `talk` closes the connection of the driver.
        with suppress(OSError):
            await self._plane.ask(f"{self._number} wrong {weak} {int(broken)}")


class ArenaSim:
    """The simulated device for `lfield sim arena` and `lfield up --sim`."""

    name = "arena"
    help = "A small robot on a plane with a box, a prey or a ball, shared by all of them on this computer."

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Adds the robot, the plane, the endpoint and the faults."""
        parser.add_argument("--plane", default="box", choices=sorted(LAYOUTS), help="what is on it (box)")
        parser.add_argument(
            "--robot", type=int, default=1, metavar="NUMBER", help="its number (1); 0: the referee"
        )
        parser.add_argument(
            "--world", default="", metavar="TEXT", help="how the plane differs: size=6 prey=2"
        )
        parser.add_argument("--listen", default=f"tcp:{HOST}:0", metavar="tcp:HOST:PORT")
        parser.add_argument("--called", default="", metavar="NAME", help="the name of its binding")
        parser.add_argument("--until-stdin-closes", action="store_true", help="end with who started it")
        add_fault_option(parser)

    def arguments(self, devices: Sequence[DeviceBinding]) -> list[str]:
        """The command line of the simulated robot of a binding, on a free port."""
        device = devices[0]
        robot = REFEREE if device.type == "Whistle" else device.option("robot")
        plane = device.option("plane")
        world = device.option("world")
        return ["--plane", plane, "--robot", str(robot), "--world", world, "--called", device.name]

    def run(self, args: argparse.Namespace) -> int:
        """Serves until it is stopped; returns 0. Raises UsageError and AddressError."""
        asyncio.run(self.serve(args))
        return 0

    async def serve(self, args: argparse.Namespace) -> None:
        """Serves in the running event loop. Raises UsageError and AddressError."""
        kind, _, place = args.listen.partition(":")
        host, _, port = place.rpartition(":")
        if kind != "tcp" or not port.isdecimal():
            raise UsageError(f"'{args.listen}' is not an address to listen at: write tcp:HOST:PORT")
        try:
            world = World.parse(args.world)
        except ValueError as error:
            raise UsageError(f"--world {args.world!r}: {error}") from None
        number, robots = str(args.robot), LAYOUTS[args.plane].of_world(world).robots
        if args.robot not in robots and (args.robot, LAYOUTS[args.plane].ball) != (REFEREE, True):
            known = ", ".join(map(str, robots))
            raise UsageError(f"there is no robot {number} on the plane '{args.plane}'; there are: {known}")
        faults = Faults(FAULTS, {number: args.called})
        faults.apply(args.fault)
        try:
            plane = await open_plane(args.plane, world)
            radio = Radio(plane, number, faults)
            server = await asyncio.start_server(radio.talk, host, int(port), limit=LONGEST)
        except OSError as error:
            addresses = f"{place} or {HOST}:{world.port or PORTS[args.plane]}"
            raise AddressError(addresses, error.strerror or str(error)) from None
        host, port = server.sockets[0].getsockname()[:2]
        places = {number: plane.robots[number].place, **plane.places} if isinstance(plane, Plane) else {}
        await serve_until_stopped(
            "arena",
            f"tcp:{host}:{port}",
            "",
            faults,
            devices={number: args.called},
            until_stdin_closes=args.until_stdin_closes,
            places=places,
        )
        await radio.wait_for_disconnect()
        await plane.leave()


SIM = ArenaSim()
