"""Counts the function calls of one hop: from the `pcall` to the first instruction of the portal.

    .venv/bin/python tests/benchmarks/hops/call_count.py            # without and with journals
    .venv/bin/python tests/benchmarks/hops/call_count.py --list     # also each call, in order

Both hosts run in this process on one event loop, over TCP and TLS of this computer. Nothing subscribes to
events. A move is a call in another file than the call before; a return is a move to a file that the hop was
in before. Counts do not depend on the speed of the computer; of several hops the smallest count is printed,
because timers of the hosts may fire during a hop.
"""

from __future__ import annotations

import argparse
import asyncio
import io
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from types import FrameType
from typing import Any

import lfield
from lfield import loop
from lfield.authority.minted import Minted
from lfield.clock import SystemClock
from lfield.host.host import Host
from lfield.host.logbook import Logbook
from lfield.host.surroundings import Options
from lfield.journal.file import FileJournal
from lfield.journal.opening import Owner
from lfield.mission.load import load_mission
from lfield.mission.mission import Mission
from lfield.net.local import reserve
from lfield.net.tcp import TcpTransport
from lfield.net.tls import Tls
from lfield.vm import portals
from lfield.vm.outside import Outsiders

HOPS, WARM_UP = 60, 40
_PACKAGE = str(Path(lfield.__file__).parent)
_PROGRAM = """
resource Post { init(string[] arg) { } portal visit() { } }
coordinator Traveller {
    init(string[] arg) {
        Post near = findPost("near");
        Post far = findPost("far");
        while (true) { far.visit(); near.visit(); }
    }
}
"""


@dataclass(frozen=True, slots=True)
class Walk:
    """The calls of one hop in their order: file and function of each."""

    calls: tuple[tuple[str, str], ...]

    @property
    def files(self) -> int:
        """How many files have a function that was called."""
        return len({file for file, _ in self.calls})

    @property
    def moves(self) -> int:
        """How often a call was in another file than the call before."""
        files = [file for file, _ in self.calls]
        return sum(before != after for before, after in pairwise(files))

    @property
    def returns(self) -> int:
        """How many of the moves led to a file that the hop was in before."""
        seen: set[str] = set()
        count, last = 0, ""
        for file, _ in self.calls:
            count += file != last and file in seen
            seen.add(file)
            last = file
        return count


class Recorder:
    """Records the calls from the departure of a coordinator to the begin of the portal that it called."""

    def __init__(self) -> None:
        self.walks: list[Walk] = []
        self._calls: list[tuple[str, str]] | None = None

    def on_departure(self) -> None:
        """The thread of a coordinator has left the engine; of several times in one hop the first counts."""
        if self._calls is None:
            self._calls = []
            sys.setprofile(self._on_event)

    def on_begin(self) -> None:
        """The portal call has begun on the other host."""
        sys.setprofile(None)
        if self._calls is not None:
            self.walks.append(Walk(tuple(self._calls)))
        self._calls = None

    def _on_event(self, frame: FrameType, event: str, _: Any) -> None:
        code = frame.f_code
        is_own = event == "call" and code.co_filename.startswith(_PACKAGE)
        # Comprehensions are frames before Python 3.12 and none from there on.
        if is_own and self._calls is not None and not code.co_name.endswith(("comp>", "genexpr>")):
            self._calls.append((code.co_filename[len(_PACKAGE) + 1 :], code.co_qualname))


@contextmanager
def recording() -> Iterator[Recorder]:
    """Record hops for the duration."""
    recorder, carry_out, begin = Recorder(), Outsiders.carry_out, portals.begin

    def recorded(self: Outsiders, *args: Any) -> None:
        recorder.on_departure()
        carry_out(self, *args)

    def begun(*args: Any, **named: Any) -> Any:
        try:
            return begin(*args, **named)
        finally:
            recorder.on_begin()

    Outsiders.carry_out, portals.begin = recorded, begun  # type: ignore[method-assign]
    try:
        yield recorder
    finally:
        sys.setprofile(None)
        Outsiders.carry_out, portals.begin = carry_out, begin  # type: ignore[method-assign]


async def recorded_hops(folder: Path, *, journals: bool) -> list[Walk]:
    """The walks of some hops, after a warm-up."""
    (folder / "mission.L").write_text(_PROGRAM, encoding="utf-8")
    deploy = folder / "mission.dL"
    deploy.write_text("//Post:near@a\n//Post:far@b\n//Traveller:traveller@a\n", encoding="utf-8")
    ports = {host: reserve("127.0.0.1:0") for host in "ab"}
    mission = load_mission(deploy, maps=[f"{host}={address}" for host, (_, address) in ports.items()])
    keys = Minted.for_hosts("ab", time.time()).hosts
    for listening, _ in ports.values():
        listening.close()
    with recording() as recorder:
        hosts = [
            _host(
                mission, host, TcpTransport(mission.max_block, Tls(keys[host])), folder if journals else None
            )
            for host in "ab"
        ]
        try:
            await asyncio.gather(*(host.start() for host in hosts))
            while len(recorder.walks) < WARM_UP + HOPS and not any(host.failure for host in hosts):
                await asyncio.sleep(0.05)
        finally:
            for host in hosts:
                await host.stop()
    return recorder.walks[WARM_UP : WARM_UP + HOPS]


def _host(mission: Mission, name: str, transport: TcpTransport, folder: Path | None) -> Host:
    journal = None
    if folder is not None:
        owner = Owner("bench", name, "")
        journal = FileJournal(folder / name / "host.journal", owner, print, SystemClock())
    address = mission.team.addresses[mission.team.number(name)]
    options = Options(address, engine="reference", journal=journal, first_start=True)
    return Host(mission, name, transport, Logbook(io.StringIO(), io.StringIO()), options)


def main() -> None:
    """Print the counts."""
    parser = argparse.ArgumentParser(description="Counts the function calls of one hop.")
    parser.add_argument("--list", action="store_true", help="print each call of the hop, in order")
    listed = parser.parse_args().list
    print(f"{'hop':<18}{'calls':>7}{'files':>7}{'moves':>7}{'returns':>9}")
    for journals in (False, True):
        with tempfile.TemporaryDirectory(prefix="lfield-calls-") as folder:
            walks = loop.run(recorded_hops(Path(folder), journals=journals))
        least = min(walks, key=lambda walk: len(walk.calls))
        name = "with journals" if journals else "without journals"
        print(f"{name:<18}{len(least.calls):>7}{least.files:>7}{least.moves:>7}{least.returns:>9}")
        for file, function in least.calls if listed else ():
            print(f"    {file:<32} {function}")


if __name__ == "__main__":
    main()
