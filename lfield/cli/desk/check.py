"""`lfield check FILE`: all errors and warnings of programs, deployments and their devices; sound bundles."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from lfield import exits


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare its options."""
    parser.add_argument(
        "files",
        metavar="FILE.L",
        nargs="+",
        type=Path,
        help="programs, deployments (.dL) and bundles (.lfm)",
    )


def run(args: argparse.Namespace) -> int:
    """0 when there are no errors, else 65."""
    # A deployment leads to its program, which may be named beside it: what is wrong there is told once.
    found = list(dict.fromkeys(finding for path in args.files for finding in _findings(path)))
    for shown, _ in found:
        print(shown, file=sys.stderr)
    errors = sum(is_error for _, is_error in found)
    warnings = len(found) - errors
    if found:
        print(f"lfield: {errors} error(s), {warnings} warning(s)", file=sys.stderr)
    return exits.DATA if errors else exits.DONE


def _findings(path: Path) -> list[tuple[str, bool]]:
    """What is found in a file, drawn, and whether it is an error.

    A bundle has the warnings with which it was built. Raises BundleError for one that is not sound.
    """
    from lfield.mission import bundle
    from lfield.mission.load import check_file, device_problems

    if path.suffix == bundle.SUFFIX:
        return [(warning, False) for warning in bundle.read(path).warnings]
    found = [(found.render(), found.severity == "error") for found in check_file(path)]
    if path.suffix == ".dL" and not any(is_error for _, is_error in found):
        found += [(problem, True) for problem in device_problems(path)]
    return found
