"""Messages for N resources to agree: a coordinator collects from each, then informs each (chapter IV).

N hosts run in one process on the in-memory network, which counts what is sent. The coordinator starts on
the last host, visits all in order to collect and again to inform: every visit is one hop, 2N in all. In a
broadcast everyone tells everyone, N(N-1) messages, and at its end all know all opinions but nobody has
decided.

A hop is confirmed by a short message that nobody waits for, as TCP confirms each message of a broadcast;
the table shows these too.
"""

from __future__ import annotations

import asyncio
import io
import tempfile
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from harness import Figure, Row, times

from lfield.clock import SystemClock
from lfield.host.host import Host, Options
from lfield.host.logbook import Logbook
from lfield.host.until_done import until_done
from lfield.mission.load import load_mission
from lfield.mission.mission import Mission
from lfield.simulate.network import MemoryNetwork

SIZES = (2, 4, 8, 16, 32, 64)

#: Seconds without a link after which a host counts as gone; none goes here.
_LOST_AFTER = 30.0

_PROGRAM = """
resource Voter {
    int wish;

    init(string[] arg) { wish = s2i(arg[1]); }

    portal opinion() emit int { return wish; }

    portal decide(int choice) { write(i2s(choice) + "\\n"); }
}

coordinator Vote {
    init(string[] arg) {
        Voter[] voters = findVoter();
        int choice = 0;
        for (int i = 0; i < voters.length(); i = i + 1) choice = max(choice, voters[i].opinion());
        for (int i = 0; i < voters.length(); i = i + 1) voters[i].decide(choice);
    }
}
"""


@dataclass(frozen=True, slots=True)
class Agreement:
    """What it took: `hops` are the coordinator's migrations, `confirmations` their short answers.

    `decisions` is what each resource was told, in the order of the hosts.
    """

    hops: int
    confirmations: int
    decisions: tuple[int, ...]


def figure() -> Figure:
    """All team sizes."""
    rows = []
    for count in SIZES:
        found = agree(count)
        broadcast = count * (count - 1)
        ratio = times(found.hops / broadcast)
        rows += [
            Row(f"N = {count}", "lfield: hops", str(found.hops), "", ratio, str(2 * count)),
            Row("", "lfield: confirmations of hops", str(found.confirmations)),
            Row("", "broadcast: N(N-1) messages", str(broadcast), "", times(1.0)),
        ]
    title = "Messages for N resources to agree, counted; ratio to a broadcast, target 2N"
    return Figure(title, rows)


def agree(count: int) -> Agreement:
    """Let so many resources, each on a host of its own, agree on the greatest of their wishes."""
    with tempfile.TemporaryDirectory() as folder:
        mission = _mission(Path(folder), count)
    return asyncio.run(_agree(mission))


def _mission(folder: Path, count: int) -> Mission:
    (folder / "vote.L").write_text(_PROGRAM, encoding="utf-8")
    lines = [f"//Voter:v{i}@h{i}?{7 * i % count}" for i in range(count)]
    deploy = folder / "vote.dL"
    deploy.write_text("\n".join([*lines, f"//Vote:vote@h{count - 1}"]), encoding="utf-8")
    return load_mission(deploy)


async def _agree(mission: Mission) -> Agreement:
    loop = asyncio.get_running_loop()

    def deliver_soon() -> None:
        loop.call_soon(network.step)

    network = MemoryNetwork(SystemClock(), on_pending=deliver_soon)
    written = {name: io.StringIO() for name in mission.team.hosts}
    hosts = [_host(mission, name, network, out) for name, out in written.items()]
    try:
        # At once: a host with coordinators waits for the others' greetings before it starts them.
        await asyncio.gather(*(host.start() for host in hosts))
        (fate,) = await until_done(hosts[-1], _LOST_AFTER)
        if fate.outcome != "done":
            raise RuntimeError(f"{fate.agent} {fate.outcome}: {fate.detail}")
        sent: Counter[str] = network.sent.copy()
    finally:
        for host in hosts:
            await host.stop()
    decisions = tuple(int(out.getvalue()) for out in written.values())
    return Agreement(sent["Transfer"], sent["Accepted"], decisions)


def _host(mission: Mission, name: str, network: MemoryNetwork, out: io.StringIO) -> Host:
    address = mission.team.addresses[mission.team.number(name)]
    return Host(mission, name, network.transport(name), Logbook(out, io.StringIO()), Options(address))
