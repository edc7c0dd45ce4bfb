"""The state of hosts and runs as JSON data, as of `lfield ps --json`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import datetime
from typing import Any

from msgspec.structs import asdict

from lfield.operator.client import by_host
from lfield.operator.targets import HostRef, TargetTeam
from lfield.operator.team_model.team_state import HostState
from lfield.wire.coordinator_messages import CoordinatorState
from lfield.wire.fields import short_digest
from lfield.wire.observer_messages import BundleStatus, DirectoryEntry, JournalStatus


def status_data(hosts: Mapping[str, HostState]) -> dict[str, Any]:
    """The state of every host as JSON data, or the error where it did not answer."""
    return {
        name: host.error.as_data() if host.error is not None else _host_data(host)
        for name, host in hosts.items()
    }


def _host_data(host: HostState) -> dict[str, Any]:
    status, devices = host.report, host.devices.values()
    return {
        "host": status.host,
        "address": status.address,
        "up": status.up,
        "program": status.program.hex()[:16],
        "deployment": status.deployment.hex()[:16],
        "bundle": _bundle(status.bundle),
        "agents": [asdict(agent) for agent in status.agents],
        "coordinators": [_coordinator(known) for known in status.coordinators],
        "linked": list(host.links),
        "away": dict(host.unreachable_for),
        "links": {peer: asdict(link) for peer, link in host.links.items()},
        "observers": host.report.observers,
        "devices": {device.name: device.telemetry for device in devices},
        "silences": {d.name: d.telemetry_age for d in devices if d.telemetry_age is not None},
        "latched": {device.name: device.latched for device in devices if device.latched},
        "late": host.jitter,
        "silence": status.silence,
        "paused": host.paused,
        "held": host.held_by_vote,
        "stopped": host.stopped,
        "unkept": status.persist_error,
        "lease": status.lease,
        "journal": _journal_data(status.journal),
        "begun": [asdict(call) for call in status.pending_calls],
        "refused": [
            {"host": refusal.host, "reason": refusal.reason, "bundle": short_digest(refusal.bundle)}
            for refusal in status.refused
        ],
        "start": None if status.start is None else asdict(status.start),
        "startable": status.startable,
        "reads": status.reads,
        "reserved": [asdict(reserved) for reserved in status.reserved],
        "moving": {device.name: device.motion for device in devices if device.motion},
        "directory": _directory(status.directory),
    }


def _bundle(run: BundleStatus | None) -> dict[str, Any] | None:
    return (
        None if run is None else {"digest": short_digest(run.digest), "signed_by": run.by, "signed": run.at}
    )


_PARKED = ("generation", "hops", "state", "where")


def _journal_data(journal: JournalStatus | None) -> dict[str, Any] | None:
    if journal is None:
        return None
    parked = [
        {
            "id": status.agent,
            **{field: getattr(status, field) for field in _PARKED},
            "program": status.program.hex()[:16],
        }
        for status in journal.parked
    ]
    return {"commits": journal.commits, "trouble": journal.trouble, "parked": parked}


def _coordinator(known: CoordinatorState) -> dict[str, Any]:
    data = asdict(known)
    return {"id": data.pop("agent"), **data}


def _directory(agents: Sequence[DirectoryEntry]) -> dict[str, Any]:
    return {
        entry.agent: {
            "refusal": entry.refusal,
            "facts": {name: [fact.value, fact.age] for name, fact in entry.facts.items()},
            "unknown": entry.unknown,
        }
        for entry in agents
    }


def runs_data(targets: Sequence[TargetTeam], hosts: Mapping[HostRef, HostState]) -> dict[str, Any]:
    """The runs, and the state of every host, or the error where it did not answer."""
    return {target.id: _team_data(target, hosts) for target in targets}


def _team_data(target: TargetTeam, hosts: Mapping[HostRef, HostState]) -> dict[str, Any]:
    runs = [
        {
            "id": run.id,
            "mission": run.manifest.mission,
            "user": run.owner,
            "since": _time_text(run.manifest.started),
            "hosts": list(run.manifest.control_sockets),
        }
        for run in target.runs
    ]
    return {"runs": runs, "hosts": status_data(by_host(hosts, target))}


def _time_text(seconds: float) -> str:
    return datetime.fromtimestamp(seconds).astimezone().isoformat(" ", "seconds")
