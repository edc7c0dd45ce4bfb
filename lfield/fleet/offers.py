"""Who offers what: the answers of this host to its programs, from its directory. A question sends nothing."""

from __future__ import annotations

from functools import lru_cache, partial

from lfield.capability.explain import render
from lfield.capability.expression import Expression, compile_constraint
from lfield.capability.matching import Matcher
from lfield.fleet.deploy import Mission
from lfield.fleet.found import found
from lfield.fleet.reporting import Reporting
from lfield.vm.offers import Found, ways

#: How many conditions are kept compiled.
MOST_CONSTRAINTS = 256


class Offers:
    """The capabilities of a mission's team, as far as its program was built with them."""

    def __init__(self, reporting: Reporting, mission: Mission) -> None:
        registry = reporting.registry
        self._reporting = reporting
        self._matcher = Matcher(registry, reporting.directory, ways(mission.program))
        self._numbers = {member.id: member.number for member in mission.team.members}
        compiled = partial(compile_constraint, attributes=registry.attributes)
        self._compiled = lru_cache(MOST_CONSTRAINTS)(compiled)

    def offers(self, capability: str, constraint: str | None) -> list[Found]:
        """Who offers a capability and fulfils the condition, best first. Raises ConstraintError."""
        wanted = self._wanted(constraint)
        self._reporting.look()
        return [found(offer, self._numbers) for offer in self._matcher.offers(capability, wanted)]

    def explain(self, capability: str, constraint: str | None) -> str:
        """Why everybody else does not, a line each. Raises ConstraintError."""
        wanted = self._wanted(constraint)
        self._reporting.look()
        return render(self._matcher.explain(capability, wanted))

    def _wanted(self, constraint: str | None) -> Expression | None:
        return None if constraint is None else self._compiled(constraint)
