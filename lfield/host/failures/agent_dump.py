"""Dumps the block of an agent that has died into a file, for `lfield inspect`."""

from __future__ import annotations

from pathlib import Path

from lfield.errors import OutputFileError
from lfield.mission.mission import Mission
from lfield.text import log_messages
from lfield.text.log_messages import LogLine
from lfield.text.secure_files import write_private
from lfield.vm.agent import Agent
from lfield.vm.inspection import dump_file


def write_agent_dump(mission: Mission, host: str, agent: Agent, folder: Path) -> LogLine:
    """Write the block of an agent into a file of a directory; returns the log line about it."""
    team, program, limit = mission.team, mission.program, agent.limits.heap
    data = dump_file.encode(host, agent.report, limit, team.members, team.hosts, program, agent.block)
    path = folder / f"{agent.id}.block"
    try:
        write_private(path, data)
        return log_messages.AGENT_DUMPED.line(agent=agent.id, path=path)
    except OutputFileError as error:
        return log_messages.AGENT_NOT_DUMPED.line(agent=agent.id, path=path, reason=error)
