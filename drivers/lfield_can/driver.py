"""The driver of one bus: passes every frame to the devices that receive it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from lfield.driver import (
    Clock,
    DeviceBinding,
    DeviceError,
    Diagnostic,
    Driver,
    Manifest,
    Reports,
    WireLog,
    read_within,
)
from lfield_can.axis import CanAxis
from lfield_can.bus.can_bus import Bus
from lfield_can.bus.frames import Frame, group_of
from lfield_can.dbc import DbcError, DbcFile
from lfield_can.drone_can.network import DroneCanNetwork
from lfield_can.drone_can.node_device import DroneCanBattery, DroneCanDevice, DroneCanEsc
from lfield_can.drone_can.servo import ACTUATOR, DroneCanServo
from lfield_can.eds import EdsError, parse_eds
from lfield_can.protocols.canopen_node import MAX_BYTES, read_eds
from lfield_can.protocols.cia402_tables import EVERY
from lfield_can.signals import CanSignals
from lfield_can.timing import Sync

#: Stored ids of other nodes, and how many an error shows.
MAX_UNKNOWN_IDS, SHOWN_UNKNOWN_IDS = 64, 5

CanDevice = CanAxis | CanSignals | DroneCanDevice
#: Functions of DroneCAN nodes, by device type.
NODES: Mapping[str, type[DroneCanDevice]] = {
    each.__name__: each for each in (DroneCanBattery, DroneCanEsc, DroneCanServo)
}
#: Creates the bus at an endpoint, with callbacks for frames and log lines, and the log of its frames.
MakeBus = Callable[[str, Callable[[Frame], None], Callable[[str], None], WireLog], Bus]


class CanDriver(Driver):
    """One CAN bus with axes, devices of DBC files and DroneCAN nodes. `make_bus` is for tests."""

    def __init__(
        self,
        bindings: Sequence[DeviceBinding],
        manifests: Mapping[str, Manifest],
        clock: Clock,
        reports: Reports,
        *,
        make_bus: MakeBus = Bus,
    ) -> None:
        self._make_bus = make_bus
        super().__init__(bindings, manifests, clock, reports)

    def _set_up(self) -> None:
        first = self.bindings[0].name
        self._bus = self._make_bus(
            self.endpoint, self._received, lambda text: self.reports.note(first, text), self.wire_log
        )
        self._drone_can = DroneCanNetwork(self._bus, self.clock, lambda text: self.reports.note(first, text))
        self._sync = Sync(self.clock, self._bus.post, EVERY)
        self._members: list[CanDevice] = []
        #: One frame of each id that no device receives.
        self._unknown_frames: dict[int, Frame] = {}
        self._listeners: dict[int, list[CanDevice]] = {}

    def _device(self, binding: DeviceBinding) -> CanDevice:
        arguments = binding, self.manifests[binding.type], self.clock, self.reports
        device: CanDevice
        if binding.type == "CanAxis":
            device = CanAxis(*arguments, self._bus, self._sync)
        elif binding.type == "CanSignals":
            device = CanSignals(*arguments, self._bus, self._unknown_ids)
        else:
            device = NODES[binding.type](*arguments, self._drone_can)
        self._members.append(device)
        return device

    async def _open(self) -> None:
        owners: dict[int, CanDevice] = {}
        for device in self._members:
            # No device is guarded yet: reading files may block here.
            device.prepare()
            for key in device.listens():
                self._listeners.setdefault(key, []).append(device)
            for key in device.commands():
                other = owners.setdefault(key, device)
                if other is not device:
                    names = f"{device.binding.name} and {other.binding.name}"
                    frames = f"frames (id 0x{key & 0x1FFFFFFF:X})"
                    resource = frames if key < ACTUATOR else f"actuator 'index' ({key - ACTUATOR})"
                    raise device.error(
                        f"{names} have the same {resource}; give each device on the bus its own"
                    )
        await self._bus.open()
        self._drone_can.start()
        for device in self._members:
            self.spawn(device.watch())

    async def _close(self) -> None:
        for device in self._members:
            device.close()
        self._drone_can.close()
        await self._bus.close()

    def _quiet(self) -> None:
        for device in self._members:
            device.set_quiet(True)
        self._drone_can.set_quiet(True)

    def _resume(self) -> None:
        for device in self._members:
            device.set_quiet(False)
        self._drone_can.set_quiet(False)

    def _received(self, frame: Frame) -> None:
        devices = self._listeners.get(frame.key)
        if devices is None and frame.extended:
            devices = self._listeners.get(group_of(frame.id))
        if devices is None and frame.extended:
            self._drone_can.on_frame(frame)
        if devices is None and len(self._unknown_frames) < MAX_UNKNOWN_IDS:
            self._unknown_frames[frame.key] = frame
        for device in devices or ():
            device.on_frame(frame)

    def _unknown_ids(self) -> str:
        """The unknown ids on the bus; '' for none."""
        ids = [f"0x{frame.id:X}{' (29 bits)' * frame.extended}" for frame in self._unknown_frames.values()]
        return ", ".join(ids[:SHOWN_UNKNOWN_IDS]) + (", ..." if len(ids) > SHOWN_UNKNOWN_IDS else "")


def mistakes_in(option: str, file: str) -> Sequence[Diagnostic]:
    """The mistakes for which the driver refuses the file of an option, `dbc` or `eds`.

    Raises DeviceError for a file that cannot be read, or has mistakes without a position.
    """
    try:
        if option == "dbc":
            DbcFile(file)
        elif Path(file).suffix.lower() == ".epf":
            read_eds(option, file, 1)
        else:
            parse_eds(file, read_within(Path(file), MAX_BYTES))
    except (DbcError, EdsError) as error:
        if error.findings:
            return error.findings
        raise DeviceError(option, str(error)) from None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise DeviceError(option, f"{file} cannot be read: {reason}") from None
    return ()
