"""`lfield check FILE.L`: every error and warning of a program, or of a deployment."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare its options."""
    parser.add_argument(
        "files", metavar="FILE.L", nargs="+", type=Path, help="programs and deployments (.dL)"
    )


def run(args: argparse.Namespace) -> int:
    """0 when there are no errors, else 65."""
    from lfield.mission.load import check_file

    found = [diagnostic for path in args.files for diagnostic in check_file(path)]
    for diagnostic in found:
        print(diagnostic.render(), file=sys.stderr)
    errors = sum(d.severity == "error" for d in found)
    warnings = len(found) - errors
    if found:
        print(f"lfield: {errors} error(s), {warnings} warning(s)", file=sys.stderr)
    return 65 if errors else 0
