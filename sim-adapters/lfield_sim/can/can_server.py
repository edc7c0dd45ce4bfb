"""Serves a bus in real time through its adapters, until it is stopped."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from lfield_sim.can.adapters.bus_hub import BusAdapter, BusHub
from lfield_sim.can.adapters.slcan_adapter import SlcanAdapter
from lfield_sim.can.adapters.socketcand_adapter import SocketcandAdapter
from lfield_sim.can.bus_world import BusDevice
from lfield_sim.fake_server import serve_until_stopped
from lfield_sim.faults import Faults
from lfield_sim.state_log import StateLog


async def serve(
    places: Sequence[tuple[str, str, int]],
    devices: Sequence[BusDevice],
    faults: Faults,
    log: StateLog,
    *,
    bitrate: int,
    names: Mapping[str, str],
    summary: str,
    until_stdin_closes: bool,
) -> None:
    """Serves devices (`names`: by id) through adapters (kind, host, port). Raises AddressError."""
    hub = BusHub(devices, faults, bitrate, log.write_changes)
    doors: list[BusAdapter] = []
    try:
        for place in places:
            doors.append(await _make_adapter(hub, *place))
            doors[-1].plug()
        faults.watch(lambda: _plug(doors, out=bool(faults.get("unplug"))))
        endpoint, *others = [door.endpoint for door in doors]
        _plug(doors, out=bool(faults.get("unplug")))
        await serve_until_stopped(
            "can",
            endpoint,
            " ".join([*others, summary]),
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


def _plug(adapters: Sequence[BusAdapter], *, out: bool) -> None:
    """Unplugs all adapters, or plugs them in."""
    for door in adapters:
        if out:
            door.unplug()
        elif not door.plugged:
            door.plug()


async def _make_adapter(hub: BusHub, kind: str, place: str, port: int) -> BusAdapter:
    """An adapter that is not plugged in yet. Raises AddressError."""
    if kind == "slcan-pty":
        return SlcanAdapter(hub, place)
    door = SocketcandAdapter(hub)
    await door.listen(place, port)
    return door
