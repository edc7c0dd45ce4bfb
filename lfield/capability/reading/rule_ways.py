"""Ways of one primitive that would be the same field of its class in L (ways.py)."""

from __future__ import annotations

from collections.abc import Iterator

from lfield.capability import ways
from lfield.capability.reading import messages
from lfield.capability.reading.draft import Draft
from lfield.text.source import Span


def check_ways(draft: Draft) -> None:
    """Report rules and needs whose names differ in the registry and not in L."""
    taken: dict[tuple[str, str], str] = {}
    for primitive, way, name, span in _ways(draft):
        other = taken.setdefault((primitive, way), name)
        if other != name:
            draft.tell(messages.SAME_WAY, span, name=name, other=other, way=way, primitive=primitive)


def _ways(draft: Draft) -> Iterator[tuple[str, str, str, Span]]:
    """Primitive, field, the name it is made of, and where that stands."""
    for equivalence in draft.equivalences.values():
        yield equivalence.serves, ways.equivalent(equivalence.name), equivalence.name, equivalence.span
    for rule in draft.compositions.values():
        yield rule.serves, ways.composed(rule.name), rule.name, rule.span
        for need in rule.needs.values():
            name = f"{rule.name}.{need.name}"
            yield rule.serves, ways.part(rule.name, need.name), name, need.span
