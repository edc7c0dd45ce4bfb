"""Cameras and gimbals with component ids of their own under the system id of a vehicle: heartbeat protocol.

Components send through the autopilot or on the same link, or on a link of their own. Ids:
https://mavlink.io/en/messages/common.html#MAV_COMPONENT.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Collection, Sequence

from lfield_mavlink.link.dialect import dialect
from lfield_mavlink.link.packet_sources import Source

#: Component ids of cameras, and of gimbals that have MAVLink.
CAMERAS: Sequence[int] = range(dialect.MAV_COMP_ID_CAMERA, dialect.MAV_COMP_ID_CAMERA6 + 1)
GIMBALS: Sequence[int] = (
    dialect.MAV_COMP_ID_GIMBAL,
    *range(dialect.MAV_COMP_ID_GIMBAL2, dialect.MAV_COMP_ID_GIMBAL6 + 1),
)
#: Seconds without a heartbeat after which a component is gone; it is sent at 1 Hz.
HEARTBEAT_TIMEOUT = 5.0

_IDS = frozenset({*CAMERAS, *GIMBALS})
#: Messages of cameras and gimbals that are decoded.
_MESSAGES = frozenset(
    {
        dialect.MAVLINK_MSG_ID_HEARTBEAT,
        dialect.MAVLINK_MSG_ID_COMMAND_ACK,
        dialect.MAVLINK_MSG_ID_CAMERA_SETTINGS,
        dialect.MAVLINK_MSG_ID_CAMERA_CAPTURE_STATUS,
        dialect.MAVLINK_MSG_ID_CAMERA_IMAGE_CAPTURED,
        dialect.MAVLINK_MSG_ID_GIMBAL_MANAGER_INFORMATION,
        dialect.MAVLINK_MSG_ID_GIMBAL_MANAGER_STATUS,
        dialect.MAVLINK_MSG_ID_GIMBAL_DEVICE_ATTITUDE_STATUS,
    }
)


def is_of_payload(component: int, kind: int) -> bool:
    """Whether a message is one of a camera or gimbal that the driver uses, by component and message id."""
    return component in _IDS and kind in _MESSAGES


class Components:
    """The cameras and gimbals of one vehicle, by component id.

    `now` returns the time in seconds. A component that was silent is present again with its next heartbeat.
    """

    def __init__(self, now: Callable[[], float]) -> None:
        self._now = now
        self._last_heartbeats: dict[int, float] = {}
        #: Set at the first heartbeat of any component.
        self.appeared = asyncio.Event()

    def on_heartbeat(self, component: int) -> None:
        """Handles a heartbeat of a camera or gimbal."""
        self._last_heartbeats[component] = self._now()
        self.appeared.set()

    def present(self, ids: Sequence[int]) -> list[int]:
        """The given ids whose heartbeats arrive, in the same order."""
        oldest = self._now() - HEARTBEAT_TIMEOUT
        return [component for component in ids if self._last_heartbeats.get(component, -math.inf) > oldest]

    def known(self, ids: Sequence[int]) -> list[int]:
        """The given ids whose heartbeats have ever arrived, in the same order."""
        return [component for component in ids if component in self._last_heartbeats]


class PayloadSources:
    """The addresses of cameras and gimbals on links of their own: `payload=` in the endpoint. Pure.

    `links` are the numbers of these links. An address is used until its heartbeats are gone.
    """

    def __init__(self, links: Collection[int]) -> None:
        self._links = links
        self._sources: dict[tuple[int, int], tuple[Source, float]] = {}

    def accepts(self, source: Source, component: tuple[int, int], kind: int, now: float) -> bool:
        """Whether a packet is of a component: system and component id; `kind` is the message id."""
        if source.link not in self._links:
            return False
        source_in_use, last_heartbeat = self._sources.get(component, (source, -math.inf))
        is_current = source_in_use == source or now - last_heartbeat > HEARTBEAT_TIMEOUT
        if is_current and kind == dialect.MAVLINK_MSG_ID_HEARTBEAT:
            self._sources[component] = source, now
        return is_current and component in self._sources

    def source(self, component: tuple[int, int]) -> Source | None:
        """The address of a component; None for the route of the autopilot."""
        return self._sources.get(component, (None, 0.0))[0]
