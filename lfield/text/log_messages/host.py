"""Log lines of a host, its journal and a run of all hosts."""

from __future__ import annotations

from lfield.text.log_messages.log_line import Clause, LogTable

HOST = LogTable()
_message = HOST.message

# --- the host and its journal ---------------------------------------------------------------------------

#: The text in the line of a host for each value of `journal`.
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
    "system clock behind: it shows {shown}, but the time is at least {least}, since {evidence}; set the "
    "clock",
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
    "{agent} waits for a line of input for at most {seconds:g} s: type the line in the terminal of {host}, "
    "in the terminal of lfield up --all as {host}: TEXT, or on the page of lfield watch",
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
    "line of input ignored: the line does not begin with the name of a host that reads input; type HOST: "
    "TEXT, where HOST is {hosts}",
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
    "the blocks of the other agents, so the reference engine runs it",
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
