"""`lfield logs`: what the programs and hosts of a mission have said, in one order."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from typing import TYPE_CHECKING

from lfield.cli.mission_argument import add_running_mission
from lfield.cli.team.events import listen

if TYPE_CHECKING:
    from lfield.operator.sight.listening import Notice
    from lfield.operator.sight.timeline.timeline import Dated


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare its options."""
    add_running_mission(parser)
    parser.add_argument("-f", "--follow", action="store_true", help="follow the log until Ctrl-C")
    parser.add_argument("--host", metavar="NAME", action="append", default=[], help="only this host")


def run(args: argparse.Namespace) -> int:
    """0, and 69 when a host was not heard; with -f 130, after a Ctrl-C."""
    from lfield.cli.views.event_view import LogView
    from lfield.operator.sight.listening import Notice

    view = LogView()

    def lines(told: Dated | Notice) -> Iterator[str]:
        if not isinstance(told, Notice):
            yield from view.lines(told)

    return listen(args, lines, since=0, follow=args.follow, only=args.host)
