"""The log lines of the Dynamixel driver: each has a stable code (lfield/docs/messages.md)."""

from lfield.driver import LogMessage

PORT_LOST = LogMessage("dynamixel-port-lost", "link lost: {reason}; reopening the port", "warning")
PORT_BACK = LogMessage("dynamixel-port-back", "link restored: the port is open again")
ECHO_REMOVED = LogMessage(
    "dynamixel-echo-removed", "echo removed: the adapter returns what is sent", "info", "half-duplex adapters"
)
SERVO_SILENT = LogMessage("dynamixel-servo-silent", "servo {number} not responding; retrying", "warning")
SERVO_BACK = LogMessage("dynamixel-servo-back", "servo {number} responding again: {condition}")
ID_CONFLICT = LogMessage("dynamixel-id-conflict", "motion refused: {reason}", "error")
FAULT = LogMessage("dynamixel-fault", "servo {number} fault: {fault}; torque {torque}", "error")
WATCHDOG_FIRED = LogMessage(
    "dynamixel-watchdog-fired", "servo {number} stopped by its own watchdog; release() frees it", "warning"
)
