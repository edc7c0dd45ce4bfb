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


class Fact(Struct, frozen=True, gc=False):
    """The value of an attribute; for `age` seconds it may have changed unnoticed (0: it never does)."""

    value: Value
    age: float = 0.0


class Candidate(Struct, frozen=True):
    """An agent of a resource type as this host knows it now.

    `facts` are its own values and its live ones by attribute; those of its type and of the primitive are the
    registry's. `hops` is 0 when it is on this host, else 1. `refusal` says why it cannot be called at all
    (`unreachable for 12 s`), '' when it can. `unknown` tells of single live attributes why there is no value
    (`fc has not reported battery`).
    """

    agent: str
    type: str
    host: str
    hops: int = 0
    refusal: str = ""
    facts: Mapping[str, Fact] = {}
    unknown: Mapping[str, str] = {}


class Team(Protocol):
    """The agents of the mission, as a host's directory or the files alone know them."""

    def candidates(self, resource: str) -> Sequence[Candidate]:
        """The agents of a resource type, in the order of the deployment."""


@dataclass(frozen=True, slots=True)
class Offer:
    """Somebody who can do it. `way` is the field of the primitive's class in L (ways.py).

    A direct offer has no `parts`; an equivalent one has one, named as its way; a composed one has one for
    each need, named by `ways.part`. `agent` and `host` are those of a direct or equivalent offer; of a
    composed one they are those of its parts, joined with '+'. The less `cost`, the better.
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
