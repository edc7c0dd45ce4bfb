"""The faults of a team, drawn from a seed."""

from __future__ import annotations

import random
from dataclasses import dataclass, replace
from typing import NamedTuple

#: The lease in all scenarios, in seconds.
LEASE = 2.0
#: Faults of links, and of hosts.
LINKS = ("link", "island", "only", "one way", "deaf", "mute", "lossy", "late")
HOSTS = ("crash", "restart", "freeze", "slow disk")


class Fault(NamedTuple):
    """A fault of hosts at a time, for a span, both in real seconds."""

    at: float
    kind: str
    hosts: tuple[str, ...]
    span: float


@dataclass(frozen=True)
class Scenario:
    """A team and its faults. `agents` has their homes; `interval` is their heartbeat interval."""

    seed: int
    hosts: tuple[str, ...]
    rates: tuple[float, ...]
    members: tuple[str, ...]
    agents: dict[str, str]
    interval: float
    faults: tuple[Fault, ...]
    until: float
    #: Links are restored, and one is cut, at the worst moment.
    ambush: bool
    #: The probability that a coordinator terminates in each of its steps.
    ends: float = 0.0


def drawn(seed: int, hosts: tuple[int, int] = (1, 7), faults: int = 12, until: float = 40.0) -> Scenario:
    """The scenario of a seed, with a maximum number of hosts and faults.

    Each scenario has some kinds of faults only: the effects of one kind could hide those of another.
    """
    rng = random.Random(seed)
    names = tuple("abcdefg"[: rng.randint(*hosts)])
    members = names if rng.random() < 0.7 else tuple(rng.sample(names, rng.randint(1, len(names))))
    rates = tuple(rng.choice([0.99, 1.01, rng.uniform(0.99, 1.01)]) for _ in names)
    agents = {f"Tour:{number}": rng.choice(names) for number in range(rng.choice([1, 1, 2]))}
    kinds = rng.sample(LINKS, rng.randint(1, 4)) + rng.sample(HOSTS, rng.choice([0, 1, 2]))
    drawn_faults = sorted(_fault(rng, kinds, names, until) for _ in range(rng.randint(0, faults)))
    interval = rng.choice([0.5, 2.0, 3.0, 5.0])
    return Scenario(
        seed, names, rates, members, agents, interval, tuple(drawn_faults), until, rng.random() < 0.5
    )


def ending(seed: int) -> Scenario:
    """A scenario of three hosts whose coordinators terminate; two hosts at a time have no link for seven
    seconds."""
    rng = random.Random(f"ending {seed}")
    scenario = drawn(seed, hosts=(3, 3), faults=0, until=30.0)
    cuts = tuple(Fault(at, "link", tuple(rng.sample(scenario.hosts, 2)), 7.0) for at in (3.0, 11.0, 19.0))
    interval = rng.choice([0.5, 2.0])
    return replace(scenario, members=scenario.hosts, interval=interval, faults=cuts, ambush=False, ends=0.1)


def _fault(rng: random.Random, kinds: list[str], names: tuple[str, ...], until: float) -> Fault:
    kind = rng.choice(kinds)
    most = max(1, len(names) - 1) if kind in LINKS else 1
    hosts = rng.sample(names, min(2, len(names)) if kind == "link" else rng.randint(1, most))
    return Fault(rng.uniform(1.0, until), kind, tuple(hosts), rng.choice([0.3, 1.5, 3.0, 6.0, 12.0]))
