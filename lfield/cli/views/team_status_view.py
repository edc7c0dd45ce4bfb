"""The state of a team after one snapshot of each host: as tables, and as JSON."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from rich.console import Group
from rich.table import Table

from lfield.cli.views.team_state_view import add_row, device_table, new_table
from lfield.cli.views.trees import plain_console
from lfield.mission.access.signed_bundle import BundleId
from lfield.operator.coordinator_location import doubt_advice
from lfield.operator.team_model.team_state import HostState, LinkState
from lfield.text.suggestions import listed
from lfield.text.terminal_escape import escape_line
from lfield.text.value_text import byte_count_text, duration_text, percentage_text
from lfield.wire.observer_messages import (
    JournalStatus,
    ParkedStatus,
    StartStatus,
)

#: The most rows of the table of links. For a larger team it has only the worst links.
MAX_LINK_ROWS, WORST_LINKS = 72, 12
#: Maximum number of missing hosts in the suggested command.
MAX_NAMED = 8


def show(hosts: Mapping[str, HostState]) -> None:
    """Print the tables."""
    plain_console().print(team_tables(hosts))


def team_tables(hosts: Mapping[str, HostState]) -> Group:
    """The tables of agents (with coordinators that have ended or are in doubt), devices, hosts, links and
    bundles, and hints after the first.
    """
    linked = {name: host for name, host in hosts.items() if host.linked}
    devices = device_table(device for host in linked.values() for device in host.devices.values())
    links, summary = _links(linked)
    further = [table for table in (devices, _hosts(linked), links) if table.row_count]
    waits = [*_starts(linked), *_refused(linked)]
    hints = map(
        escape_line,
        [*_stopped(linked), *_paused(linked), *waits, *_not_persisted(linked), *doubt_advice(linked)],
    )
    bundles = ["", *map(escape_line, _bundles(linked))] if _bundles(linked) else []
    tables = (part for table in further for part in ("", table))
    return Group(_agents(hosts), *hints, *tables, *summary, *bundles)


def _bundles(linked: Mapping[str, HostState]) -> list[str]:
    """The running bundles with their hosts: one, unless the hosts differ."""
    found: dict[str, list[str]] = {}
    for name, host in linked.items():
        if (run := host.report.bundle) is not None:
            found.setdefault(str(BundleId(run.digest, by=run.by, at=run.at)), []).append(name)
    return [f"bundle {release}: {', '.join(hosts)}" for release, hosts in found.items()]


def _stopped(linked: Mapping[str, HostState]) -> list[str]:
    """The emergency stops in force, each with its hosts and the command that ends it."""
    hosts_by_reason = defaultdict[str, list[str]](list)
    for name, host in linked.items():
        if host.stopped:
            hosts_by_reason[host.stopped].append(name)
    return [
        f"EMERGENCY STOP of {', '.join(hosts)}: {reason}; 'lfield estop --lift' ends the stop"
        for reason, hosts in hosts_by_reason.items()
    ]


def _paused(linked: Mapping[str, HostState]) -> list[str]:
    hosts = [name for name, host in linked.items() if host.paused]
    lines = [f"paused: {', '.join(hosts)}; 'lfield resume' resumes the mission"] if hosts else []
    if voters := [name for name, host in linked.items() if host.held_by_vote]:
        lines.append(
            f"held by a vote about an activation: {', '.join(voters)}; 'lfield status' shows whose votes are "
            "unknown"
        )
    return lines


def _starts(linked: Mapping[str, HostState]) -> list[str]:
    """The coordinators that are not started yet, with the reason and the remedy."""
    lines = []
    for host, state in linked.items():
        if (start := state.report.start) is None:
            continue
        subject = f"{host}: {listed(start.agents)} {'is' if len(start.agents) == 1 else 'are'} not started"
        if start.held:
            lines.append(f"{subject}: {start.held}; 'lfield start' starts them")
        elif start.hosts:
            options = " ".join(f"--without {missing}" for missing in start.hosts[:MAX_NAMED])
            lines.append(
                f"{subject}: waiting for {listed(start.hosts)}; start them, or start the mission without "
                f"them: 'lfield start {options}'"
            )
    return lines


def _refused(linked: Mapping[str, HostState]) -> list[str]:
    """The refused links. Both sides report them; one line for each reason is printed."""
    found: dict[tuple[str, str], str] = {}
    for name, host in linked.items():
        for peer, reason in host.refused.items():
            found.setdefault((peer, reason), f"{name} refuses {peer}: {reason}")
    return list(found.values())


def _not_persisted(linked: Mapping[str, HostState]) -> list[str]:
    return [
        f"{name} is failing: {host.report.persist_error}"
        for name, host in linked.items()
        if host.report.persist_error
    ]


def _hosts(linked: Mapping[str, HostState]) -> Table:
    right = "HEARTBEAT DELAY", "GUARD TIMEOUT", "LEASE"
    table = new_table("HOST", *right, "JOURNAL", right=right)
    for name, host in linked.items():
        report = host.report
        late = f"{host.jitter:.3f} s" if host.jitter is not None else ""
        silence = f"{report.silence:g} s" if report.silence is not None else ""
        lease = "" if report.lease is None else f"{report.lease:.1f} s" if report.lease else "none"
        add_row(table, name, late, silence, lease, _journal(report.journal))
    return table


class _LinkRow(NamedTuple):
    """One end of a link: the host, the other host, and the seconds without a link or the measurements."""

    host: str
    peer: str
    away: float | None
    link: LinkState | None

    @property
    def badness(self) -> tuple[float, float, float]:
        """Greater for a worse link: first missing ones, then by loss, then by round trip."""
        if self.link is None:
            return self.away or 0.0, 1.0, 0.0
        return -1.0, self.link.loss or 0.0, self.link.round_trip or 0.0

    def texts(self) -> tuple[str, ...]:
        """The cells of the row."""
        if self.link is None:
            return self.host, self.peer, f"none for {self.away:.0f} s", "", "", "", ""
        link = self.link
        took = "" if link.round_trip is None else duration_text(link.round_trip)
        loss = "" if link.loss is None else percentage_text(link.loss)
        both = ("" if count is None else byte_count_text(count) for count in (link.sent, link.received))
        peer = f"{self.peer} over {link.path}, standby {link.standby or 'none'}" if link.path else self.peer
        return self.host, peer, took, loss, *both, _kinds(link.kinds)


def _links(linked: Mapping[str, HostState]) -> tuple[Table, list[str]]:
    """A row for each end of each link, because loss differs by direction; in a large team the worst ones, and
    a summary of all.
    """
    right = "ROUND TRIP", "LOSS", "SENT", "RECEIVED"
    table = new_table("HOST", "LINK WITH", *right, "BY KIND", right=right)
    rows: list[_LinkRow] = []
    for name, host in linked.items():
        rows += [_LinkRow(name, peer, None, link) for peer, link in host.links.items()]
        rows += [_LinkRow(name, peer, seconds, None) for peer, seconds in host.unreachable_for.items()]
    worst, summary = rows, list[str]()
    if len(rows) > MAX_LINK_ROWS:
        worst = sorted(rows, key=lambda row: row.badness, reverse=True)[:WORST_LINKS]
        summary = [_link_summary(rows)]
    for row in worst:
        add_row(table, *row.texts())
    for name, host in linked.items():
        if host.report.observers and worst is rows:
            add_row(table, name, "observers", "", "", "", "", _kinds(host.report.observers))
    return table, summary


def _link_summary(rows: Sequence[_LinkRow]) -> str:
    links = [row.link for row in rows if row.link is not None]
    trips = sorted(link.round_trip for link in links if link.round_trip is not None)
    losses = [link.loss for link in links if link.loss is not None]
    parts = [f"{len(links)} ends of links", f"{len(rows) - len(links)} missing"]
    if trips:
        median = trips[len(trips) // 2]
        parts.append(f"round trip {duration_text(median)} (median), {duration_text(trips[-1])} (maximum)")
    if losses:
        parts.append(f"loss up to {percentage_text(max(losses))}")
    return f"{'; '.join(parts)}; the {WORST_LINKS} worst are listed, --json has all"


def _kinds(kinds: Mapping[str, int]) -> str:
    """The bytes of messages by kind of traffic."""
    return ", ".join(f"{kind} {byte_count_text(count)}" for kind, count in kinds.items())


def _journal(journal: JournalStatus | None) -> str:
    if journal is None:
        return "not saved"
    commits = f"{journal.commits} commit{'s' * (journal.commits != 1)} in the last minute"
    return f"{commits}; failing: {journal.trouble}" if journal.trouble else commits


#: Texts of the states of a pending call.
_PENDING_CALL = {
    "running": "{0} running",
    "done": "{0} completed, result not delivered yet",
    "thrown": "{0} threw an exception, not delivered yet",
    "lost": "{0} was lost in a restart",
}


def _agents(hosts: Mapping[str, HostState]) -> Table:
    right = "HOPS", "SERVED", "HEAP"
    table = new_table("HOST", "AGENT", "TYPE", "STATE", *right, right=right)
    newest = _newest_starts(hosts)
    for host, known_host in hosts.items():
        if not known_host.linked:
            add_row(table, host, "-", "", "no answer", "", "", "")
            continue
        before, report = table.row_count, known_host.report
        for agent in report.agents:
            hops = str(agent.hops) if agent.kind == "coordinator" else ""
            served = str(agent.served) if agent.kind == "resource" else ""
            add_row(table, host, agent.id, agent.type, agent.state, hops, served, _size(agent.heap))
        for known in report.coordinators:
            is_past = known.generation < newest[known.agent]
            over = known.state == "EXITED" and known.where == host and not is_past
            if known.state == "IN DOUBT" or known.unreadable or over:
                state = f"{known.outcome or 'in doubt'}: {known.detail}".splitlines()[0].rstrip(": ")
                add_row(table, host, known.agent, "", state, str(known.hops), "", "")
        for waiting in report.start.agents if report.start is not None else ():
            add_row(table, host, waiting, "", _waiting(report.start), "", "", "")
        for name in report.startable:
            if name not in newest:
                add_row(table, host, name, "", "startable", "", "", "")
        for call in report.pending_calls:
            state = _PENDING_CALL[call.state].format(f"{call.resource}.{call.portal}")
            add_row(table, host, call.agent, "", state, "", "", "")
        for reserved in report.reserved:
            state = f"{reserved.resource} reserved for {reserved.held:.0f} s, {reserved.left:.0f} s left"
            add_row(table, host, reserved.agent, "", state, "", "", "")
        for parked in report.journal.parked if report.journal is not None else ():
            if parked.state != "MOVED":
                add_row(table, host, parked.agent, "", _parked(parked), str(parked.hops), "", "")
        if table.row_count == before:
            add_row(table, host, "-", "", "up, no agents", "", "", "")
    return table


def _waiting(start: StartStatus | None) -> str:
    if start is None or not (start.hosts or start.held):
        return "starting"
    return "not started: held" if start.held else f"waits for {listed(start.hosts)} to start"


def _newest_starts(hosts: Mapping[str, HostState]) -> Mapping[str, int]:
    """The newest start of each coordinator that was not superseded."""
    newest: dict[str, int] = defaultdict(int)
    for host in hosts.values():
        for known in host.report.coordinators if host.linked else ():
            if known.outcome != "superseded":
                newest[known.agent] = max(newest[known.agent], known.generation)
    return newest


def _parked(parked: ParkedStatus) -> str:
    migration = f", and may have migrated to {parked.where}" if parked.state == "PREPARED" else ""
    return (
        f"parked: belongs to another mission ({parked.program.hex()[:16]}){migration}; continues when that "
        "is started here"
    )


def _size(count: int) -> str:
    return f"{count} B" if count < 1024 else f"{count / 1024:.1f} KiB"
