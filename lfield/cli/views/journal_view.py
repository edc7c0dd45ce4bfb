"""A journal in words: who is in it, in which state and since when, and the L stack of each block."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

from lfield.journal.opening import lost, moment
from lfield.journal.pages import (
    BegunPage,
    BundlePage,
    CopyPage,
    Fence,
    Paused,
    ProgramPage,
    ReservationPage,
    Run,
    Starts,
    Stopped,
)
from lfield.wire.fields import short_digest

if TYPE_CHECKING:
    from lfield.journal.reading import Seen
    from lfield.vm.inspect.decode import FrameView, ThreadView

#: For people, by what is kept.
_STATES = {
    "ABSENT": "was refused here",
    "RUN": "is here",
    "PREPARED": "may have left",
    "MOVED": "has left, this is its shadow",
    "EXITED": "has ended",
}

_OUTCOMES = {
    "": "not known: it was under way",
    "done": "has come to its end, and waits to be fetched",
    "thrown": "has thrown an exception, which waits to be fetched",
}


def journal_lines(seen: Seen) -> Iterator[str]:
    """What `lfield inspect` prints of a journal."""
    if seen.head is None:
        yield "journal   whose it is cannot be read"
    else:
        yield f"journal   of {seen.head.host} in {seen.head.deployment}"
        yield f"identity  {seen.head.identity:016x}"
    programs = {page.digest: page for _, page in seen.pages if isinstance(page, ProgramPage)}
    for _, page in seen.pages:
        match page:
            case Starts():
                yield f"starts    {page.count}"
            case Run():
                yield f"run       {'goes on' if page.open else 'has ended'}"
            case BundlePage() if page.digest:
                yield f"bundle    {short_digest(page.digest)}, signed"
            case Paused() if page.on:
                yield "paused    until 'lfield resume'"
            case Stopped() if page.reason:
                yield f"stopped   until 'lfield estop --lift': {page.reason}"
            case Fence():
                yield f"fence     {page.agent}: no start before {page.generation}"
            case ReservationPage():
                holder = f"{page.agent}, start {page.generation}" if page.agent else "nobody"
                yield f"reserved  {page.resource}, number {page.number}: {holder}"
            case ProgramPage():
                yield f"program   {page.digest.hex()[:16]}, {len(page.code)} bytes"
    for entry, page in sorted(seen.pages, key=lambda found: found[0].key):
        if isinstance(page, CopyPage):
            yield from _copy_lines(page, entry.kept, programs)
        elif isinstance(page, BegunPage):
            yield from _begun_lines(page, entry.kept)
    for title, damaged in (("damaged", seen.damaged), ("moved aside", seen.aside)):
        for one in damaged:
            yield f"\n{title}: {lost(one.entry)}: {one.why}"


def _copy_lines(page: CopyPage, kept: float, programs: Mapping[bytes, ProgramPage]) -> Iterator[str]:
    yield f"\n{page.agent}, start {page.generation}: {page.state}: {_STATES[page.state]}"
    yield f"  as of     {moment(kept)}"
    yield f"  transfer  {page.sequence}, after {page.hops} hop{'s' * (page.hops != 1)}"
    if page.target:
        yield f"  sent to   {page.target}, memory {page.memory:016x}"
    if page.kind:
        yield f"  refused   {page.kind}: {page.reason}"
    if page.doubt:
        yield f"  in doubt  {page.doubt}"
    if page.outcome:
        yield f"  ended     {page.outcome} on {page.ended_on}" + (f": {page.detail}" if page.detail else "")
    if page.block:
        yield f"  block     {len(page.block)} bytes of program {page.program.hex()[:16]}"
        yield from (f"  {line}" for line in _stack(page, programs))


def _begun_lines(page: BegunPage, kept: float) -> Iterator[str]:
    yield f"\n{page.agent}, start {page.generation}: call {page.number} begun: {page.resource}.{page.portal}"
    yield f"  as of     {moment(kept)}"
    size = f", {len(page.parcel)} bytes" if page.parcel else ""
    yield f"  outcome   {_OUTCOMES[page.outcome]}{size}"


def _stack(page: CopyPage, programs: Mapping[bytes, ProgramPage]) -> Iterator[str]:
    from lfield.errors import BlockError, ProgramFileError
    from lfield.vm.inspect import dump
    from lfield.vm.inspect.decode import view

    explains = programs.get(page.program)
    if explains is None:
        yield "its program is not in this journal, so there is no stack to show"
        return
    try:
        program, block = dump.explained(explains.code, explains.types, page.block)
    except (BlockError, ProgramFileError) as error:
        yield str(error)
        return
    shown = view(block, program, explains.members)
    if shown.interval:
        yield interval_line(shown.interval)
    for thread in shown.threads:
        yield from thread_lines(thread)


def interval_line(seconds: float) -> str:
    """What a coordinator's heartbeat interval means."""
    return f"heartbeat recovered {seconds:g} s after the last sign of it"


def thread_lines(thread: ThreadView) -> Iterator[str]:
    """A thread and its stack, innermost first, with what its variables hold."""
    from lfield.vm.inspect.traceback import ends

    serves = f", serves portal call {thread.call}" if thread.call else ""
    yield f"thread {thread.id}: {thread.state}{serves}"
    inner, between, outer = ends(thread.frames)
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
