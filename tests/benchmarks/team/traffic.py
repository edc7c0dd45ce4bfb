"""The traffic of a host in an idle team, and the cost of a simulation of the whole team."""

from __future__ import annotations

from pathlib import Path

from harness.checkout import Checkout
from harness.figure import Figure, Opener
from harness.number_text import COUNT, RATE, SECONDS
from harness.paced import Round
from harness.processes import Processes
from harness.samples import Contender

#: Seconds of virtual time by number of hosts.
TEAMS = {3: 60.0, 10: 30.0, 30: 30.0, 50: 30.0, 100: 60.0, 300: 10.0, 1000: 60.0}
#: Seconds for the largest team on a slow computer.
TIMEOUT = 600.0
MESSAGES, BYTES = "messages of a host each second", "bytes of a host each second"
START, SECOND = "start, 10 s: processor", "a second: processor"

_TEAM = str(Path(__file__).with_name("idle_team.py"))


def team(hosts: int) -> Opener:
    """Measure a team of `hosts` hosts."""

    def opener(checkout: Checkout, _: Processes) -> Contender:
        def measure() -> Round:
            with Processes() as processes:
                child = checkout.run(processes, _TEAM, str(hosts), str(TEAMS[hosts]))
                messages, sent, start, second = map(float, child.line(TIMEOUT).split())
                rates = {MESSAGES: [round(messages, 1)], BYTES: [sent / 1000]}
                return {**rates, START: [start], SECOND: [second]}

        return measure

    return opener


FIGURE = Figure(
    "Traffic of an idle team",
    {f"{hosts} hosts": team(hosts) for hosts in TEAMS},
    rounds=1,
    units={MESSAGES: COUNT, BYTES: RATE, START: SECONDS, SECOND: SECONDS},
    sizes={f"{hosts} hosts": hosts for hosts in TEAMS},
    targets={MESSAGES: "8", SECOND: "1 s"},
    ratios=(("1000 hosts", "100 hosts", "12x"),),
    notes=("whole hosts on simulated computers, without devices; both sides of a link count what they send",),
    between=("3 hosts", "30 hosts"),
)
