"""`lfield events`: the events of the hosts of a mission, each with its cause, until a Ctrl-C."""

from __future__ import annotations

import argparse
import sys
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import TYPE_CHECKING

from lfield import exit_status
from lfield.cli.mission_argument import add_running_mission, named_mission, selected_runs, selected_teams
from lfield.errors import UsageError
from lfield.text.suggestions import did_you_mean, listed

if TYPE_CHECKING:
    from lfield.operator.dashboard.event_feed import FeedNotice
    from lfield.operator.dashboard.timeline.event_timeline import DatedEvent
    from lfield.operator.targets import HostRef, TargetTeam
    from lfield.wire.events import EventsDropped

#: Rate of telemetry events in Hz: default and maximum.
RATE, MAX_RATE = 1.0, 20.0
#: The most hosts of another user's runs.
MAX_FOREIGN_HOSTS = 32


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare its options."""
    add_running_mission(parser)
    form = parser.add_mutually_exclusive_group()
    form.add_argument("--json", action="store_true", help="print one JSON object per line")
    form.add_argument("--csv", action="store_true", help="print telemetry and hops as CSV")
    parser.add_argument(
        "--since",
        metavar="N",
        type=_number,
        help="print the events after number N of each host; 0: all stored events (default: only new ones)",
    )
    parser.add_argument(
        "--no-follow", action="store_true", help="exit after the stored events (implies --since 0)"
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
    """Without --no-follow 130, after a Ctrl-C; else 0, or 69 when a host did not answer."""
    from lfield.cli.views import event_view
    from lfield.operator.dashboard.event_feed import FeedNotice
    from lfield.wire.events import KINDS, TELEMETRY, EventsDropped

    kinds = _kinds(args.kinds, event_view.CSV_KINDS if args.csv else tuple(KINDS))
    if not (args.kinds or args.csv or args.json):
        # Telemetry is printed only on request.
        kinds -= TELEMETRY
    table = event_view.EventCsv()

    def lines(item: DatedEvent | FeedNotice) -> Iterator[str]:
        if isinstance(item, FeedNotice):
            if args.json and item.lost:
                yield event_view.event_json(item)
        elif isinstance(item.event.what, EventsDropped) and "skipped" not in kinds:
            _print_skipped(item.host, item.event.what, kinds)
        elif item.event.kind not in kinds:
            return
        elif args.csv:
            yield from table.rows(item)
        else:
            yield event_view.event_json(item) if args.json else event_view.event_line(item)

    if args.csv:
        print(table.header(), flush=True)
    since = 0 if args.since is None and args.no_follow else args.since
    rate = args.rate if TELEMETRY & kinds and not args.no_follow else 0.0
    return print_events(args, lines, since=since, telemetry=rate, follow=not args.no_follow, only=args.host)


#: The end event that is missing too when its begin event was skipped.
_END_EVENTS = {"left": "hopped", "began": "ended", "asked": "answered"}


def _print_skipped(host: str, what: EventsDropped, kinds: frozenset[str]) -> None:
    """Print gaps of the requested events, which are events of another kind."""
    from lfield.operator.team_model.log_buffer import lost_events_text

    if kinds & {what.skipped, _END_EVENTS.get(what.skipped, "")}:
        _print_notice(host, lost_events_text(f"events of kind '{what.skipped}'", what.count))


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


# --- for `logs` too -----------------------------------------------------------------------------------------


def print_events(
    args: argparse.Namespace,
    lines: Callable[[DatedEvent | FeedNotice], Iterable[str]],
    *,
    since: int | None,
    telemetry: float = 0.0,
    follow: bool,
    only: Sequence[str] = (),
) -> int:
    """Print the lines of events to stdout; losses and unreachable hosts go to stderr."""
    import asyncio

    from lfield.operator.targets import display_names

    parties = selected_teams(args, selected_runs(args))
    names = _limit_foreign(_select_hosts(display_names(parties), only))
    if follow and named_mission(args) is None and not any(party.runs for party in parties):
        # No mission has to run there, so nothing else may be printed.
        print("lfield: following the hosts of the inventory; Ctrl-C ends this", file=sys.stderr, flush=True)

    def current_teams() -> list[TargetTeam]:
        return selected_teams(args, selected_runs(args))

    async def print_events() -> int:
        from lfield.operator.dashboard.event_feed import open_feed

        async with open_feed(
            parties, names, current_teams, args.keys, since=since, telemetry=telemetry
        ) as team:
            try:
                async for item in team.events(follow=follow):
                    _print_item(item, lines)
            except asyncio.CancelledError:
                # After a Ctrl-C: print the newest events without waiting for their causes.
                for item in team.remaining():
                    _print_item(item, lines)
                raise
            return exit_status.UNAVAILABLE if team.unreached else exit_status.DONE

    return asyncio.run(print_events())


def _select_hosts(names: dict[HostRef, str], only: Sequence[str]) -> dict[HostRef, str]:
    """The selected hosts. Raises UsageError for an unknown one."""
    hosts = {place.host for place in names} | set(names.values())
    for name in only:
        if name not in hosts:
            hint = did_you_mean(name, sorted(hosts))
            raise UsageError(
                f"no host '{name}'; the hosts are {listed(sorted(hosts))}{f'; {hint}' if hint else ''}"
            )
    return {place: name for place, name in names.items() if not only or {place.host, name} & set(only)}


def _limit_foreign(names: dict[HostRef, str]) -> dict[HostRef, str]:
    """Limits the hosts of each other user; prints to stderr how many are left out."""
    found: dict[str, list[HostRef]] = defaultdict(list)
    for place in names:
        found[place.user].append(place)
    for user, places in found.items():
        if user and len(places) > MAX_FOREIGN_HOSTS:
            left = len(places) - MAX_FOREIGN_HOSTS
            print(f"lfield: {left} hosts of user {user} are left out: name a run with --run", file=sys.stderr)
            for place in places[MAX_FOREIGN_HOSTS:]:
                del names[place]
    return names


def _print_item(
    item: DatedEvent | FeedNotice, lines: Callable[[DatedEvent | FeedNotice], Iterable[str]]
) -> None:
    from lfield.operator.dashboard.event_feed import FeedNotice

    if isinstance(item, FeedNotice):
        _print_notice(item.host, item.text)
    for line in lines(item):
        print(line, flush=True)


def _print_notice(host: str, text: str) -> None:
    from lfield.text.terminal_escape import escape_line

    print(f"{host}: {escape_line(text)}", file=sys.stderr, flush=True)
