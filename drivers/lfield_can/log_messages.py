"""The log lines of the CAN driver: each has a stable code (lfield/docs/messages.md)."""

from lfield.driver import LogMessage

# --- the bus --------------------------------------------------------------------------------------------

ERROR_FRAMES = LogMessage("can-error-frames", "error frames on {bus} (count {count}): {reason}", "warning")
BUS_STATE = LogMessage("can-bus-state", "controller of {bus} {state}: {reason}", "warning")
BUS_ACTIVE = LogMessage("can-bus-active", "controller of {bus} error active again")
SILENT = LogMessage("can-silent", "link lost: no message received", "warning")
RESPONDING = LogMessage("can-responding", "link restored: messages are received again")
ID_CONFLICT = LogMessage("can-id-conflict", "motion refused: {reason}", "error")
ID_UNIQUE = LogMessage("can-id-unique", "motion permitted again: the id is unique")

# --- axes -----------------------------------------------------------------------------------------------

SETUP_FAILED = LogMessage("can-setup-failed", "set-up failed: {reason}; retrying", "warning")
SET_UP_AGAIN = LogMessage("can-set-up-again", "restarted and set up again; not enabled", "warning")
LEAVING_BOUNDS = LogMessage("can-leaving-bounds", "stopped: the axis moved out of its bounds", "error")
EMERGENCY = LogMessage("can-emergency", "emergency message: {reason}", "error")
TORQUE_GAP = LogMessage(
    "can-torque-gap", "torque off briefly: the drive cannot be enabled from a quick stop", "warning"
)
LIMIT_BY_DRIVER = LogMessage("can-limit-by-driver", "limit enforced by this driver only: {reason}")
COASTS = LogMessage("can-coasts", "coasts after a fault: object 0x605E (fault reaction) is 0", "warning")
QUICK_STOP_UNKNOWN = LogMessage(
    "can-quick-stop-unknown",
    "effect of a quick stop unknown: {reason}; check in the manual of the drive whether a quick stop brakes",
    "warning",
)
HEARTBEAT_IGNORED = LogMessage(
    "can-heartbeat-ignored", "heartbeat of this computer not monitored: {reason}", "warning"
)
PDO_LACKS = LogMessage("can-pdo-lacks", "the drive does not {ability}: {reason}")
PDO_BY_SYNC = LogMessage("can-pdo-by-sync", "{pdo} has no timer: requested by SYNC")
PDO_BY_CHANGE = LogMessage(
    "can-pdo-by-change",
    "{pdo} is sent only on change (transmission type {type}): its values are valid while the drive's "
    "heartbeat is received",
)
PDO_SLOW = LogMessage(
    "can-pdo-slow", "{pdo} is sent at most every {milliseconds:g} ms: its values are outdated", "warning"
)

# --- devices of DBC and EDS files -----------------------------------------------------------------------

FILE_WARNING = LogMessage("can-file-warning", "{place}: warning[{kind}]: {reason}; {hint}", "warning")
FILE_WARNINGS = LogMessage("can-file-warnings", "{path}: more warnings: {count}", "warning")
TWO_SOURCES = LogMessage(
    "can-two-sources",
    "{message} comes from two addresses, 0x{first:02X} and 0x{second:02X}; using 0x{first:02X}: specify the "
    "address in the DBC file",
    "warning",
)
INVALID_FRAME = LogMessage("can-invalid-frame", "message {message} invalid: {reason}", "warning")
NOT_SAFE = LogMessage("can-not-safe", "safe state not commanded: {reason}", "error")
CYCLE_OVERRUN = LogMessage(
    "can-cycle-overrun",
    "cyclic frames not sent because the guard was late (count {count}): use longer periods, or a computer "
    "with less load",
    "warning",
)
NOTHING_RECEIVED = LogMessage("can-nothing-received", "no message received: waived by its binding", "warning")

# --- DroneCAN -------------------------------------------------------------------------------------------

NODE_ID_GIVEN = LogMessage("can-node-id-given", "node id {node} assigned to the unique id {unique_id}")
OTHER_ALLOCATOR = LogMessage(
    "can-other-allocator",
    "no more node ids assigned: node {node} is an allocator too; remove 'unique_id' from the "
    "bindings, or remove that node",
    "warning",
)
NODE_RESTARTED = LogMessage("can-node-restarted", "node {node} restarted", "warning")
