"""A short flight of two copters as a stream of events and telemetry, and readers of exported files."""

from __future__ import annotations

import io
import json
from collections import defaultdict
from typing import Any

from mcap.reader import NonSeekingReader, make_reader

from lfield.driver.frame import Origin, Pose
from lfield.export.export_input import MissionInfo, StreamItem, TelemetrySample
from lfield.export.mcap_writer import export_mcap
from lfield.manifest import DeviceManifest, Quantity
from lfield.mission.bindings import Frames
from lfield.operator.dashboard.timeline.event_timeline import Cause, DatedEvent
from lfield.wire import events
from lfield.wire.events import Event, StateEvent, TelemetryEvent

START = 1_700_000_000.0
#: The origin of the map. Host `desk` in FRAMED is 10 m south of it.
ORIGIN = Origin(47.0, 8.0, 400.0)

COPTER = DeviceManifest(
    "Mavlink",
    "mavlink",
    (),
    (
        Quantity("mode", "string", meaning="the mode"),
        Quantity("armed", "boolean"),
        Quantity("position", "real[]", "m", meaning="of home", frame="place"),
        Quantity("globalPosition", "real[]", meaning="degrees, degrees, metres"),
        Quantity("attitude", "real[]", "rad"),
        Quantity("heading", "real", "rad", meaning="clockwise from north"),
        Quantity("groundSpeed", "real", "m/s", meaning="over ground"),
        Quantity("satellites", "int"),
    ),
    ("land",),
)
DEVICES = {"lead.fc": COPTER, "wing.fc": COPTER}
FRAMED = MissionInfo("flight", DEVICES, Frames(ORIGIN, {"desk": Pose(-10.0, 0.0, 0.0)}))
UNFRAMED = MissionInfo("flight", DEVICES)


class Team:
    """A source of events and telemetry of hosts. It numbers the events of each host."""

    def __init__(self) -> None:
        self._numbers: dict[str, int] = defaultdict(int)

    def event(
        self, time: float, host: str, content: StateEvent | TelemetryEvent, cause: Cause | None = None
    ) -> DatedEvent:
        """An event `time` seconds after the start."""
        self._numbers[host] += not isinstance(content, TelemetryEvent)
        return DatedEvent(host, 7, Event(self._numbers[host], START + time, time, 0, content), cause)

    def sample(self, time: float, host: str, device: str, **values: Any) -> TelemetrySample:
        """Telemetry `time` seconds after the start."""
        return TelemetrySample(START + time, host, device, values, 0.1)


def flight() -> list[StreamItem]:
    """Two copters with a distance of 30 m. A coordinator hops once, fails to hop once, and ends."""
    team = Team()
    departure = events.MigrationStarted("pilot", 1, 1, "bravo", "wing", "climb", 600)
    return [
        team.event(0.0, "alpha", events.LinkUp("bravo")),
        team.event(0.0, "alpha", events.AgentStarted("pilot", 1)),
        team.sample(0.1, "alpha", "lead.fc", position=[0.0, 0.0, -10.0], heading=1.5, mode="GUIDED"),
        team.sample(0.1, "bravo", "wing.fc", position=[30.0, 0.0, -10.0], armed=True, satellites=9),
        team.event(0.2, "alpha", departure),
        team.event(0.21, "bravo", events.MigrationArrived("pilot", 1, 1, "alpha", 600), Cause("alpha", 7, 3)),
        team.event(0.22, "alpha", events.MigrationConfirmed("pilot", 1, 1, "bravo", 0.01)),
        team.event(0.3, "bravo", events.Printed("pilot", "up, ", "out")),
        team.event(0.4, "bravo", events.Printed("pilot", "and away\n", "out")),
        team.event(0.5, "bravo", events.LineLogged("battery low", "battery-low", "warning")),
        team.event(0.6, "bravo", events.MigrationStarted("pilot", 1, 2, "alpha", "lead", "land", 610)),
        team.event(0.7, "bravo", events.MigrationFailed("pilot", 1, 2, "alpha", "Unreachable", "no link")),
        team.event(0.8, "alpha", events.LinkTelemetry("bravo", 0.004, None, 120, 130)),
        team.event(0.8, "bravo", events.AgentActivity("pilot", "sleeping", "mission.L", 12, "")),
        team.event(1.3, "bravo", events.DeviceTelemetry("wing.fc", {"position": [31.0, 4.0, -12.0]}, 0.2)),
        team.event(1.4, "bravo", events.AgentFinished("pilot", 1, "done")),
    ]


def mcap_bytes(stream: list[StreamItem], info: MissionInfo = FRAMED) -> bytes:
    """The stream as an MCAP file."""
    out = io.BytesIO()
    export_mcap(stream, info, out=out)
    return out.getvalue()


def by_topic(data: bytes) -> dict[str, list[tuple[float, dict[str, Any]]]]:
    """The messages of a complete file by topic, each with its time after the start."""
    found: dict[str, list[tuple[float, dict[str, Any]]]] = defaultdict(list)
    for _, channel, message in make_reader(io.BytesIO(data), validate_crcs=True).iter_messages():
        found[channel.topic].append((round(message.log_time / 1e9 - START, 6), json.loads(message.data)))
    return found


def readable(data: bytes) -> int:
    """The number of messages that a reader without an index reads from the start of a file."""
    count = 0
    try:
        for _ in NonSeekingReader(io.BytesIO(data)).iter_messages(log_time_order=False):
            count += 1
    except Exception:
        # The file ends within a record: any error of the reader is expected.
        return count
    return count
