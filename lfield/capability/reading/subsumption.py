"""The specific serves the general: rules that follow from the tree of terms by themselves.

Where the term of P lies below that of Q and P has all portals of Q, with the same signatures, every offer of
P is one of Q, without any loss: the rule `P-is-Q`. A P that lacks one of them is just below Q in the tree.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from lfield.capability.model import Equivalence, Primitive
from lfield.capability.reading.portals import same_name
from lfield.capability.reading.signatures import same_call


def subsumptions(primitives: Mapping[str, Primitive]) -> dict[str, Equivalence]:
    """All rules that follow from the places of some primitives in the tree, by name."""
    by_term: dict[str, list[Primitive]] = {}
    for primitive in primitives.values():
        by_term.setdefault(primitive.id, []).append(primitive)
    rules = {}
    for specific in primitives.values():
        for ancestor in _ancestors(specific.id):
            for general in by_term.get(ancestor, ()):
                if not lacking(specific, general):
                    rule = _rule(specific, general)
                    rules[rule.name] = rule
    return rules


def lacking(specific: Primitive, general: Primitive) -> tuple[str, ...]:
    """The portals of the general primitive that the specific one has not, or has with another signature."""
    return tuple(
        name
        for name, portal in general.portals.items()
        if name not in specific.portals or not same_call(portal, specific.portals[name])
    )


def _ancestors(id: str) -> Iterable[str]:
    while "." in id:
        id = id.rpartition(".")[0]
        yield id


def _rule(specific: Primitive, general: Primitive) -> Equivalence:
    return Equivalence(
        name=f"{specific.name}-is-{general.name}",
        serves=general.name,
        by=specific.name,
        portals={name: same_name(portal, specific.span) for name, portal in general.portals.items()},
        span=specific.span,
        meaning=f"{general.id} is the more general of the two",
    )
