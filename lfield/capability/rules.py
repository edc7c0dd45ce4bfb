"""Which ways lead to a primitive: providers, chains of one-to-one rules, and compositions at their ends.

A chain passes no primitive twice: what is behind is offered there anyhow. One subsumption does not follow
another either, because a third one makes the same step at once.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping

from lfield.capability import ways
from lfield.capability.assembly import Assembly
from lfield.capability.model import Equivalence, Registry
from lfield.capability.provided import Provided
from lfield.capability.ranking import Ranking

#: One-to-one rules from the primitive that is wanted down to the one that is asked.
Chain = tuple[Equivalence, ...]


class Rules:
    """The rules of a registry by the primitive they serve, always in the order of their names.

    `open_ways` are the fields a program was compiled with by primitive; None leaves all ways open.
    """

    def __init__(
        self, registry: Registry, open_ways: Mapping[str, Collection[str]] | None, depth: int
    ) -> None:
        self._open, self._depth = open_ways, depth
        self.ranking = Ranking(registry)
        self._providers: dict[str, list[Provided]] = {}
        self._equivalences: dict[str, list[Equivalence]] = {}
        self._compositions: dict[str, list[Assembly]] = {}
        self._chains: dict[str, list[Chain]] = {}
        self._inside: dict[str, frozenset[str]] = {}
        for _, provider in sorted(registry.providers.items()):
            for name in provider.serves:
                if self._is_open(name, ways.direct(provider.type)):
                    provided = Provided(name, provider, registry.attributes, self.ranking)
                    self._providers.setdefault(name, []).append(provided)
        for _, rule in sorted(registry.equivalences.items()):
            if self._is_open(rule.serves, ways.equivalent(rule.name)):
                self._equivalences.setdefault(rule.serves, []).append(rule)
        for _, composition in sorted(registry.compositions.items()):
            if self._is_open(composition.serves, ways.composed(composition.name)):
                assembly = Assembly(composition, self.ranking)
                self._compositions.setdefault(composition.serves, []).append(assembly)

    def _is_open(self, primitive: str, way: str) -> bool:
        return self._open is None or way in self._open.get(primitive, ())

    def providers(self, primitive: str) -> list[Provided]:
        """The resource types that serve a primitive themselves."""
        return self._providers.get(primitive, [])

    def equivalences(self, primitive: str, above: Chain = ()) -> list[Equivalence]:
        """The one-to-one rules that may go on a chain which has come to a primitive."""
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
            found = sorted(self._longer(primitive, ()), key=lambda c: (len(c), [r.name for r in c]))
            self._chains[primitive] = found
        return self._chains[primitive]

    def _longer(self, primitive: str, above: Chain) -> Iterator[Chain]:
        yield above
        if len(above) < self._depth:
            for rule in self.equivalences(primitive, above):
                yield from self._longer(rule.by, (*above, rule))

    def inside(self, primitive: str) -> frozenset[str]:
        """The compositions that may occur anywhere in a plan for a primitive."""
        if primitive not in self._inside:
            self._inside[primitive] = frozenset(self._reached(primitive))
        return self._inside[primitive]

    def _reached(self, primitive: str) -> Iterator[str]:
        seen, waiting = {primitive}, [primitive]
        while waiting:
            reached = waiting.pop()
            following = [rule.by for rule in self._equivalences.get(reached, [])]
            for assembly in self.compositions(reached):
                yield assembly.rule.name
                following += [need.primitive for need in assembly.rule.needs.values()]
            waiting += [name for name in dict.fromkeys(following) if name not in seen]
            seen.update(following)


def is_subsumption(rule: Equivalence) -> bool:
    """Whether the registry made the rule itself: the specific serves the general (`Retrieve-is-Haul`)."""
    return rule.name == f"{rule.by}-is-{rule.serves}"
