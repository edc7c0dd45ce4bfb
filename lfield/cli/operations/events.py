"""`lfield events`: the events of the hosts of a mission, each with its cause, printed or recorded."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from lfield.cli.event_session import LOST_AFTER, SessionPlan, print_notice, run_session
from lfield.cli.mission_argument import add_running_mission
from lfield.errors import UsageError
from lfield.text.number_arguments import real_above_0
from lfield.text.suggestions import did_you_mean, listed

if TYPE_CHECKING:
    from lfield.operator.dashboard.event_feed import FeedNotice
    from lfield.operator.dashboard.timeline.event_timeline import DatedEvent
    from lfield.wire.events import EventsDropped

#: Rate of telemetry events in Hz: default and maximum.
RATE, MAX_RATE = 1.0, 20.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add_running_mission(parser)
    form = parser.add_mutually_exclusive_group()
    form.add_argument("--json", action="store_true", help="print one JSON object per line")
    form.add_argument("--csv", action="store_true", help="print telemetry and hops as CSV")
    parser.add_argument(
        "--mcap",
        metavar="FILE",
        type=Path,
        help="record to a new MCAP file, for Foxglove and other viewers; prints only with --json or --csv",
    )
    parser.add_argument(
        "--since",
        metavar="N",
        type=_number,
        help="print the events after number N of each host; 0: all stored events (default: only new ones)",
    )
    end = parser.add_mutually_exclusive_group()
    end.add_argument(
        "--no-follow", action="store_true", help="exit after the stored events (implies --since 0)"
    )
    end.add_argument(
        "--until-done",
        action="store_true",
        help="exit when every coordinator has ended, with the status of the mission",
    )
    parser.add_argument(
        "--lost-after",
        metavar="SECONDS",
        type=real_above_0(1e6, "seconds"),
        default=LOST_AFTER,
        help="with --until-done: exit with status 4 when a host has been unreachable for this long, "
        f"and with 69 when no host has answered (default: {LOST_AFTER:g})",
    )
    parser.add_argument("--kinds", metavar="KIND,...", default="", help="print only events of these kinds")
    parser.add_argument(
        "--host",
        metavar="NAME",
        action="append",
        default=[],
        help="print only events of this host (repeatable)",
    )
    parser.add_argument(
        "--rate",
        metavar="HZ",
        type=_rate,
        default=RATE,
        help=f"rate of telemetry events, at most {MAX_RATE:g}; 0: no telemetry (default: {RATE:g})",
    )


def _number(text: str) -> int:
    if not text.isdecimal() or len(text) > 18:
        raise argparse.ArgumentTypeError(f"'{text}' is not an event number: they count from 1")
    return int(text)


def _rate(text: str) -> float:
    try:
        rate = float(text)
    except ValueError:
        rate = -1.0
    if not 0.0 <= rate <= MAX_RATE:
        raise argparse.ArgumentTypeError(f"the rate must be from 0 to {MAX_RATE:g} Hz")
    return rate


def run(args: argparse.Namespace) -> int:
    """Returns the status of the mission with --until-done; 130 after a Ctrl-C; else 0, or 69 when a host
    did not answer.
    """
    from lfield.cli.views import event_view
    from lfield.client.event_json import event_json
    from lfield.operator.dashboard.event_feed import FeedNotice
    from lfield.wire.events import KINDS, TELEMETRY, EventsDropped

    kinds = _kinds(args.kinds, event_view.CSV_KINDS if args.csv else tuple(KINDS))
    prints = args.json or args.csv or args.mcap is None
    if not (args.kinds or args.csv or args.json or args.mcap):
        # Telemetry is printed only on request.
        kinds -= TELEMETRY
    table = event_view.EventCsv()

    def lines(item: DatedEvent | FeedNotice) -> Iterator[str]:
        if not prints:
            return
        if isinstance(item, FeedNotice):
            if args.json and item.lost:
                yield event_json(item)
        elif isinstance(item.event.what, EventsDropped) and "skipped" not in kinds:
            _print_skipped(item.host, item.event.what, kinds)
        elif item.event.kind not in kinds:
            return
        elif args.csv:
            yield from table.rows(item)
        else:
            yield event_json(item) if args.json else event_view.event_line(item)

    if args.csv:
        print(table.header(), flush=True)
    plan = SessionPlan(
        since=0 if args.since is None and args.no_follow else args.since,
        telemetry=args.rate if TELEMETRY & kinds and not args.no_follow else 0.0,
        follow=not args.no_follow,
        only=args.host,
        mcap=args.mcap,
        kinds=kinds,
        until_done=args.until_done,
        lost_after=args.lost_after,
    )
    return run_session(args, lines, plan)


#: The end event that is also missing when its begin event was skipped.
_END_EVENTS = {"left": "hopped", "began": "ended", "asked": "answered"}


def _print_skipped(host: str, event: EventsDropped, kinds: frozenset[str]) -> None:
    """Print gaps of the requested events, which are events of another kind."""
    from lfield.operator.team_model.log_buffer import lost_events_text

    if kinds & {event.skipped, _END_EVENTS.get(event.skipped, "")}:
        print_notice(host, lost_events_text(f"events of kind '{event.skipped}'", event.count))


def _kinds(text: str, known: Sequence[str]) -> frozenset[str]:
    """The requested kinds, or all. Raises UsageError."""
    named = [kind for kind in text.split(",") if kind]
    for kind in named:
        if kind not in known:
            hint = did_you_mean(kind, known)
            raise UsageError(
                f"unknown kind of events '{kind}'; the kinds are {listed(known)}{f'; {hint}' if hint else ''}"
            )
    return frozenset(named or known)
