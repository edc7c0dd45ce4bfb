"""`python -m lfield.simulate MISSION.dL --seed 7 --faults cut=5 kill=20`: a team on virtual time.

Hosts and guards are the real ones. Whatever devices the mission has do what their manifests say, and nothing
else: what they tell are constants.
"""

from __future__ import annotations

import argparse
import random
import sys
from dataclasses import fields
from pathlib import Path

from lfield.errors import LfieldError, ProgramError
from lfield.mission.load import load_mission
from lfield.simulate.fleet import Fleet
from lfield.simulate.weather import Weather

#: What can go wrong.
KINDS = [field.name for field in fields(Weather)]


def main() -> int:
    """Run it and print what was said; returns the exit status."""
    parser = argparse.ArgumentParser(prog="python -m lfield.simulate", description=__doc__)
    parser.add_argument("mission", metavar="MISSION.dL", type=Path, help="the deployment")
    parser.add_argument("--seed", type=int, default=0, help="of everything that is left to chance")
    parser.add_argument("--seconds", type=float, default=60.0, help="how long it runs, in virtual time")
    parser.add_argument(
        "--faults",
        metavar="KIND=SECONDS",
        type=_fault,
        nargs="*",
        default=[],
        help=f"mean seconds between two faults of a kind: {', '.join(KINDS)}",
    )
    parser.add_argument("--quiet", action="store_true", help="print the last line only")
    args = parser.parse_args()
    try:
        fleet = Fleet(load_mission(args.mission, simulate=True), args.seed)
    except ProgramError as error:
        print("\n".join(d.render() for d in error.diagnostics), file=sys.stderr)
        return error.exit_status
    except LfieldError as error:
        print(f"lfield.simulate: {error}", file=sys.stderr)
        return error.exit_status
    storm = Weather(**dict(args.faults)).over(fleet, random.Random(args.seed))
    fleet.run(args.seconds)
    if not args.quiet:
        faults = [(at, "weather", what) for at, what in storm.faults]
        for at, who, text in sorted([*fleet.log, *faults], key=lambda line: line[0]):
            print(f"{at:12.6f} {who} | {text.rstrip()}")
    events, struck = fleet.timeline.events, len(storm.faults)
    print(f"{events} events, {struck} faults in {args.seconds:g} s; digest {fleet.digest}")
    return 0


def _fault(text: str) -> tuple[str, float]:
    kind, _, mean = text.partition("=")
    if kind not in KINDS:
        raise argparse.ArgumentTypeError(f"there is no fault '{kind}'; there are {', '.join(KINDS)}")
    try:
        seconds = float(mean)
    except ValueError:
        seconds = 0.0
    if not 0.0 < seconds < float("inf"):
        raise argparse.ArgumentTypeError(f"'{text}' needs seconds above 0, as in {kind}=20")
    return kind, seconds


if __name__ == "__main__":
    sys.exit(main())
