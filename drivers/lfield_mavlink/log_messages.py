"""The log lines of the MAVLink driver: each has a stable code (lfield/docs/messages.md)."""

from lfield.driver import LogMessage

# --- links and identity ---------------------------------------------------------------------------------

SERIAL_LOST = LogMessage("mavlink-serial-lost", "link lost: serial:{path}: {reason}; reopening it", "warning")
SERIAL_BACK = LogMessage("mavlink-serial-back", "link opened: serial:{path}")
LINK_UNOPENED = LogMessage(
    "mavlink-link-unopened", "link not opened: {reason}; continuing with the other links", "warning"
)
LINK_STILL_UNOPENED = LogMessage(
    "mavlink-link-still-unopened", "link not opened: {reason} (attempt {attempt})", "warning"
)
LINK_OPENED = LogMessage("mavlink-link-opened", "link opened: {link}, after {attempts} attempts")
LINK_SILENT = LogMessage("mavlink-link-silent", "link lost: no message received", "warning")
LINK_BACK = LogMessage("mavlink-link-back", "link restored: messages are received again")
SETUP_FAILED = LogMessage(
    "mavlink-setup-failed", "set-up failed after the link was restored: {reason}; retrying", "warning"
)
SIGNING_NOT_STORED = LogMessage(
    "mavlink-signing-not-stored",
    "signing time not stored: {reason}; after a restart the vehicle may ignore packets temporarily",
    "warning",
)
ADDRESS_CHANGED = LogMessage("mavlink-address-changed", "address changed to {new}, from {old}")
TWO_VEHICLES = LogMessage(
    "mavlink-two-vehicles",
    "not unique: two vehicles send as system {system}: {own}, and {other}, which is ignored; {remedy}",
    "error",
)
TWO_VEHICLES_MIXED = LogMessage(
    "mavlink-two-vehicles-mixed",
    "not unique: two vehicles send as system {system}, both over {source}: the telemetry of the second is "
    "ignored, but both receive commands; {remedy}",
    "error",
)
STATION_CONFLICT = LogMessage("mavlink-station-conflict", "motion commands refused: {reason}", "error")
FOREIGN_COMPONENT = LogMessage(
    "mavlink-foreign-component",
    "ignoring heartbeats of {sender}: they carry the ids of this vehicle's autopilot (system {system}, "
    "component {component}) and arrive over {place}; give their sender its own ids",
    "warning",
)
SAME_VEHICLE = LogMessage("mavlink-same-vehicle", "same vehicle as before, after {reason}: {comparison}")
OTHER_VEHICLE = LogMessage("mavlink-other-vehicle", "commands refused: {reason}", "error")

# --- reports of the autopilot ---------------------------------------------------------------------------

AUTOPILOT_TEXT = LogMessage(
    "mavlink-autopilot-text", "autopilot: {text}", "warning", "a STATUSTEXT of severity warning or higher"
)
NO_ORIGIN = LogMessage(
    "mavlink-no-origin",
    "frame origin unknown: no position in the team's frame before the vehicle has a position estimate",
)
NO_HOME = LogMessage(
    "mavlink-no-home",
    "home position unknown: positions are relative to the place where the vehicle was switched on",
)
TELEMETRY_MISSING = LogMessage("mavlink-telemetry-missing", "telemetry not reported: {names}", "warning")
NOT_ARMABLE = LogMessage("mavlink-not-armable", "arming delayed: {reason}")
AUTONOMOUS_WAIVED = LogMessage(
    "mavlink-autonomous-waived",
    "autonomous motions continue if this computer fails: waived by its binding: {reason}",
)

GIMBAL_CONTROLLED = LogMessage(
    "mavlink-gimbal-controlled",
    "gimbal not pointed: system {system}, component {component} controls it; acquireGimbal() takes control",
    "warning",
)
GIMBAL_CONTROL_UNKNOWN = LogMessage(
    "mavlink-gimbal-control-unknown",
    "gimbal not pointed: component {component} does not report which station controls it; acquireGimbal() "
    "takes control",
    "warning",
)

# --- motion ---------------------------------------------------------------------------------------------

FOREIGN_CONTROL = LogMessage(
    "mavlink-foreign-control", "under foreign control: {reason}; release() takes control again", "warning"
)
LEFT_ALONE = LogMessage(
    "mavlink-left-alone", "not commanded: the vehicle is in {mode}, controlled by {holder}", "warning"
)
FALLING = LogMessage("mavlink-falling", "falling: {reason}", "error")
CRASHED = LogMessage("mavlink-crashed", "crashed: {reason}", "error")
FENCE_SUSPECTED = LogMessage("mavlink-fence-suspected", "motion blocked: {symptom}, and {reason}", "warning")
MISSION_CHANGED = LogMessage(
    "mavlink-mission-changed", "mission changed in flight: {reason}; holding", "warning"
)
NOT_HOLDING = LogMessage("mavlink-not-holding", "not holding: {reason}", "error")
MOTORS_ON = LogMessage(
    "mavlink-motors-on", "motors still on after {seconds:g} s on the ground: switching them off", "warning"
)
LIMIT_EXEMPT = LogMessage(
    "mavlink-limit-exempt", "limit exceeded: {excess}; not corrected, {reason}", "warning"
)
LIMIT_EXCEEDED = LogMessage("mavlink-limit-exceeded", "limit exceeded: {excess}; {correction}", "warning")
LIMIT_NOT_CORRECTED = LogMessage(
    "mavlink-limit-not-corrected", "{quantity} not corrected: {reason}; retrying", "warning"
)
LIMIT_KEPT = LogMessage("mavlink-limit-kept", "within its limit of {limit} again")
SPEED_RESTORED = LogMessage("mavlink-speed-restored", "speed of {speed:g} m/s commanded again")
SPEED_NOT_CORRECTED = LogMessage("mavlink-speed-not-corrected", "speed not corrected: {reason}", "warning")
