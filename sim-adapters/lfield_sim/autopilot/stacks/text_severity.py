"""Severity of each text by its beginning, as recorded.

A text has one severity on all vehicles, except for some of rovers. Unlisted ones are INFO.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum


class Severity(IntEnum):
    """The used values of MAV_SEVERITY."""

    CRITICAL = 2
    WARNING = 4
    NOTICE = 5
    INFO = 6
    DEBUG = 7


_BEGINNINGS: Mapping[Severity, tuple[str, ...]] = {
    Severity.CRITICAL: (
        # ArduPilot
        "Arm: ",
        "PreArm: ",
        "Auto: Missing Takeoff Cmd",
        "Battery 1 is critical",
        "Battery 1 is empty",
        "Crash: ",
        "EKF Failsafe",
        "EKF failsafe",
        "Mission: there is no item",
        "Motor Test: vehicle not landed",
        "Place vehicle level",
        "Potential Thrust Loss",
        # PX4
        "Already higher than takeoff altitude",
        "Arming denied",
        "Critical battery level",
        "Dangerous battery level",
        "Disarming denied",
        "Failsafe activated",
        "Geofence: ",
        "IGN MISSION_ITEM",
        "Operation timeout",
        "Preflight Fail: ",
        "Reposition is outside geofence",
        "Switching to ",
        "WPM: ",
        "[cal] calibration cancelled",
    ),
    Severity.WARNING: (
        # ArduPilot
        "Battery 1 is low",
        "Battery Failsafe",
        "Fence validation failed",
        "Flight mode change failed",
        "GCS Failsafe",
        "Invalid vertex count",
        "Mission upload timeout",
        "Mode change to AUTO failed",
        "No such mode",
        "Radio Failsafe",
        "got MISSION_REQUEST",
        "target not received",
        # PX4
        "Low battery level",
        "Preflight Fail: No connection to the GCS",
    ),
    Severity.NOTICE: (
        "Circle fence breached",
        "Disarm to allow calibration",
        "Fence breach cleared",
        "Max Alt fence breached",
        "Mission Complete",
        "No Mission.",
        "Polygon fence breached",
    ),
    Severity.DEBUG: ("Fence Indexed OK", "INS: ", "RCInput: ", "Unsupported FTP"),
}
_OF_ROVERS: Mapping[str, Severity] = {"GCS Failsafe Cleared": Severity.INFO}
#: The longest match applies.
_SEVERITIES = sorted(
    ((text, severity) for severity, texts in _BEGINNINGS.items() for text in texts),
    key=lambda each: len(each[0]),
    reverse=True,
)


def severity_of(text: str, *, rover: bool) -> Severity:
    """The severity of a text."""
    if rover and text in _OF_ROVERS:
        return _OF_ROVERS[text]
    return next((severity for prefix, severity in _SEVERITIES if text.startswith(prefix)), Severity.INFO)
