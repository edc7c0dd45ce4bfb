"""Agent dumps, journals and bundles as JSON, for `lfield inspect --json`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import msgspec

from lfield.journal.journal_loader import describe_loss
from lfield.journal.records import CoordinatorRecord, ProgramRecord

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from lfield.journal.readonly_view import ReadOnlyView
    from lfield.journal.records import Record
    from lfield.journal.store import DamagedEntry
    from lfield.mission.bundle import BundleContents
    from lfield.mission.mission import Mission
    from lfield.vm.inspection.block_view import BlockView, ThreadView
    from lfield.vm.inspection.dump_file import Dump

#: Longer bytes of a record are shown by their number: they are blocks, programs and results.
_LONGEST_HEX = 32


def dump_data(record: Dump, block_view: BlockView, digest: bytes) -> dict[str, Any]:
    """A dumped agent; `digest` is that of its program."""
    hosts = record.hosts
    return {
        "kind": "dump",
        "agent": block_view.id,
        "agent_kind": block_view.kind,
        "type": block_view.type,
        "host": record.host,
        "hops": block_view.hops,
        "trail": [hosts[n] if 0 <= n < len(hosts) else str(n) for n in block_view.trail],
        "heartbeat_interval": block_view.interval or None,
        "program": digest.hex(),
        "reason": record.reason,
        "threads": thread_data(block_view.threads),
        "fields": dict(block_view.fields),
        "heap": {
            "used": block_view.used,
            "limit": record.limit,
            "objects": [
                {"type": name, "count": count, "bytes": size} for name, count, size in block_view.heap
            ],
        },
    }


def thread_data(threads: Iterable[ThreadView]) -> list[dict[str, Any]]:
    """Threads with their frames, innermost first."""
    found = [msgspec.to_builtins(thread) for thread in threads]
    for thread in found:
        for frame in thread["frames"]:
            frame["locals"] = dict(frame["locals"])
    return found


def journal_data(view: ReadOnlyView) -> dict[str, Any]:
    """The readable records of a journal, and the damaged parts."""
    programs = {record.digest: record for _, record in view.records if isinstance(record, ProgramRecord)}
    header = view.header
    return {
        "kind": "journal",
        "host": header.host if header else None,
        "deployment": header.deployment if header else None,
        "identity": f"{header.identity:016x}" if header else None,
        "records": [
            {"record": entry.key.kind, "written_at": entry.written_at, **_record_data(record, programs)}
            for entry, record in sorted(view.records, key=lambda found: found[0].key)
        ],
        "damaged": _damage_data(view.damaged),
        "moved_aside": _damage_data(view.moved_aside),
        "fault": view.fault,
    }


def _damage_data(entries: Iterable[DamagedEntry]) -> list[dict[str, str]]:
    return [{"what": describe_loss(damaged.entry), "reason": damaged.reason} for damaged in entries]


def _record_data(record: Record, programs: Mapping[bytes, ProgramRecord]) -> dict[str, Any]:
    found = {name: _plain(getattr(record, name)) for name in record.__struct_fields__}
    if isinstance(record, CoordinatorRecord) and record.block:
        found["threads"] = _stack_data(record, programs)
    return found


def _plain(value: object) -> object:
    if isinstance(value, bytes):
        return value.hex() if len(value) <= _LONGEST_HEX else {"bytes": len(value)}
    return msgspec.to_builtins(value)


def _stack_data(
    record: CoordinatorRecord, programs: Mapping[bytes, ProgramRecord]
) -> list[dict[str, Any]] | None:
    """The stack of a stored coordinator; None where it cannot be decoded."""
    from lfield.errors import BlockError, ProgramFileError
    from lfield.vm.inspection import dump_file
    from lfield.vm.inspection.block_view import view

    explains = programs.get(record.program)
    if explains is None:
        return None
    try:
        program, block = dump_file.decode_program_and_block(explains.code, explains.types, record.block)
    except (BlockError, ProgramFileError):
        return None
    return thread_data(view(block, program, explains.members).threads)


def mission_data(mission: Mission, found: BundleContents, signed: str | None) -> dict[str, Any]:
    """A bundle, or that of a deployment, for which `signed` is None."""
    return {
        "kind": "deployment" if signed is None else "bundle",
        "digest": found.digest.hex(),
        "mission": mission.name,
        "signed": signed,
        "parts": [
            {"name": part.name, "bytes": part.size, "digest": part.digest.hex()} for part in found.table
        ],
        "hosts": [
            {"name": host, "address": mission.team.addresses[number], "agents": _agent_data(mission, number)}
            for number, host in enumerate(mission.team.hosts)
        ],
        "recovered": sorted(mission.fenced),
        "access_file": mission.access.file or None,
        "drivers": {name: driver.to_install for name, driver in mission.drivers.by_driver.items()},
    }


def _agent_data(mission: Mission, host: int) -> Sequence[dict[str, Any]]:
    return [
        {
            "id": member.id,
            "kind": member.kind,
            "type": member.type,
            "devices": [
                {
                    "field": device.field,
                    "type": device.type,
                    "driver": device.driver,
                    "endpoint": device.endpoint,
                }
                for device in mission.bindings.of([member.id])
            ],
        }
        for member in mission.team.members_on(host)
    ]
