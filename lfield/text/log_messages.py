"""The table of log lines: each has a stable code, a level and a template.

A host logs only the `LogLine`s that `LogMessage.line` makes. Drivers have tables of their own, with
`LogMessage`s of the same kind. `lfield/docs/messages.md` lists all tables; events carry code and level
(`lfield events --json`).
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from math import isfinite
from typing import Literal, NamedTuple

Level = Literal["info", "warning", "error"]


class LogLine(str):
    """The text of a log line, with the code and the level of its message, and the values of its template."""

    __slots__ = ("code", "level", "template_values")

    def __new__(cls, text: str, code: str, level: Level, template_values: Mapping[str, object]) -> LogLine:
        """`LogMessage.line` and `report_line` call this, and readers of lines that a host has logged."""
        made = super().__new__(cls, text)
        made.code, made.level = code, level
        made.template_values = template_values
        return made

    code: str
    level: Level
    template_values: Mapping[str, object]

    def as_data(self) -> dict[str, object]:
        """Code, level, text and fields, as of JSON; a value that is no number or text becomes text."""
        plain = {
            name: value if isinstance(value, int) or _is_finite(value) else str(value)
            for name, value in self.template_values.items()
        }
        return {"code": self.code, "level": self.level, "text": str(self), "fields": plain}


def _is_finite(value: object) -> bool:
    """Whether it is a number that JSON has."""
    return isinstance(value, float) and isfinite(value)


class Clause(NamedTuple):
    """A part of a template that is made from values: they stay plain data, and the text reads well."""

    values: tuple[str, ...]
    text: Callable[..., str]


@dataclass(frozen=True, slots=True)
class LogMessage:
    """One kind of log line; `meaning` explains the template where necessary.

    `clauses` are the fields of the template that are no values.
    """

    code: str
    template: str
    level: Level = "info"
    meaning: str = ""
    clauses: Mapping[str, Clause] = field(default_factory=dict, compare=False)

    def line(self, **values: object) -> LogLine:
        """The line with the values of its template and of its clauses."""
        made = {
            name: clause.text(*(values[each] for each in clause.values))
            for name, clause in self.clauses.items()
        }
        return LogLine(self.template.format(**values, **made), self.code, self.level, values)


#: Every message by its code.
LOG_MESSAGES: dict[str, LogMessage] = {}


def _message(
    code: str, template: str, level: Level = "info", meaning: str = "", **clauses: Clause
) -> LogMessage:
    assert code not in LOG_MESSAGES, code
    LOG_MESSAGES[code] = LogMessage(code, template, level, meaning, clauses)
    return LOG_MESSAGES[code]


# --- the host and its journal ---------------------------------------------------------------------------

#: What the line of a host says for each value of `journal`.
_JOURNALS = {"stored": "", "none": "; state not saved", "simulation": "; no journal (simulation)"}
_LOCAL = "for commands of this computer"
HOST_LISTENING = _message(
    "host-listening",
    "{host} listening {where}{unsaved}",
    meaning=f"journal is one of: {', '.join(_JOURNALS)}",
    where=Clause(("address",), lambda address: f"on {address}" if address else _LOCAL),
    unsaved=Clause(("journal",), _JOURNALS.__getitem__),
)
HOST_FAILED = _message("host-failed", "{host} stopped: {reason}", "error")
TRACEBACK = _message(
    "traceback", "traceback of the failure:\n{text}", "error", "only with LFIELD_TRACEBACK=1"
)
HOST_ENDING_ERROR = _message("host-ending-error", "{host} stopped with another error: {reason}", "error")
HOST_RECORDING_ENDED = _message(
    "host-recording-ended",
    "the recording of {host} ended: {reason}; the mission is not affected",
    "warning",
    "by a host that cannot write into the folder of its recording, or by a fault of the recorder",
)
NO_CONTROL_SOCKET = _message(
    "no-control-socket",
    "{host} without control socket: {reason}; commands reach it over the network only, with keys",
    "warning",
)
HOST_KILLED = _message("host-killed", "{host} killed ({signal})", "error", "by `lfield up --all`")
HOST_STUCK = _message(
    "host-stuck", "{host} killed: it did not stop within {seconds:.0f} s", "error", "by `lfield up --all`"
)
BUNDLE_KEPT = _message(
    "bundle-kept", "bundle {bundle} accepted because its mission has already started: {reason}", "warning"
)
CLOCK_BEHIND = _message(
    "clock-behind",
    "system clock behind: it shows {shown}, and it is at least {least}, since {evidence}; set the clock",
    "warning",
)
CLOCK_AHEAD = _message(
    "clock-ahead",
    "event timestamps of {host} ignored: {seconds:.0f} s ahead of the clock of this host; set both clocks, "
    "and restart the host whose clock was ahead",
    "warning",
    "the order of its events and those of this host is not certain",
)
CLOCK_SET = _message("clock-set", "system clock set: it changed by {seconds:+.0f} s", "warning")
SEQUENCE_STARTED = _message("sequence-started", "{agent} started by {by} (start {generation})")
SEQUENCE_STOPPING = _message("sequence-stopping", "{agent} is being stopped by {by}")
SEQUENCE_REFUSED = _message("sequence-refused", "{function} by {agent} refused: {reason}", "warning")
INPUT_AWAITED = _message(
    "input-awaited",
    "{agent} waits for a line of input, at most {seconds:g} s: type it where this host runs, or on the page "
    "of lfield watch",
    meaning="of `read` in the program",
)
INPUT_READ = _message("input-read", "{agent} has read: {text}", meaning="a line of the operator's input")
INPUT_DROPPED = _message("input-dropped", "line of input for {host} ignored: {reason}", "warning")
INPUT_RECEIVED = _message("input-received", "line of input received from {operator}")
INPUT_CUT = _message(
    "input-cut", "line of input for {host} shortened to {length} characters", "warning", "the rest is dropped"
)
INPUT_UNADDRESSED = _message(
    "input-unaddressed",
    "line of input ignored: it names no host: type HOST: TEXT, where HOST is {hosts}",
    "warning",
    "by `lfield up --all`, where several hosts run programs that read",
)
ENGINE_FALLBACK = _message("engine-fallback", "the reference engine runs the program: {reason}", "warning")
METHOD_UNCOMPILED = _message(
    "method-uncompiled", "method {method} not compiled: {reason}; the reference engine runs it", "warning"
)
BLOCK_OUTSIDE_ARENA = _message(
    "block-outside-arena",
    "{agent} running slowly: its block of {size:.1f} MiB does not fit into the WebAssembly memory with "
    "those of the other agents, so the reference engine runs it",
    "warning",
)
CODE_CACHE_IGNORED = _message(
    "code-cache-ignored", "machine code compiled again: {file}: {reason}", "warning"
)
JOURNAL_BLOCKED = _message("journal-blocked", "coordinators blocked: journal write failed: {reason}", "error")
JOURNAL_WRITABLE = _message("journal-writable", "journal writable again")
MIGRATIONS_REJECTED = _message("migrations-rejected", "{host} rejecting migrations: {reason}", "warning")
MIGRATIONS_ACCEPTED = _message("migrations-accepted", "{host} accepting migrations again")
WAITING_FOR_REST = _message(
    "waiting-for-rest",
    "{host} stopping: waiting for its devices to come to rest; a second Ctrl-C or SIGTERM does not wait",
)

# --- the end of a run of all hosts ------------------------------------------------------------------------

_HOP_NOUN = Clause(("hops",), lambda hops: "hop" if hops == 1 else "hops")
MISSION_COMPLETED = _message(
    "mission-completed",
    "mission completed after {seconds:.0f} s, {hops} {hop_noun}; exit status {status}",
    hop_noun=_HOP_NOUN,
)
MISSION_INTERRUPTED = _message(
    "mission-interrupted",
    "mission stopped after {seconds:.0f} s, {hops} {hop_noun}; exit status {status}: interrupted",
    "warning",
    hop_noun=_HOP_NOUN,
)
MISSION_FAILED = _message(
    "mission-failed",
    "mission failed on {where} after {seconds:.0f} s, {hops} {hop_noun}; exit status {status}: {reason}",
    "error",
    hop_noun=_HOP_NOUN,
)

# --- agents ---------------------------------------------------------------------------------------------

PROGRAM_OUTPUT = _message("program-output", "{agent}: {text}", meaning="what a program prints")
OUTPUT_DROPPED = _message(
    "output-dropped", "{count} lines left out: too frequent", meaning="in `lfield logs`: output of programs"
)
AGENT_DIED = _message("agent-died", "{agent} died of an uncaught {report}", "error")
AGENT_DUMPED = _message("agent-dumped", "{agent} dumped: read it with 'lfield inspect {path}'")
AGENT_NOT_DUMPED = _message("agent-not-dumped", "{agent} not dumped to {path}: {reason}", "error")
_OMITTED = Clause(
    ("omitted",), lambda omitted: f" ({omitted} more since the last such line)" if omitted else ""
)
LOOP_OVERRUN = _message(
    "loop-overrun",
    "loop {loop} of {agent} overran: its next tick was due {late:.3f} s earlier; {skipped} skipped{more}",
    meaning="its body or its host took longer than the period; at most one line per loop in 10 s",
    more=_OMITTED,
)
LOOP_FAILED = _message(
    "loop-failed",
    "loop {loop} of {agent} failed: {reason}; it continues at its next tick{more}",
    "warning",
    "at most one line per loop in 10 s",
    more=_OMITTED,
)
LOOP_SUPPRESSED = _message(
    "loop-suppressed",
    "loop {loop} of {agent} suppressed by {by}{more}",
    meaning="at most one line per loop in 10 s",
    more=_OMITTED,
)
INIT_WAIT = _message(
    "init-wait", "{agent} waiting: the init of {resource} has neither returned nor yielded yet"
)
START_WAIT = _message(
    "start-wait",
    "{agents} not started: waiting for {hosts}; start these hosts, or start the mission without them: "
    "'lfield start {options}'",
)
START_HELD = _message("start-held", "{agents} not started: {reason}; then run 'lfield start'")
START_NEEDS_HISTORY = _message(
    "start-needs-history",
    "{agents} not started: this host has no record of earlier starts, and {hosts} has to answer first; "
    "--first-start states that there was no earlier start",
)
START_WITHOUT_PROOF = _message(
    "start-without-proof",
    "{agents} started without proof: this host has no record of earlier starts, and {hosts} did not answer; "
    "an earlier start that still runs there would run twice",
    "warning",
)
START_PAUSED = _message("start-paused", "{agents} not started: {reason}")
START_WITHOUT_HOSTS = _message(
    "start-without-hosts", "start without {hosts}: requested by an operator", "warning"
)
START_NEEDS_MAJORITY = _message(
    "start-needs-majority", "{agents} not started: no majority of the members responds yet"
)
START_REFUSED = _message("start-refused", "{agent} not started again: it {reason}", "warning")
START_REQUESTED = _message("start-requested", "start requested: 'lfield start' by {operator}")
PORTAL_CALLED = _message("portal-called", "{resource}.{portal}() called by {caller}")
PORTAL_CALL_ENDED = _message("portal-call-ended", "{resource}.{portal}() called by {caller} ended: {outcome}")
PORTAL_CALL_REFUSED = _message(
    "portal-call-refused", "{resource}.{portal}() not called for {caller}: {reason}", "warning"
)
ASSISTANT_CALLED = _message("assistant-called", "tool {tool} called by {caller}: {arguments}")
ASSISTANT_ANSWERED = _message("assistant-answered", "tool {tool} called by {caller} ended: {outcome}")
ASSISTANT_REFUSED = _message(
    "assistant-request-refused", "request {method} of {caller} refused: {reason}", "warning"
)
ASSISTANT_LINE_SKIPPED = _message(
    "assistant-line-skipped",
    "a line of the assistant's program skipped: it is not a message: {reason}",
    "warning",
)
AGENT_RESUMED = _message("agent-resumed", "{agent} resumed from the journal")
AGENT_RESTARTED = _message(
    "agent-restarted",
    "{agent} restarted: {host} stopped before its first call with side effects",
)
AGENT_UNREADABLE = _message(
    "agent-unreadable", "{agent} not resumed: its record in the journal cannot be read: {reason}", "error"
)
AGENT_RECOVERED = _message(
    "agent-recovered", "{agent} recovered on this host as start {generation}", "warning"
)
AGENT_IN_DOUBT = _message("agent-in-doubt", "{agent} in doubt: {reason}", "warning")
AGENT_STOPPED = _message("agent-stopped", "{agent} stopped: {reason}", "warning")
AGENT_UNREACHABLE = _message("agent-unreachable", "{agent} unreachable, outcome unknown: {reason}", "error")
AGENT_LOST = _message("agent-lost", "{agent} lost: {reason}", "error")
AGENT_ENDED_ELSEWHERE = _message("agent-ended-elsewhere", "{agent} ended on {host}: {outcome}")
AGENT_GIVEN_UP = _message("agent-given-up", "{agent} declared lost: 'lfield forget'", "warning")
MIGRATION_REFUSED = _message("migration-refused", "migration of {agent} rejected: {reason}", "warning")
MIGRATION_ANOMALY = _message(
    "migration-anomaly",
    "message about {agent} ignored: {host} sent it to an earlier incarnation of this host",
    "warning",
)

# --- leases and failover --------------------------------------------------------------------------------

NO_HEARTBEAT_INTERVAL = _message(
    "no-heartbeat-interval", "heartbeatInterval ignored: {host} has no journal", "warning"
)
NO_LEASE_GIVEN = _message(
    "no-lease-given",
    "votes for leases withheld: the journal of {host} is new or has lost a vote, and {members} must respond "
    "first; if a member is permanently lost, restart all hosts with a 'recovery: {{members: [...]}}' without "
    "it; --first-start states that this host has never run this deployment",
    "warning",
)
LEASE_LOST = _message(
    "lease-lost",
    "lease of {host} ended: no majority of the members responds; calls of its coordinators fail, and their "
    "devices go to their safe states",
    "error",
)
FAILOVER_SUSPECTED = _message(
    "failover-suspected",
    "{agent} suspected lost: no heartbeat of its host for {seconds:g} s; querying every host",
)
FAILOVER_DEFERRED = _message(
    "failover-deferred", "failover of {agent} left to {host}: it has a newer checkpoint"
)
FAILOVER_WAITING = _message(
    "failover-waiting", "failover of {agent} waiting: no majority of the members responds; retrying"
)
FAILOVER_DECIDED = _message(
    "failover-decided",
    "failover of {agent} to this host: no other host has resumed it, and {promised} of {members} members "
    "have fenced its earlier starts",
    "warning",
)
FAILOVER_IMPOSSIBLE = _message(
    "failover-impossible",
    "failover of {agent} impossible: its newest checkpoint, on {host}, cannot be read; if the host that held "
    "{agent} is permanently lost, 'lfield recover {agent}' resumes an older checkpoint, and 'lfield forget "
    "{agent}' ends it",
    "error",
)
END_NOT_FINAL = _message(
    "end-not-final",
    "end of {agents} not final: no majority of the members has stored it; {host} is waiting for that",
)
END_UNCONFIRMED = _message(
    "end-unconfirmed",
    "end of {agents} not confirmed: no majority of the members responded for {seconds:g} s; another host may "
    "resume an earlier checkpoint",
    "warning",
)

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
    "certificate revocation list {newest} incomplete: it does not revoke {serials}, and {other} does, so the "
    "authority was restored from an older copy; this host treats them as revoked until it stops; revoke them "
    "again with 'lfield keys revoke serial {first}'",
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

#: Their lines, without the name of the device, by code.
DEVICE_MESSAGES: dict[str, LogMessage] = {}


def _device_message(
    code: str, template: str, level: Level = "info", meaning: str = "", **clauses: Clause
) -> LogMessage:
    assert code not in LOG_MESSAGES, code
    made = DEVICE_MESSAGES[code] = LogMessage(code, template, level, meaning, clauses)
    return made


GUARD_SIGNAL_IGNORED = _device_message(
    "guard-signal-ignored",
    "{signal} ignored: the guard ends with its host, after it has made its devices safe",
)
RECORDING_ENDED = _device_message(
    "recording-ended",
    "recording of {files} ended: {reason}; the device is not affected",
    "warning",
    "by a guard that cannot write into the folder of a recording any longer",
)
DRIVER_TASK_FAILED = _device_message("driver-task-failed", "driver task failed: {reason}", "error")
SAFE_STATE_UNCONFIRMED = _device_message(
    "safe-state-unconfirmed", "safe state not confirmed: {reason}; retrying", "error"
)
SENSOR_NOT_LATCHED = _device_message(
    "sensor-not-latched", "sensor without safe state: {reason}", meaning="why its host would make it safe"
)
DEVICE_REOPENED_WRONG = _device_message(
    "device-reopened-wrong", "settings differ after a restart of the guard: {reason}", "warning"
)
WATCHDOG_WAIVED = _device_message(
    "watchdog-waived", "device watchdog: {own}, limit {longest:g} s; accepted by a waiver"
)
SETTING_MISMATCH = _device_message("setting-mismatch", "setting {setting}: {reason}", "error")
SERIAL_LATENCY = _device_message(
    "serial-latency",
    "serial latency too high: {port} delays every response by {milliseconds} ms; write 1 into {file} (as "
    "root, or by a udev rule)",
    "warning",
)
SERIAL_LOST = _device_message("serial-lost", "link lost: {reason}; reopening the serial port", "warning")
ENDPOINT_LOST = _device_message("endpoint-lost", "link lost: {endpoint}: {reason}", "warning")
ENDPOINT_UNOPENED = _device_message(
    "endpoint-unopened", "link not opened: {endpoint}: {reason} (attempt {count})", "warning"
)


def _answer(address: str, attempts: int, seconds: float) -> str:
    if not address:
        return ""
    return f": {address}, after {attempts} attempt{'s' * (attempts != 1)} and {seconds:.0f} s"


ENDPOINT_REOPENED = _device_message(
    "endpoint-reopened",
    "link opened: {endpoint}{answer}",
    answer=Clause(("address", "attempts", "seconds"), _answer),
)
SERIAL_BACK = _device_message("serial-back", "link opened: serial port {port}")


def report_line(device: str, text: str, code: str, level: Level) -> LogLine:
    """The log line of a report of a driver or guard; `code` is '' for a report without a code."""
    line = DEVICE_REPORT.line(device=device, text=text)
    return LogLine(f"{device} {text}", code, level, line.template_values) if code else line


def report_fields(text: str) -> tuple[str, str, Level]:
    """Text, code and level of a report; '' and "info" for a plain string."""
    return (str(text), text.code, text.level) if isinstance(text, LogLine) else (text, "", "info")


def json_line(time: float, host: str, line: LogLine) -> str:
    """A log line as a JSON object in ASCII, with its time in seconds since 1970 UTC, and a line feed."""
    return json.dumps({"time": round(time, 6), "host": host, **line.as_data()}) + "\n"
