"""Deterministic simulation testing from the command line.

`python tests/simulate/simulate.py --seeds 1000` runs and checks the scenarios of 1,000 seeds.
`python tests/simulate/simulate.py --pushes --seeds 1000` does that with pushes to the services of robots.
`python tests/simulate/simulate.py MISSION.dL --seed 7 --faults cut=5 kill=20` runs a mission in virtual time.

Hosts and guards are the real ones. The devices of the mission behave as their manifests describe; their
telemetry is constant.
"""

from __future__ import annotations

import argparse
import random
import sys
from collections.abc import Iterable
from dataclasses import fields, replace
from pathlib import Path

from lfield.errors import LfieldError, ProgramError
from lfield.mission.loader import load_mission
from lfield.simulate.host_fleet import Fleet
from simulation_testing.fault_injection import FaultRates
from simulation_testing.scenarios.scenario import Scenario
from simulation_testing.scenarios.scenario_drawing import KINDS, draw_scenario
from simulation_testing.scenarios.scenario_run import run_scenario
from simulation_testing.scenarios.scenario_shrinker import COMMAND
from simulation_testing.seed_runner import IN_A_LINE, lines_of, run_seeds
from simulation_testing.services.push_runner import run_push_seeds
from simulation_testing.services.push_scenario import draw_push_scenario, run_push_scenario

#: The kinds of faults.
FAULTS = [field.name for field in fields(FaultRates)]


def main() -> int:
    """Run the command, print its result and return the exit status."""
    parser = _parser()
    args = parser.parse_args()
    if args.pushes:
        return _pushes(parser, args)
    if args.seeds is not None:
        return _seeds(parser, args)
    if args.story is not None:
        return _run_scenarios(args)
    if args.mission is None:
        parser.error("give --seeds N, --story SEED or a MISSION.dL")
    return _run_mission(args)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog=COMMAND, description=__doc__)
    parser.add_argument("--quiet", action="store_true", help="print the last line only")
    many = parser.add_argument_group("scenarios")
    many.add_argument("--seeds", type=_count, metavar="N", help="run and check the scenarios of N seeds")
    many.add_argument("--first", type=int, default=0, metavar="SEED", help="the first seed")
    many.add_argument(
        "--processes",
        type=_count,
        default=0,
        metavar="N",
        help="number of processes, default one for each core",
    )
    many.add_argument("--pushes", action="store_true", help="scenarios with pushes to the services of robots")
    many.add_argument("--outcomes", type=Path, metavar="FILE", help="write the digest of each outcome")
    many.add_argument("--story", type=int, metavar="SEED", help="repeat one scenario, whole or reduced:")
    for name in ("hosts", "walkers", "arms"):
        many.add_argument(f"--{name}", type=int, metavar="N")
    many.add_argument("--as", choices=KINDS, dest="kind", help="the kind of its coordinators")
    many.add_argument("--keep", type=_numbers, metavar="N,N", help="the numbers of the faults to inject")
    one = parser.add_argument_group("a mission")
    one.add_argument("mission", metavar="MISSION.dL", type=Path, nargs="?", help="the deployment")
    one.add_argument("--seed", type=int, default=0, help="the seed of all random numbers")
    one.add_argument("--seconds", type=float, help="duration in virtual time")
    kinds = f"mean seconds between two faults of a kind: {', '.join(FAULTS)}"
    one.add_argument("--faults", metavar="KIND=SECONDS", type=_fault, nargs="*", default=[], help=kinds)
    return parser


def _seeds(parser: argparse.ArgumentParser, args: argparse.Namespace) -> int:
    if args.outcomes and (args.first or args.seeds % IN_A_LINE):
        parser.error(f"--outcomes needs --first 0, and a multiple of {IN_A_LINE} for --seeds")
    tally = run_seeds(range(args.first, args.first + args.seeds), args.processes)
    if args.outcomes:
        args.outcomes.write_text("\n".join([*lines_of(tally.outcomes), ""]), encoding="utf-8")
    return 1 if tally.broken else 0


def _pushes(parser: argparse.ArgumentParser, args: argparse.Namespace) -> int:
    if args.seeds is not None:
        seeds = range(args.first, args.first + args.seeds)
        return 1 if run_push_seeds(seeds, args.processes) else 0
    if args.story is None:
        parser.error("give --seeds N or --story SEED with --pushes")
    verdict = run_push_scenario(draw_push_scenario(args.story), keep_log=True)
    if not args.quiet:
        _print(verdict.log, ())
    for breach in verdict.breaches:
        print(breach)
    print(f"{verdict.counts} in {verdict.seconds:g} s; digest {verdict.digest}")
    return 1 if verdict.breaches else 0


def _run_scenarios(args: argparse.Namespace) -> int:
    options = {name: getattr(args, name) for name in ("hosts", "walkers", "arms", "seconds", "keep")}
    draws = KINDS[args.kind] if args.kind else draw_scenario
    scenario: Scenario = replace(
        draws(args.story), **{name: v for name, v in options.items() if v is not None}
    )
    verdict = run_scenario(scenario, keep_log=True)
    if not args.quiet:
        _print(verdict.log, verdict.faults)
    for breach in verdict.breaches:
        print(breach)
    print(f"{len(verdict.faults)} faults in {verdict.seconds:g} s; digest {verdict.digest}")
    return 1 if verdict.breaches else 0


def _run_mission(args: argparse.Namespace) -> int:
    try:
        fleet = Fleet(load_mission(args.mission, simulate=True), args.seed)
    except ProgramError as error:
        print("\n".join(d.render() for d in error.diagnostics), file=sys.stderr)
        return error.exit_status
    except LfieldError as error:
        print(f"{COMMAND}: {error}", file=sys.stderr)
        return error.exit_status
    seconds = args.seconds or 60.0
    storm = FaultRates(**dict(args.faults)).inject(fleet, random.Random(args.seed), seconds)
    fleet.run(seconds)
    if not args.quiet:
        _print(fleet.log, storm.faults)
    events, struck = fleet.timeline.events, len(storm.faults)
    print(f"{events} events, {struck} faults in {seconds:g} s; digest {fleet.digest}")
    return 0


def _print(log: Iterable[tuple[float, str, str]], faults: Iterable[tuple[float, str]]) -> None:
    fault_log = [(at, "weather", what) for at, what in faults]
    for at, host, text in sorted([*log, *fault_log], key=lambda line: line[0]):
        print(f"{at:12.6f} {host} | {text.rstrip()}")


def _count(text: str) -> int:
    if not text.isdecimal() or not int(text):
        raise argparse.ArgumentTypeError(f"'{text}' is no number above 0")
    return int(text)


def _numbers(text: str) -> frozenset[int]:
    if any(not part.isdecimal() for part in text.split(",") if part):
        raise argparse.ArgumentTypeError(f"'{text}' is no list of numbers, as in 3,7,12")
    return frozenset(int(part) for part in text.split(",") if part)


def _fault(text: str) -> tuple[str, float]:
    kind, _, mean = text.partition("=")
    if kind not in FAULTS:
        raise argparse.ArgumentTypeError(f"there is no fault '{kind}'; there are {', '.join(FAULTS)}")
    try:
        seconds = float(mean)
    except ValueError:
        seconds = 0.0
    if not 0.0 < seconds < float("inf"):
        raise argparse.ArgumentTypeError(f"'{text}' needs seconds above 0, as in {kind}=20")
    return kind, seconds
