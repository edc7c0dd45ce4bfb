"""A constant team for golden programs with capability queries: all attributes are as in the registry."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from lfield.bytecode.program import Program
from lfield.capability.model import Registry, Value
from lfield.capability.offer import Candidate, Fact, Position
from lfield.host.offer_queries import MatchResults
from lfield.vm.agent import TeamMember
from lfield.vm.offer_objects import realisations


@dataclass(frozen=True)
class StillTeam:
    """A team that never changes: every agent can be called. Hosts are shown by their numbers."""

    members: Sequence[TeamMember]
    agents: Mapping[str, Mapping[str, Value]]

    def candidates(self, resource: str) -> Sequence[Candidate]:
        """The agents of a resource type, in the order of the deployment."""
        return [self._candidate(m) for m in self.members if m.type == resource]

    def location(self) -> Position | None:
        """None: no agent has a position."""
        return None

    def _candidate(self, member: TeamMember) -> Candidate:
        facts = {name: Fact(value) for name, value in self.agents.get(member.id, {}).items()}
        return Candidate(member.id, member.type, str(member.host), facts=facts, number=member.number)


def still_answers(registry: Registry, program: Program, members: Sequence[TeamMember]) -> MatchResults:
    """The match results of a host in a constant team."""
    numbers = {member.id: member.number for member in members}
    return MatchResults(registry, StillTeam(members, registry.agents), realisations(program), numbers)
