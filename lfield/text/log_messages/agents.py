"""Log lines of agents, leases and failover."""

from __future__ import annotations

from lfield.text.log_messages.log_line import Clause, LogTable

AGENTS = LogTable()
_message = AGENTS.message

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
    "line of the assistant's program skipped, since the line is not a message: {reason}",
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
    "failover-deferred", "failover of {agent} left to {host}, which has a newer checkpoint"
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
    "end of {agents} not final: no majority of the members has stored it; {host} waits for this majority",
)
END_UNCONFIRMED = _message(
    "end-unconfirmed",
    "end of {agents} not confirmed: no majority of the members responded for {seconds:g} s; another host may "
    "resume an earlier checkpoint",
    "warning",
)
