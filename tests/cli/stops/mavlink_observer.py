"""A second MAVLink client that only observes: the vehicle's behaviour, independent of hosts and guards."""

from __future__ import annotations

import threading
import time

from pymavlink import mavutil
from pymavlink.dialects.v20 import all as dialect

# : Seconds for anything that depends on the load of the computer.
BOUND = 120.0


class MavlinkObserver:
    """Watches system 1 at a fake's UDP endpoint; times are of the monotonic clock, heights in metres."""

    def __init__(self, endpoint: str) -> None:
        # Not the autopilot's ground station: these heartbeats must not prevent a failsafe.
        self._link = mavutil.mavlink_connection(
            endpoint.replace("udp:", "udpout:"), source_system=77, source_component=190
        )
        self._changed, self._ended = threading.Condition(), False
        self.mode, self.armed, self.height = "", False, 0.0
        self._answers = 0
        #: Every mode of the vehicle, with the height at its start.
        self.modes: list[tuple[float, str]] = []
        self._thread = threading.Thread(target=self._watch, daemon=True)
        self._thread.start()

    def _watch(self) -> None:
        greeted = 0.0
        while not self._ended:
            if time.monotonic() > greeted + 1.0:
                greeted = time.monotonic()
                self._link.mav.heartbeat_send(
                    dialect.MAV_TYPE_ONBOARD_CONTROLLER, dialect.MAV_AUTOPILOT_INVALID, 0, 0, 0
                )
            message = self._link.recv_match(
                type=["HEARTBEAT", "GLOBAL_POSITION_INT", "LOCAL_POSITION_NED", "COMMAND_ACK"],
                blocking=True,
                timeout=0.2,
            )
            if message is not None and message.get_srcSystem() == 1:
                with self._changed:
                    self._on_message(message)
                    self._changed.notify_all()

    def _on_message(self, message) -> None:
        if message.get_type() == "COMMAND_ACK":
            self._answers += message.command == dialect.MAV_CMD_REQUEST_MESSAGE
        elif message.get_type() == "HEARTBEAT":
            mode = mavutil.mode_mapping_acm.get(message.custom_mode, str(message.custom_mode))
            if mode != self.mode:
                self.mode = mode
                self.modes.append((self.height, mode))
            self.armed = bool(message.base_mode & dialect.MAV_MODE_FLAG_SAFETY_ARMED)
        elif message.get_type() == "LOCAL_POSITION_NED":
            self.height = -message.z
        else:
            self.height = message.relative_alt / 1000.0

    def take_over(self, mode: str) -> None:
        """Take over the vehicle by a change of mode, as a pilot does."""
        number = next(number for number, name in mavutil.mode_mapping_acm.items() if name == mode)
        self._link.mav.set_mode_send(1, dialect.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED, number)
        self.until(lambda seen: seen.mode == mode)

    def catch_up(self) -> None:
        """Wait for the messages that the vehicle has already sent: a busy computer reads them late."""
        before = self._answers
        self._link.mav.command_long_send(
            1, 1, dialect.MAV_CMD_REQUEST_MESSAGE, 0, dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION, *[0.0] * 6
        )
        self.until(lambda seen: seen._answers > before)

    def until(self, condition, bound: float = BOUND) -> None:
        """Wait until a condition of this observer holds."""
        with self._changed:
            is_met = self._changed.wait_for(lambda: condition(self), bound)
        assert is_met, f"mode {self.mode}, {'armed' if self.armed else 'not armed'}, {self.height:.1f} m up"

    def close(self) -> None:
        """Stop observing."""
        self._ended = True
        self._thread.join(5.0)
        self._link.close()
