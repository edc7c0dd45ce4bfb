"""What matching takes and gives: candidates with their facts, offers, and refusals with their reasons.

Candidates and facts are structs: in a lively team thousands of them are made for one question.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal, Protocol

from msgspec import Struct

from lfield.capability.model import Value

Kind = Literal["direct", "equivalent", "composed"]

#: Where a value is from, the surest last: a usual one of its type, said by somebody for the mission or for
#: the type, told by the device of itself, or measured by it lately.
Provenance = Literal["nominal", "stated", "told", "measured"]


class Fact(Struct, frozen=True, gc=False):
    """The value of an attribute, and where it is `of`.

    One that was measured may have changed unnoticed for `age` seconds; any other stands.
    """

    value: Value
    age: float = 0.0
    of: Provenance = "stated"

    @property
    def source(self) -> str:
        """Where it is from, in words: `nominal`, `stated`, `told by the device`, `measured 0.4 s ago`."""
        match self.of:
            case "told":
                return "told by the device"
            case "measured":
                return f"measured {self.age:.{0 if self.age >= 10 else 1}f} s ago"
            case said:
                return said


#: Where something is: north, east and, where that is known, down, in metres, in the frame of the team.
Place = tuple[float, float, float | None]


class Candidate(Struct, frozen=True, gc=False):
    """An agent of a resource type as this host knows it now.

    `facts` are what its host has told, by attribute, and `stated` what the mission says of it, which counts
    before; what its type and the primitive say is the registry's. `hops` is 0 when it is on this host, else
    1. `refusal` says why it cannot be called at all (`unreachable for 12 s`), '' when it can. `unknown` tells
    of single live attributes why there is no value (`fc has not reported battery`). `number` is its place in
    the deployment. `barred` says by primitive why whoever asks may not call it for that.
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
    barred: Mapping[str, str] = {}

    def fact(self, name: str) -> Fact | None:
        """What is known of an attribute, whatever its type says."""
        return self.stated.get(name) or self.facts.get(name)


class Team(Protocol):
    """The agents of the mission, as a host's directory or the files alone know them."""

    def candidates(self, resource: str) -> Sequence[Candidate]:
        """The agents of a resource type, in the order of the deployment."""

    def here(self) -> Place | None:
        """Where the question is asked, None when nobody knows."""


@dataclass(frozen=True, slots=True)
class Term:
    """A term of a cost (matching/ranking.py): the weight called `name`, times an amount."""

    name: str
    amount: float
    weight: float


@dataclass(frozen=True, slots=True)
class Penalty:
    """What an attribute adds to the fitness of an agent: `share * penalty`. None: its value is not known."""

    attribute: str
    value: Value | None
    share: float
    penalty: float


@dataclass(frozen=True, slots=True)
class Offer:
    """Somebody who can do it. `way` is the field of the primitive's class in L (ways.py).

    A direct offer has no `parts`; an equivalent one has one, named as its way; a composed one has one for
    each need, named by `ways.part`. `agent` and `host` are those of a direct or equivalent offer; of a
    composed one they are those of its parts, joined with '+'. The less `cost`, the better: it is the sum of
    its `terms` and of the costs of its parts. `penalties` make up the fitness of a direct one.
    """

    primitive: str
    kind: Kind
    way: str
    agent: str
    host: str
    cost: float
    facts: Mapping[str, Fact] = field(default_factory=dict)
    parts: Mapping[str, Offer] = field(default_factory=dict)
    rule: str = ""
    terms: tuple[Term, ...] = ()
    penalties: tuple[Penalty, ...] = ()

    @property
    def score(self) -> float:
        """From 0 (never) to 1 (nothing could be better)."""
        return 1.0 / (1.0 + self.cost)


@dataclass(frozen=True, slots=True)
class Refusal:
    """A candidate that is not offered: an agent, or a rule, with every reason why.

    `str()` is a line: `arm2: payload 1.2 < 2.0`. The `inner` refusals of a rule are those of its needs.
    """

    subject: str
    reasons: tuple[str, ...]
    inner: tuple[Refusal, ...] = ()

    def __str__(self) -> str:
        return f"{self.subject}: {'; '.join(self.reasons)}"
