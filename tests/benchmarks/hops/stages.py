"""A hop stage by stage, from the `pcall` on one host to the portal's first instruction on the other.

Both hosts run in this process, on one loop, over TCP of this computer: they share one clock, and the kernel
does not wake a sleeping process, an additional cost of a hop between two processes (`ONLY=hop`). Nothing is
stored on disk; the figure `hop` has a line for that cost.
"""

from __future__ import annotations

import asyncio
import io
import time
from collections.abc import Iterator, Mapping
from itertools import product
from pathlib import Path

from harness.checkout import Checkout
from harness.figure import Figure, Row
from harness.processes import Processes, free_port
from harness.samples import Tick, median
from hops.taps import ENDS, READ, Stages, Tap, tapping

from lfield import event_loop
from lfield.authority.ephemeral_ca import EphemeralCa
from lfield.authority.identity import ALL_RIGHTS as EVERY_RIGHT
from lfield.authority.identity import Identity
from lfield.authority.key_material import Keys
from lfield.host.core import HostCore
from lfield.host.environment import HostOptions
from lfield.host.host import Host
from lfield.host.logbook import Logbook
from lfield.host.team.host_services import HostServices
from lfield.mission.loader import load_mission
from lfield.mission.mission import Mission
from lfield.net import framed_link
from lfield.net.framed_link import FramedLink
from lfield.net.link_manager import LinkManager
from lfield.net.tcp_transport import TcpTransport
from lfield.net.tls import TlsIdentity
from lfield.vm.host_calls import HostCallDispatcher
from lfield.vm.machine import Machine
from lfield.vm.memory.block import Block
from lfield.vm.memory.block_verifier import BlockVerifier
from lfield.vm.memory.liveness import Liveness
from lfield.vm.wasm.engine_selection import has_wasm

#: Bytes of live state in addition to the coordinator.
SIZES = (64, 8 << 10)
HOPS, WARM_UP = 400, 100

ALL, TURNS, BEGINS, REST = "all of it", "the host's turn", "first instruction", "(the rest)"

#: The taps in the order of a hop.
TAPS = (
    Tap("freeze", HostCallDispatcher, "dispatch", there=BEGINS),
    Tap("decide to go", HostServices, "depart"),
    Tap("seal", Machine, "pack"),
    Tap("clear dead", Liveness, "clear_dead"),
    Tap("collect, copy", Block, "image"),
    Tap("write", LinkManager, "send_transfer", behind=ENDS),
    Tap("encode", framed_link, "encode_transfer"),
    Tap("decode", FramedLink, "receive_frame", behind=READ),
    Tap("decide to take", HostCore, "on_transfer"),
    Tap("inject", Machine, "inject"),
    Tap("check", BlockVerifier, "check"),
    Tap(TURNS, Host, "on_transfer"),
    Tap(TURNS, HostCore, "run"),
    Tap("run", Machine, "run"),
)
ORDER = (*(tap.stage for tap in TAPS[:7]), ENDS, READ, *(tap.stage for tap in TAPS[7:12]), "run", BEGINS)

_PROGRAM = """
resource Post {
    init(string[] arg) { }
    portal visit() { }
}

coordinator Traveller {
    int[] load;

    init(string[] arg) {
        Post near = findPost("near");
        Post far = findPost("far");
        load = new int[s2i(arg[1]) / 8];
        while (true) {
            far.visit();
            near.visit();
        }
    }
}
"""


def measured(checkout: Checkout, rounds: int, tick: Tick) -> Iterator[Row]:
    """The stages of hops of each size with each engine."""
    for size, engine in product(SIZES, ("reference", "wasm") if has_wasm() else ("reference",)):
        case = f"{size} B: {engine} engine"
        tick(case)
        with Processes() as processes:
            hops = event_loop.run(travel(processes.folder(), size, rounds * HOPS, engine))
        yield from rows(case, hops)


def rows(case: str, hops: list[Mapping[str, float]]) -> Iterator[Row]:
    """A row for each stage; the ratio is its share of the whole."""
    totals = [sum(hop.values()) for hop in hops]
    yield Row(case, ALL, samples=totals)
    for stage in (*ORDER, ""):
        samples = [hop.get(stage, 0.0) for hop in hops]
        share = median(samples) / median(totals)
        yield Row("", stage or REST, samples=samples, ratio=share)


async def travel(
    folder: Path, size: int, count: int, engine: str, *, plain: bool = False
) -> list[Mapping[str, float]]:
    """Run `count` hops of a coordinator with `size` bytes of live state after a warm-up in TLS or `plain`."""
    (folder / "mission.L").write_text(_PROGRAM, encoding="utf-8")
    deploy = folder / "mission.dL"
    deploy.write_text(f"//Post:near@a\n//Post:far@b\n//Traveller:traveller@a?{size}\n", encoding="utf-8")
    mission = load_mission(deploy, maps=[f"{host}=127.0.0.1:{free_port()}" for host in "ab"])
    stages = Stages()
    with tapping(stages, TAPS):
        keys = EphemeralCa.for_hosts("ab", time.time()).hosts
        carried = {host: _plain(mission, host) if plain else _in_tls(mission, keys[host]) for host in "ab"}
        hosts = [_host(mission, host, engine, transport) for host, transport in carried.items()]
        try:
            await asyncio.gather(*(host.start() for host in hosts))
            while len(stages.hops) < WARM_UP + count:
                _check_failures(hosts)
                await asyncio.sleep(0.05)
        finally:
            for host in hosts:
                await host.stop()
    return [*stages.hops[WARM_UP : WARM_UP + count]]


def _in_tls(mission: Mission, keys: Keys) -> TcpTransport:
    return TcpTransport(mission.max_block, TlsIdentity(keys))


def _plain(mission: Mission, name: str) -> TcpTransport:
    """A transport without TLS: every peer is identified as the other of the two hosts."""
    other = Identity("host", "b" if name == "a" else "a", EVERY_RIGHT)
    return TcpTransport(mission.max_block, identify=lambda _: other)


def _host(mission: Mission, name: str, engine: str, transport: TcpTransport) -> Host:
    options = HostOptions(mission.team.addresses[mission.team.number(name)], engine=engine)
    return Host(mission, name, transport, Logbook(io.StringIO(), io.StringIO()), options)


def _check_failures(hosts: list[Host]) -> None:
    for host in hosts:
        if host.failure is not None:
            raise RuntimeError(str(host.failure))


FIGURE = Figure(
    "A hop stage by stage, both hosts in one process; ratio: the share of the whole",
    {},
    rounds=10,
    own_rows=measured,
    sizes={f"{size} B": size for size in SIZES},
    notes=(
        f"rounds of {HOPS} hops; every stage is what it takes itself, and half a tap (about 0.3 µs)",
        "freeze: since the exit of the engine; run: until the pcall is there again; "
        "first instruction: until the portal can begin",
    ),
)
