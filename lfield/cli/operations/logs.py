"""`lfield logs`: the log of the programs and hosts of a mission, in order of time."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from typing import TYPE_CHECKING

from lfield.cli.event_session import SessionPlan, run_session
from lfield.cli.mission_argument import add_running_mission

if TYPE_CHECKING:
    from lfield.operator.dashboard.event_feed import FeedNotice
    from lfield.operator.dashboard.timeline.event_timeline import DatedEvent


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add_running_mission(parser)
    parser.add_argument("-f", "--follow", action="store_true", help="follow the log until Ctrl-C")
    parser.add_argument("--json", action="store_true", help="print one JSON object per line")
    parser.add_argument(
        "--host",
        metavar="NAME",
        action="append",
        default=[],
        help="print only the log of this host (repeatable)",
    )


def run(args: argparse.Namespace) -> int:
    """0, or 69 when a host did not answer; with -f 130, after a Ctrl-C."""
    from lfield.cli.views.event_view import LogLineView, log_json, log_text
    from lfield.client.event_json import event_json
    from lfield.operator.dashboard.event_feed import FeedNotice

    view = LogLineView()

    def lines(item: DatedEvent | FeedNotice) -> Iterator[str]:
        if not isinstance(item, FeedNotice):
            for line in view.lines(item):
                yield log_json(item, line) if args.json else log_text(item, line)
        elif args.json and item.lost:
            yield event_json(item)

    return run_session(args, lines, SessionPlan(since=0, follow=args.follow, only=args.host))
