"""Log lines of the service; a table as that of `lfield.text.log_messages`."""

from __future__ import annotations

from lfield.text.log_messages import Level, LogMessage

#: Every message of the service by its code.
SERVICE_MESSAGES: dict[str, LogMessage] = {}


def _message(code: str, template: str, level: Level = "info", meaning: str = "") -> LogMessage:
    message = LogMessage(code, template, level, meaning)
    assert code not in SERVICE_MESSAGES, code
    SERVICE_MESSAGES[code] = message
    return message


LISTENING = _message("service-listening", "{host} service listening on {address}; active bundle {bundle}")
BUNDLE_STORED = _message("service-bundle-stored", "bundle {bundle} of {mission} stored, signed by {by}")
BUNDLE_REFUSED = _message("service-bundle-refused", "bundle {bundle} refused: {reason}", "warning")
VOTED = _message("service-voted", "vote {vote} on activating {bundle}, proposed by {by}{reason}")
BALLOT_OPEN = _message(
    "service-ballot-open",
    "activation of {bundle} undecided for {seconds:.0f} s: votes of {missing} unknown; no start until then",
    "warning",
)
ACTIVATED = _message("service-activated", "bundle {bundle} active, decided by the votes of {hosts}")
ABORTED = _message("service-aborted", "activation of {bundle} aborted: {reason}", "warning")
HOST_STARTED = _message("service-host-started", "host of {bundle} started, process {pid}")
HOST_ADOPTED = _message(
    "service-host-adopted",
    "host of {bundle} still running as process {pid}",
    meaning="the service was restarted and supervises it again",
)
HOST_ENDED = _message(
    "service-host-ended", "host of {bundle} ended with status {status}: {reason}", "warning"
)
HOST_RESTART = _message(
    "service-host-restart", "host of {bundle} restarts in {seconds:g} s: {reason}", "warning"
)
HOST_INTERRUPTED = _message(
    "service-host-interrupted", "mission interrupted: {reason}; 'lfield start' continues it", "warning"
)
MISSED_END = _message(
    "service-missed-end",
    "mission ended on {host} while the host of this robot was not running; stopping the host of this robot",
)
COMMAND = _message("service-command", "{action} requested by {operator}")
COMMAND_REFUSED = _message("service-command-refused", "{action} of {operator} refused: {reason}", "warning")
DISCARDED = _message("service-discarded", "coordinators {agents} discarded by {operator}", "warning")
STATE_ERROR = _message("service-state-error", "state of the service not stored: {reason}", "error")
