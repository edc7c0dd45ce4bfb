"""Cameras and gimbals with component ids of their own under the system id of a vehicle: heartbeat protocol.

They send through the autopilot or on the same link: commands to them take the way of commands to the
autopilot. Ids: https://mavlink.io/en/messages/common.html#MAV_COMPONENT.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Sequence

from lfield_mavlink.link.dialect import dialect

#: Component ids of cameras, and of gimbals that have MAVLink.
CAMERAS: Sequence[int] = range(dialect.MAV_COMP_ID_CAMERA, dialect.MAV_COMP_ID_CAMERA6 + 1)
GIMBALS: Sequence[int] = (
    dialect.MAV_COMP_ID_GIMBAL,
    *range(dialect.MAV_COMP_ID_GIMBAL2, dialect.MAV_COMP_ID_GIMBAL6 + 1),
)
#: Seconds without a heartbeat after which a component is gone; it is sent at 1 Hz.
GONE = 5.0

_IDS = frozenset({*CAMERAS, *GIMBALS})
#: Messages of them that are decoded.
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
        self._beats: dict[int, float] = {}
        #: Set at the first heartbeat of any of them.
        self.appeared = asyncio.Event()

    def on_heartbeat(self, component: int) -> None:
        """A heartbeat of a camera or gimbal."""
        self._beats[component] = self._now()
        self.appeared.set()

    def present(self, ids: Sequence[int]) -> list[int]:
        """Those of these ids whose heartbeats arrive, in this order."""
        oldest = self._now() - GONE
        return [component for component in ids if self._beats.get(component, -math.inf) > oldest]
