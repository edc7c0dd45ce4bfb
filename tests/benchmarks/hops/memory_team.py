"""A mission on the in-memory network, all hosts in one process; the network counts messages.

`figure_of` compares programs that work with N resources, each on its own host.
"""

from __future__ import annotations

import asyncio
import io
from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path

from harness.checkout import Checkout
from harness.figure import Figure, Opener
from harness.number_text import COUNT
from harness.paced import Round
from harness.processes import Processes
from memory_network import MemoryNetwork

from lfield.clock import SystemClock
from lfield.host.environment import HostOptions
from lfield.host.host import Host
from lfield.host.logbook import Logbook
from lfield.host.process.mission_completion import wait_until_done
from lfield.mission.loader import load_mission
from lfield.mission.mission import Mission

#: The numbers of resources.
SIZES = (2, 4, 8, 16)
#: Seconds without a link after which a host counts as unreachable; no host is stopped here.
_LOST_AFTER = 30.0


def figure_of(
    title: str,
    program: str,
    ways: Mapping[str, str],
    agents: Callable[[int], list[str]],
    targets: Mapping[str, str],
) -> Figure:
    """Hops and seconds of each way, whose text replaces WORK in the program, with `agents` for each size.

    The last line of the program's output has the seconds.
    """

    def opener(work: str) -> Opener:
        def ready(checkout: Checkout, processes: Processes) -> Callable[[], Round]:
            return lambda: one_round(processes, work)

        return ready

    def one_round(processes: Processes, work: str) -> Round:
        found: Round = {}
        for count in SIZES:
            sent, written = carry_out(processes.folder(), program.replace("WORK", work), agents(count))
            found[f"N = {count}: hops"] = [sent["Transfer"]]
            found[f"N = {count}: seconds"] = [float(written[-1])]
        return found

    return Figure(
        title,
        {way: opener(work) for way, work in ways.items()},
        base=("one after another",),
        rounds=3,
        units={f"N = {count}: hops": COUNT for count in SIZES},
        sizes={f"N = {count}": count for count in SIZES},
        targets=targets,
    )


def carry_out(folder: Path, program: str, agents: list[str]) -> tuple[Counter[str], list[str]]:
    """Run a program until its only coordinator, which ends on the last host, is done.

    Returns the numbers of sent messages by name, and the output of each host.
    """
    (folder / "mission.L").write_text(program, encoding="utf-8")
    deploy = folder / "mission.dL"
    deploy.write_text("\n".join(agents), encoding="utf-8")
    return asyncio.run(_carry_out(load_mission(deploy)))


async def _carry_out(mission: Mission) -> tuple[Counter[str], list[str]]:
    loop = asyncio.get_running_loop()
    network = MemoryNetwork(SystemClock(), on_pending=lambda: loop.call_soon(network.step))
    written = {name: io.StringIO() for name in mission.team.hosts}
    hosts = [_host(mission, name, network, out) for name, out in written.items()]
    try:
        # Concurrently: a host with coordinators waits for the Hello of the other hosts before it starts them.
        await asyncio.gather(*(host.start() for host in hosts))
        (outcome,) = await wait_until_done(hosts[-1], _LOST_AFTER)
        if outcome.outcome != "done":
            raise RuntimeError(f"{outcome.agent} {outcome.outcome}: {outcome.detail}")
        sent: Counter[str] = network.sent.copy()
    finally:
        for host in hosts:
            await host.stop()
    return sent, [out.getvalue() for out in written.values()]


def _host(mission: Mission, name: str, network: MemoryNetwork, out: io.StringIO) -> Host:
    address = mission.team.addresses[mission.team.number(name)]
    return Host(mission, name, network.transport(name), Logbook(out, io.StringIO()), HostOptions(address))
