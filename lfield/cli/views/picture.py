"""A team as it stands: as a table of who is where and how every device is, and as JSON."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

from msgspec.structs import asdict
from rich.console import Console, Group
from rich.table import Table

from lfield.errors import LfieldError
from lfield.operator.ask import Answers
from lfield.operator.descent import SILENT
from lfield.text.values import telemetry_in_words
from lfield.wire.messages import DeviceStatus, JournalStatus, Known, ParkedStatus, Status, Told


def show(answers: Answers[Status]) -> None:
    """Print the table."""
    Console().print(picture(answers))


def picture(answers: Answers[Status]) -> Group:
    """The agents of all hosts with the coordinators that have ended or are in doubt, then the devices.

    Last are the hosts: how late each was, how long it may be silent, and what it keeps.
    """
    further = (table for table in (_devices(answers), _hosts(answers)) if table.row_count)
    return Group(_agents(answers), *(part for table in further for part in ("", table)))


def _hosts(answers: Answers[Status]) -> Table:
    shown = Table(box=None, pad_edge=False)
    for column in ("HOST", "LATE", "SILENCE", "JOURNAL"):
        shown.add_column(column, justify="right" if column in ("LATE", "SILENCE") else "left")
    for host, answer in answers.items():
        if not isinstance(answer, LfieldError):
            late = f"{answer.late:.3f} s" if answer.late is not None else ""
            silence = f"{answer.silence:g} s" if answer.silence is not None else ""
            shown.add_row(host, late, silence, _journal(answer.journal))
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
            shown.add_row(host, device.name, _device_state(device), words)
    return shown


def _device_state(device: DeviceStatus) -> str:
    if device.silent is not None and device.silent > SILENT:
        return f"silent {device.silent:.0f} s"
    if not device.latched:
        return "in use" if device.silent is not None else "not heard yet"
    return f"safe: {device.moving}" if device.moving else "safe, at rest"


def _agents(answers: Answers[Status]) -> Table:
    shown = Table(box=None, pad_edge=False)
    for column in ("HOST", "AGENT", "TYPE", "STATE", "HOPS", "SERVED", "HEAP"):
        shown.add_column(column, justify="right" if column in ("HOPS", "SERVED", "HEAP") else "left")
    for host, answer in answers.items():
        if isinstance(answer, LfieldError):
            shown.add_row(host, "-", "", "no answer", "", "", "")
            continue
        for agent in answer.agents:
            hops = str(agent.hops) if agent.kind == "coordinator" else ""
            served = str(agent.served) if agent.kind == "resource" else ""
            shown.add_row(host, agent.id, agent.type, agent.state, hops, served, _size(agent.heap))
        for known in answer.coordinators:
            if known.state == "IN DOUBT" or (known.state == "EXITED" and known.where == host):
                state = f"{known.outcome or 'in doubt'}: {known.detail}".splitlines()[0].rstrip(": ")
                if known.state == "IN DOUBT":
                    state += f"; 'lfield forget {known.agent}' ends it by your word"
                shown.add_row(host, known.agent, "", state, str(known.hops), "", "")
        for parked in answer.journal.parked if answer.journal is not None else ():
            if parked.state != "MOVED":
                shown.add_row(host, parked.agent, "", _parked(parked), str(parked.hops), "", "")
    return shown


def _parked(parked: ParkedStatus) -> str:
    left = f" and may have left for {parked.where}" if parked.state == "PREPARED" else ""
    return (
        f"parked: it is of another mission ({parked.program.hex()[:16]}){left}, and goes on when that is "
        f"started here; 'lfield forget {parked.agent}' ends it by your word"
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
        "agents": [asdict(agent) for agent in status.agents],
        "coordinators": [_coordinator(known) for known in status.coordinators],
        "linked": [link.host for link in status.links if link.away is None],
        "away": {link.host: link.away for link in status.links if link.away is not None},
        "devices": {device.name: device.telemetry for device in status.devices},
        "silences": {device.name: device.silent for device in status.devices if device.silent is not None},
        "latched": {device.name: device.latched for device in status.devices if device.latched},
        "late": status.late,
        "silence": status.silence,
        "journal": _journal_data(status.journal),
        "moving": {device.name: device.moving for device in status.devices if device.moving},
        "directory": _directory(status.directory),
    }


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
