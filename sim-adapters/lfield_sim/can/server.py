"""Serves a world in real time through its doors, until it is told to end."""

from __future__ import annotations

import asyncio
import selectors
import time
from collections.abc import Callable, Mapping, Sequence

from lfield_sim.can.bus import Port
from lfield_sim.can.doors import Door, SlcanDoor, SocketcandDoor
from lfield_sim.can.frame import Frame
from lfield_sim.can.world import Device, World
from lfield_sim.faults import Faults
from lfield_sim.serving import serve_until_told


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
    places: Sequence[tuple[str, str, int]],
    devices: Sequence[Device],
    faults: Faults,
    bitrate: int,
    names: Mapping[str, str],
    words: str,
    until_stdin_closes: bool,
) -> None:
    hub = _Hub(devices, faults, bitrate)
    doors: list[Door] = []
    try:
        for place in places:
            doors.append(await _door(hub, *place))
            doors[-1].plug()
        faults.watch(lambda: _plug(doors, out=bool(faults.get("unplug"))))
        endpoint, *others = [door.endpoint for door in doors]
        _plug(doors, out=bool(faults.get("unplug")))
        await serve_until_told(
            "can",
            endpoint,
            " ".join([*others, words]),
            faults,
            devices=names,
            until_stdin_closes=until_stdin_closes,
        )
    finally:
        hub.stop()
        for door in doors:
            door.close()


def _plug(doors: Sequence[Door], *, out: bool) -> None:
    """Pull all doors out, or plug in those that are out."""
    for door in doors:
        if out:
            door.unplug()
        elif not door.plugged:
            door.plug()


async def _door(hub: _Hub, kind: str, place: str, port: int) -> Door:
    """A door that is not plugged in yet. Raises AddressError."""
    if kind == "slcan-pty":
        return SlcanDoor(hub, place)
    door = SocketcandDoor(hub)
    await door.listen(place, port)
    return door
