"""The realisations of a primitive: providers, chains of one-to-one rules, and compositions at their ends.

A chain passes no primitive twice: its continuation is already offered at the first. A subsumption does not
follow another one, because a third one makes the same step at once.
"""

from __future__ import annotations

import heapq
from collections import defaultdict
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from itertools import islice

from lfield.capability import realisations
from lfield.capability.matching.assembly import Assembly
from lfield.capability.matching.provider_plans import ProviderPlans
from lfield.capability.matching.ranking import Ranking
from lfield.capability.model import Equivalence, Registry
from lfield.capability.offer import Candidate

#: One-to-one rules from the requested primitive down to the one of the provider.
Chain = tuple[Equivalence, ...]

#: Maximum number of chains to a primitive, shortest first; real registries have fewer.
MAX_CHAINS = 256


class RuleIndex:
    """The rules of a registry by the primitive they serve, always in the order of their names.

    `agents` returns the agents of a resource type. `open_ways` are the fields a program was compiled with by
    primitive; None leaves all realisations open.
    """

    def __init__(
        self,
        registry: Registry,
        agents: Callable[[str], Sequence[Candidate]],
        open_ways: Mapping[str, Collection[str]] | None,
        depth: int,
    ) -> None:
        self._open, self._depth = open_ways, depth
        self.ranking = Ranking(registry, agents)
        self._providers: dict[str, list[ProviderPlans]] = defaultdict(list)
        self._equivalences: dict[str, list[Equivalence]] = defaultdict(list)
        self._compositions: dict[str, list[Assembly]] = defaultdict(list)
        self._equivalences_by_source: dict[str, list[Equivalence]] = defaultdict(list)
        self._compositions_by_need: dict[str, list[Assembly]] = defaultdict(list)
        self._chains: dict[str, list[Chain]] = {}
        self._reached: dict[str, tuple[str, ...]] = {}
        self._inside: dict[str, frozenset[str]] = {}
        for _, provider in sorted(registry.providers.items()):
            for name in provider.serves:
                if self._is_open(name, realisations.direct(provider.type)):
                    provided = ProviderPlans(name, provider, registry.attributes, self.ranking)
                    self._providers[name].append(provided)
        for _, rule in sorted(registry.equivalences.items()):
            if self._is_open(rule.serves, realisations.equivalent(rule.name)):
                self._equivalences[rule.serves].append(rule)
                self._equivalences_by_source[rule.by].append(rule)
        for _, composition in sorted(registry.compositions.items()):
            if self._is_open(composition.serves, realisations.composed(composition.name)):
                self._compose(Assembly(composition, self.ranking))

    def _compose(self, assembly: Assembly) -> None:
        self._compositions[assembly.rule.serves].append(assembly)
        for primitive in dict.fromkeys(need.primitive for need in assembly.rule.needs.values()):
            self._compositions_by_need[primitive].append(assembly)

    def _is_open(self, primitive: str, field: str) -> bool:
        return self._open is None or field in self._open.get(primitive, ())

    def providers(self, primitive: str) -> list[ProviderPlans]:
        """The resource types that serve a primitive themselves."""
        return self._providers.get(primitive, [])

    def equivalences(self, primitive: str, above: Chain = ()) -> list[Equivalence]:
        """The one-to-one rules that may extend a chain at a primitive."""
        passed = {rule.serves for rule in above} | {primitive}
        subsumed = bool(above) and is_subsumption(above[-1])
        return [
            rule
            for rule in self._equivalences.get(primitive, [])
            if rule.by not in passed and not (subsumed and is_subsumption(rule))
        ]

    def compositions(self, primitive: str) -> list[Assembly]:
        """The one-to-many rules that serve a primitive."""
        return self._compositions.get(primitive, [])

    def chains(self, primitive: str) -> list[Chain]:
        """All chains to a primitive, the shortest first, beginning with the empty one."""
        if primitive not in self._chains:
            self._chains[primitive] = list(islice(self._shortest(primitive), MAX_CHAINS))
        return self._chains[primitive]

    def _shortest(self, primitive: str) -> Iterator[Chain]:
        chains: list[Chain] = [()]
        for _ in range(self._depth + 1):
            yield from chains
            chains = [
                (*chain, rule)
                for chain in chains[:MAX_CHAINS]
                for rule in self.equivalences(chain[-1].by if chain else primitive, chain)
            ]

    def equivalences_by(self, primitive: str) -> list[Equivalence]:
        """The one-to-one rules by which a primitive serves others."""
        return self._equivalences_by_source.get(primitive, [])

    def compositions_with(self, primitive: str) -> list[Assembly]:
        """The one-to-many rules that need a primitive."""
        return self._compositions_by_need.get(primitive, [])

    def reached(self, primitive: str) -> tuple[str, ...]:
        """A primitive, and all others that may occur in a plan for it."""
        if primitive not in self._reached:
            found = dict.fromkeys([primitive])
            waiting = [primitive]
            while waiting:
                following = [name for name in self._below(waiting.pop()) if name not in found]
                found |= dict.fromkeys(following)
                waiting += following
            self._reached[primitive] = tuple(found)
        return self._reached[primitive]

    def _below(self, primitive: str) -> dict[str, None]:
        """The primitives that the rules for a primitive require, each once."""
        found = dict.fromkeys(rule.by for rule in self._equivalences.get(primitive, []))
        for assembly in self.compositions(primitive):
            found |= dict.fromkeys(need.primitive for need in assembly.rule.needs.values())
        return found

    def inside(self, primitive: str) -> frozenset[str]:
        """The compositions that may occur anywhere in a plan for a primitive."""
        if primitive not in self._inside:
            names = (a.rule.name for reached in self.reached(primitive) for a in self.compositions(reached))
            self._inside[primitive] = frozenset(names)
        return self._inside[primitive]


def is_subsumption(rule: Equivalence) -> bool:
    """Whether the registry made the rule itself: the specific serves the general (`Retrieve-is-Haul`)."""
    return rule.name == f"{rule.by}-is-{rule.serves}"


# --- bounds --------------------------------------------------------------------------------------------


def least_costs(rules: RuleIndex, goal: str, agents: Callable[[str], float | None]) -> Mapping[str, float]:
    """Lower bounds of the costs of all primitives that may be part of a plan for `goal`.

    `agents` returns the least cost of direct providers. Primitives without a provider are left out;
    conditions are ignored. This is Knuth's generalisation of Dijkstra's algorithm to AND/OR graphs
    (Information Processing Letters 6, 1977): primitives are settled in the order of their least costs; a rule
    counts when all its needs are settled.
    """
    settled: dict[str, float] = {}
    own = ((name, agents(name)) for name in rules.reached(goal))
    waiting = [(cost, name) for name, cost in own if cost is not None]
    heapq.heapify(waiting)
    while waiting:
        cost, primitive = heapq.heappop(waiting)
        if primitive not in settled:
            settled[primitive] = cost
            for served in _following(rules, primitive, settled):
                heapq.heappush(waiting, served)
    return settled


def _following(rules: RuleIndex, primitive: str, settled: Mapping[str, float]) -> Iterator[tuple[float, str]]:
    """The primitives that can be served once a primitive is settled, with their costs."""
    for rule in rules.equivalences_by(primitive):
        yield rules.ranking.by_rule(settled[primitive], rule.loss), rule.serves
    for assembly in rules.compositions_with(primitive):
        cost = assembly.least_cost(settled)
        if cost is not None:
            yield cost, assembly.rule.serves
