"""`lfield events`: what happens on the hosts of a mission, each with what led to it, until a Ctrl-C."""

from __future__ import annotations

import argparse
import sys
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import TYPE_CHECKING

from lfield import exits
from lfield.cli.mission_argument import add_running_mission, meant_parties, meant_runs
from lfield.errors import UsageError
from lfield.text.suggest import did_you_mean, listed

if TYPE_CHECKING:
    from lfield.operator.addressed import Party, Place
    from lfield.operator.sight.listening import Notice
    from lfield.operator.sight.timeline.timeline import Dated
    from lfield.wire.events import Skipped

#: How often a second telemetry is told, unless it is chosen, and at most.
RATE, MAX_RATE = 1.0, 20.0
#: The most hosts that are heard because another user says that there are such.
MOST_OF_OTHERS = 32


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
        help="start after event N of each host; 0: with the oldest stored event",
    )
    parser.add_argument(
        "--no-follow", action="store_true", help="exit after the stored events (implies --since 0)"
    )
    parser.add_argument("--kinds", metavar="KIND,...", default="", help="only events of these kinds")
    parser.add_argument("--host", metavar="NAME", action="append", default=[], help="only this host")
    parser.add_argument(
        "--rate",
        metavar="HZ",
        type=_rate,
        default=RATE,
        help=f"rate of telemetry events, at most {MAX_RATE:g}; 0: none (default: {RATE:g})",
    )


def _number(text: str) -> int:
    if not text.isdecimal() or len(text) > 18:
        raise argparse.ArgumentTypeError(f"events are counted from 1, and '{text}' is no number of one")
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
    """Without --no-follow 130, after a Ctrl-C; else 0, and 69 when a host was not heard."""
    from lfield.cli.views import event_view
    from lfield.operator.sight.listening import Notice
    from lfield.wire.events import KINDS, TELEMETRY, Skipped

    kinds = _kinds(args.kinds, event_view.IN_TABLES if args.csv else tuple(KINDS))
    if not (args.kinds or args.csv or args.json):
        # A person reads what happens; what is told again and again has to be asked for.
        kinds -= TELEMETRY
    table = event_view.Csv()

    def lines(told: Dated | Notice) -> Iterator[str]:
        if isinstance(told, Notice):
            if args.json and told.lost:
                yield event_view.as_json(told)
        elif isinstance(told.event.what, Skipped) and "skipped" not in kinds:
            _tell_skipped(told.host, told.event.what, kinds)
        elif told.event.kind not in kinds:
            return
        elif args.csv:
            yield from table.rows(told)
        else:
            yield event_view.as_json(told) if args.json else event_view.as_line(told)

    if args.csv:
        print(table.header(), flush=True)
    since = 0 if args.since is None and args.no_follow else args.since
    rate = args.rate if TELEMETRY & kinds and not args.no_follow else 0.0
    return listen(args, lines, since=since, telemetry=rate, follow=not args.no_follow, only=args.host)


#: What is not told either of what was skipped as the first of it was.
_ENDS = {"left": "hopped", "began": "ended", "asked": "answered"}


def _tell_skipped(host: str, what: Skipped, kinds: frozenset[str]) -> None:
    """Where events that are wanted are missing, and the one that says so is not shown."""
    from lfield.operator.sight.picture.loglines import left_out

    if kinds & {what.skipped, _ENDS.get(what.skipped, "")}:
        _tell(host, left_out(f"events of kind '{what.skipped}'", what.count))


def _kinds(text: str, known: Sequence[str]) -> frozenset[str]:
    """The kinds that were named, or all. Raises UsageError."""
    named = [word for word in text.split(",") if word]
    for word in named:
        if word not in known:
            hint = did_you_mean(word, known)
            raise UsageError(
                f"there are no events of kind '{word}' here, but {listed(known)}{f'; {hint}' if hint else ''}"
            )
    return frozenset(named or known)


# --- for `logs` too -----------------------------------------------------------------------------------------


def listen(
    args: argparse.Namespace,
    lines: Callable[[Dated | Notice], Iterable[str]],
    *,
    since: int | None,
    telemetry: float = 0.0,
    follow: bool,
    only: Sequence[str] = (),
) -> int:
    """Print the lines of what is heard; what was lost, and who is not heard, goes to stderr."""
    import asyncio

    from lfield.operator.addressed import names_of

    parties = meant_parties(args, meant_runs(args))
    names = _bounded(_named(names_of(parties), only))

    def look() -> list[Party]:
        return meant_parties(args, meant_runs(args))

    async def heard() -> int:
        from lfield.operator.sight.listening import ears

        async with ears(parties, names, look, args.keys, since=since, telemetry=telemetry) as team:
            try:
                async for told in team.events(follow=follow):
                    _print(told, lines)
            except asyncio.CancelledError:
                # A Ctrl-C: what came last has not waited long enough for what may have led to it.
                for told in team.rest():
                    _print(told, lines)
                raise
            return exits.UNAVAILABLE if team.unheard else exits.DONE

    return asyncio.run(heard())


def _named(names: dict[Place, str], only: Sequence[str]) -> dict[Place, str]:
    """Those of the hosts that are wanted. Raises UsageError for one that there is not."""
    hosts = {place.host for place in names} | set(names.values())
    for name in only:
        if name not in hosts:
            hint = did_you_mean(name, sorted(hosts))
            raise UsageError(
                f"there is no host '{name}': there is {listed(sorted(hosts))}{f'; {hint}' if hint else ''}"
            )
    return {place: name for place, name in names.items() if not only or {place.host, name} & set(only)}


def _bounded(names: dict[Place, str]) -> dict[Place, str]:
    """Of each other user only so many; on stderr, how many are left out."""
    found: dict[str, list[Place]] = defaultdict(list)
    for place in names:
        found[place.user].append(place)
    for user, places in found.items():
        if user and len(places) > MOST_OF_OTHERS:
            left = len(places) - MOST_OF_OTHERS
            print(
                f"lfield: {left} hosts of user {user} are not heard: name a run with --run", file=sys.stderr
            )
            for place in places[MOST_OF_OTHERS:]:
                del names[place]
    return names


def _print(told: Dated | Notice, lines: Callable[[Dated | Notice], Iterable[str]]) -> None:
    from lfield.operator.sight.listening import Notice

    if isinstance(told, Notice):
        _tell(told.host, told.text)
    for line in lines(told):
        print(line, flush=True)


def _tell(host: str, text: str) -> None:
    from lfield.text.visible import in_one_line

    print(f"{host}: {in_one_line(text)}", file=sys.stderr, flush=True)
