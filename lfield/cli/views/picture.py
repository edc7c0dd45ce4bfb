"""A team as it stands: as a table of who is where and how every device is, and as JSON."""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import Any

from msgspec.structs import asdict
from rich.console import Group
from rich.table import Table

from lfield.cli.views.trees import plain_console
from lfield.errors import LfieldError
from lfield.mission.access.release import Release
from lfield.operator.ask import Answers
from lfield.operator.descent import SILENT
from lfield.operator.whereabouts import what_can_be_done
from lfield.text.suggest import listed
from lfield.text.values import bytes_in_words, duration_in_words, share_in_words, telemetry_in_words
from lfield.text.visible import in_one_line
from lfield.wire.coordinators import Known
from lfield.wire.fields import short_digest
from lfield.wire.observing import (
    BundleStatus,
    DeviceStatus,
    JournalStatus,
    LinkStatus,
    ParkedStatus,
    StartStatus,
    Status,
    Told,
)

#: So many missing hosts are named in the command that leaves them out.
MOST_NAMED = 8


def show(answers: Answers[Status]) -> None:
    """Print the table."""
    plain_console().print(picture(answers))


def picture(answers: Answers[Status]) -> Group:
    """The agents of all hosts with the coordinators that have ended or are in doubt, what can be done about
    those that nobody has, then the devices.

    Last are the hosts: how late each was, how long it may be silent, what it keeps, and which bundle it runs;
    and their links.
    """
    further = [table for table in (_devices(answers), _hosts(answers), _links(answers)) if table.row_count]
    waits = [*_starts(answers), *_refused(answers)]
    hints = map(in_one_line, [*_paused(answers), *waits, *_unkept(answers), *what_can_be_done(answers)])
    bundles = ["", *map(in_one_line, _bundles(answers))] if _bundles(answers) else []
    return Group(_agents(answers), *hints, *(part for table in further for part in ("", table)), *bundles)


def _bundles(answers: Answers[Status]) -> list[str]:
    """Which bundles run, and where: one, unless somebody has forgotten a host."""
    found: dict[str, list[str]] = {}
    for host, told in answers.items():
        if not isinstance(told, LfieldError) and (run := told.bundle) is not None:
            found.setdefault(str(Release(run.digest, by=run.by, at=run.at)), []).append(host)
    return [f"bundle {release}: {', '.join(hosts)}" for release, hosts in found.items()]


def _paused(answers: Answers[Status]) -> list[str]:
    hosts = [host for host, told in answers.items() if not isinstance(told, LfieldError) and told.paused]
    return [f"paused: {', '.join(hosts)}; 'lfield resume' lets the mission go on"] if hosts else []


def _starts(answers: Answers[Status]) -> list[str]:
    """What the coordinators wait for that are not started yet, and what can be done about it."""
    lines = []
    for host, told in answers.items():
        if isinstance(told, LfieldError) or (start := told.start) is None:
            continue
        who = f"{host}: {listed(start.agents)} {'is' if len(start.agents) == 1 else 'are'} not started"
        if start.held:
            lines.append(f"{who}: {start.held}; 'lfield start' starts what waits")
        elif start.hosts:
            options = " ".join(f"--without {missing}" for missing in start.hosts[:MOST_NAMED])
            lines.append(
                f"{who}: waiting for {listed(start.hosts)}; start them, or let the mission begin without "
                f"them: 'lfield start {options}'"
            )
    return lines


def _refused(answers: Answers[Status]) -> list[str]:
    """The hosts that no link can be made with. Both sides say so; one line for each reason is enough."""
    found: dict[tuple[str, str], str] = {}
    for host, told in answers.items():
        for refused in () if isinstance(told, LfieldError) else told.refused:
            found.setdefault(
                (refused.host, refused.reason), f"{host} refuses {refused.host}: {refused.reason}"
            )
    return list(found.values())


def _unkept(answers: Answers[Status]) -> list[str]:
    told = {host: told for host, told in answers.items() if not isinstance(told, LfieldError)}
    return [f"{host} is in trouble: {status.unkept}" for host, status in told.items() if status.unkept]


def _add(shown: Table, *cells: str) -> None:
    """A row of what hosts say of programs, devices and themselves; a terminal obeys none of it."""
    shown.add_row(*map(in_one_line, cells))


