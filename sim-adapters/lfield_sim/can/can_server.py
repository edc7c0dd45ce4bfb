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
    endpoints: Sequence[tuple[str, str, int]],
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
    adapters: list[BusAdapter] = []
    try:
        for endpoint in endpoints:
            adapters.append(await _make_adapter(hub, *endpoint))
            adapters[-1].plug()
        faults.watch(lambda: _plug(adapters, out=bool(faults.get("unplug"))))
        first_endpoint, *others = [adapter.endpoint for adapter in adapters]
        _plug(adapters, out=bool(faults.get("unplug")))
        await serve_until_stopped(
            "can",
            first_endpoint,
            " ".join([*others, summary]),
            faults,
            devices=names,
            until_stdin_closes=until_stdin_closes,
            facts={device.id: device.facts for device in devices},
        )
    finally:
        hub.stop()
        for adapter in adapters:
            adapter.close()
        log.close()


def _plug(adapters: Sequence[BusAdapter], *, out: bool) -> None:
    """Unplugs all adapters, or plugs them in."""
    for adapter in adapters:
        if out:
            adapter.unplug()
        elif not adapter.plugged:
            adapter.plug()


async def _make_adapter(hub: BusHub, kind: str, host_or_path: str, port: int) -> BusAdapter:
    """An adapter that is not plugged in yet. Raises AddressError."""
    if kind == "slcan-pty":
        return SlcanAdapter(hub, host_or_path)
    adapter = SocketcandAdapter(hub)
    await adapter.listen(host_or_path, port)
    return adapter
