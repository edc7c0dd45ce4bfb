"""Who offers what: the answers of this host to its programs, from its directory. A question sends nothing."""

from __future__ import annotations

from lfield.host.answers import Answers
from lfield.host.reporting import Reporting
from lfield.mission.mission import Mission
from lfield.vm.offers import Found, ways


class Offers:
    """The capabilities of a mission's team, as far as its program was built with them."""

    def __init__(self, reporting: Reporting, mission: Mission) -> None:
        numbers = {member.id: member.number for member in mission.team.members}
        self._reporting = reporting
        self._answers = Answers(reporting.registry, reporting.directory, ways(mission.program), numbers)

    def offers(self, capability: str, constraint: str | None) -> list[Found]:
        """Who offers a capability and fulfils the condition, best first. Raises ConstraintError."""
        self._reporting.look()
        return self._answers.offers(capability, constraint)

    def explain(self, capability: str, constraint: str | None) -> str:
        """Why everybody else does not, a line each. Raises ConstraintError."""
        self._reporting.look()
        return self._answers.explain(capability, constraint)
