"""`lfield query "Lift where payload >= 2.0"`: the agents that provide a capability, and why others do not."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from lfield.cli.mission_argument import add_running_mission, named_mission, selected_runs, selected_team

#: The largest team that can be requested.
MAX_TEAM = 1000

if TYPE_CHECKING:
    from lfield.capability.matching.matcher import Matcher
    from lfield.capability.model import Primitive
    from lfield.cli.views.query_view import KnownTeam, PrimitiveAnswer
    from lfield.mission.team import Team
    from lfield.operator.query_parser import CapabilityQuery
    from lfield.operator.team_query import QueryContext


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare its options."""
    parser.add_argument(
        "query",
        metavar="QUERY",
        help='capability or taxonomy id, with or without a condition: "Lift where payload >= 2.0"',
    )
    add_running_mission(parser)
    parser.add_argument(
        "--capabilities",
        metavar="FILE",
        type=Path,
        help="registry of the mission (default: MISSION.capabilities.yaml)",
    )
    parser.add_argument(
        "--at", metavar="HOST", default="", help="rank the agents as a coordinator on this host would"
    )
    parser.add_argument(
        "--files", action="store_true", help="answer from the files only; do not connect to hosts"
    )
    parser.add_argument(
        "--explain",
        action="store_true",
        help="also print how each score is computed, and why other agents do not match",
    )
    parser.add_argument(
        "--team", metavar="N", type=_size, help="also print the best teams of N different agents"
    )
    parser.add_argument("--json", action="store_true", help="print the answer as JSON")


def _size(text: str) -> int:
    """The number of members of a team."""
    if not text.isdecimal() or not 1 <= int(text[:9]) <= MAX_TEAM:
        raise argparse.ArgumentTypeError(f"a team has from 1 to {MAX_TEAM} members, not '{text}'")
    return int(text)


def run(args: argparse.Namespace) -> int:
    """0 when there are offers, 1 when there are none."""
    from lfield.capability.matching.matcher import Matcher
    from lfield.cli.views import query_view
    from lfield.operator.client import print_unanswered
    from lfield.operator.query_parser import parse_query
    from lfield.operator.targets import open_team, running_mission
    from lfield.operator.team_query import read_context

    path = named_mission(args) or running_mission(selected_runs(args))
    team = open_team(path)
    asked = read_context(path, team, args.capabilities)
    registry = asked.registry
    question = parse_query(args.query, registry)
    at = team.find_host(args.at) if args.at else ""
    known = _known(args, team, asked, at)
    matcher = Matcher(registry, known.team, asked.ways)
    answers = [_answer(matcher, primitive, question, args.team) for primitive in question.primitives]
    print_unanswered(known.unanswered)
    if args.json:
        print(query_view.as_json(question, known, answers, registry))
    else:
        query_view.show(question, known, answers, registry, explain=args.explain)
    return 0 if any(answer.offers if args.team is None else answer.teams for answer in answers) else 1


def _answer(
    matcher: Matcher, primitive: Primitive, question: CapabilityQuery, size: int | None
) -> PrimitiveAnswer:
    from lfield.cli.views.query_view import PrimitiveAnswer

    found = matcher.find(primitive.name, question.offer_query)
    refusals = matcher.explain(primitive.name, question.constraint)
    if size is None:
        return PrimitiveAnswer(
            primitive, found.offers, found.count, refusals, found.notes, is_truncated=bool(found.cut)
        )
    formed = matcher.teams(primitive.name, size, question.offer_query)
    notes = list(dict.fromkeys([*found.notes, *formed.notes]))
    return PrimitiveAnswer(
        primitive, found.offers, found.count, refusals, notes, formed.teams, formed.agents, bool(found.cut)
    )


def _known(args: argparse.Namespace, team: Team, asked: QueryContext, at: str) -> KnownTeam:
    from lfield.cli.views.query_view import KnownTeam
    from lfield.errors import AddressError
    from lfield.operator.client import PATIENT_SNAPSHOT, ask_teams, by_host, unanswered
    from lfield.operator.team_model.host_model import host_states
    from lfield.operator.team_query import directory_views, roster_from_files, roster_from_hosts

    party = None if args.files else selected_team(args)
    answers = by_host(ask_teams([party], PATIENT_SNAPSHOT, args.keys), party) if party else {}
    views, errors = directory_views(host_states(answers)), unanswered(answers)
    # No listener anywhere means that the mission is not running, which is not an error.
    is_unreachable = not views and all(isinstance(error, AddressError) for error in errors.values())
    unanswered_hosts = {} if is_unreachable else errors
    registry, pose = asked.registry, asked.frames.place(at)
    if not views:
        return KnownTeam(
            roster_from_files(registry, team.deployed, at, asked.stated, pose), unanswered=unanswered_hosts
        )
    if at in errors:
        raise errors[at]
    roster = roster_from_hosts(registry, team.deployed, views, errors.keys(), at, pose)
    return KnownTeam(roster, tuple(views), unanswered_hosts)
