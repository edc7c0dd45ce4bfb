"""The bus: one port, one chain, its devices, and telemetry that also feeds their watchdogs."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping, Sequence

from lfield.driver import Clock, DeviceBinding, Driver, Manifest, Reports
from lfield.driver.serial import PortEvents, SerialPort, parse_serial_endpoint
from lfield_dynamixel import log_messages
from lfield_dynamixel.bus.half_duplex_bus import Bus, Port
from lfield_dynamixel.bus.servo_chain import Chain
from lfield_dynamixel.devices import Dynamixel, DynamixelGroup
from lfield_dynamixel.members import Members

#: Seconds between two polls; at most half a time-to-live, or their watchdogs would expire.
PERIOD = 0.05

#: Creates the port at an endpoint, with the receiver of its events and a log function.
MakePortAt = Callable[[str, PortEvents, Callable[[str], None]], Port]

_TYPES: dict[str, type[Members]] = {"Dynamixel": Dynamixel, "DynamixelGroup": DynamixelGroup}


def serial_port(endpoint: str, events: PortEvents, note: Callable[[str], None]) -> Port:
    """The tty of a bus. Raises DeviceError for an invalid endpoint."""
    return SerialPort(*parse_serial_endpoint(endpoint), events, note)


class DynamixelDriver(Driver):
    """One serial port with servos. `make_port` is for tests."""

    def __init__(
        self,
        bindings: Sequence[DeviceBinding],
        manifests: Mapping[str, Manifest],
        clock: Clock,
        reports: Reports,
        *,
        make_port: MakePortAt = serial_port,
    ) -> None:
        self._make_port = make_port
        super().__init__(bindings, manifests, clock, reports)

    def _set_up(self) -> None:
        self._bus = Bus(
            lambda events: self._make_port(self.endpoint, events, self._note),
            self._lost,
            self._back,
            lambda: self._note(log_messages.ECHO_REMOVED.line()),
            self.wire_log,
        )
        self._chain = Chain(self._bus)
        # Cleared while the host is silent: a polled servo would not notice it.
        self._may_poll = asyncio.Event()
        self._may_poll.set()

    def _device(self, binding: DeviceBinding) -> Members:
        device_class = _TYPES[binding.type]
        return device_class(binding, self.manifests[binding.type], self.clock, self.reports, self._chain)

    @property
    def _members(self) -> list[Members]:
        return [device for device in self.devices.values() if isinstance(device, Members)]

    async def _open(self) -> None:
        users: dict[int, Members] = {}
        for device in self._members:
            for number in device.numbers:
                if number in users:
                    other = users[number].binding.name
                    raise device.error(f"servo {number} on {self.endpoint} already belongs to {other}")
                users[number] = device
        self._bus.open()
        self.spawn(self._poll())

    async def _close(self) -> None:
        self._bus.close()

    def _quiet(self) -> None:
        self._may_poll.clear()

    def _resume(self) -> None:
        self._may_poll.set()

    async def _poll(self) -> None:
        """Polls every device; not while the host is silent or the port is lost."""
        period = min([PERIOD, *(0.5 * device.binding.ttl for device in self._members)])
        while True:
            await self._may_poll.wait()
            if not self._bus.is_lost:
                for device in self._members:
                    if device.opened and self._may_poll.is_set():
                        await device.poll()
            await asyncio.sleep(period)

    def _lost(self, reason: str) -> None:
        self._note(log_messages.PORT_LOST.line(reason=reason))

    def _back(self) -> None:
        self._note(log_messages.PORT_BACK.line())

    def _note(self, text: str) -> None:
        for device in self._members:
            device.note(text)
