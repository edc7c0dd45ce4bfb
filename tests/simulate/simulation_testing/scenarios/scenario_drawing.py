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
    dice = random.Random(f"beside {seed}")
    kind = dice.choices([*RARER, ""], [*RARER.values(), 1.0 - sum(RARER.values())])[0]
    story = KINDS[kind](seed) if kind else _usual(seed)
    if not kind and story.journals and random.Random(f"drawn ending {seed}").random() < ENDING:
        story = ending(seed)
    elif not kind and random.Random(f"drawn apart {seed}").random() < APART:
        story = apart(seed)
    if dice.random() < (ORDERED_WITH_DEVICES if story.arms else ORDERED):
        story = under_orders(story, dice)
    if dice.random() < SLOW:
        story = replace(story, slowness=dice.choice(SLOWNESS))
    return story


def under_orders(story: Scenario, rng: random.Random) -> Scenario:
    """The scenario with orders of an operator, and with at least one device if the program has devices."""
    orders = rng.choice((("estop",), ("pause",), ("estop", "pause")))
    means = {order: rng.uniform(*OFTEN) for order in orders}
    arms = story.arms if story.kind in PROGRAMS else max(1, story.arms)
    return replace(story, means={**story.means, **means}, arms=arms)


def _usual(seed: int) -> Scenario:
    story = plain(seed)
    if not story.journals:
        return forgetful(seed)
    if random.Random(f"together {seed}").random() < CREWS:
        if random.Random(f"reserve {seed}").random() < KEEPERS:
            return keeper(seed)
        return (racer if random.Random(f"race {seed}").random() < RACERS else crew)(seed)
    dice = random.Random(f"kind {seed}")
    kind = dice.choice(KEPT)
    return KINDS[dice.choice(DOUBTFUL) if kind == "doubted" else kind](seed)


def split(seed: int) -> Scenario:
    """A scenario of a larger team that is split into two groups; the majority continues with the others'
    coordinators."""
    story, dice = doubted(seed), random.Random(f"split {seed}")
    hosts = dice.choice((4, 5, 5, 5, 6, 7))
    means = {"split": dice.uniform(*OFTEN)}
    means |= {kind: dice.uniform(*OFTEN) for kind in ("cut", "stop", "kill") if dice.random() < 0.5 * LIKELY}
    lease = dice.choice((1.0, 2.0))
    seconds = DOUBTED + 2.0 * lease
    return replace(
        story,
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
    dice = random.Random(f"crowd {seed}")
    story = dice.choice((plain, plain, fenced))(seed)
    hosts, seconds = dice.choice((10, 11, 13)), dice.uniform(4.0, 7.0) + (LONGER if story.interval else 0.0)
    return replace(
        story,
        kind="crowd",
        cast=hosts,
        hosts=hosts,
        walkers=dice.choice((1, 2)),
        stays=0,
        arms=min(story.arms, 1),
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
    dice = random.Random(f"apart {seed}")
    story = dice.choice((plain, plain, fenced))(seed)
    hosts = dice.choice((3, 3, 4, 5, 6))
    row = [f"h{n}" for n in dice.sample(range(hosts), hosts)]
    pairs = [(one, other) for n, one in enumerate(row) for other in row[n + 2 :]]
    broken = pairs if dice.random() < 0.5 else dice.sample(pairs, 1)
    kind, lasts = dice.choice(("cut", "cut", "one_way")), dice.uniform(*APART_FOR)
    aimed = [Fault(dice.uniform(0.5, 2.5), kind, one, other, lasts, 1.0) for one, other in broken]
    if dice.random() < 0.5:
        aimed += [replace(fault, at=fault.at + 0.001, kind="reset") for fault in aimed]
    kinds = [kind for kind in ("kill", "restart", "stop") if dice.random() < LIKELY]
    seconds = 3.0 + lasts
    return replace(
        story,
        kind="apart",
        cast=hosts,
        hosts=hosts,
        walkers=3,
        stays=0,
        arms=min(story.arms, 1),
        calls=FOR_EVER,
        stay=0.04,
        lost_after=None,
        means={kind: dice.uniform(*OFTEN) for kind in kinds},
        aimed=tuple(sorted(aimed, key=lambda fault: fault.at)),
        weather=seconds,
        seconds=seconds,
        witnesses=0,
    )


def flight(seed: int) -> Scenario:
    """A scenario of keepers whose resources have devices, on slow computers at times."""
    story, dice = keeper(seed), random.Random(f"flown {seed}")
    means = {kind: dice.uniform(*BETWEEN) for kind in ("guard_kill", "guard_stop") if dice.random() < LIKELY}
    return replace(story, kind="flown", means={**story.means, **means})


def wrecked(seed: int) -> Scenario:
    """A scenario of a permanently lost host: an operator recovers its coordinators or declares them lost."""
    story, dice = plain(seed), random.Random(f"wrecked {seed}")
    kinds = [kind for kind in DOUBTS if dice.random() < LIKELY]
    seconds = story.weather + LONGER
    return replace(
        story,
        kind="wrecked",
        means={"wreck": seconds / 3.0} | {kind: dice.uniform(*OFTEN) for kind in kinds},
        arms=min(story.arms, 1),
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
