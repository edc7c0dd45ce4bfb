"""Serves a world in real time through its doors, until it is told to end."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from lfield_sim.can.doors.hub import Door, Hub
from lfield_sim.can.doors.slcan_door import SlcanDoor
from lfield_sim.can.doors.socketcand_door import SocketcandDoor
from lfield_sim.can.world import Device
from lfield_sim.faults import Faults
from lfield_sim.serving import serve_until_told
from lfield_sim.state_log import StateLog


async def serve(
    places: Sequence[tuple[str, str, int]],
    devices: Sequence[Device],
    faults: Faults,
    log: StateLog,
    *,
    bitrate: int,
    names: Mapping[str, str],
    words: str,
    until_stdin_closes: bool,
) -> None:
    """Serve devices (`names`: by id) through doors (kind, host, port). Raises AddressError."""
    hub = Hub(devices, faults, bitrate, log.look)
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
            facts={device.id: device.facts for device in devices},
        )
    finally:
        hub.stop()
        for door in doors:
            door.close()
        log.close()


def _plug(doors: Sequence[Door], *, out: bool) -> None:
    """Pull all doors out, or plug in those that are out."""
    for door in doors:
        if out:
            door.unplug()
        elif not door.plugged:
            door.plug()


async def _door(hub: Hub, kind: str, place: str, port: int) -> Door:
    """A door that is not plugged in yet. Raises AddressError."""
    if kind == "slcan-pty":
        return SlcanDoor(hub, place)
    door = SocketcandDoor(hub)
    await door.listen(place, port)
    return door
