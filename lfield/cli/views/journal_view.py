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
    programs = {page.digest: page for _, page in view.records if isinstance(page, ProgramRecord)}
    for _, page in view.records:
        match page:
            case StartCounter():
                yield f"starts    {page.count}"
            case RunMarker():
                yield f"run       {'not ended' if page.open else 'ended'}"
            case BundleRecord() if page.digest:
                yield f"bundle    {short_digest(page.digest)}, signed"
            case PauseFlag() if page.on:
                yield "paused    until 'lfield resume'"
            case EmergencyStopFlag() if page.reason:
                yield f"stopped   until 'lfield estop --lift': {page.reason}"
            case FenceRecord():
                yield f"fence     {page.agent}: no start before {page.generation}"
            case ReservationRecord():
                holder = f"{page.agent}, start {page.generation}" if page.agent else "free"
                yield f"reserved  {page.resource}, number {page.number}: {holder}"
            case ProgramRecord():
                yield f"program   {page.digest.hex()[:16]}, {len(page.code)} bytes"
    for entry, page in sorted(view.records, key=lambda found: found[0].key):
        if isinstance(page, CoordinatorRecord):
            yield from _coordinator_lines(page, entry.written_at, programs)
        elif isinstance(page, PendingCallRecord):
            yield from _pending_call_lines(page, entry.written_at)
    for title, damaged in (("damaged", view.damaged), ("moved aside", view.moved_aside)):
        for one in damaged:
            yield f"\n{title}: {describe_loss(one.entry)}: {one.reason}"


def _coordinator_lines(
    page: CoordinatorRecord, kept: float, programs: Mapping[bytes, ProgramRecord]
) -> Iterator[str]:
    yield f"\n{page.agent}, start {page.generation}: {page.state}: {_STATES[page.state]}"
    yield f"  as of     {format_time(kept)}"
    yield f"  transfer  {page.sequence}, after {page.hops} hop{'s' * (page.hops != 1)}"
    if page.target:
        yield f"  sent to   {page.target}, memory {page.receiver_memory:016x}"
    if page.kind:
        yield f"  refused   {page.kind}: {page.reason}"
    if page.doubt:
        yield f"  in doubt  {page.doubt}"
    if page.outcome:
        yield f"  ended     {page.outcome} on {page.ended_on}" + (f": {page.detail}" if page.detail else "")
    if page.block:
        yield f"  block     {len(page.block)} bytes of program {page.program.hex()[:16]}"
        yield from (f"  {line}" for line in _stack(page, programs))


def _pending_call_lines(page: PendingCallRecord, kept: float) -> Iterator[str]:
    start = f"{page.agent}, start {page.generation}"
    yield f"\n{start}: call {page.number} started: {page.resource}.{page.portal}"
    yield f"  as of     {format_time(kept)}"
    size = f", {len(page.result)} bytes" if page.result else ""
    yield f"  outcome   {_OUTCOMES[page.outcome]}{size}"


def _stack(page: CoordinatorRecord, programs: Mapping[bytes, ProgramRecord]) -> Iterator[str]:
    from lfield.errors import BlockError, ProgramFileError
    from lfield.vm.inspection import dump_file
    from lfield.vm.inspection.block_view import view

    explains = programs.get(page.program)
    if explains is None:
        yield "stack not shown: the program is not in this journal"
        return
    try:
        program, block = dump_file.decode_program_and_block(explains.code, explains.types, page.block)
    except (BlockError, ProgramFileError) as error:
        yield str(error)
        return
    shown = view(block, program, explains.members)
    if shown.interval:
        yield interval_line(shown.interval)
    for thread in shown.threads:
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
    for kept in frame.reserved:
        yield f"       reserved: {kept}"
