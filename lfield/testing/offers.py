"""A team for golden programs that ask for capabilities: everybody is as the registry says."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from lfield.bytecode.program import Program
from lfield.capability.model import Registry, Value
from lfield.capability.offer import Candidate, Fact, Place
from lfield.host.offers import Answers
from lfield.vm.agent import Member
from lfield.vm.offers import ways


@dataclass(frozen=True)
class StillTeam:
    """A team of which nothing ever changes: everybody can be called. Hosts are shown by their numbers."""

    members: Sequence[Member]
    agents: Mapping[str, Mapping[str, Value]]

    def candidates(self, resource: str) -> Sequence[Candidate]:
        """The agents of a resource type, in the order of the deployment."""
        return [self._candidate(m) for m in self.members if m.type == resource]

    def here(self) -> Place | None:
        """Nobody is anywhere."""
        return None

    def _candidate(self, member: Member) -> Candidate:
        facts = {name: Fact(value) for name, value in self.agents.get(member.id, {}).items()}
        return Candidate(member.id, member.type, str(member.host), facts=facts, number=member.number)


def still_answers(registry: Registry, program: Program, members: Sequence[Member]) -> Answers:
    """What a host of a still team answers to a program."""
    numbers = {member.id: member.number for member in members}
    return Answers(registry, StillTeam(members, registry.agents), ways(program), numbers)
