"""`lfield query "Lift where payload >= 2.0"`: the agents that provide a capability, and the reasons
against others.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from lfield.capability.condition_tree import MAX_TEAM
from lfield.cli.mission_argument import add_running_mission, named_mission, selected_runs, selected_team
from lfield.errors import UsageError
from lfield.text.number_arguments import whole_between


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
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
        "--team",
        metavar="N",
        type=whole_between(1, MAX_TEAM, "agents"),
        help="also print the best teams of N different agents",
    )
    parser.add_argument("--json", action="store_true", help="print the answer as JSON")


def run(args: argparse.Namespace) -> int:
    """Returns 0 when there are offers, 1 when there are none."""
    from lfield.cli.views import query_view
    from lfield.client.capability_query import TeamQueries
    from lfield.client.query_json import query_data
    from lfield.operator.client import PATIENT_SNAPSHOT, ask_teams, by_host, print_unanswered
    from lfield.operator.targets import open_team, running_mission

    if args.query.endswith((".dL", ".lfm")):
        example = f'lfield query "Lift where payload >= 2.0" {args.query}'
        raise UsageError(f"no capability is named before {args.query}: {example}")
    path = named_mission(args) or running_mission(selected_runs(args))
    queries = TeamQueries(path, open_team(path), args.capabilities)
    registry = queries.context.registry
    question = queries.parse(args.query)
    at = queries.host(args.at)
    target = None if args.files else selected_team(args)
    snapshots = by_host(ask_teams([target], PATIENT_SNAPSHOT, args.keys), target) if target else {}
    known = queries.known_team(snapshots, at)
    answers = queries.answers(question, known, args.team)
    print_unanswered(known.unanswered)
    if args.json:
        print(json.dumps(query_data(question, known, answers, registry), indent=2))
    else:
        query_view.show(question, known, answers, registry, explain=args.explain)
    return 0 if any(answer.offers if args.team is None else answer.teams for answer in answers) else 1
