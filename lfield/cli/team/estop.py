"""`lfield estop`: every device into its safe state, who did not confirm that, and the way down of all."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from lfield import exits
from lfield.cli.mission_argument import add_running_mission, meant_parties, meant_runs, named_mission
from lfield.text.visible import clipped, in_one_line

if TYPE_CHECKING:
    from lfield.errors import LfieldError
    from lfield.operator.addressed import Party, Place
    from lfield.operator.observing import Request
    from lfield.operator.runs import Run
    from lfield.wire.observing import EmergencyStopped

    Stopped = Mapping[Place, EmergencyStopped | LfieldError]

#: How long devices of hosts that no run here is of have to come to rest, in seconds: as most bindings say.
REST_WITHIN = 120.0
#: The longest line of those that are stopped, in characters: of all of a team, but for a very large one.
_LINE = 4000


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare its options."""
    add_running_mission(parser)
    parser.add_argument("--reason", metavar="TEXT", default="", help="reason, for the logs of the hosts")
    parser.add_argument(
        "--lift", action="store_true", help="end the emergency stop: programs may release their devices again"
    )
    parser.add_argument(
        "--no-wait", action="store_true", help="exit when all devices have confirmed, before they are at rest"
    )


def run(args: argparse.Namespace) -> int:
    """0 when every device has confirmed and was seen at rest, else 3; 69 where nothing runs at all."""
    from lfield.operator.addressed import names_of
    from lfield.operator.ask import emergency_stop

    parties = meant_parties(args, meant_runs(args))
    names = names_of(parties)
    if named_mission(args) is None:
        _tell_whom(parties, "lifting" if args.lift else "stopping")
    reason = f"the emergency stop was pressed{': ' if args.reason else ''}{args.reason}"
    word = "may be released" if args.lift else "safe"
    try:
        told = told_in_turn(parties, emergency_stop(reason, lift=args.lift), args.keys, names, word)
    except KeyboardInterrupt:
        return exits.UNSAFE
    return came_of(parties, told, names, args.keys, looks=not (args.lift or args.no_wait))


def _tell_whom(parties: Sequence[Party], doing: str) -> None:
    from lfield.operator.places import unseen

    for party in parties:
        print(clipped(in_one_line(f"{doing} {party.id}: {', '.join(party.addresses)}"), _LINE))
    if unseen():
        _tell(f"lfield: {unseen()}")


class Told(NamedTuple):
    """What hosts have said; whether every device is as it was asked for, and everybody has answered."""

    answers: Stopped
    confirmed: bool
    everybody: bool


def told_in_turn(
    parties: Sequence[Party],
    request: Request[EmergencyStopped],
    keys: Path | None,
    names: Mapping[Place, str],
    word: str,
) -> Told:
    """Ask for it, and tell what each host says as it comes; devices are then what the `word` says.

    Raises KeyboardInterrupt after it has named the hosts whose answers were not printed.
    """
    from lfield.operator.ask import asked_in_turn

    answers: dict[Place, EmergencyStopped | LfieldError] = {}
    confirmed = everybody = True
    try:
        for some in asked_in_turn(parties, request, keys):
            confirmed &= _all_confirmed(some, names, word)
            _tell_not_kept(some, names)
            everybody &= _all_reached(some, names)
            answers |= some
    except KeyboardInterrupt:
        left = ", ".join(name for place, name in names.items() if place not in answers)
        _tell(clipped(f"interrupted: no answer yet from {left}; run the command again", _LINE))
        raise
    return Told(answers, confirmed, everybody)


def came_of(
    parties: Sequence[Party], told: Told, names: Mapping[Place, str], keys: Path | None, *, looks: bool
) -> int:
    """The status it comes to, after a look at the way down where somebody `looks`; 69 where nothing runs."""
    from lfield.operator.ask import reached

    if not (parties[0].runs or any(reached(answer) for answer in told.answers.values())):
        return exits.UNAVAILABLE
    if not looks:
        return exits.DONE if told.confirmed and told.everybody else exits.UNSAFE
    down = way_down(parties, told.answers, names, keys)
    return exits.worst((exits.DONE if told.everybody else exits.UNSAFE, down))


def _all_reached(answers: Stopped, names: Mapping[Place, str]) -> bool:
    """Whether every host has answered; a line on stderr for each that has not."""
    from lfield.operator.ask import tell_silent, unheard

    unreached = unheard(answers, names)
    tell_silent(unreached, "NOT REACHED, its devices have not confirmed: ")
    return not unreached


def _all_confirmed(answers: Stopped, names: Mapping[Place, str], word: str) -> bool:
    """A line for each device of the hosts that answered, on stderr what is wrong; whether all is well."""
    well = True
    for place, answer in answers.items():
        if isinstance(answer, Exception):
            continue
        if not answer.devices:
            print(f"{names[place]}: has no devices that move")
        for device, problem in answer.devices.items():
            well = well and not problem
            said = f"{names[place]}: {device}: {f'NOT CONFIRMED: {problem}' if problem else word}"
            print(in_one_line(said), file=sys.stderr if problem else sys.stdout, flush=True)
    return well


def _tell_not_kept(answers: Stopped, names: Mapping[Place, str]) -> None:
    for place, answer in answers.items():
        if not isinstance(answer, Exception) and answer.trouble:
            _tell(f"{names[place]}: {answer.trouble}")


def way_down(
    parties: Sequence[Party], answers: Stopped, names: Mapping[Place, str], keys: Path | None
) -> int:
    """Look at the devices until they are at rest, and name those that are not; the status it comes to."""
    from lfield.cli.views.way_down import watch
    from lfield.clock import SystemClock
    from lfield.operator.ask import observer, own_keys
    from lfield.operator.descent import Descent

    within = max((_rest_within(run) for party in parties for run in party.runs), default=REST_WITHIN)
    descent = Descent(within, SystemClock().monotonic())
    for place, answer in answers.items():
        if not isinstance(answer, Exception):
            descent.stopped(place, answer)
    try:
        known = {place: at for party in parties for place, at in party.places.items()}
        places = {
            place: known[place] for place, answer in answers.items() if not isinstance(answer, Exception)
        }
        watch(descent, observer(own_keys(places.values(), keys)), places, names)
        interrupted = False
    except KeyboardInterrupt:
        _tell("no longer looking, and nothing else has changed: 'lfield ps' shows how the devices are")
        interrupted = True
    wrong = descent.verdicts()
    for device, sentence in wrong:
        _tell(f"{names[device.place]}: {device.name}: {sentence}")
    if interrupted:
        return exits.INTERRUPTED
    return exits.UNSAFE if wrong else exits.DONE


def _rest_within(run: Run) -> float:
    """How long devices of a run have; that another user says so is no reason to look for ever."""
    return min(run.note.rest_within, REST_WITHIN) if run.user else run.note.rest_within


def _tell(text: str) -> None:
    print(in_one_line(text), file=sys.stderr)
