"""Agreement of two hosts, connected by other hosts, on the holder of a coordinator (mobility.md).

While a path of links connects two hosts for `AGREED_WITHIN` seconds, they do not both report one coordinator
as in doubt, and a host that has sent one to the other knows whether that has it. A link stands when both of
its ends have it and no path between them is silent or slow; a path leads over hosts whose processes run. The
second rule does not hold for a receiver with another memory, or whose disk stores nothing or is slow: its
answer has to be durable first.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from itertools import combinations

from lfield.simulate.host_fleet import Fleet, HostRun
from lfield.wire.coordinator_messages import CoordinatorState
from simulation_testing.invariants.breaches import Breaches

#: Seconds after which two connected hosts agree: a query in doubt is repeated every 3 s.
AGREED_WITHIN = 8.0

#: Two hosts that disagree: the subject, the hosts with their lives, and the sender's transfer, 0 for none.
_Case = tuple[str, str, HostRun, str, HostRun, int]


class AgreementChecks:
    """The transfers in doubt of a team."""

    def __init__(self, breaches: Breaches, fleet: Callable[[], Fleet]) -> None:
        self._breaches, self._fleet = breaches, fleet
        #: The true time since which two connected hosts disagree.
        self._since: dict[_Case, float] = {}

    def check(self) -> None:
        """Check the reports of hosts; called several times a second."""
        fleet = self._fleet()
        rows = {name: life.core.mobility.known_states() for name, life in fleet.runs.items()}
        cases = {*self._both_in_doubt(rows), *self._without_answer(rows)}
        groups = _groups(fleet) if cases else {}
        now = fleet.now
        self._since = {
            case: self._since.get(case, now)
            for case in cases
            if case[1] in groups and groups.get(case[1]) is groups.get(case[3])
        }
        for (agent, one, _, other, _, sequence), since in self._since.items():
            if now - since > AGREED_WITHIN:
                what = f"{one} does not know whether {other} has transfer {sequence} of {agent}"
                found = what if sequence else f"both report {agent} as in doubt"
                self._breaches.add(
                    "doubt", (one, other), f"{found}, and hosts connect them for {now - since:.1f} s"
                )

    def _both_in_doubt(self, rows: dict[str, list[CoordinatorState]]) -> Iterable[_Case]:
        """True if both report doubt; the host of an unreadable block counts it as lost."""
        lives = self._fleet().runs
        doubts = {
            name: {row.agent for row in known if row.state == "IN DOUBT" and not row.unreadable}
            for name, known in rows.items()
        }
        for one, other in combinations(sorted(doubts), 2):
            for agent in sorted(doubts[one] & doubts[other]):
                yield agent, one, lives[one], other, lives[other], 0

    def _without_answer(self, rows: dict[str, list[CoordinatorState]]) -> Iterable[_Case]:
        fleet = self._fleet()
        for name, known in rows.items():
            for row in known:
                if row.state not in ("PREPARED", "IN DOUBT") or row.where not in fleet.runs:
                    continue
                receiver, disk = fleet.runs[row.where], fleet.disks[row.where]
                remembers = receiver.core.hello().state_id == row.receiver_memory
                if remembers and not (disk.full or disk.broken or disk.slow):
                    yield row.agent, name, fleet.runs[name], row.where, receiver, row.sequence


def _groups(fleet: Fleet) -> dict[str, set[str]]:
    """For each running host, the hosts that standing links connect with it."""
    groups: dict[str, set[str]] = {}
    runs = {name: life for name, life in fleet.runs.items() if not life.process.loop.frozen}
    for name in runs:
        groups[name] = {name}
    for one, other in combinations(sorted(runs), 2):
        if _are_linked(fleet, one, other) and groups[one] is not groups[other]:
            joined = groups[one] | groups[other]
            groups |= dict.fromkeys(joined, joined)
    return groups


def _are_linked(fleet: Fleet, one: str, other: str) -> bool:
    ways, incarnation = (
        fleet.network.paths,
        {name: fleet.runs[name].core.incarnation for name in (one, other)},
    )
    ends = all(
        fleet.runs[near].host.peers.incarnations.get(far) == incarnation[far]
        for near, far in ((one, other), (other, one))
    )
    return ends and not ways.silences(one, other) and not {(one, other), (other, one)} & ways.slow.keys()
