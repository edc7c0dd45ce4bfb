"""`lfield estop`: emergency stop of every device, with confirmation and the progress to rest."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, redirect_stdout
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from lfield import exit_status
from lfield.cli.mission_argument import add_running_mission, named_mission, selected_runs, selected_teams
from lfield.text.terminal_escape import escape_line, truncate

if TYPE_CHECKING:
    from lfield.errors import LfieldError
    from lfield.operator.observer_link import Request
    from lfield.operator.runs import Run
    from lfield.operator.targets import HostRef, TargetTeam
    from lfield.wire.observer_messages import EmergencyStopResult

    Stopped = Mapping[HostRef, EmergencyStopResult | LfieldError]
    #: The reasons why devices are not known to be at rest, by host and device.
    InMotion = Mapping[tuple[HostRef, str], str]

#: Time to come to rest, in seconds, for devices of hosts without a run here: as most bindings say.
DEFAULT_REST_TIME = 120.0
#: The longest line that lists hosts, in characters.
_MAX_LINE = 4000


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add_running_mission(parser)
    parser.add_argument(
        "--reason", metavar="TEXT", default="", help="reason, which the hosts write to their logs"
    )
    parser.add_argument(
        "--lift",
        action="store_true",
        help="end the emergency stop; after that, programs can release their devices",
    )
    parser.add_argument(
        "--no-wait",
        action="store_true",
        help="exit as soon as all devices have confirmed; do not wait until they are at rest",
    )
    parser.add_argument(
        "--json", action="store_true", help="print one JSON object at the end; lines for people go to stderr"
    )


def run(args: argparse.Namespace) -> int:
    """Returns 0 when every device has confirmed and is at rest, else 3; 69 when no mission is running.

    A host where no mission runs has nothing to lift.
    """
    with nonblocking_command_output():
        if not args.json:
            return _run(args)[0]
        with redirect_stdout(sys.stderr):
            status, data = _run(args)
        print(json.dumps(data))
        return status


def nonblocking_command_output() -> AbstractContextManager[None]:
    """In the block, unread output (Ctrl-S, a full pipe) does not delay the orders that are sent to hosts.

    The command still ends only when its output has been read: the output names the devices that are not safe.
    """
    from lfield.text.nonblocking_output import nonblocking_output

    return nonblocking_output("lfield: ", content="output", drain_timeout=None)


def _run(args: argparse.Namespace) -> tuple[int, dict[str, object]]:
    """The exit status, and the answers as JSON data."""
    from lfield.operator.client import emergency_stop
    from lfield.operator.targets import display_names

    targets = selected_teams(args, selected_runs(args))
    names = display_names(targets)
    if named_mission(args) is None:
        _print_targets(targets, "lifting" if args.lift else "stopping")
    reason = f"the emergency stop was pressed{': ' if args.reason else ''}{args.reason}"
    goal = "may be released" if args.lift else "safe"
    request = emergency_stop(reason, lift=args.lift)
    try:
        report = ask_and_print(targets, request, args.keys, names, goal, needs_all=not args.lift)
    except KeyboardInterrupt:
        return exit_status.UNSAFE, {}
    waits_for_rest = not (args.lift or args.no_wait)
    status, in_motion = exit_status_of(targets, report, names, args.keys, waits_for_rest=waits_for_rest)
    return status, _report_data(report.answers, names, in_motion if waits_for_rest else None)


def _print_targets(targets: Sequence[TargetTeam], doing: str) -> None:
    from lfield.operator.run_dirs import unreadable_hint

    for target in targets:
        print(
            truncate(
                escape_line(
                    f"{doing} {target.id or 'the hosts of the inventory'}: {', '.join(target.addresses)}"
                ),
                _MAX_LINE,
            )
        )
    if unreadable_hint():
        _print(f"lfield: {unreadable_hint()}")


class StopReport(NamedTuple):
    """The answers of hosts, and whether every device and host has confirmed."""

    answers: Stopped
    is_confirmed: bool
    is_complete: bool


def ask_and_print(
    teams: Sequence[TargetTeam],
    request: Request[EmergencyStopResult],
    keys: Path | None,
    names: Mapping[HostRef, str],
    state: str,
    *,
    needs_all: bool = True,
) -> StopReport:
    """Send the order and print each answer as it arrives; devices are then in the `state`.

    Without `needs_all` the report is complete also without the hosts where no program listens. Raises
    KeyboardInterrupt after it has named the hosts whose answers were not printed.
    """
    from lfield.operator.client import ask_in_turn, is_reached

    answers: dict[HostRef, EmergencyStopResult | LfieldError] = {}
    confirmed = everybody = True
    try:
        for team_answers in ask_in_turn(teams, request, keys):
            confirmed &= _all_confirmed(team_answers, names, state)
            _print_not_persisted(team_answers, names)
            needed = team_answers
            if not needs_all:
                _print_without_mission(team_answers, names)
                needed = {place: answer for place, answer in team_answers.items() if is_reached(answer)}
            everybody &= _all_reached(needed, names)
            answers |= team_answers
    except KeyboardInterrupt:
        missing = ", ".join(name for place, name in names.items() if place not in answers)
        _print(truncate(f"interrupted: no answer yet from {missing}; run the command again", _MAX_LINE))
        raise
    return StopReport(answers, confirmed, everybody)


def exit_status_of(
    teams: Sequence[TargetTeam],
    report: StopReport,
    names: Mapping[HostRef, str],
    keys: Path | None,
    *,
    waits_for_rest: bool,
) -> tuple[int, InMotion]:
    """The exit status, and the devices that are not at rest, if `waits_for_rest`; 69 when nothing runs."""
    from lfield.operator.client import is_reached

    if not (teams[0].runs or any(is_reached(answer) for answer in report.answers.values())):
        return exit_status.UNAVAILABLE, {}
    if not waits_for_rest:
        is_done = report.is_confirmed and report.is_complete
        return exit_status.DONE if is_done else exit_status.UNSAFE, {}
    down, in_motion = watch_safe_states(teams, report.answers, names, keys)
    complete = exit_status.DONE if report.is_complete else exit_status.UNSAFE
    return exit_status.most_severe((complete, down)), in_motion


def _all_reached(answers: Stopped, names: Mapping[HostRef, str]) -> bool:
    """Whether every host has answered; prints a line to stderr for each that has not."""
    from lfield.operator.client import print_unanswered, unanswered_by_name

    unreached = unanswered_by_name(answers, names)
    print_unanswered(unreached, "NOT REACHED, its devices have not confirmed: ")
    return not unreached


def _print_without_mission(answers: Stopped, names: Mapping[HostRef, str]) -> None:
    """A line for each host where no program listens."""
    from lfield.operator.client import is_reached

    for place, answer in answers.items():
        if not is_reached(answer):
            print(f"{names[place]}: no mission runs there, nothing to lift", flush=True)


def _report_data(
    answers: Stopped, names: Mapping[HostRef, str], in_motion: InMotion | None
) -> dict[str, object]:
    """The answers as JSON data by host: an error, or each device with its problem, '' for none.

    `in_motion` is None when the devices were not watched.
    """
    data: dict[str, object] = {}
    for place, answer in answers.items():
        if isinstance(answer, Exception):
            data[names[place]] = answer.as_data()
            continue
        devices = {}
        for device, problem in answer.devices.items():
            moving = "" if in_motion is None else in_motion.get((place, device), "")
            at_rest = None if in_motion is None else not moving
            devices[device] = {"confirmed": not problem, "at_rest": at_rest, "problem": moving or problem}
        data[names[place]] = {"devices": devices, "trouble": answer.trouble}
    return data


def _all_confirmed(answers: Stopped, names: Mapping[HostRef, str], state: str) -> bool:
    """Print a line for each device, failures to stderr; returns whether all have confirmed."""
    is_confirmed = True
    for place, answer in answers.items():
        if isinstance(answer, Exception):
            continue
        if not answer.devices:
            print(f"{names[place]}: has no devices that move")
        for device, problem in answer.devices.items():
            is_confirmed = is_confirmed and not problem
            text = f"{names[place]}: {device}: {f'NOT CONFIRMED: {problem}' if problem else state}"
            print(escape_line(text), file=sys.stderr if problem else sys.stdout, flush=True)
    return is_confirmed


def _print_not_persisted(answers: Stopped, names: Mapping[HostRef, str]) -> None:
    for place, answer in answers.items():
        if not isinstance(answer, Exception) and answer.trouble:
            _print(f"{names[place]}: {answer.trouble}")


def watch_safe_states(
    targets: Sequence[TargetTeam], answers: Stopped, names: Mapping[HostRef, str], keys: Path | None
) -> tuple[int, InMotion]:
    """Watch the devices until they are at rest, and print those that are not.

    Returns the exit status, and these devices.
    """
    from lfield.cli.views.safe_state_view import watch_progress
    from lfield.clock import SystemClock
    from lfield.operator.client import observer_transport, own_keys
    from lfield.operator.safe_state_progress import SafeStateProgress

    within = max((_rest_time(run) for target in targets for run in target.runs), default=DEFAULT_REST_TIME)
    descent = SafeStateProgress(within, SystemClock().monotonic())
    for place, answer in answers.items():
        if not isinstance(answer, Exception):
            descent.on_stopped(place, answer)
    try:
        known = {place: at for target in targets for place, at in target.host_refs.items()}
        places = {
            place: known[place] for place, answer in answers.items() if not isinstance(answer, Exception)
        }
        watch_progress(descent, observer_transport(own_keys(places.values(), keys)), places, names)
        interrupted = False
    except KeyboardInterrupt:
        _print("stopped watching; the order is unchanged: 'lfield ps' shows the devices")
        interrupted = True
    unsafe = descent.verdicts()
    for device, sentence in unsafe:
        _print(f"{names[device.host_ref]}: {device.name}: {sentence}")
    in_motion = {(device.host_ref, device.name): sentence for device, sentence in unsafe}
    if interrupted:
        return exit_status.INTERRUPTED, in_motion
    return exit_status.UNSAFE if unsafe else exit_status.DONE, in_motion


def _rest_time(run: Run) -> float:
    """Time for the devices of a run to come to rest, bounded for runs of other users."""
    return min(run.manifest.rest_within, DEFAULT_REST_TIME) if run.user else run.manifest.rest_within


def _print(text: str) -> None:
    print(escape_line(text), file=sys.stderr)
