"""Counts the function calls of one hop, from the `pcall` to the first instruction of the portal, and of a
device instruction, from the calling thread to the first byte on the wire of the device.

    .venv/bin/python tests/benchmarks/hops/call_count.py            # without and with journals
    .venv/bin/python tests/benchmarks/hops/call_count.py --list     # also each call, in order

Both hosts run in this process on one event loop, over TCP and TLS of this computer. Nothing subscribes to
events. A move is a call in another file than the call before; a return is a move to a file that the hop was
in before. Of several hops the smallest count is printed, because timers of the hosts may fire during a hop.
More timers fire on a busy computer. So the same hop is also counted in a simulated team without TLS, where
every run has the same counts: `figures.tsv` has their upper bounds (test_call_count.py). Its figures over
TCP were counted on an idle computer.
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
from itertools import pairwise, product
from pathlib import Path
from types import FrameType
from typing import Any, NamedTuple

import pytest

import lfield
from lfield import event_loop
from lfield.authority.ephemeral_ca import EphemeralCa
from lfield.bytecode.opcodes import BY_NAME
from lfield.clock import SystemClock
from lfield.host.environment import HostOptions
from lfield.host.host import Host
from lfield.host.logbook import Logbook
from lfield.journal.file_journal import FileJournal
from lfield.journal.journal_loader import JournalOwner
from lfield.mission.loader import load_mission
from lfield.mission.mission import Mission
from lfield.net.local_addresses import open_listening_socket
from lfield.net.tcp_transport import TcpTransport
from lfield.net.tls import TlsIdentity
from lfield.simulate.hardware import Hardware
from lfield.simulate.host_fleet import Fleet, FleetOptions
from lfield.vm import portal_calls
from lfield.vm.agent import Agent
from lfield.vm.engine_interface import HostCall
from lfield.vm.host_calls import HostCallDispatcher

HOPS, WARM_UP = 60, 40
#: Seconds of virtual time that these hops take at most.
TIMEOUT = 60.0
_PACKAGE = str(Path(lfield.__file__).parent)
#: A portal that commands a vehicle, for the device instruction.
_DEVICE_PROGRAM = """
resource Post {
    Mavlink fc;
    init(string[] arg) { fc.release(); }
    portal go() { fc.setVelocity(1.0, 0.0, 0.0); }
}
coordinator Pilot {
    init(string[] arg) { Post post = findPost("a"); while (true) { post.go(); sleep(0.1); } }
}
"""
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


_AGENTS = "//Post:near@a\n//Post:far@b\n//Traveller:traveller@a\n"
_DEVICE = BY_NAME["device"].code


@dataclass(frozen=True, slots=True)
class Walk:
    """The calls of one hop in their order: file and function of each."""

    calls: tuple[tuple[str, str], ...]

    @property
    def files(self) -> int:
        """The number of files with a called function."""
        return len({file for file, _ in self.calls})

    @property
    def moves(self) -> int:
        """The number of calls in another file than the previous call."""
        files = [file for file, _ in self.calls]
        return sum(before != after for before, after in pairwise(files))

    @property
    def returns(self) -> int:
        """The number of moves to a file that the hop was in before."""
        observed: set[str] = set()
        count, last = 0, ""
        for file, _ in self.calls:
            count += file != last and file in observed
            observed.add(file)
            last = file
        return count


class Recorder:
    """Records the calls from the departure of a coordinator to the start of the called portal."""

    def __init__(self) -> None:
        self.walks: list[Walk] = []
        self._calls: list[tuple[str, str]] | None = None

    def on_departure(self) -> None:
        """Start recording when the thread of a coordinator first leaves the engine in a hop."""
        if self._calls is None:
            self._calls = []
            sys.setprofile(self._on_event)

    def on_begin(self) -> None:
        """Stop recording when the portal call has started on the other host."""
        sys.setprofile(None)
        if self._calls is not None:
            self.walks.append(Walk(tuple(self._calls)))
        self._calls = None

    def _on_event(self, frame: FrameType, event: str, _: Any) -> None:
        code = frame.f_code
        is_own = event == "call" and code.co_filename.startswith(_PACKAGE)
        # Comprehensions have frames of their own before Python 3.12 only.
        if is_own and self._calls is not None and not code.co_name.endswith(("comp>", "genexpr>")):
            self._calls.append((code.co_filename[len(_PACKAGE) + 1 :], code.co_qualname))


class HopFigures(NamedTuple):
    """Upper bounds of a hop."""

    calls: int
    files: int
    returns: int


#: By network and journals: "simulated" or "TCP", "no" or "yes".
FIGURES = {
    (network, journals): HopFigures(*map(int, counts))
    for network, journals, *counts in (
        line.split("\t")
        for line in Path(__file__).with_name("figures.tsv").read_text(encoding="utf-8").splitlines()[1:]
    )
}


@contextmanager
def recording() -> Iterator[Recorder]:
    """Record hops for the duration."""
    recorder, carry_out, begin = Recorder(), HostCallDispatcher.dispatch, portal_calls.start_call

    def recorded(self: HostCallDispatcher, *args: Any) -> None:
        recorder.on_departure()
        carry_out(self, *args)

    def begun(*args: Any, **named: Any) -> Any:
        try:
            return begin(*args, **named)
        finally:
            recorder.on_begin()

    HostCallDispatcher.dispatch, portal_calls.start_call = recorded, begun  # type: ignore[method-assign]
    try:
        yield recorder
    finally:
        sys.setprofile(None)
        HostCallDispatcher.dispatch, portal_calls.start_call = carry_out, begin  # type: ignore[method-assign]


def _written(folder: Path, program: str = _PROGRAM, agents: str = _AGENTS) -> Path:
    """Write the mission; returns its deployment file."""
    (folder / "mission.L").write_text(program, encoding="utf-8")
    deploy = folder / "mission.dL"
    deploy.write_text(agents, encoding="utf-8")
    return deploy


def device_call(folder: Path) -> Walk:
    """The device instruction with the fewest calls, without the calls of the simulation.

    The hardware is a model of one that is commanded by one write; a driver of a real device adds the calls
    that encode its protocol.
    """
    mission = load_mission(_written(folder, _DEVICE_PROGRAM, "//Post:a@a\n//Pilot:pilot@a\n"), simulate=True)
    recorder, dispatch, command = Recorder(), HostCallDispatcher.dispatch, Hardware.command

    def dispatched(self: HostCallDispatcher, agent: Agent, thread: int, leave: HostCall) -> None:
        if leave.op == _DEVICE:
            recorder.on_departure()
        dispatch(self, agent, thread, leave)

    def commanded(self: Hardware, *given: Any, **named: Any) -> None:
        recorder.on_begin()
        command(self, *given, **named)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(HostCallDispatcher, "dispatch", dispatched)
        patch.setattr(Hardware, "command", commanded)
        fleet = Fleet(mission, options=FleetOptions(keeps=False))
        while len(recorder.walks) < WARM_UP + HOPS and fleet.now < TIMEOUT:
            fleet.run(1.0)
        sys.setprofile(None)
    fleet.close()
    walks = recorder.walks[WARM_UP:]
    own = [Walk(tuple(call for call in walk.calls if not call[0].startswith("simulate/"))) for walk in walks]
    return min(own, key=lambda walk: len(walk.calls))


def simulated_hops(folder: Path, *, journals: bool) -> list[Walk]:
    """The walks of some hops in a simulated team, after a warm-up, without the calls of the simulation."""
    mission = load_mission(_written(folder))
    with recording() as recorder:
        fleet = Fleet(mission, options=FleetOptions(keeps=journals))
        while len(recorder.walks) < WARM_UP + HOPS and fleet.now < TIMEOUT:
            fleet.run(1.0)
    fleet.close()
    hops = recorder.walks[WARM_UP : WARM_UP + HOPS]
    return [Walk(tuple(call for call in hop.calls if not call[0].startswith("simulate/"))) for hop in hops]


async def recorded_hops(folder: Path, *, journals: bool) -> list[Walk]:
    """The walks of some hops over TCP, after a warm-up."""
    deploy = _written(folder)
    ports = {host: open_listening_socket("127.0.0.1:0") for host in "ab"}
    mission = load_mission(deploy, maps=[f"{host}={address}" for host, (_, address) in ports.items()])
    keys = EphemeralCa.for_hosts("ab", time.time()).hosts
    for listening, _ in ports.values():
        listening.close()
    with recording() as recorder:
        hosts = [
            _host(
                mission,
                host,
                TcpTransport(mission.max_block, TlsIdentity(keys[host])),
                folder if journals else None,
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
        owner = JournalOwner("bench", name, "")
        journal = FileJournal(folder / name / "host.journal", owner, print, SystemClock())
    address = mission.team.addresses[mission.team.number(name)]
    options = HostOptions(address, engine="reference", journal=journal, first_start=True)
    return Host(mission, name, transport, Logbook(io.StringIO(), io.StringIO()), options)


def shortest(*, simulated: bool, journals: bool) -> Walk:
    """The hop with the fewest calls."""
    with tempfile.TemporaryDirectory(prefix="lfield-calls-") as name:
        folder = Path(name)
        if simulated:
            walks = simulated_hops(folder, journals=journals)
        else:
            walks = event_loop.run(recorded_hops(folder, journals=journals))
    return min(walks, key=lambda walk: len(walk.calls))


def main() -> None:
    """Print the counts."""
    parser = argparse.ArgumentParser(description="Counts the function calls of one hop.")
    parser.add_argument("--list", action="store_true", help="print each call of the hop, in order")
    listed = parser.parse_args().list
    print(f"{'network':<11}{'journals':<10}{'calls':>7}{'files':>7}{'moves':>7}{'returns':>9}")
    for simulated, journals in product((False, True), repeat=2):
        least = shortest(simulated=simulated, journals=journals)
        network, journaled = "simulated" if simulated else "TCP", "yes" if journals else "no"
        print(
            f"{network:<11}{journaled:<10}{len(least.calls):>7}{least.files:>7}{least.moves:>7}{least.returns:>9}"
        )
        for file, function in least.calls if listed else ():
            print(f"    {file:<32} {function}")
    with tempfile.TemporaryDirectory(prefix="lfield-calls-") as name:
        walk = device_call(Path(name))
    print(f"{'device':<21}{len(walk.calls):>7}{walk.files:>7}{walk.moves:>7}{walk.returns:>9}")
    for file, function in walk.calls if listed else ():
        print(f"    {file:<32} {function}")


if __name__ == "__main__":
    main()
