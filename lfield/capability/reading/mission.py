"""The sections `agents` and `ranking`, which are a mission's: single agents, and what a good offer is.

```yaml
agents: {arm2: {payload: 1.2}}
ranking: {weights: {loss: 2.0, hop: 0.1}, attributes: {payload: 2.0}}
```
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import fields as fields_of
from dataclasses import replace

from lfield.capability.model import Weights
from lfield.capability.reading import messages
from lfield.capability.reading.draft import Draft
from lfield.capability.reading.values import read_values
from lfield.text.suggest import listed
from lfield.text.yaml_fields import Fields

#: The terms of the cost that have a weight; the weights of single attributes stand beside them.
_TERMS = tuple(f.name for f in fields_of(Weights) if f.name != "attributes")
_HEAVIEST = 1e6


def read_agents(draft: Draft, deployed: Collection[str] | None) -> None:
    """The values of single agents; when the `deployed` ones are given, any other name is a mistake."""
    for _, entry, fields in draft.entries("agents"):
        if deployed is not None and entry.key not in deployed:
            hint = draft.like(entry.key, deployed)
            known = listed(sorted(deployed))
            draft.tell(messages.UNKNOWN_AGENT, entry.key_span, hint=hint, name=entry.key, agents=known)
        draft.agents.setdefault(entry.key, {}).update(read_values(draft, fields))


def read_ranking(draft: Draft) -> None:
    """The weights: a later file counts before an earlier one, a mission's before all."""
    for file in draft.files:
        section = file.top.section("ranking")
        stated = section.section("weights")
        weights = {
            term: stated.number(term, minimum=0.0, maximum=_HEAVIEST) for term in _TERMS if term in stated
        }
        stated.done()
        attributes = {**draft.weights.attributes, **_attribute_weights(draft, section.section("attributes"))}
        draft.weights = replace(draft.weights, attributes=attributes, **weights)
        section.done()


def _attribute_weights(draft: Draft, section: Fields) -> dict[str, float]:
    weights = {}
    for entry in section.named():
        if draft.attribute(entry.key, entry.key_span) is not None:
            weights[entry.key] = section.number(entry.key, minimum=0.0, maximum=_HEAVIEST)
    return weights
