"""The team of a mission from its deployment or its bundle, without looking at the rest of it."""

from __future__ import annotations

from pathlib import Path

from lfield.lang.deployment import Deployment, read_deployment
from lfield.mission import bundle
from lfield.mission.team import Team, team_of


def make_team(deployment: Deployment) -> Team:
    """The team of a deployment; of one that was read without its program no kinds are known."""
    kinds = {agent.type: agent.kind for agent in deployment.agents}
    ports = {agent.host: agent.port for agent in deployment.agents if agent.port is not None}
    rows = [(agent.type, agent.id, agent.host, agent.arguments) for agent in deployment.agents]
    return team_of(rows, kinds.__getitem__, ports)


def open_team(path: Path) -> Team:
    """The team of a bundle, or of a deployment.

    Raises InputFileError, and BundleError or ProgramError for a file with mistakes.
    """
    if path.suffix == bundle.SUFFIX:
        return bundle.read(path).team
    return make_team(read_deployment(path, None))
