"""`python -m lfield.simulate MISSION.dL --seed 7`: hosts on virtual time, and the run's digest.

Resources have no devices here: a mission that calls some gets their DeviceException.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from lfield.errors import LfieldError, ProgramError
from lfield.mission.load import load_mission
from lfield.simulate.fleet import Fleet, Weather


def main() -> int:
    """Run it and print what was said; returns the exit status."""
    parser = argparse.ArgumentParser(prog="python -m lfield.simulate", description=__doc__)
    parser.add_argument("mission", metavar="MISSION.dL", type=Path, help="the deployment")
    parser.add_argument("--seed", type=int, default=0, help="of everything that is left to chance")
    parser.add_argument("--seconds", type=float, default=60.0, help="how long it runs, in virtual time")
    parser.add_argument("--cut-every", type=float, default=0.0, help="mean seconds between two cut links")
    parser.add_argument("--crash-every", type=float, default=0.0, help="mean seconds between two crashes")
    parser.add_argument("--quiet", action="store_true", help="print the last line only")
    args = parser.parse_args()
    try:
        fleet = Fleet(load_mission(args.mission), args.seed)
    except ProgramError as error:
        print("\n".join(d.render() for d in error.diagnostics), file=sys.stderr)
        return error.exit_status
    except LfieldError as error:
        print(f"lfield.simulate: {error}", file=sys.stderr)
        return error.exit_status
    Weather(args.cut_every, args.crash_every).over(fleet)
    fleet.run(args.seconds)
    if not args.quiet:
        for at, host, text in fleet.log:
            print(f"{at:12.6f} {host} | {text.rstrip()}")
    print(f"{fleet.events} events, {fleet.transfers} hops in {args.seconds:g} s; digest {fleet.digest}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
