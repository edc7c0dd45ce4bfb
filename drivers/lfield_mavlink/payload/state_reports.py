"""Messages with the state of payload, by request: reports of a camera, a gimbal or an actuator."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable
from typing import Any

from lfield_mavlink.contact.contact import STATE_TIMEOUT, Contact
from lfield_mavlink.link.dialect import AUTOPILOT, dialect

WINCH, SERVOS = dialect.MAVLINK_MSG_ID_WINCH_STATUS, dialect.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW
RELAYS = dialect.MAVLINK_MSG_ID_RELAY_STATUS
SETTINGS, CAPTURE = (
    dialect.MAVLINK_MSG_ID_CAMERA_SETTINGS,
    dialect.MAVLINK_MSG_ID_CAMERA_CAPTURE_STATUS,
)
IMAGE = dialect.MAVLINK_MSG_ID_CAMERA_IMAGE_CAPTURED
MANAGER, CONTROL, ATTITUDE = (
    dialect.MAVLINK_MSG_ID_GIMBAL_MANAGER_INFORMATION,
    dialect.MAVLINK_MSG_ID_GIMBAL_MANAGER_STATUS,
    dialect.MAVLINK_MSG_ID_GIMBAL_DEVICE_ATTITUDE_STATUS,
)
KINDS = (WINCH, SERVOS, RELAYS, SETTINGS, CAPTURE, IMAGE, MANAGER, CONTROL, ATTITUDE)
#: Seconds to wait for a requested message, and between two of them; requests for a message that is not sent.
PATIENCE, PAUSE, REQUESTS = 0.5, 0.1, 3


class StateReports:
    """The latest message of each kind and component."""

    def __init__(self, vehicle: Contact) -> None:
        self._vehicle = vehicle
        self._latest: dict[tuple[int, int], tuple[float, Any]] = {}
        for kind in KINDS:
            vehicle.on(kind, self._on_report)

    def _on_report(self, message: Any) -> None:
        key = message.get_msgId(), message.get_srcComponent()
        self._latest[key] = self._vehicle.clock.monotonic(), message

    def recent(self, kind: int, component: int = AUTOPILOT, age: float = PATIENCE) -> Any | None:
        """The latest message of a kind, None if none arrived within `age` seconds."""
        at, message = self._latest.get((kind, component), (-math.inf, None))
        return message if self._vehicle.clock.monotonic() - at <= age else None

    async def request(self, kind: int, component: int = AUTOPILOT, index: float | None = None) -> Any | None:
        """Requests a message of a kind, again if it was lost; None when the component does not send it."""
        self._latest.pop((kind, component), None)
        request = dialect.MAV_CMD_REQUEST_MESSAGE
        for _ in range(REQUESTS):
            answer = await self._vehicle.exchange.command(request, float(kind), index, target=component)
            if answer.result != dialect.MAV_RESULT_ACCEPTED:
                break
            if await self._vehicle.wait_for(lambda: (kind, component) in self._latest, PATIENCE):
                break
        return self._latest.get((kind, component), (0.0, None))[1]

    async def confirm(
        self,
        instruction: str,
        kind: int,
        agrees: Callable[[Any], bool],
        timeout: float = STATE_TIMEOUT,
        component: int = AUTOPILOT,
    ) -> None:
        """Waits until a message confirms an effect; returns at once if the component does not send that
        message.
        """
        end = self._vehicle.clock.monotonic() + timeout
        message = await self.request(kind, component)
        if message is None:
            return
        while message is None or not agrees(message):
            if self._vehicle.clock.monotonic() >= end:
                raise self._vehicle.error(
                    f"{instruction} was accepted but did not happen within {timeout:.1f} s"
                )
            self._vehicle.check_link()
            await asyncio.sleep(PAUSE)
            message = await self.request(kind, component)
