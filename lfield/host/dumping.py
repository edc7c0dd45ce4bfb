"""Where the block of an agent that has died goes: into a file, for `lfield inspect`."""

from __future__ import annotations

from pathlib import Path

from lfield.errors import OutputFileError
from lfield.mission.mission import Mission
from lfield.text.private import write_private
from lfield.vm.agent import Agent
from lfield.vm.inspect import dump


def dump_agent(mission: Mission, host: str, agent: Agent, folder: Path) -> str:
    """Put the block of an agent of this host into a file of a folder; what to tell of it."""
    team, program, limit = mission.team, mission.program, agent.limits.heap
    data = dump.encode(host, agent.report, limit, team.members, team.hosts, program, agent.block)
    path = folder / f"{agent.id}.block"
    try:
        write_private(path, data)
        return f"dumped {agent.id}: lfield inspect {path}"
    except OutputFileError as error:
        return f"cannot dump {agent.id} to {path}: {error}"
