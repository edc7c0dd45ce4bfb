"""Hops of coordinators as arrows from host to host. Pure.

The arrow is drawn when the coordinator leaves, or when it arrives if its departure is not in the stream. A
hop that fails is erased again. Without the positions of both hosts no arrow can be drawn.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from lfield.export.channels import Channel, ChannelMessage, timestamp
from lfield.export.foxglove_schemas import SCENE_UPDATE
from lfield.export.scene import MapPoint, color, direction, entity, pose
from lfield.export.vehicle_track import VehicleTracker
from lfield.operator.dashboard.timeline.event_timeline import DatedEvent
from lfield.wire.events import MigrationArrived, MigrationFailed, MigrationStarted

#: Seconds for which an arrow is shown.
LIFETIME = 2.0
#: The most hops that are remembered as drawn.
MAX_HOPS = 1 << 12
#: Hosts that are closer than this (m) get no arrow, only its text.
MIN_LENGTH = 0.01

HOPS = Channel("/hops", SCENE_UPDATE)

_ORANGE = (1.0, 0.6, 0.0)


class HopArrows:
    """The arrows of all coordinators; `vehicles` has the positions of hosts."""

    def __init__(self, vehicles: VehicleTracker) -> None:
        self._vehicles = vehicles
        self._drawn: dict[str, None] = {}

    def messages(self, dated: DatedEvent) -> Iterator[ChannelMessage]:
        """The arrow of a hop, or its deletion."""
        match dated.event.what:
            case MigrationStarted(agent, generation, sequence, to, resource, portal):
                text = f"{agent}: {resource}.{portal}" if resource else agent
                yield from self._draw(dated.time, f"{agent} {generation} {sequence}", dated.host, to, text)
            case MigrationArrived(agent, generation, sequence, of):
                yield from self._draw(dated.time, f"{agent} {generation} {sequence}", of, dated.host, agent)
            case MigrationFailed(agent, generation, sequence):
                if self._drawn.pop(id := f"{agent} {generation} {sequence}", id) is None:
                    deletion = {"timestamp": timestamp(dated.time), "type": 0, "id": id}
                    yield ChannelMessage(HOPS, dated.time, {"deletions": [deletion], "entities": []})

    def _draw(self, time: float, id: str, source: str, target: str, text: str) -> Iterator[ChannelMessage]:
        start, end = self._vehicles.place(source), self._vehicles.place(target)
        if id in self._drawn or start is None or end is None:
            return
        self._drawn[id] = None
        if len(self._drawn) > MAX_HOPS:
            del self._drawn[next(iter(self._drawn))]
        shapes = {"arrows": _arrows(start, end), "texts": [_text(start, text)]}
        yield ChannelMessage(
            HOPS, time, {"deletions": [], "entities": [entity(time, id, LIFETIME, **shapes)]}
        )


def _arrows(start: MapPoint, end: MapPoint) -> list[dict[str, Any]]:
    turned, length = direction(start, end)
    if length < MIN_LENGTH:
        return []
    head = min(0.6, 0.2 * length)
    return [
        {
            "pose": pose(start, turned),
            "shaft_length": length - head,
            "shaft_diameter": 0.15,
            "head_length": head,
            "head_diameter": 0.4,
            "color": color(*_ORANGE),
        }
    ]


def _text(place: MapPoint, text: str) -> dict[str, Any]:
    return {
        "pose": pose(place._replace(z=place.z + 1.0)),
        "billboard": True,
        "font_size": 0.6,
        "scale_invariant": False,
        "color": color(*_ORANGE),
        "text": text,
    }