def _hosts(answers: Answers[Status]) -> Table:
    shown = Table(box=None, pad_edge=False)
    for column in ("HOST", "LATE", "SILENCE", "LEASE", "JOURNAL"):
        shown.add_column(column, justify="left" if column in ("HOST", "JOURNAL") else "right")
    for host, answer in answers.items():
        if not isinstance(answer, LfieldError):
            late = f"{answer.late:.3f} s" if answer.late is not None else ""
            silence = f"{answer.silence:g} s" if answer.silence is not None else ""
            lease = "" if answer.lease is None else f"{answer.lease:.1f} s" if answer.lease else "none"
            _add(shown, host, late, silence, lease, _journal(answer.journal))
    return shown


def _links(answers: Answers[Status]) -> Table:
    """A row for each end of each link: what is lost on the way there may arrive on the way back."""
    shown = Table(box=None, pad_edge=False)
    for column in ("HOST", "LINK WITH", "ROUND TRIP", "LOSS", "SENT", "RECEIVED"):
        shown.add_column(column, justify="left" if column in ("HOST", "LINK WITH") else "right")
    for host, answer in answers.items():
        for link in () if isinstance(answer, LfieldError) else answer.links:
            if link.away is not None:
                _add(shown, host, link.host, f"none for {link.away:.0f} s", "", "", "")
                continue
            took = "" if link.round_trip is None else duration_in_words(link.round_trip)
            loss = "" if link.loss is None else share_in_words(link.loss)
            both = ("" if count is None else bytes_in_words(count) for count in (link.sent, link.received))
            _add(shown, host, link.host, took, loss, *both)
    return shown


def _journal(journal: JournalStatus | None) -> str:
    if journal is None:
        return "keeps nothing"
    commits = f"{journal.commits} commit{'s' * (journal.commits != 1)} in the last minute"
    return f"{commits}; in trouble: {journal.trouble}" if journal.trouble else commits


def _devices(answers: Answers[Status]) -> Table:
    shown = Table(box=None, pad_edge=False)
    for column in ("HOST", "DEVICE", "STATE", "TELEMETRY"):
        # How it stands with a vehicle is read at a glance; its telemetry takes the lines it needs.
        shown.add_column(column, no_wrap=column == "STATE")
    for host, answer in answers.items():
        if isinstance(answer, LfieldError):
            continue
        for device in answer.devices:
            words = telemetry_in_words(device.telemetry)
            _add(shown, host, device.name, _device_state(device), words)
    return shown


def _device_state(device: DeviceStatus) -> str:
    if device.silent is not None and device.silent > SILENT:
        return f"silent {device.silent:.0f} s"
    if not device.latched:
        return "in use" if device.silent is not None else "no telemetry yet"
    return f"safe: {device.moving}" if device.moving else "safe, at rest"


#: What becomes of a call that was begun.
_BEGUN = {
    "running": "has begun {0}",
    "done": "{0} has ended, to be fetched",
    "thrown": "{0} has thrown, to be fetched",
    "lost": "{0} was lost in a restart",
}


def _agents(answers: Answers[Status]) -> Table:
    shown = Table(box=None, pad_edge=False)
    for column in ("HOST", "AGENT", "TYPE", "STATE", "HOPS", "SERVED", "HEAP"):
        shown.add_column(column, justify="right" if column in ("HOPS", "SERVED", "HEAP") else "left")
    newest = _newest(answers)
    for host, answer in answers.items():
        if isinstance(answer, LfieldError):
            _add(shown, host, "-", "", "no answer", "", "", "")
            continue
        before = shown.row_count
        for agent in answer.agents:
            hops = str(agent.hops) if agent.kind == "coordinator" else ""
            served = str(agent.served) if agent.kind == "resource" else ""
            _add(shown, host, agent.id, agent.type, agent.state, hops, served, _size(agent.heap))
        for known in answer.coordinators:
            is_past = known.generation < newest[known.agent]
            over = known.state == "EXITED" and known.where == host and not is_past
            if known.state == "IN DOUBT" or known.unreadable or over:
                state = f"{known.outcome or 'in doubt'}: {known.detail}".splitlines()[0].rstrip(": ")
                _add(shown, host, known.agent, "", state, str(known.hops), "", "")
        for waiting in answer.start.agents if answer.start is not None else ():
            _add(shown, host, waiting, "", _waiting(answer.start), "", "", "")
        for begun in answer.begun:
            state = _BEGUN[begun.state].format(f"{begun.resource}.{begun.portal}")
            _add(shown, host, begun.agent, "", state, "", "", "")
        for reserved in answer.reserved:
            state = (
                f"has reserved {reserved.resource} for {reserved.held:.0f} s, and {reserved.left:.0f} s yet"
            )
            _add(shown, host, reserved.agent, "", state, "", "", "")
        for parked in answer.journal.parked if answer.journal is not None else ():
            if parked.state != "MOVED":
                _add(shown, host, parked.agent, "", _parked(parked), str(parked.hops), "", "")
        if shown.row_count == before:
            _add(shown, host, "-", "", "up, no agents", "", "", "")
    return shown


