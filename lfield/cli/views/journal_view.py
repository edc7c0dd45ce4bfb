"""A journal as text: its coordinators with state and time, and the L stack of each block."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

from lfield.journal.journal_loader import describe_loss, format_time
from lfield.journal.records import (
    BundleRecord,
    CoordinatorRecord,
    EmergencyStopFlag,
    FenceRecord,
    PauseFlag,
    PendingCallRecord,
    ProgramRecord,
    ReservationRecord,
    RunMarker,
    StartCounter,
)
from lfield.wire.fields import short_digest

if TYPE_CHECKING:
    from lfield.journal.readonly_view import ReadOnlyView
    from lfield.vm.inspection.block_view import FrameView, ThreadView

#: Texts of the states of a coordinator record.
_STATES = {
    "ABSENT": "rejected",
    "RUN": "here",
    "PREPARED": "migrating, unconfirmed",
    "MOVED": "migrated; this is its shadow",
    "EXITED": "ended",
}

_OUTCOMES = {
    "": "unknown: the call was running",
    "done": "completed; the result is waiting for its caller",
    "thrown": "exception; it is waiting for its caller",
}


def journal_lines(view: ReadOnlyView) -> Iterator[str]:
    """The output of `lfield inspect` for a journal."""
    if view.header is None:
        yield "journal   header damaged: host and deployment unknown"
    else:
        yield f"journal   of {view.header.host} in {view.header.deployment}"
        yield f"identity  {view.header.identity:016x}"
    programs = {record.digest: record for _, record in view.records if isinstance(record, ProgramRecord)}
    for _, record in view.records:
        match record:
            case StartCounter():
                yield f"starts    {record.count}"
            case RunMarker():
                yield f"run       {'not ended' if record.open else 'ended'}"
            case BundleRecord() if record.digest:
                yield f"bundle    {short_digest(record.digest)}, signed"
            case PauseFlag() if record.on:
                yield "paused    until 'lfield resume'"
            case EmergencyStopFlag() if record.reason:
                yield f"stopped   until 'lfield estop --lift': {record.reason}"
            case FenceRecord():
                yield f"fence     {record.agent}: no start before {record.generation}"
            case ReservationRecord():
                holder = f"{record.agent}, start {record.generation}" if record.agent else "free"
                yield f"reserved  {record.resource}, number {record.number}: {holder}"
            case ProgramRecord():
                yield f"program   {record.digest.hex()[:16]}, {len(record.code)} bytes"
    for entry, record in sorted(view.records, key=lambda found: found[0].key):
        if isinstance(record, CoordinatorRecord):
            yield from _coordinator_lines(record, entry.written_at, programs)
        elif isinstance(record, PendingCallRecord):
            yield from _pending_call_lines(record, entry.written_at)
    for title, damaged in (("damaged", view.damaged), ("moved aside", view.moved_aside)):
        for lost in damaged:
            yield f"\n{title}: {describe_loss(lost.entry)}: {lost.reason}"


def _coordinator_lines(
    record: CoordinatorRecord, written_at: float, programs: Mapping[bytes, ProgramRecord]
) -> Iterator[str]:
    yield f"\n{record.agent}, start {record.generation}: {record.state}: {_STATES[record.state]}"
    yield f"  as of     {format_time(written_at)}"
    yield f"  transfer  {record.sequence}, after {record.hops} hop{'s' * (record.hops != 1)}"
    if record.target:
        yield f"  sent to   {record.target}, memory {record.receiver_memory:016x}"
    if record.kind:
        yield f"  refused   {record.kind}: {record.reason}"
    if record.doubt:
        yield f"  in doubt  {record.doubt}"
    if record.outcome:
        yield f"  ended     {record.outcome} on {record.ended_on}" + (
            f": {record.detail}" if record.detail else ""
        )
    if record.block:
        yield f"  block     {len(record.block)} bytes of program {record.program.hex()[:16]}"
        yield from (f"  {line}" for line in _stack(record, programs))


def _pending_call_lines(record: PendingCallRecord, written_at: float) -> Iterator[str]:
    start = f"{record.agent}, start {record.generation}"
    yield f"\n{start}: call {record.number} started: {record.resource}.{record.portal}"
    yield f"  as of     {format_time(written_at)}"
    size = f", {len(record.result)} bytes" if record.result else ""
    yield f"  outcome   {_OUTCOMES[record.outcome]}{size}"


def _stack(record: CoordinatorRecord, programs: Mapping[bytes, ProgramRecord]) -> Iterator[str]:
    from lfield.errors import BlockError, ProgramFileError
    from lfield.vm.inspection import dump_file
    from lfield.vm.inspection.block_view import view

    explains = programs.get(record.program)
    if explains is None:
        yield "stack not shown: the program is not in this journal"
        return
    try:
        program, block = dump_file.decode_program_and_block(explains.code, explains.types, record.block)
    except (BlockError, ProgramFileError) as error:
        yield str(error)
        return
    block_view = view(block, program, explains.members)
    if block_view.interval:
        yield interval_line(block_view.interval)
    for thread in block_view.threads:
        yield from thread_lines(thread)


def interval_line(seconds: float) -> str:
    """The heartbeat interval of a coordinator as text."""
    return f"heartbeat failover {seconds:g} s after its last heartbeat"


def thread_lines(thread: ThreadView) -> Iterator[str]:
    """A thread and its stack, innermost first, with its variables."""
    from lfield.vm.inspection.traceback import split_ends

    serves = f", serves portal call {thread.call}" if thread.call else ""
    yield f"thread {thread.id}: {thread.state}{serves}"
    inner, between, outer = split_ends(thread.frames)
    for frame in inner:
        yield from _frame_lines(frame)
    if between:
        yield f"  ... {between} more calls ..."
    for frame in outer:
        yield from _frame_lines(frame)


def _frame_lines(frame: FrameView) -> Iterator[str]:
    where = f"{frame.file}:{frame.line}" if frame.line else "?"
    yield f"  at {frame.method} ({where})    {frame.text}"
    for name, value in frame.locals:
        yield f"       {name} = {value}"
    for call in frame.calls:
        yield f"       together: {call}"
    for reservation in frame.reserved:
        yield f"       reserved: {reservation}"
