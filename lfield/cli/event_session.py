"""A session of `lfield events` or `logs`: follows hosts, prints and records their events."""

from __future__ import annotations

import argparse
import asyncio
import signal
import sys
from collections import defaultdict
from collections.abc import AsyncIterator, Callable, Collection, Iterable, Sequence
from contextlib import asynccontextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from msgspec import Struct

from lfield import exit_status
from lfield.cli.mission_argument import named_mission, selected_runs, selected_teams
from lfield.errors import UsageError
from lfield.text.suggestions import did_you_mean, listed

if TYPE_CHECKING:
    from lfield.cli.event_recording import EventRecording
    from lfield.mission.mission import Mission
    from lfield.operator.dashboard.event_feed import EventFeed, FeedNotice
    from lfield.operator.dashboard.timeline.event_timeline import DatedEvent
    from lfield.operator.targets import HostRef, TargetTeam
    from lfield.operator.team_model.mission_end import CoordinatorEnd, MissionEnd

#: The most hosts of another user's runs.
MAX_FOREIGN_HOSTS = 32
#: Seconds after which an unreachable host is not waited for, as by `lfield up --until-done`.
LOST_AFTER = 15.0

Lines = Callable[["DatedEvent | FeedNotice"], Iterable[str]]


class SessionPlan(Struct, frozen=True):
    """The hosts and events to follow, and the end: without `follow` only the stored events.

    `since`, `telemetry` (Hz): as in `StreamCursor`. `only`: the hosts, all if empty. `mcap`: records the
    events of these `kinds` there. `until_done`: ends with the mission; a host without contact for
    `lost_after` seconds is not waited for.
    """

    since: int | None = None
    telemetry: float = 0.0
    follow: bool = True
    only: Sequence[str] = ()
    mcap: Path | None = None
    kinds: Collection[str] = ()
    until_done: bool = False
    lost_after: float = LOST_AFTER


def run_session(args: argparse.Namespace, lines: Lines, plan: SessionPlan) -> int:
    """Print the `lines` of events to stdout, and losses and unreachable hosts to stderr; returns the exit
    status."""
    from lfield.operator.targets import display_names, single_target

    targets = selected_teams(args, selected_runs(args))
    mission = None
    if plan.mcap is not None or plan.until_done:
        targets = [single_target(targets)]
        mission = _mission_of(args, targets[0])
    names = _limit_foreign(display_names(targets))
    selected = _select_hosts(names, plan.only)
    session = _Session(
        args, lines, plan, targets, names if plan.until_done else selected, set(selected.values())
    )
    try:
        return session.run(mission)
    except asyncio.CancelledError:
        # A signal other than that of Ctrl-C.
        return exit_status.INTERRUPTED


def _mission_of(args: argparse.Namespace, team: TargetTeam) -> Mission | None:
    """The mission from its files: the named ones, or those of a run of this user; None if they cannot be
    used."""
    from lfield.client.team_watch import read_mission

    path, deployment = named_mission(args), ""
    if path is None and team.runs and not team.user:
        path, deployment = Path(team.runs[0].manifest.mission), team.runs[0].manifest.deployment
    mission = read_mission(path) if path is not None else None
    if mission is not None and deployment not in ("", mission.team.deployment.hex()):
        mission = None
    if mission is None:
        print(
            f"lfield: the files of the mission cannot be used{f': {path}' if path else ''}", file=sys.stderr
        )
    return mission


