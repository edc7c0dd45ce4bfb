"""Serves a world in real time through its doors, until it is told to end."""

from __future__ import annotations

import asyncio
import selectors
import time
from collections.abc import Callable, Mapping, Sequence

from lfield.errors import AddressError
from lfield_sim.can.bus import Port
from lfield_sim.can.doors import SlcanDoor, SocketcandDoor
from lfield_sim.can.frame import Frame
from lfield_sim.can.world import Device, World
from lfield_sim.faults import Faults
from lfield_sim.serving import serve_until_told

CHANNEL = "can0"


class _Hub:
    """The world on the loop's clock; wakes when the bus or a model has something to do."""

    def __init__(self, devices: Sequence[Device], faults: Faults, bitrate: int) -> None:
        self._loop = asyncio.get_running_loop()
        self._day = time.time() - self._loop.time()
        self._faults = faults
        self._world = World(devices, faults, bitrate=bitrate, start=self._loop.time())
        self._going_on: list[Callable[[], None]] = []
        self._timer = self._loop.call_soon(self._run)

    def join(self, port: Port) -> None:
        self._world.bus.attach(port)

    def leave(self, port: Port) -> None:
        self._world.bus.detach(port)

    def send(self, port: Port, frame: Frame) -> None:
        self._world.bus.send(port, frame, self._loop.time())
        self._wake()

    def when_sent(self, go_on: Callable[[], None]) -> None:
        self._going_on.append(go_on)

    def seconds(self, time: float) -> float:
        return self._day + time

    def is_off(self, port: Port) -> bool:
        return bool(self._faults.get("bus_off")) or port.off_until > self._loop.time()

    def stop(self) -> None:
        """End the world."""
        self._timer.cancel()

    def _run(self) -> None:
        self._world.advance(self._loop.time())
        waiting, self._going_on = self._going_on, []
        for go_on in waiting:
            go_on()
        self._wake()

    def _wake(self) -> None:
        self._timer.cancel()
        self._timer = self._loop.call_at(self._world.due(), self._run)


def run(
    doors: Sequence[tuple[str, str, int]],
    devices: Sequence[Device],
    faults: Faults,
    *,
    bitrate: int,
    names: Mapping[str, str],
    words: str,
    until_stdin_closes: bool,
) -> int:
    """Serve devices (`names`: by id) through doors (kind, host, port). Raises AddressError."""
    serving = _serve(doors, devices, faults, bitrate, names, words, until_stdin_closes)
    # epoll rounds a wait up to a millisecond, which is eight frames; select does not.
    with asyncio.Runner(loop_factory=lambda: asyncio.SelectorEventLoop(selectors.SelectSelector())) as runner:
        runner.run(serving)
    return 0


async def _serve(
    doors: Sequence[tuple[str, str, int]],
    devices: Sequence[Device],
    faults: Faults,
    bitrate: int,
    names: Mapping[str, str],
    words: str,
    until_stdin_closes: bool,
) -> None:
    hub = _Hub(devices, faults, bitrate)
    endpoints: list[str] = []
    closing: list[Callable[[], None]] = [hub.stop]
    try:
        for door in doors:
            endpoint, close = await _open(hub, *door)
            endpoints.append(endpoint)
            closing.append(close)
        others = " ".join([*endpoints[1:], words])
        await serve_until_told(
            "can", endpoints[0], others, faults, devices=names, until_stdin_closes=until_stdin_closes
        )
    finally:
        for close in closing:
            close()


async def _open(hub: _Hub, kind: str, host: str, port: int) -> tuple[str, Callable[[], None]]:
    """Open a door: the endpoint as a binding has it, and how to close it."""
    if kind == "slcan-pty":
        dongle = SlcanDoor(hub)
        return f"slcan:{dongle.path}@115200", dongle.close
    loop = asyncio.get_running_loop()
    try:
        listener = await loop.create_server(lambda: SocketcandDoor(hub), host, port)
    except OSError as error:
        raise AddressError(f"socketcand:{host}:{port}", error.strerror or str(error)) from None
    bound = listener.sockets[0].getsockname()[1]
    return f"socketcand:{host}:{bound}/{CHANNEL}", listener.close
