"""The input of all exports: a stream of items in the order of their times, and the mission. Pure.

`export_mcap(stream, info, out)` and `export_csv(stream, info, open_table)` read any iterable of these items:

    DatedEvent         an event of a host with the merged time, as `lfield events` gets it (decision 65).
                       Events of the kind `measured` are telemetry of a device.
    TelemetrySample    values of a device from another source, as of a recording; the quantities that have
                       changed are sufficient
    StreamNotice       a gap in the stream, as while a host was unreachable

Times are seconds since 1970. The items should be in order: readers of the output may assume that. `info` is
the data from the files of the mission: units and meanings of quantities, and frames (`mission_info`).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from msgspec import Struct, field

from lfield.driver.frame import Origin
from lfield.manifest import DeviceManifest, Quantity
from lfield.mission.bindings import Frames
from lfield.mission.mission import Mission
from lfield.operator.dashboard.timeline.event_timeline import DatedEvent
from lfield.operator.team_model.vehicle_readings import DEFAULT_INSTRUMENTS, Instruments, instruments_of
from lfield.wire.events import DeviceTelemetry
from lfield.wire.fields import Telemetry


class TelemetrySample(NamedTuple):
    """Values of a device, AGENT.FIELD, by quantity, in the units of its manifest and the team's frame.

    `silent` is the age of the newest value in seconds.
    """

    time: float
    host: str
    device: str
    values: Mapping[str, Telemetry]
    silent: float = 0.0


class StreamNotice(NamedTuple):
    """A gap in the stream of a host, or its reason."""

    time: float
    host: str
    text: str


StreamItem = DatedEvent | TelemetrySample | StreamNotice


def telemetry_of(item: StreamItem) -> TelemetrySample | None:
    """The telemetry of a device in an item; None for any other item."""
    if isinstance(item, TelemetrySample):
        return item
    if isinstance(item, DatedEvent) and isinstance(item.event.what, DeviceTelemetry):
        measured = item.event.what
        return TelemetrySample(item.time, item.host, measured.device, measured.values, measured.silent)
    return None


# --- the mission --------------------------------------------------------------------------------------------


class MissionInfo(Struct, frozen=True):
    """A mission: the manifests of its devices (AGENT.FIELD), and its frames.

    Without its files all fields are empty: units are then unknown, and quantities are found by their usual
    names.
    """

    name: str = ""
    devices: Mapping[str, DeviceManifest] = field(default_factory=dict)
    frames: Frames = field(default_factory=Frames)

    @property
    def origin(self) -> Origin | None:
        """The origin of the team's frame on the Earth, None if it is not stated."""
        return self.frames.origin

    def quantities(self, device: str) -> Mapping[str, Quantity]:
        """The quantities of a device by name."""
        manifest = self.devices.get(device)
        return {} if manifest is None else {quantity.name: quantity for quantity in manifest.telemetry}

    def instruments(self, device: str) -> Instruments:
        """The quantities of a device by meaning."""
        manifest = self.devices.get(device)
        return DEFAULT_INSTRUMENTS if manifest is None else instruments_of(manifest)


#: A mission whose files are not available.
NO_INFO = MissionInfo()


def mission_info(name: str, mission: Mission) -> MissionInfo:
    """The data of the files of a mission."""
    manifests = {
        type: manifest.device
        for driver in mission.drivers.by_driver.values()
        for type, manifest in driver.manifests.items()
    }
    devices = {
        device.name: manifests[device.type] for device in mission.bindings.all if device.type in manifests
    }
    return MissionInfo(name, devices, mission.bindings.frames)
