"""Findings about the recovery of a mission: quorum and lease, by its deployment and devices file together."""

from __future__ import annotations

from lfield.errors import BindingError
from lfield.lang.deployment import DeployedAgent, Deployment
from lfield.mission.mission import Mission
from lfield.text.source_text import Diagnostic
from lfield.text.suggestions import listed


def check_recovery(mission: Mission, deployment: Deployment | None = None) -> Mission:
    """The mission, after a check of its recovery members and that silence is within the lease.

    Raises BindingError, rendered at the first fenced coordinator where the deployment is available.
    """
    try:
        if mission.recovery.members:
            mission.bindings.check_lease_bounds()
    except BindingError as error:
        if deployment is None:
            raise
        drawn = Diagnostic("Y115", str(error), _first_fenced(deployment, mission).span)
        raise BindingError([drawn.render()], [drawn]) from None
    return mission


def quorum_warnings(deployment: Deployment, mission: Mission) -> list[Diagnostic]:
    """Warnings for quorums of one or two members, which cannot lose any: the majority of two is two."""
    members, team = mission.recovery.members, mission.team
    if len(members) == 1 and any(
        team.members_on(n) for n, host in enumerate(team.hosts) if host not in members
    ):
        failed, reason = members[0], "no other host can decide"
    elif len(members) == 2:
        failed, reason = f"one of {listed(members)}", "the other one is not a majority"
    else:
        return []
    first = _first_fenced(deployment, mission)
    message = f"{first.id} cannot be recovered when {failed} is lost: {reason}"
    return [Diagnostic("Y114", message, first.span, _more_members(mission), "warning")]


def _more_members(mission: Mission) -> str:
    """The advice for enough members to tolerate the loss of one."""
    witness = "add a witness, a host without agents: //@name"
    if not mission.bindings.recovery.members:
        return witness
    named = "name at least three hosts in 'recovery: {members: [...]}' of the devices file"
    return named if len(mission.team.hosts) > 2 else f"{witness}; and {named}"


def _first_fenced(deployment: Deployment, mission: Mission) -> DeployedAgent:
    return next(agent for agent in deployment.agents if agent.id in mission.fenced)
