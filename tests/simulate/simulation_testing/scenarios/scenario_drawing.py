"""The scenario of a seed: its kind, and whether it has orders of an operator or slow computers."""

from __future__ import annotations

import random
from collections.abc import Callable, Mapping
from dataclasses import replace

from simulation_testing.fault_injection import Fault
from simulation_testing.scenarios.scenario import (
    BETWEEN,
    DOUBTED,
    DOUBTS,
    FOR_EVER,
    LIKELY,
    LONGER,
    OFTEN,
    PROGRAMS,
    STAYS_ON,
    Scenario,
    crew,
    doubted,
    ending,
    fenced,
    forgetful,
    keeper,
    parted,
    plain,
    racer,
)

#: The kinds of scenarios of hosts with journals.
KEPT, DOUBTFUL = ("plain", "plain", "fenced", "doubted"), ("doubted", "parted")
#: The share of crews, and the share of crews that are replaced by keepers.
CREWS, KEEPERS = 0.25, 0.5
#: The share of the other crews that are replaced by racers.
RACERS = 0.5
#: The probability of these kinds, beside all others.
RARER = {"split": 0.12, "crowd": 0.04, "flown": 0.1, "wrecked": 0.06}
#: The share of scenarios with orders of an operator, also of those with devices; the share on slow computers.
ORDERED, ORDERED_WITH_DEVICES, SLOW = 0.15, 0.35, 0.2
#: The share of the usual scenarios with journals in which the coordinators end soon.
ENDING = 0.06
#: The share of scenarios of hosts without a direct link, and its duration in seconds.
APART, APART_FOR = 0.05, (14.0, 20.0)
#: The factor of the processor time of all code.
SLOWNESS = (10.0, 50.0, 200.0)


def draw_scenario(seed: int) -> Scenario:
    """The scenario of a seed: some have larger teams, wrecks, orders of an operator, or slow computers."""
    rng = random.Random(f"beside {seed}")
    kind = rng.choices([*RARER, ""], [*RARER.values(), 1.0 - sum(RARER.values())])[0]
    scenario = KINDS[kind](seed) if kind else _usual(seed)
    if not kind and scenario.journals and random.Random(f"drawn ending {seed}").random() < ENDING:
        scenario = ending(seed)
    elif not kind and random.Random(f"drawn apart {seed}").random() < APART:
        scenario = apart(seed)
    if rng.random() < (ORDERED_WITH_DEVICES if scenario.arms else ORDERED):
        scenario = under_orders(scenario, rng)
    if rng.random() < SLOW:
        scenario = replace(scenario, slowness=rng.choice(SLOWNESS))
    return scenario


def under_orders(scenario: Scenario, rng: random.Random) -> Scenario:
    """The scenario with orders of an operator, and with at least one device if the program has devices."""
    orders = rng.choice((("estop",), ("pause",), ("estop", "pause")))
    means = {order: rng.uniform(*OFTEN) for order in orders}
    arms = scenario.arms if scenario.kind in PROGRAMS else max(1, scenario.arms)
    return replace(scenario, means={**scenario.means, **means}, arms=arms)


def _usual(seed: int) -> Scenario:
    scenario = plain(seed)
    if not scenario.journals:
        return forgetful(seed)
    if random.Random(f"together {seed}").random() < CREWS:
        if random.Random(f"reserve {seed}").random() < KEEPERS:
            return keeper(seed)
        return (racer if random.Random(f"race {seed}").random() < RACERS else crew)(seed)
    rng = random.Random(f"kind {seed}")
    kind = rng.choice(KEPT)
    return KINDS[rng.choice(DOUBTFUL) if kind == "doubted" else kind](seed)


def split(seed: int) -> Scenario:
    """A scenario of a larger team that is split into two groups; the majority continues with the others'
    coordinators."""
    scenario, rng = doubted(seed), random.Random(f"split {seed}")
    hosts = rng.choice((4, 5, 5, 5, 6, 7))
    means = {"split": rng.uniform(*OFTEN)}
    means |= {kind: rng.uniform(*OFTEN) for kind in ("cut", "stop", "kill") if rng.random() < 0.5 * LIKELY}
    lease = rng.choice((1.0, 2.0))
    seconds = DOUBTED + 2.0 * lease
    return replace(
        scenario,
        kind="split",
        cast=hosts,
        hosts=hosts,
        walkers=3,
        means=means,
        stays=STAYS_ON[0],
        lease=lease,
        weather=seconds,
        seconds=seconds,
    )


