"""The cost of a coordinator that other hosts may continue: hopping, and at rest. Counted, not timed."""

from __future__ import annotations

from pathlib import Path

from harness.checkout import Checkout
from harness.figure import Figure, Opener
from harness.number_text import COUNT, RATE
from harness.paced import Round
from harness.processes import Processes
from harness.samples import Contender

#: How many hosts, and for how many seconds of virtual time they are measured.
TEAMS = {3: 60.0, 9: 30.0, 30: 30.0}
#: Seconds in which the largest is measured on a slow computer.
PATIENCE = 300.0
KINDS = {"volatile": "keeps nothing", "kept": "kept on disk", "leased": "kept, under leases"}
OF_A_HOP = ("messages of a hop", "commits of a hop")
AT_REST = ("messages of a host each second", "bytes of a host each second")

_TEAM = str(Path(__file__).with_name("leased_team.py"))


def team(kind: str) -> Opener:
    """Teams of all sizes with a coordinator of this kind; the smallest is the one whose hops are counted."""

    def opener(checkout: Checkout, _: Processes) -> Contender:
        def measure() -> Round:
            found: Round = {}
            for hosts, seconds in TEAMS.items():
                with Processes() as processes:
                    child = checkout.run(processes, _TEAM, kind, str(hosts), str(seconds))
                    costs = map(float, child.line(PATIENCE).split())
                    messages, sent = map(float, child.line(PATIENCE).split())
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
    "What a coordinator costs, on its way and at rest",
    {f"lfield: {told}": team(kind) for kind, told in KINDS.items()},
    rounds=1,
    units=UNITS,
    sizes={f"{hosts} hosts": hosts for hosts in TEAMS},
    notes=(
        "means of all hosts, on simulated computers without devices; leases of 2 s, of all hosts or of nine",
        "nobody confirms an arrival where it has left again in the same moment, as here if nothing is kept",
    ),
)
