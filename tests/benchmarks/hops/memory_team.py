"""A mission on the in-memory network, all hosts in one process: it counts what is sent."""

from __future__ import annotations

import asyncio
import io
from collections import Counter
from pathlib import Path

from memory_network import MemoryNetwork

from lfield.clock import SystemClock
from lfield.host.environment import HostOptions
from lfield.host.host import Host
from lfield.host.logbook import Logbook
from lfield.host.process.mission_completion import wait_until_done
from lfield.mission.loader import load_mission
from lfield.mission.mission import Mission

#: Seconds without a link after which a host counts as gone; none goes here.
_LOST_AFTER = 30.0


def carry_out(folder: Path, program: str, agents: list[str]) -> tuple[Counter[str], list[str]]:
    """Run a program until its one coordinator, on the last host, is done.

    Returns the messages that were sent, by name, and what each host has written.
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
        # At once: a host with coordinators waits for the others' greetings before it starts them.
        await asyncio.gather(*(host.start() for host in hosts))
        (fate,) = await wait_until_done(hosts[-1], _LOST_AFTER)
        if fate.outcome != "done":
            raise RuntimeError(f"{fate.agent} {fate.outcome}: {fate.detail}")
        sent: Counter[str] = network.sent.copy()
    finally:
        for host in hosts:
            await host.stop()
    return sent, [out.getvalue() for out in written.values()]


def _host(mission: Mission, name: str, network: MemoryNetwork, out: io.StringIO) -> Host:
    address = mission.team.addresses[mission.team.number(name)]
    return Host(mission, name, network.transport(name), Logbook(out, io.StringIO()), HostOptions(address))
