"""A second MAVLink client that only watches a vehicle, independently of lfield."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

from pymavlink import mavutil
from pymavlink.dialects.v20 import all as dialect

#: The ids of this client differ from those of the ground station, so that it does not prevent a failsafe.
SYSTEM, COMPONENT = 77, 190
#: The requested messages and their rates (Hz).
RATES = {
    dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 10.0,
    dialect.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 5.0,
    dialect.MAVLINK_MSG_ID_CURRENT_MODE: 5.0,
}


@dataclass(frozen=True)
class Observation:
    """One observed change: time (CLOCK_MONOTONIC, s), quantity, and value."""

    at: float
    quantity: str
    value: str


class Watcher:
    """Watches one system at an endpoint; heights in metres above home, speeds over ground in m/s."""

    def __init__(self, endpoint: str, system: int) -> None:
        self._system = system
        self._link = mavutil.mavlink_connection(
            endpoint.replace("udp:", "udpout:"),
            dialect="all",
            source_system=SYSTEM,
            source_component=COMPONENT,
        )
        self._changed, self._ended = threading.Condition(), False
        self.mode, self.armed, self.height, self.speed = "", False, math.nan, math.nan
        #: Every mode, arming, and text, in order.
        self.observations: list[Observation] = []
        #: (time, speed in m/s) of every report.
        self.speeds: list[tuple[float, float]] = []
        #: (time, seconds since the start of the autopilot by its own clock) of every report.
        self.times: list[tuple[float, float]] = []
        self._thread = threading.Thread(target=self._watch, daemon=True)
        self._thread.start()

    # -- queries --------------------------------------------------------------------------------------

    def until(self, condition: Callable[[Watcher], bool], bound: float, event: str) -> float:
        """Waits until a condition of this watcher holds; returns the seconds. Fails after `bound`."""
        start = time.monotonic()
        with self._changed:
            holds = self._changed.wait_for(lambda: condition(self), bound)
        assert holds, f"waited {bound:g} s for {event}; now {self}; observed:\n{self.history(start)}"
        return time.monotonic() - start

    def top_speed(self, since: float) -> float:
        """The highest speed over ground since a time, 0 without a report."""
        return max((speed for at, speed in self.speeds if at >= since), default=0.0)

    def pace(self, last: float) -> float | None:
        """The rate of the vehicle's clock in the last seconds, 1 for real time; None with too few reports."""
        now = time.monotonic()
        reports = [report for report in self.times if report[0] >= now - last]
        if not reports or reports[-1][0] - reports[0][0] < 2.0:
            return None
        return (reports[-1][1] - reports[0][1]) / (reports[-1][0] - reports[0][0])

    def history(self, since: float = 0.0) -> str:
        """The observations, one per line, with the seconds since `since`, or since the first one."""
        start = since or (self.observations[0].at if self.observations else 0.0)
        lines = [
            f"{each.at - start:8.2f} s  {each.quantity} {each.value}"
            for each in self.observations
            if each.at >= since
        ]
        return "\n".join(lines[-40:]) or "(no observation)"

    def __str__(self) -> str:
        armed = "armed" if self.armed else "disarmed"
        return f"{self.mode or 'no contact'}, {armed}, {self.height:.1f} m up, {self.speed:.1f} m/s"

    # -- watching -------------------------------------------------------------------------------------

    def _watch(self) -> None:
        last_heartbeat = -math.inf
        while not self._ended:
            if time.monotonic() > last_heartbeat + 1.0:
                last_heartbeat = time.monotonic()
                self._send_heartbeat()
            message = self._link.recv_match(blocking=True, timeout=0.2)
            if message is not None and message.get_srcSystem() == self._system:
                with self._changed:
                    self._on_message(message)
                    self._changed.notify_all()

    def _send_heartbeat(self) -> None:
        """Sends a heartbeat, and requests the messages if none arrived in the last second."""
        send = self._link.mav
        send.heartbeat_send(dialect.MAV_TYPE_ONBOARD_CONTROLLER, dialect.MAV_AUTOPILOT_INVALID, 0, 0, 0)
        if math.isnan(self.speed) or not self.speeds or time.monotonic() - self.speeds[-1][0] > 1.0:
            number = dialect.MAV_CMD_SET_MESSAGE_INTERVAL
            for kind, rate in RATES.items():
                send.command_long_send(self._system, 1, number, 0, kind, 1e6 / rate, 0, 0, 0, 0, 0)

    def _on_message(self, message) -> None:
        kind = message.get_type()
        if kind == "HEARTBEAT" and message.get_srcComponent() == 1:
            self._note("mode", mavutil.mode_string_v10(message))
            self._note("armed", bool(message.base_mode & dialect.MAV_MODE_FLAG_SAFETY_ARMED))
        elif kind == "LOCAL_POSITION_NED":
            self.speed = math.hypot(message.vx, message.vy)
            self.speeds.append((time.monotonic(), self.speed))
            self.times.append((time.monotonic(), message.time_boot_ms / 1000.0))
        elif kind == "GLOBAL_POSITION_INT":
            self.height = message.relative_alt / 1000.0
        elif kind == "STATUSTEXT":
            self.observations.append(Observation(time.monotonic(), "text", message.text))

    def _note(self, quantity: str, value: object) -> None:
        if getattr(self, quantity) != value:
            setattr(self, quantity, value)
            self.observations.append(
                Observation(time.monotonic(), quantity, f"{value} at {self.height:.1f} m")
            )

    def close(self) -> None:
        """Ends the thread and closes the link."""
        self._ended = True
        self._thread.join(5.0)
        self._link.close()
