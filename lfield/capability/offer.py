"""Input and output of matching: candidates with their facts, offers, and refusals with their reasons.

Candidates and facts are structs: in a lively team thousands of them are made for one question.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal, Protocol

from msgspec import Struct, field

from lfield.capability.model import Value

OfferKind = Literal["direct", "equivalent", "composed"]

#: The provenance of a value, the most reliable last: usual for the type, stated for the mission or the type,
#: reported by the device, or measured by it.
Provenance = Literal["nominal", "stated", "told", "measured"]


class Fact(Struct, frozen=True, gc=False):
    """The value of an attribute, and its provenance `of`.

    A measured one is `age` seconds old; the others have no age.
    """

    value: Value
    age: float = 0.0
    of: Provenance = "stated"

    @property
    def source(self) -> str:
        """The provenance as text: `nominal`, `stated`, `reported by the device`, `measured 0.4 s ago`."""
        match self.of:
            case "told":
                return "reported by the device"
            case "measured":
                return f"measured {self.age:.{0 if self.age >= 10 else 1}f} s ago"
            case other:
                return other


#: A position: north, east and, if known, down, in metres, in the frame of the team.
Position = tuple[float, float, float | None]


class Candidate(Struct, frozen=True, gc=False):
    """An agent of a resource type as known to this host.

    `facts` are the values reported by its host, by attribute, and `stated` those of the mission, which take
    precedence; those of its type and the primitive are in the registry. `hops` is 0 when it is on this host,
    else 1. `refusal` is the reason why it cannot be called (`unreachable for 12 s`), '' when it can.
    `unknown` are the reasons for missing live attributes (`fc has not reported battery`). `number` is its
    place in the deployment. `denials` has by primitive the reason why the querying coordinator may not call
    it.
    """

    agent: str
    type: str
    host: str
    hops: int = 0
    refusal: str = ""
    facts: Mapping[str, Fact] = {}
    unknown: Mapping[str, str] = {}
    number: int = 0
    stated: Mapping[str, Fact] = {}
    denials: Mapping[str, str] = {}

    def fact(self, name: str) -> Fact | None:
        """The value of an attribute of this agent, without those of its type."""
        return self.stated.get(name) or self.facts.get(name)


class AgentSource(Protocol):
    """The agents of the mission, from a host's directory or from the files."""

    def candidates(self, resource: str) -> Sequence[Candidate]:
        """The agents of a resource type, in the order of the deployment."""

    def location(self) -> Position | None:
        """The place of the query, None when unknown."""


class CostTerm(Struct, frozen=True):
    """A term of a cost (matching/ranking.py): the weight called `name`, times an amount."""

    name: str
    amount: float
    weight: float


class Penalty(Struct, frozen=True):
    """The part of an attribute in the fitness of an agent: `share * penalty`. None: the value is unknown."""

    attribute: str
    value: Value | None
    share: float
    penalty: float


class Offer(Struct, frozen=True):
    """An agent or team that serves a primitive.

    `realisation` is the field of the primitive's class in L (realisations.py). A direct offer has no `parts`;
    an equivalent one has one, named as its realisation; a composed one has one for each need, named by
    `realisations.part`. `agent` and `host` are those of a direct or equivalent offer; of a composed one they
    are those of its parts, joined with '+'. The less `cost`, the better: it is the sum of
    its `terms` and of the costs of its parts. `penalties` make up the fitness of a direct one.
    """

    primitive: str
    kind: OfferKind
    realisation: str
    agent: str
    host: str
    cost: float
    facts: Mapping[str, Fact] = field(default_factory=dict)
    parts: Mapping[str, Offer] = field(default_factory=dict)
    rule: str = ""
    terms: tuple[CostTerm, ...] = ()
    penalties: tuple[Penalty, ...] = ()

    @property
    def score(self) -> float:
        """From 0 (never) to 1 (the best possible)."""
        return 1.0 / (1.0 + self.cost)


class Rejection(Struct, frozen=True):
    """A candidate that is not offered: an agent, or a rule, with all reasons.

    `str()` is a line: `arm2: payload 1.2 < 2.0`. The `inner` refusals of a rule are those of its needs.
    """

    subject: str
    reasons: tuple[str, ...]
    inner: tuple[Rejection, ...] = ()

    def __str__(self) -> str:
        return f"{self.subject}: {'; '.join(self.reasons)}"
