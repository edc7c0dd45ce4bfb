"""The bus: one link, one reader, every message handed to the vehicle it came from."""

from __future__ import annotations

import asyncio
from typing import Any

from lfield.driver import DeviceBinding, Driver
from lfield_mavlink.dialect import AUTOPILOT, Reader, Writer, dialect
from lfield_mavlink.links import Link, make_link
from lfield_mavlink.vehicle import MavlinkVehicle

#: Seconds between our own heartbeats.
HEARTBEAT = 1.0


class MavlinkDriver(Driver):
    """One link with the vehicles on it."""

    def _device(self, binding: DeviceBinding) -> MavlinkVehicle:
        return MavlinkVehicle(binding, self.manifests[binding.type], self.clock, self.reports, self._send)

    async def _open(self) -> None:
        self._reader, self._writer = Reader(), Writer()
        self._vehicles: dict[int, MavlinkVehicle] = {}
        for device in self.devices.values():
            assert isinstance(device, MavlinkVehicle)
            if device.system in self._vehicles:
                raise device.error(f"two devices are system {device.system} on {self.endpoint}")
            self._vehicles[device.system] = device
        self._link: Link | None = self._make_link()
        await self._link.open()
        self.spawn(self._beat())
        for vehicle in self._vehicles.values():
            self.spawn(vehicle.watch())

    async def _close(self) -> None:
        link = getattr(self, "_link", None)
        if link is not None:
            link.close()

    def _make_link(self) -> Link:
        return make_link(self.endpoint, self._received)

    def _received(self, data: bytes) -> None:
        for message in self._reader.feed(data):
            vehicle = self._vehicles.get(message.get_srcSystem())
            # Cameras and gimbals have heartbeats too; only the autopilot's says how the vehicle is.
            if vehicle is not None and message.get_srcComponent() == AUTOPILOT:
                vehicle.on_message(message)

    def _send(self, message: Any) -> None:
        assert self._link is not None
        self._link.send(self._writer.pack(message))

    async def _beat(self) -> None:
        """Be heard as a ground station, as the autopilots' failsafes expect."""
        message = dialect.MAVLink_heartbeat_message(
            dialect.MAV_TYPE_GCS, dialect.MAV_AUTOPILOT_INVALID, 0, 0, dialect.MAV_STATE_ACTIVE, 3
        )
        while True:
            self._send(message)
            await asyncio.sleep(HEARTBEAT)
