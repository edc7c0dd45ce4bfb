"""Information about an autopilot on request: older commands, modes, logs.

Commands: https://mavlink.io/en/messages/common.html, modes:
https://mavlink.io/en/services/standard_modes.html, logs: messages 117 to 120 of the same page. Answers as
recorded.
"""

from __future__ import annotations

from typing import Any

from pymavlink.dialects.v20 import all as dialect

from lfield_sim.autopilot.autopilot import Autopilot
from lfield_sim.autopilot.flavours import MavResult
from lfield_sim.mavlink.geo import GeoOrigin
from lfield_sim.mavlink.mav_command import CommandAnswer, MavCommand
from lfield_sim.mavlink.services.service import VehicleService
from lfield_sim.mavlink.telemetry.condition_messages import autopilot_version, fence_status, home_position
from lfield_sim.mavlink.telemetry.target_messages import distance_of

#: Messages that PX4 accepts but that clients here cannot parse: protocol version, component information.
UNREAD = (300, 395, 397)
#: Messages that PX4 does not send on request: MISSION_CURRENT, RELAY_STATUS.
REFUSED = (42, 376)
#: REQUEST_PROTOCOL_VERSION and REQUEST_CAMERA_INFORMATION, which were removed from the dialect.
PROTOCOL_VERSION, CAMERA_INFORMATION = 519, 521
#: Seconds from a request to PX4's list of logs; bytes of the one log.
LOG_PAUSE, LOG_SIZE = 0.3, 188_416


class InformationService(VehicleService):
    """Information about one vehicle."""

    def __init__(self, autopilot: Autopilot, place: GeoOrigin) -> None:
        super().__init__(autopilot, place)
        self._px4 = autopilot.flavour.submodes
        self._logs_at: float | None = None
        self.handles = {dialect.MAVLINK_MSG_ID_LOG_REQUEST_LIST: self._on_log_list}
        self.commands = {
            dialect.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES: self._capabilities,
            dialect.MAV_CMD_GET_HOME_POSITION: self._home,
            PROTOCOL_VERSION: self._protocol_version,
            CAMERA_INFORMATION: self._camera_information,
            dialect.MAV_CMD_ACTUATOR_TEST: self._camera_information,
        }
        self.messages = {} if self._px4 else {dialect.MAVLINK_MSG_ID_NAV_CONTROLLER_OUTPUT: self._navigation}
        self.requests = {dialect.MAVLINK_MSG_ID_AVAILABLE_MODES: self._modes}
        if self._px4:
            self.requests |= dict.fromkeys(UNREAD, list) | dict.fromkeys(REFUSED, _nothing)
        else:
            self.requests[dialect.MAVLINK_MSG_ID_MISSION_ITEM_REACHED] = self._last_reached
            self.requests[dialect.MAVLINK_MSG_ID_FENCE_STATUS] = self._fence

    def advance(self, now: float) -> list[Any]:
        """PX4's list of logs, when it is due."""
        if self._logs_at is None or now < self._logs_at:
            return []
        self._logs_at = None
        return [_log(0)]

    def reboot(self) -> None:
        """Drops pending log requests."""
        self._logs_at = None

    # -- commands -------------------------------------------------------------------------------------

    def _capabilities(self, _: MavCommand) -> CommandAnswer:
        return MavResult.ACCEPTED, [autopilot_version(self.autopilot, self.place)]

    def _home(self, _: MavCommand) -> CommandAnswer:
        return MavResult.ACCEPTED, [home_position(self.autopilot, self.place)]

    def _protocol_version(self, _: MavCommand) -> CommandAnswer:
        return (MavResult.ACCEPTED if self._px4 else MavResult.UNSUPPORTED), []

    def _camera_information(self, _: MavCommand) -> CommandAnswer:
        """Refuses a request for camera information; PX4 does not answer for other components."""
        return (None if self._px4 else MavResult.UNSUPPORTED), []

    # -- messages -------------------------------------------------------------------------------------

    def _modes(self) -> list[Any]:
        """AVAILABLE_MODES 435, one for each mode."""
        modes = self.autopilot.kind.modes
        return [
            dialect.MAVLink_available_modes_message(
                len(modes), number, mode.standard, mode.number, 0, name.encode()
            )
            for number, (name, mode) in enumerate(modes.items(), 1)
        ]

    def _last_reached(self) -> list[Any]:
        return [dialect.MAVLink_mission_item_reached_message(self.autopilot.mission.last_reached)]

    def _fence(self) -> list[Any]:
        """The state of the fence, which ArduPilot reports only while the fence is enabled."""
        enabled = self.autopilot.parameters[self.autopilot.flavour.fence.enable]
        return [fence_status(self.autopilot, self.place)] if enabled else []

    def _navigation(self) -> Any:
        """NAV_CONTROLLER_OUTPUT 62: only the distance to its target, 0 for none."""
        distance = distance_of(self.autopilot)
        return dialect.MAVLink_nav_controller_output_message(0.0, 0.0, 0, 0, distance, 0.0, 0.0, 0.0)

    # -- logs -----------------------------------------------------------------------------------------

    def _on_log_list(self, _: Any) -> list[Any]:
        if not self._px4:
            return [_log(1)]
        self._logs_at = self.autopilot.now + LOG_PAUSE
        return []


def _nothing() -> None:
    return None


def _log(number: int) -> Any:
    return dialect.MAVLink_log_entry_message(number, 1, 1, 0, LOG_SIZE)
