"""Who can do it now, best first, and why the others cannot."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from itertools import islice

from lfield.capability.matching.explain import Explanation
from lfield.capability.matching.rules import Rules
from lfield.capability.matching.search import Limits, Search
from lfield.capability.model import Expression, Registry
from lfield.capability.offer import Offer, Refusal, Team


class Matcher:
    """Answers queries from what one host knows; nothing is sent.

    `ways` restricts the answers to the fields that a program was compiled with, by primitive (ways.py).
    Candidates that are the same objects as in the last query are not looked at again.
    """

    def __init__(
        self,
        registry: Registry,
        team: Team,
        ways: Mapping[str, Collection[str]] | None = None,
        limits: Limits | None = None,
    ) -> None:
        self._limits = limits or Limits()
        #: So many offers are given.
        self.most = self._limits.offers
        self._team = team
        self._rules = Rules(registry, team.candidates, ways, self._limits.depth)

    def offers(self, primitive: str, constraint: Expression | None = None) -> list[Offer]:
        """The best who serve the primitive and fulfil the constraint, the cheapest first, at most `most`.

        Ties go to the way with fewer rules, then by the names of rules, then by the order of the deployment.
        Of each composition there are the best `limits.per_rule`.
        """
        return [plan.offer for plan in islice(self._search(primitive, constraint).plans(), self.most)]

    def count(self, primitive: str, constraint: Expression | None = None) -> int:
        """How many there are of whom `offers` gives the best."""
        return sum(1 for _ in self._search(primitive, constraint).plans())

    def explain(self, primitive: str, constraint: Expression | None = None) -> list[Refusal]:
        """Everyone who could serve the primitive and is not offered: each agent of each way, each rule."""
        return Explanation(self._search(primitive, constraint)).refusals()

    def _search(self, primitive: str, constraint: Expression | None) -> Search:
        return Search(self._rules, self._team, self._limits, primitive, constraint)
