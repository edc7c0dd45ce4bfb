"""The cost of a coordinator that a quorum can recover, hopping and at rest: counts, not times."""

from __future__ import annotations

from pathlib import Path

from harness.checkout import Checkout
from harness.figure import Figure, Opener
from harness.number_text import COUNT, RATE
from harness.paced import Round
from harness.processes import Processes
from harness.samples import Contender

#: Seconds of virtual time by number of hosts.
TEAMS = {3: 60.0, 9: 30.0, 30: 30.0}
#: Seconds for the largest team on a slow computer.
TIMEOUT = 300.0
KINDS = {"volatile": "without journal", "kept": "with journal", "leased": "with journal and leases"}
OF_A_HOP = ("messages of a hop", "commits of a hop")
AT_REST = ("messages of a host each second", "bytes of a host each second")

_TEAM = str(Path(__file__).with_name("leased_team.py"))


def team(kind: str) -> Opener:
    """Measure teams of all sizes with a coordinator of this kind; hops are counted in the smallest team."""

    def opener(checkout: Checkout, _: Processes) -> Contender:
        def measure() -> Round:
            found: Round = {}
            for hosts, seconds in TEAMS.items():
                with Processes() as processes:
                    child = checkout.run(processes, _TEAM, kind, str(hosts), str(seconds))
                    costs = map(float, child.line(TIMEOUT).split())
                    messages, sent = map(float, child.line(TIMEOUT).split())
                if hosts == min(TEAMS):
                    found |= {what: [round(cost, 2)] for what, cost in zip(OF_A_HOP, costs, strict=True)}
                found[f"{hosts} hosts: {AT_REST[0]}"] = [round(messages, 1)]
                found[f"{hosts} hosts: {AT_REST[1]}"] = [sent / 1000]
            return found

        return measure

    return opener


UNITS = dict.fromkeys(OF_A_HOP, COUNT)
UNITS |= {
    f"{hosts} hosts: {what}": unit
    for what, unit in zip(AT_REST, (COUNT, RATE), strict=True)
    for hosts in TEAMS
}

FIGURE = Figure(
    "The cost of a coordinator, of a hop and at rest",
    {f"lfield: {name}": team(kind) for kind, name in KINDS.items()},
    rounds=1,
    units=UNITS,
    sizes={f"{hosts} hosts": hosts for hosts in TEAMS},
    notes=(
        "means of all hosts, on simulated computers without devices; leases of 2 s, of all hosts or of nine",
        "a host without a journal does not confirm an arrival if the coordinator departs in the same turn",
    ),
)
