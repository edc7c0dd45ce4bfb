"""Findings about the quorum of a mission: members that the deployment and the devices file name together."""

from __future__ import annotations

from lfield.lang.deployment import DeployedAgent, Deployment
from lfield.mission.mission import Mission
from lfield.text.source_text import Diagnostic
from lfield.text.suggestions import listed


def quorum_warnings(deployment: Deployment, mission: Mission) -> list[Diagnostic]:
    """Warnings for quorums of one or two members, which cannot lose any: the majority of two is two."""
    members, team = mission.recovery.members, mission.team
    if len(members) == 1 and any(
        team.members_on(n) for n, host in enumerate(team.hosts) if host not in members
    ):
        failed, why = members[0], "no other host can decide"
    elif len(members) == 2:
        failed, why = f"one of {listed(members)}", "the other one is not a majority"
    else:
        return []
    first = first_fenced(deployment, mission)
    message = f"{first.id} cannot be recovered when {failed} is lost: {why}"
    return [Diagnostic("Y114", message, first.span, _more_members(mission), "warning")]


def _more_members(mission: Mission) -> str:
    """How to add enough members to tolerate the loss of one."""
    witness = "add a witness, a host without agents: //@name"
    if not mission.bindings.recovery.members:
        return witness
    named = "name at least three hosts in 'recovery: {members: [...]}' of the devices file"
    return named if len(mission.team.hosts) > 2 else f"{witness}; and {named}"


def first_fenced(deployment: Deployment, mission: Mission) -> DeployedAgent:
    """The first agent of a deployment that can be recovered."""
    return next(agent for agent in deployment.agents if agent.id in mission.fenced)
