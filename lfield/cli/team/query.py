"""`lfield query "Lift where payload >= 2.0"`: who of a team can do it, and why the others cannot."""

from __future__ import annotations

import argparse
import asyncio
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from lfield.cli.mission_argument import add_mission, mission_path, where_it_runs

if TYPE_CHECKING:
    from lfield.capability.model import Registry
    from lfield.cli.views.query_view import Known
    from lfield.errors import LfieldError
    from lfield.mission.team import Team


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare its options."""
    parser.add_argument(
        "query", metavar="QUERY", help='a capability, or an id of the taxonomy: "Lift where payload >= 2.0"'
    )
    add_mission(parser)
    parser.add_argument(
        "--capabilities", metavar="FILE", type=Path, help="the mission's registry, if not beside it"
    )
    parser.add_argument("--at", metavar="HOST", default="", help="answer as this host would")
    parser.add_argument("--files", action="store_true", help="from the files alone: ask no host")
    parser.add_argument("--explain", action="store_true", help="also tell why the others are not offered")
    parser.add_argument("--json", action="store_true", help="print the answer as JSON")
    parser.add_argument(
        "--map", metavar="NAME=ADDR:PORT", action="append", default=[], help="where a host is reached"
    )


def run(args: argparse.Namespace) -> int:
    """0 when there are offers, 1 when there are none."""
    from lfield.capability.matching.matcher import Matcher
    from lfield.cli.views import query_view
    from lfield.operator.query import mission_registry
    from lfield.operator.question import read_question
    from lfield.operator.whereabouts import open_team

    path = mission_path(args)
    team = open_team(path)
    registry = mission_registry(path, team, args.capabilities)
    question = read_question(args.query, registry)
    at = team.lookup(args.at) if args.at else ""
    known = _known(args, team, registry, at)
    matcher = Matcher(registry, known.team)
    answers = [
        query_view.Answer(
            primitive,
            matcher.offers(primitive.name, question.constraint),
            matcher.count(primitive.name, question.constraint),
            matcher.explain(primitive.name, question.constraint),
        )
        for primitive in question.primitives
    ]
    for host, why in known.silent:
        print(f"{host}: {why}", file=sys.stderr)
    if args.json:
        print(query_view.as_json(question, known, answers, registry))
    else:
        query_view.show(question, known, answers, registry, explain=args.explain)
    return 0 if any(answer.offers for answer in answers) else 1


def _known(args: argparse.Namespace, team: Team, registry: Registry, at: str) -> Known:
    from lfield.cli.views.query_view import Known
    from lfield.errors import AddressError
    from lfield.operator.query import from_files, from_hosts, views_of

    views, errors = views_of({} if args.files else _ask(args, team))
    # Where nobody listens at all nothing runs, which is no problem; anything else is one.
    nobody = not views and all(isinstance(error, AddressError) for error in errors.values())
    silent = () if nobody else tuple((host, str(error)) for host, error in errors.items())
    if not views:
        return Known(from_files(registry, team.deployed, at), silent=silent)
    return Known(from_hosts(registry, team.deployed, views, errors.keys(), at), tuple(views), silent)


def _ask(args: argparse.Namespace, team: Team) -> dict[str, dict[str, object] | LfieldError]:
    from lfield.net.tcp import TcpTransport
    from lfield.operator.ask import ask_all

    transport = TcpTransport(1 << 20, connect_timeout=2.0)
    return asyncio.run(ask_all(transport, where_it_runs(team, args).reached))
