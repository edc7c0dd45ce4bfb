"""`lfield query "Lift where payload >= 2.0"`: who of a team can do it, and why the others cannot."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from lfield.cli.mission_argument import add_running_mission, meant_party, meant_runs, named_mission

#: The largest team that can be asked for.
MAX_TEAM = 1000

if TYPE_CHECKING:
    from lfield.capability.matching.matcher import Matcher
    from lfield.capability.model import Primitive
    from lfield.cli.views.query_view import Answer, Known
    from lfield.mission.team import Team
    from lfield.operator.query import Asked
    from lfield.operator.question import Question


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare its options."""
    parser.add_argument(
        "query",
        metavar="QUERY",
        help='capability or taxonomy id, with a condition: "Lift where payload >= 2.0"',
    )
    add_running_mission(parser)
    parser.add_argument(
        "--capabilities",
        metavar="FILE",
        type=Path,
        help="registry of the mission (default: MISSION.capabilities.yaml)",
    )
    parser.add_argument("--at", metavar="HOST", default="", help="answer from the point of view of this host")
    parser.add_argument("--files", action="store_true", help="use the files only; do not connect to hosts")
    parser.add_argument(
        "--explain",
        action="store_true",
        help="also print the terms of each score, and why other agents do not match",
    )
    parser.add_argument(
        "--team", metavar="N", type=_size, help="also print the best teams of N distinct agents"
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
    from lfield.operator.addressed import only_mission, open_team
    from lfield.operator.ask import tell_silent
    from lfield.operator.query import read_asked
    from lfield.operator.question import read_question

    path = named_mission(args) or only_mission(meant_runs(args))
    team = open_team(path)
    asked = read_asked(path, team, args.capabilities)
    registry = asked.registry
    question = read_question(args.query, registry)
    at = team.lookup(args.at) if args.at else ""
    known = _known(args, team, asked, at)
    matcher = Matcher(registry, known.team, asked.ways)
    answers = [_answer(matcher, primitive, question, args.team) for primitive in question.primitives]
    tell_silent(known.silent)
    if args.json:
        print(query_view.as_json(question, known, answers, registry))
    else:
        query_view.show(question, known, answers, registry, explain=args.explain)
    return 0 if any(answer.offers if args.team is None else answer.teams for answer in answers) else 1


def _answer(matcher: Matcher, primitive: Primitive, question: Question, size: int | None) -> Answer:
    from lfield.cli.views.query_view import Answer

    found = matcher.find(primitive.name, question.wish)
    refusals = matcher.explain(primitive.name, question.constraint)
    if size is None:
        return Answer(primitive, found.offers, found.count, refusals, found.notes, is_cut=bool(found.cut))
    formed = matcher.teams(primitive.name, size, question.wish)
    notes = list(dict.fromkeys([*found.notes, *formed.notes]))
    return Answer(
        primitive, found.offers, found.count, refusals, notes, formed.teams, formed.agents, bool(found.cut)
    )


def _known(args: argparse.Namespace, team: Team, asked: Asked, at: str) -> Known:
    from lfield.cli.views.query_view import Known
    from lfield.errors import AddressError
    from lfield.operator.ask import ask_parties, by_host, patiently, silent
    from lfield.operator.query import from_files, from_hosts, views_of

    party = None if args.files else meant_party(args)
    answers = by_host(ask_parties([party], patiently(), args.keys), party) if party else {}
    views, errors = views_of(answers), silent(answers)
    # Where nobody listens at all nothing runs, which is no problem; anything else is one.
    nobody = not views and all(isinstance(error, AddressError) for error in errors.values())
    told = {} if nobody else errors
    registry, pose = asked.registry, asked.frames.place(at)
    if not views:
        return Known(from_files(registry, team.deployed, at, asked.stated, pose), silent=told)
    if at in errors:
        raise errors[at]
    roster = from_hosts(registry, team.deployed, views, errors.keys(), at, pose)
    return Known(roster, tuple(views), told)