class _Session:
    """A session; `names` are the display names of the followed hosts; events of the `shown` ones are
    printed.
    """

    def __init__(
        self,
        args: argparse.Namespace,
        lines: Lines,
        plan: SessionPlan,
        targets: Sequence[TargetTeam],
        names: dict[HostRef, str],
        selected: Collection[str],
    ) -> None:
        self._args, self._lines, self._plan = args, lines, plan
        self._targets, self._names, self._selected = targets, names, selected
        self._recording: EventRecording | None = None

    def run(self, mission: Mission | None) -> int:
        """Run the session; returns the exit status."""
        if self._plan.mcap is None:
            return asyncio.run(self._follow(mission))
        # With the package mcap, only where events are recorded.
        from lfield.cli.event_recording import event_recording
        from lfield.export.export_input import NO_INFO, mission_info

        info = NO_INFO if mission is None else mission_info(mission.name, mission)
        with event_recording(self._plan.mcap, info) as self._recording:
            return asyncio.run(self._follow(mission))

    def _teams(self) -> list[TargetTeam]:
        return selected_teams(self._args, selected_runs(self._args))

    async def _follow(self, mission: Mission | None) -> int:
        from lfield.clock import SystemClock
        from lfield.operator.dashboard.event_feed import open_feed
        from lfield.operator.team_model.mission_end import MissionEnd

        plan, end = self._plan, None
        has_runs = any(target.runs for target in self._targets)
        if plan.follow and not has_runs and named_mission(self._args) is None:
            # No mission has to run there, so there may be no other output.
            print(
                "lfield: following the hosts of the inventory; Ctrl-C ends this", file=sys.stderr, flush=True
            )
        if plan.until_done:
            end = MissionEnd(
                [place.host for place in self._names], _homes(mission), plan.lost_after, SystemClock()
            )
        if plan.until_done or plan.mcap is not None:
            _cancel_on_signals()
        async with (
            open_feed(
                self._targets,
                self._names,
                self._teams,
                self._args.keys,
                since=plan.since,
                telemetry=plan.telemetry,
                observer=end,
            ) as feed,
            self._background(feed, end),
        ):
            try:
                until = end.is_over if end is not None else lambda: False
                async for item in feed.events(follow=plan.follow, until=until):
                    self._emit(item)
            except asyncio.CancelledError:
                # After a Ctrl-C: the newest events, without waiting for their causes.
                for item in feed.remaining():
                    self._emit(item)
                raise
            unreached = feed.unreached
        if end is None:
            return exit_status.UNAVAILABLE if unreached else exit_status.DONE
        return _end_status(end.outcomes or (), unreached, len(self._names))

    @asynccontextmanager
    async def _background(self, feed: EventFeed, end: MissionEnd | None) -> AsyncIterator[None]:
        from lfield.operator.dashboard.event_stream.background_task import background_tasks

        work = [self._recording.flush_regularly()] if self._recording is not None else []
        work += [feed.follow_end(end)] if end is not None else []
        async with background_tasks(*work):
            yield

    def _emit(self, item: DatedEvent | FeedNotice) -> None:
        from lfield.operator.dashboard.event_feed import FeedNotice

        if isinstance(item, FeedNotice):
            print_notice(item.host, item.text)
        elif item.host not in self._selected:
            return
        if self._recording is not None and (
            isinstance(item, FeedNotice) or item.event.kind in self._plan.kinds
        ):
            self._recording.add(item)
        for line in self._lines(item):
            print(line, flush=True)


def _cancel_on_signals() -> None:
    """End the session on a request to end, or at the end of the terminal, as on a Ctrl-C."""
    loop, task = asyncio.get_running_loop(), asyncio.current_task()
    for number in (signal.SIGTERM, signal.SIGHUP):
        if task is not None and signal.getsignal(number) is not signal.SIG_IGN:
            loop.add_signal_handler(number, task.cancel)


# --- the end of the mission ---------------------------------------------------------------------------------


def _homes(mission: Mission | None) -> dict[str, str] | None:
    """The home of each coordinator; None if the files of the mission are not available."""
    if mission is None:
        return None
    homes = mission.team.homes
    return {member.id: homes[member.id] for member in mission.team.initial_coordinators}


def _end_status(ends: Collection[CoordinatorEnd], unreached: Collection[str], hosts: int) -> int:
    """Print the ends of the coordinators; returns the exit status of the mission."""
    if len(unreached) == hosts:
        print("lfield: no host of the mission has answered", file=sys.stderr)
        return exit_status.UNAVAILABLE
    statuses = {"done": exit_status.DONE, "unknown": exit_status.UNKNOWN_OUTCOME}
    for end in ends:
        print_notice(end.agent, f"{end.outcome}{f': {end.detail}' if end.detail else ''}")
    found = [statuses.get(end.outcome, exit_status.FAILED) for end in ends]
    return exit_status.most_severe([*found, *([exit_status.UNAVAILABLE] if unreached else [])])


# --- hosts --------------------------------------------------------------------------------------------------


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
            omitted = len(places) - MAX_FOREIGN_HOSTS
            print(
                f"lfield: {omitted} hosts of user {user} are left out: name a run with --run", file=sys.stderr
            )
            for place in places[MAX_FOREIGN_HOSTS:]:
                del names[place]
    return names


def print_notice(host: str, text: str) -> None:
    """Print a notice about a host to stderr."""
    from lfield.text.terminal_escape import escape_line

    print(f"{host}: {escape_line(text)}", file=sys.stderr, flush=True)
