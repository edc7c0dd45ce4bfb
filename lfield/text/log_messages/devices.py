"""Log lines of devices and guards."""

from __future__ import annotations

from lfield.text.log_messages.log_line import Clause, Level, LogLine, LogTable

DEVICES = LogTable()
_message = DEVICES.message

# --- devices --------------------------------------------------------------------------------------------

DEVICE_REPORT = _message(
    "device-report", "{device}: {text}", meaning="a report of a driver that has no code of its own"
)
DEVICE_OPENED = _message("device-opened", "{device} link opened: {identity} at {endpoint}")
DEVICE_RELEASED = _message("device-released", "{device} released from its safe state")
DEVICE_GOES_SAFE = _message("device-goes-safe", "{device} entering safe state '{state}': {reason}", "warning")
DEVICE_SAFE = _message("device-safe", "{device} in safe state '{state}': {reason}", "warning")
DEVICE_AT_REST = _message("device-at-rest", "{device} at rest")
DEVICE_MOVING = _message(
    "device-moving", "{device} still moving: {moving}", meaning="progress of a stop, every few seconds"
)
DEVICE_LOCKED_OUT = _message(
    "device-locked-out",
    "{device} LOCKED OUT: {reason}; inspect it, then run 'lfield estop --lift'",
    "error",
)
DEVICE_UNCONFIRMED = _message(
    "device-unconfirmed",
    "{device} safe state not confirmed: host killed ({signal})",
    "error",
    "by `lfield up --all`, when the guard of the device has not confirmed it within 1 s",
)
DEVICE_NOT_SAFE = _message("device-not-safe", "{device} NOT SAFE: {reason}", "error")
GUARD_HANGS = _message("guard-hangs", "guard of {bus} unresponsive: restarting it", "error")
GUARD_DIED = _message("guard-died", "guard of {bus} died with status {status}: restarting it", "error")
GUARD_RESTART_FAILED = _message(
    "guard-restart-failed", "guard of {bus} not restarted: {reason}; retrying", "error"
)
GUARD_PROTOCOL = _message(
    "guard-protocol", "guard of {bus} sent invalid bytes: {reason}; restarting it", "error"
)
HEARTBEAT_LATE = _message(
    "heartbeat-late",
    "heartbeats to the guards late by {late} (longest so far {longest}): this computer is overloaded; reduce "
    "its load, since guards make their devices safe at {limit}",
    "warning",
)

# --- reports of guards and of the base class of drivers; each follows "DEVICE " ----------------------------

#: The lines of reports, without the name of the device.
DEVICE_MESSAGES = LogTable()
_report = DEVICE_MESSAGES.message

GUARD_SIGNAL_IGNORED = _report(
    "guard-signal-ignored",
    "{signal} ignored: the guard ends with its host, after it has made its devices safe",
)
RECORDING_ENDED = _report(
    "recording-ended",
    "recording of {files} ended: {reason}; the device is not affected",
    "warning",
    "by a guard that cannot write into the folder of a recording any longer",
)
DRIVER_TASK_FAILED = _report("driver-task-failed", "task failed: {reason}", "error")
DRIVER_NOT_CLOSED = _report("driver-not-closed", "not closed: {reason}", "error")
SAFE_STATE_UNCONFIRMED = _report(
    "safe-state-unconfirmed", "safe state not confirmed: {reason}; retrying", "error"
)
SENSOR_NOT_LATCHED = _report(
    "sensor-not-latched", "sensor without safe state: {reason}", meaning="why its host would make it safe"
)
DEVICE_REOPENED_WRONG = _report(
    "device-reopened-wrong", "settings differ after a restart of the guard: {reason}", "warning"
)
WATCHDOG_WAIVED = _report(
    "watchdog-waived", "device watchdog: {own}, limit {longest:g} s; accepted by a waiver"
)
SETTING_MISMATCH = _report("setting-mismatch", "setting {setting}: {reason}", "error")
SERIAL_LATENCY = _report(
    "serial-latency",
    "serial latency too high: {port} delays every response by {milliseconds} ms; write 1 into {file} (as "
    "root, or by a udev rule)",
    "warning",
)
SERIAL_LOST = _report("serial-lost", "link lost: {reason}; reopening the serial port", "warning")
ENDPOINT_LOST = _report("endpoint-lost", "link lost: {endpoint}: {reason}", "warning")
ENDPOINT_UNOPENED = _report(
    "endpoint-unopened", "link not opened: {endpoint}: {reason} (attempt {count})", "warning"
)


def _answer(address: str, attempts: int, seconds: float) -> str:
    if not address:
        return ""
    return f": {address}, after {attempts} attempt{'s' * (attempts != 1)} and {seconds:.0f} s"


ENDPOINT_REOPENED = _report(
    "endpoint-reopened",
    "link opened: {endpoint}{answer}",
    answer=Clause(("address", "attempts", "seconds"), _answer),
)
SERIAL_BACK = _report("serial-back", "link opened: serial port {port}")


def report_line(device: str, text: str, code: str, level: Level) -> LogLine:
    """The log line of a report of a driver or guard; `code` is '' for a report without a code."""
    line = DEVICE_REPORT.line(device=device, text=text)
    return LogLine(f"{device} {text}", code, level, line.template_values) if code else line


def report_fields(text: str) -> tuple[str, str, Level]:
    """Text, code and level of a report; '' and "info" for a plain string."""
    return (str(text), text.code, text.level) if isinstance(text, LogLine) else (text, "", "info")
