"""Log lines of the commands of operators and of links."""

from __future__ import annotations

from lfield.text.log_messages.log_line import Clause, LogTable

LINKS = LogTable()
_message = LINKS.message

# --- operators ------------------------------------------------------------------------------------------

EMERGENCY_STOP = _message("emergency-stop", "EMERGENCY STOP by {operator}: {reason}", "warning")
EMERGENCY_STOP_ACTIVE = _message(
    "emergency-stop-active",
    "EMERGENCY STOP still active: {reason}; end it with 'lfield estop --lift'",
    "warning",
)
EMERGENCY_STOP_LIFTED = _message(
    "emergency-stop-lifted", "emergency stop lifted by {operator}: programs may release their devices"
)
MISSION_PAUSED = _message(
    "mission-paused", "mission paused: no agent runs here until 'lfield resume'", "warning"
)
MISSION_STILL_PAUSED = _message(
    "mission-still-paused",
    "mission still paused: no agent runs here until 'lfield resume'",
    "warning",
)
MISSION_RESUMED = _message("mission-resumed", "mission resumed")
MISSION_HELD = _message(
    "mission-held",
    "mission held: no agent runs here until the result of a vote about an activation is known",
    meaning="the service of this robot votes about activating a bundle; 'lfield resume' does not end this",
)
MISSION_HOLD_ENDED = _message("mission-hold-ended", "mission no longer held by a vote")
ORDER_DENIED = _message("order-denied", "order of {operator} not executed: {reason}", "warning")
STOP_NOT_STORED = _message(
    "stop-not-stored",
    "emergency stop not stored: {reason}; after a restart this host would not restore it",
    "error",
)
STOP_END_NOT_STORED = _message(
    "stop-end-not-stored",
    "end of the emergency stop not stored: {reason}; after a restart this host would hold its devices again",
    "error",
)

# --- links ----------------------------------------------------------------------------------------------

LINKED = _message(
    "linked",
    "link to {host} established{restart}",
    restart=Clause(("restarted",), lambda restarted: "; it was restarted" if restarted else ""),
)
LINK_LOST = _message("link-lost", "link to {host} lost", "warning")
LINK_TIMED_OUT = _message(
    "link-timed-out", "link to {host} timed out after {seconds:.1f} s; closing", "warning"
)
STANDBY_READY = _message("standby-ready", "standby connection with {host} over {address}")
PATH_CHANGED = _message("path-changed", "link to {host} moves from {old} to {new}: {reason}", "warning")
LINK_REFUSED = _message("link-refused", "link to {host} refused: {reason}", "error")
HOST_UNREACHABLE = _message(
    "host-unreachable", "{host} unreachable at {address}: {reason}; retrying", "warning"
)
LINK_CLOSED = _message("link-closed", "link from {caller} closed: {reason}", "warning")
PEER_REFUSED = _message("peer-refused", "{peer} rejected: {reason}", "warning")
PEER_RESTRICTED = _message(
    "peer-restricted", "{peer} restricted to stops and to running calls: {reason}", "warning"
)
PEER_SLOWED = _message(
    "peer-slowed",
    "{peer} at {caller} throttled: {reason}; the link is closed if this lasts {seconds:g} s",
    "warning",
)
PEER_BANNED = _message(
    "peer-banned",
    "{peer} at {caller} disconnected: {reason}; {name} is accepted again after {seconds:g} s",
    "error",
)
NO_DATAGRAMS = _message(
    "no-datagrams",
    "UDP port {address} not opened: {reason}; emergency stops need a TCP connection",
    "warning",
)
NO_ZENOH = _message("zenoh-unreachable", "not listening on {address} yet: {reason}", "warning")
NO_DESCRIPTORS = _message("no-descriptors", "new connections rejected: {reason}", "error")
LISTENING_ALSO = _message("listening-also", "{host} listening on {address} too: the name now resolves to it")
LISTENING_ENDED = _message(
    "listening-ended", "{host} no longer listening on {address}: the name resolves to another address"
)
LISTENING_FAILED = _message(
    "listening-failed", "{host} not listening on {address}: {reason}; retrying", "error"
)
LINES_SUPPRESSED = _message(
    "lines-suppressed", "log lines about invalid messages of peers suppressed for {period:g} s: too many"
)
LINES_DROPPED = _message("lines-dropped", "{count} log lines about invalid messages of peers suppressed")
CRL_RECEIVED = _message("crl-received", "certificate revocation list {number} received")
CRL_INCOMPLETE = _message(
    "crl-incomplete",
    "certificate revocation list {newest} incomplete: it does not revoke {serials}, but {other} does, so the "
    "authority was restored from an older copy; this host treats these certificates as revoked until it "
    "stops; revoke them again with 'lfield keys revoke serial {first}'",
    "error",
)
CRL_NOT_STORED = _message(
    "crl-not-stored",
    "certificate revocation list {number} not stored: {reason}; after a restart this host would accept the "
    "certificates that it revokes{of_holders}; free disk space, or copy the list to the keys of this host",
    "error",
    of_holders=Clause(("holders",), lambda holders: f" ({holders})" if holders else ""),
)
CRL_STORED = _message("crl-stored", "certificate revocation list {number} stored")
REPORT_INVALID = _message("report-invalid", "status report ignored: {reason}", "warning")
