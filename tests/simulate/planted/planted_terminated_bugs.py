"""The rules against the recovery of a terminated coordinator, each removed: the judge must find it."""

from __future__ import annotations

import random
from dataclasses import replace
from typing import Any

from msgspec import structs
from planted_bugs import Bug, Patch

from lfield.host.migration.write_ahead import WriteAheadQueue
from lfield.host.team.leases import TeamLeases
from lfield.replication.lease.core import Quorum
from lfield.replication.lease.termination_log import TerminationLog
from lfield.replication.transfer.core import Mobility
from simulation_testing.scenarios.scenario import Scenario, ending
from simulation_testing.seed_runner import DrawScenario

#: The breaches that reveal these bugs.
RECOVERED = frozenset({"terminated", "promised"})


def _no_ends_in_answers(patch: Patch) -> None:
    """Answers to queries omit the states of ended coordinators, a second source of terminations."""
    on_states = Mobility.on_states

    def without_ends(self: Mobility, host: str, records: Any) -> Any:
        return on_states(self, host, [one for one in records if one.state != "EXITED"])

    patch.setattr(Mobility, "on_states", without_ends)


def a_termination_is_not_reported(patch: Patch) -> None:
    """A terminated coordinator looks like an unknown one."""
    _no_ends_in_answers(patch)
    patch.setattr(TeamLeases, "_termination_checkpoint", lambda self, agent: None)


def a_vote_ignores_a_termination(patch: Patch) -> None:
    """Acknowledgements report it, but a vote does not consider it."""
    _no_ends_in_answers(patch)
    on_propose, sought = Quorum._on_propose, Quorum._locate

    def promises(self: Quorum, host: str, message: Any, now: float) -> Any:
        return on_propose(self, host, structs.replace(message, start=2**62), now)

    def silent(self: Quorum, agent: str, now: float) -> Any:
        return structs.replace(sought(self, agent, now), ended=None)

    patch.setattr(Quorum, "_on_propose", promises)
    patch.setattr(Quorum, "_locate", silent)
    patch.setattr(TerminationLog, "all", property(lambda self: []))


def a_termination_is_sent_before_it_is_on_disk(patch: Patch) -> None:
    patch.setattr(WriteAheadQueue, "durable_states", lambda self, rows, here: list(rows))


def a_termination_is_stored_despite_a_promise(patch: Patch) -> None:
    """The termination becomes final while the promised recovery begins, and the proposer is not informed."""
    patch.setattr(TerminationLog, "is_delayed", lambda self, ended, now: False)
    patch.setattr(TerminationLog, "all", property(lambda self: []))


def _bug(plant: Any, broken: str, seed: int, draws: DrawScenario = ending) -> Bug:
    return Bug(plant, broken, RECOVERED, seed, draws)


def calm(seed: int) -> Scenario:
    """A scenario of three hosts with one cut link as the only fault."""
    scenario = replace(ending(seed), means={}, cast=3, hosts=3, walkers=3, witnesses=0)
    return replace(scenario, aimed=scenario.aimed[:1])


def slowly(seed: int) -> Scenario:
    """A scenario in which a host loses power while the end of a coordinator is written to disk."""
    scenario = replace(ending(seed), calls=1 + seed % 2, stay=1.0, means={}, sync=0.002)
    slow = replace(
        scenario.aimed[0], kind="disk_slow", at=scenario.calls - 0.3 * random.Random(seed).random(), lasts=6.0
    )
    power = replace(slow, kind="power", at=slow.at + 2.0, lasts=1.0)
    return replace(scenario, aimed=(slow, power))


TERMINATED_BUGS = [
    _bug(
        a_termination_is_not_reported,
        "a host that has a termination answers like one that has none",
        99,
        calm,
    ),
    _bug(
        a_vote_ignores_a_termination,
        "a vote for a failover ignores a known termination",
        99,
        calm,
    ),
    _bug(
        a_termination_is_sent_before_it_is_on_disk, "a termination is sent before it is on disk", 184, slowly
    ),
    _bug(
        a_termination_is_stored_despite_a_promise,
        "a termination is stored although a failover has been promised",
        41,
    ),
]