def _waiting(start: StartStatus | None) -> str:
    if start is None or not (start.hosts or start.held):
        return "is being started"
    return "not started: held" if start.held else f"waits for {listed(start.hosts)} to start"


def _newest(answers: Answers[Status]) -> Mapping[str, int]:
    """The newest start of each coordinator that gave way to no earlier one: how others ended is past."""
    newest: dict[str, int] = defaultdict(int)
    for answer in answers.values():
        for known in () if isinstance(answer, LfieldError) else answer.coordinators:
            if known.outcome != "superseded":
                newest[known.agent] = max(newest[known.agent], known.generation)
    return newest


def _parked(parked: ParkedStatus) -> str:
    left = f" and may have left for {parked.where}" if parked.state == "PREPARED" else ""
    return (
        f"parked: it is of another mission ({parked.program.hex()[:16]}){left}, and goes on when that is "
        "started here"
    )


def _size(count: int) -> str:
    return f"{count} B" if count < 1024 else f"{count / 1024:.1f} KiB"


# --- as JSON ------------------------------------------------------------------------------------------


def as_json(answers: Answers[Status]) -> str:
    """What every host says of itself, or why it says nothing."""
    return json.dumps(as_data(answers), indent=2)


def as_data(answers: Answers[Status]) -> dict[str, Any]:
    """The same as data that JSON can hold."""
    return {
        host: {"error": str(answer)} if isinstance(answer, LfieldError) else _status(answer)
        for host, answer in answers.items()
    }


def _status(status: Status) -> dict[str, Any]:
    return {
        "host": status.host,
        "address": status.address,
        "up": status.up,
        "program": status.program.hex()[:16],
        "deployment": status.deployment.hex()[:16],
        "bundle": _bundle(status.bundle),
        "agents": [asdict(agent) for agent in status.agents],
        "coordinators": [_coordinator(known) for known in status.coordinators],
        "linked": [link.host for link in status.links if link.away is None],
        "away": {link.host: link.away for link in status.links if link.away is not None},
        "links": {link.host: _link(link) for link in status.links if link.away is None},
        "devices": {device.name: device.telemetry for device in status.devices},
        "silences": {device.name: device.silent for device in status.devices if device.silent is not None},
        "latched": {device.name: device.latched for device in status.devices if device.latched},
        "late": status.late,
        "silence": status.silence,
        "paused": status.paused,
        "stopped": status.stopped,
        "unkept": status.unkept,
        "lease": status.lease,
        "journal": _journal_data(status.journal),
        "begun": [asdict(begun) for begun in status.begun],
        "refused": [
            {"host": one.host, "reason": one.reason, "bundle": short_digest(one.bundle)}
            for one in status.refused
        ],
        "start": None if status.start is None else asdict(status.start),
        "reserved": [asdict(reserved) for reserved in status.reserved],
        "moving": {device.name: device.moving for device in status.devices if device.moving},
        "directory": _directory(status.directory),
    }


def _bundle(run: BundleStatus | None) -> dict[str, Any] | None:
    return (
        None if run is None else {"digest": short_digest(run.digest), "signed_by": run.by, "signed": run.at}
    )


def _link(link: LinkStatus) -> dict[str, Any]:
    return {name: getattr(link, name) for name in ("round_trip", "loss", "sent", "received")}


_PARKED = ("generation", "hops", "state", "where")


def _journal_data(journal: JournalStatus | None) -> dict[str, Any] | None:
    if journal is None:
        return None
    parked = [
        {"id": one.agent, **{n: getattr(one, n) for n in _PARKED}, "program": one.program.hex()[:16]}
        for one in journal.parked
    ]
    return {"commits": journal.commits, "trouble": journal.trouble, "parked": parked}


def _coordinator(known: Known) -> dict[str, Any]:
    said = asdict(known)
    return {"id": said.pop("agent"), **said}


def _directory(agents: Sequence[Told]) -> dict[str, Any]:
    return {
        told.agent: {
            "refusal": told.refusal,
            "facts": {name: [fact.value, fact.age] for name, fact in told.facts.items()},
            "unknown": told.unknown,
        }
        for told in agents
    }
