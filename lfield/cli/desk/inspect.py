"""`lfield inspect FILE`: a dumped block as agent, threads, L stack, locals and heap."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from lfield.vm.inspect.decode import BlockView, ThreadView


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare its options."""
    parser.add_argument("file", metavar="FILE", type=Path, help="a dump that 'lfield up --dump DIR' wrote")


def run(args: argparse.Namespace) -> int:
    """Print what the dump says."""
    from lfield.errors import BlockError
    from lfield.text.files import read_bytes
    from lfield.vm.inspect import dump
    from lfield.vm.inspect.decode import view

    try:
        record, program, block = dump.decode(read_bytes(args.file, dump.MAX_SIZE))
    except BlockError as error:
        raise BlockError(f"{args.file}: {error.reason}", word=error.word) from None
    shown = view(block, program, record.members)
    trail = " → ".join(record.hosts[n] if n < len(record.hosts) else str(n) for n in shown.trail)
    print(f"agent     {shown.id} ({shown.kind} {shown.type})")
    print(f"on        {record.host}, after {shown.hops} hop(s): {trail}")
    print(f"program   {program.digest.hex()[:16]}")
    if record.reason:
        print("why       " + record.reason.replace("\n", "\n          "))
    for thread in shown.threads:
        _print_thread(thread)
    _print_state(shown, record.limit)
    return 0


def _print_thread(thread: ThreadView) -> None:
    serves = f", serves portal call {thread.call}" if thread.call else ""
    print(f"\nthread {thread.id}: {thread.state}{serves}")
    for frame in thread.frames:
        where = f"{frame.file}:{frame.line}" if frame.line else "?"
        print(f"  at {frame.method} ({where})    {frame.text}")
        for name, value in frame.locals:
            print(f"       {name} = {value}")


def _print_state(shown: BlockView, limit: int) -> None:
    print(f"\nfields of {shown.id}")
    for name, value in shown.fields:
        print(f"       {name} = {value}")
    print(f"\nheap: {shown.used} of {limit} bytes")
    for name, count, size in shown.heap:
        print(f"  {size:>9} bytes  {count:>6} × {name}")
