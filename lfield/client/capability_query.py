"""A capability query to a team: from its running hosts, or from the files of the mission alone."""

from __future__ import annotations

import asyncio
from pathlib import Path

from lfield.capability.condition_tree import MAX_TEAM
from lfield.capability.matching.matcher import Matcher
from lfield.client.query_json import KnownTeam, query_data
from lfield.client.team_connection import HostSnapshots
from lfield.errors import AddressError, UsageError
from lfield.mission.team import Team as MissionTeam
from lfield.operator.client import unanswered
from lfield.operator.query_parser import CapabilityQuery, parse_query
from lfield.operator.team_model.host_model import host_states
from lfield.operator.team_query import (
    PrimitiveAnswer,
    QueryContext,
    directory_views,
    primitive_answer,
    read_context,
    roster_from_files,
    roster_from_hosts,
)


class TeamQueries:
    """Queries to the team of a mission at `path`; its files are read once.

    `capabilities` replaces the registry of the mission. Raises as `read_context`.
    """

    def __init__(self, path: Path, team: MissionTeam, capabilities: Path | None = None) -> None:
        self._team, self._context = team, read_context(path, team, capabilities)

    @property
    def context(self) -> QueryContext:
        """The data of the files of the mission."""
        return self._context

    def parse(self, text: str) -> CapabilityQuery:
        """The query in a text. Raises UsageError, ProgramError."""
        return parse_query(text, self._context.registry)

    def host(self, name: str) -> str:
        """The host with that name, '' for ''. Raises UsageError."""
        return self._team.find_host(name) if name else ""

    def known_team(self, answers: HostSnapshots, at: str = "") -> KnownTeam:
        """The team by the snapshots of its hosts, as a coordinator on the host `at` knows it.

        Raises the error of that host.
        """
        views, errors = directory_views(host_states(answers)), unanswered(answers)
        # No listener anywhere means that the mission is not running, which is not an error.
        is_unreachable = not views and all(isinstance(error, AddressError) for error in errors.values())
        unanswered_hosts = {} if is_unreachable else errors
        context, deployed = self._context, self._team.deployed
        registry, pose = context.registry, context.frames.place(at)
        if not views:
            roster = roster_from_files(registry, deployed, at, context.stated, pose)
            return KnownTeam(roster, unanswered=unanswered_hosts)
        if at in errors:
            raise errors[at]
        roster = roster_from_hosts(registry, deployed, views, errors.keys(), at, pose)
        return KnownTeam(roster, tuple(views), unanswered_hosts)

    def answers(
        self, question: CapabilityQuery, known: KnownTeam, size: int | None = None
    ) -> list[PrimitiveAnswer]:
        """The answers, one for each primitive; with a `size` also teams of so many agents.

        Raises UsageError for a size that no team has.
        """
        if size is not None and not 1 <= size <= MAX_TEAM:
            raise UsageError(f"a team has from 1 to {MAX_TEAM} members, not {size}")
        matcher = Matcher(self._context.registry, known.team, self._context.realisations)
        return [primitive_answer(matcher, primitive, question, size) for primitive in question.primitives]

    async def data(
        self, text: str, answers: HostSnapshots, at: str = "", size: int | None = None
    ) -> dict[str, object]:
        """The answer as JSON data, computed outside the event loop."""

        def work() -> dict[str, object]:
            question, known = self.parse(text), self.known_team(answers, self.host(at))
            found = self.answers(question, known, size)
            return query_data(question, known, found, self._context.registry)

        return await asyncio.to_thread(work)