def crowd(seed: int) -> Scenario:
    """A scenario of a team of more than nine hosts: each keeps links with eight neighbours."""
    rng = random.Random(f"crowd {seed}")
    scenario = rng.choice((plain, plain, fenced))(seed)
    hosts, seconds = rng.choice((10, 11, 13)), rng.uniform(4.0, 7.0) + (LONGER if scenario.interval else 0.0)
    return replace(
        scenario,
        kind="crowd",
        cast=hosts,
        hosts=hosts,
        walkers=rng.choice((1, 2)),
        stays=0,
        arms=min(scenario.arms, 1),
        calls=FOR_EVER,
        stay=0.04,
        lost_after=None,
        journals=True,
        weather=seconds,
        seconds=seconds,
        witnesses=0,
    )


def apart(seed: int) -> Scenario:
    """A scenario in which links break for long while coordinators hop over them; others connect the ends.

    Sometimes the links of a team form only a chain, in any order.
    """
    rng = random.Random(f"apart {seed}")
    scenario = rng.choice((plain, plain, fenced))(seed)
    hosts = rng.choice((3, 3, 4, 5, 6))
    row = [f"h{n}" for n in rng.sample(range(hosts), hosts)]
    pairs = [(one, other) for n, one in enumerate(row) for other in row[n + 2 :]]
    broken = pairs if rng.random() < 0.5 else rng.sample(pairs, 1)
    kind, lasts = rng.choice(("cut", "cut", "one_way")), rng.uniform(*APART_FOR)
    aimed = [Fault(rng.uniform(0.5, 2.5), kind, one, other, lasts, 1.0) for one, other in broken]
    if rng.random() < 0.5:
        aimed += [replace(fault, at=fault.at + 0.001, kind="reset") for fault in aimed]
    kinds = [kind for kind in ("kill", "restart", "stop") if rng.random() < LIKELY]
    seconds = 3.0 + lasts
    return replace(
        scenario,
        kind="apart",
        cast=hosts,
        hosts=hosts,
        walkers=3,
        stays=0,
        arms=min(scenario.arms, 1),
        calls=FOR_EVER,
        stay=0.04,
        lost_after=None,
        means={kind: rng.uniform(*OFTEN) for kind in kinds},
        aimed=tuple(sorted(aimed, key=lambda fault: fault.at)),
        weather=seconds,
        seconds=seconds,
        witnesses=0,
    )


def flight(seed: int) -> Scenario:
    """A scenario of keepers whose resources have devices, on slow computers at times."""
    scenario, rng = keeper(seed), random.Random(f"flown {seed}")
    means = {kind: rng.uniform(*BETWEEN) for kind in ("guard_kill", "guard_stop") if rng.random() < LIKELY}
    return replace(scenario, kind="flown", means={**scenario.means, **means})


def wrecked(seed: int) -> Scenario:
    """A scenario of a permanently lost host: an operator recovers its coordinators or declares them lost."""
    scenario, rng = plain(seed), random.Random(f"wrecked {seed}")
    kinds = [kind for kind in DOUBTS if rng.random() < LIKELY]
    seconds = scenario.weather + LONGER
    return replace(
        scenario,
        kind="wrecked",
        means={"wreck": seconds / 3.0} | {kind: rng.uniform(*OFTEN) for kind in kinds},
        arms=min(scenario.arms, 1),
        calls=FOR_EVER,
        stay=0.04,
        lost_after=None,
        journals=True,
        weather=seconds,
        seconds=seconds,
    )


#: Scenarios by the kind of their coordinators.
KINDS: Mapping[str, Callable[[int], Scenario]] = {
    "plain": plain,
    "forgetful": forgetful,
    "fenced": fenced,
    "doubted": doubted,
    "parted": parted,
    "ending": ending,
    "crew": crew,
    "racer": racer,
    "keeper": keeper,
    "split": split,
    "apart": apart,
    "crowd": crowd,
    "flown": flight,
    "wrecked": wrecked,
}
