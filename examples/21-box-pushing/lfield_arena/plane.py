"""The plane, which all simulated robots of a computer share.

The first simulated robot creates the plane and serves it at a port; the others connect to this port. In a
test with virtual time, all simulated robots use one plane directly.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable
from functools import partial
from typing import Protocol

from lfield.event_loop import SimulatedLoop
from lfield_arena.box import WIDTH
from lfield_arena.field import LAYOUTS, Field, Prey
from lfield_arena.referee import REFEREE, Referee
from lfield_arena.robot import Robot
from lfield_arena.world import World

#: Seconds: duration of a step; interval of checks for clients. Bytes: maximum length of a line.
TICK, CHECK_INTERVAL, LONGEST = 0.01, 0.1, 4096
#: The address of each plane; a port in the world has precedence.
HOST, PORTS = "127.0.0.1", {"box": 7100, "hunt": 7200, "pitch": 7300}
Place = tuple[float, float, float]


class PlaneAccess(Protocol):
    """The access of a simulated robot to the plane."""

    async def ask(self, line: str) -> str:
        """Sends a request of a robot to the plane, `NUMBER REQUEST`; returns the answer. Raises OSError."""

    async def leave(self) -> None:
        """Ends the access. The process with the plane waits until all others have left."""


class Plane:
    """The plane in this process."""

    def __init__(self, layout: str, world: World) -> None:
        self.field = Field.from_layout(LAYOUTS[layout].of_world(world), world)
        robots = {str(number): Robot(self.field, number) for number in self.field.robots}
        self.robots: dict[str, Robot | Referee] = {**robots}
        if self.field.ball is not None:
            self.robots[str(REFEREE)] = Referee(self.field)
        self._clients = 0
        self._task = asyncio.get_running_loop().create_task(self._run())

    @property
    def places(self) -> dict[str, Callable[[], Place]]:
        """Positions of objects other than robots: metres north, east and up, by name."""
        if self.field.all_prey:
            names = ("prey", *(f"prey {n}" for n in range(2, 1 + len(self.field.all_prey))))
            return {
                name: partial(_prey_place, prey)
                for name, prey in zip(names, self.field.all_prey, strict=True)
            }
        if self.field.box is None:
            return {"ball": lambda: (*self.field.targets[0][:2], 0.0)}
        ends = {"box": 0.0, "box, left end": -WIDTH / 2.0, "box, right end": WIDTH / 2.0}
        return {name: partial(self._point_of_box, aside) for name, aside in ends.items()}

    def _point_of_box(self, aside: float) -> Place:
        north, east, heading = self.field.targets[0]
        return north - aside * math.sin(heading), east + aside * math.cos(heading), 0.0

    async def serve(self, port: int) -> None:
        """Accepts other simulated robots. Raises OSError if there is already a plane."""
        await asyncio.start_server(self._talk, HOST, port, limit=LONGEST)

    async def ask(self, line: str) -> str:
        """See PlaneAccess."""
        number, _, request = line.partition(" ")
        return self.robots[number].answer(request)

    async def leave(self) -> None:
        """See PlaneAccess."""
        while self._clients:
            await asyncio.sleep(CHECK_INTERVAL)
        self._task.cancel()

    async def _run(self) -> None:
        while True:
            await asyncio.sleep(TICK)
            for robot in self.robots.values():
                robot.step(TICK)
            self.field.step(TICK)

    async def _talk(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._clients += 1
        try:
            while line := (await reader.readline()).decode("ascii", "replace").strip():
                writer.write(f"{await self.ask(line)}\n".encode())
        except (OSError, ValueError, KeyError):
            pass
        finally:
            writer.close()
            self._clients -= 1


def _prey_place(prey: Prey) -> Place:
    return *prey.place, 0.0


class RemotePlane:
    """The plane of another process, over its port."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._reader, self._writer = reader, writer
        self._lock = asyncio.Lock()

    async def ask(self, line: str) -> str:
        """See PlaneAccess."""
        async with self._lock:
            self._writer.write(f"{line}\n".encode())
            answer = (await self._reader.readline()).decode("ascii").strip()
        if not answer:
            raise OSError("the plane is gone")
        return answer

    async def leave(self) -> None:
        """See PlaneAccess."""
        self._writer.close()


async def open_plane(layout: str, world: World) -> PlaneAccess:
    """Access to the plane of a layout: shared, remote, or new. Raises OSError if the port is in use."""
    loop = asyncio.get_running_loop()
    if isinstance(loop, SimulatedLoop):
        return loop.shared(f"the plane '{layout}'", lambda: Plane(layout, world))
    plane, port = Plane(layout, world), world.port or PORTS[layout]
    try:
        await plane.serve(port)
    except OSError:
        await plane.leave()
        return RemotePlane(*await asyncio.open_connection(HOST, port, limit=LONGEST))
    return plane
