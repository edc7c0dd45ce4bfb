"""`lfield check FILE`: all errors and warnings of programs, deployments and their devices; sound bundles."""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from lfield import exit_status
from lfield.errors import UsageError

if TYPE_CHECKING:
    from lfield.errors import ReportableFinding


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        "files",
        metavar="FILE",
        nargs="+",
        type=Path,
        help="programs (.L, .lb), deployments (.dL) and bundles (.lfm)",
    )
    parser.add_argument("--json", action="store_true", help="print the findings as a JSON array")


def run(args: argparse.Namespace) -> int:
    """Returns 0 when there are no errors, else 65."""
    from lfield.text.message_tables import render_findings, tally

    found = _without_duplicates(finding for path in args.files for finding in _findings(path))
    errors = sum(finding.severity == "error" for finding in found)
    if args.json:
        print(json.dumps([finding.as_data() for finding in found], indent=2))
    elif found:
        print(render_findings(found), file=sys.stderr)
        print(f"lfield: {tally(errors, len(found) - errors)}", file=sys.stderr)
    return exit_status.DATA if errors else exit_status.DONE


def _without_duplicates(findings: Iterable[ReportableFinding]) -> list[ReportableFinding]:
    """The findings, each once: a program may be named itself and by its deployment."""
    found: dict[str, ReportableFinding] = {}
    for finding in findings:
        data = finding.as_data()
        if data.get("file"):
            data["file"] = os.path.realpath(str(data["file"]))
        found.setdefault(json.dumps(data, sort_keys=True), finding)
    return list(found.values())


def _findings(path: Path) -> list[ReportableFinding]:
    """The findings about a file.

    A bundle has the warnings with which it was built. Raises BundleError or ProgramFileError for a compiled
    file that is not sound, and UsageError for a file of another kind.
    """
    from lfield.mission import bundle
    from lfield.mission.loader import check_file, load_program, mission_problems
    from lfield.text.source_text import PlainFinding

    if path.suffix in (".yaml", ".yml"):
        raise UsageError(
            f"{path} is not a program: check its deployment (.dL), which uses the files beside it"
        )
    if path.suffix == bundle.SUFFIX:
        return [PlainFinding(warning, "warning", "bundle-warning") for warning in bundle.read(path).warnings]
    if path.suffix == ".lb":
        load_program(path)
        return []
    # A deployment in a program file would be valid: its lines are comments there.
    if path.suffix not in (".L", ".dL") and path.is_file():
        raise UsageError(f"{path} is neither a program (.L, .lb) nor a deployment (.dL) nor a bundle (.lfm)")
    found = list(check_file(path, _hosts_with_keys() if path.suffix == ".dL" else ()))
    program = path.with_suffix(".L")
    if path.suffix == ".dL" and not program.exists():
        missing = f"there is no {program}: the types and arguments of {path} were not checked"
        return [*found, PlainFinding(missing, "warning", "no-program")]
    if any(finding.severity == "error" for finding in found):
        return [*found, *_broken_drivers()]
    return [*found, *mission_problems(path)] if path.suffix == ".dL" else found


def _broken_drivers() -> Iterator[ReportableFinding]:
    """A warning for each installed driver that cannot be used: it may provide a type that the program
    lacks.
    """
    from lfield.driver.plugins import discover
    from lfield.text.source_text import PlainFinding

    return (PlainFinding(problem, "warning", "driver-broken") for problem in discover().problems)


def _hosts_with_keys() -> frozenset[str]:
    """The hosts for which the authority of this user has made keys: an inventory of the team."""
    from lfield.authority.keystore import authority_folder
    from lfield.errors import NoHomeFolder

    try:
        folder = authority_folder(os.environ)
    except NoHomeFolder:
        return frozenset()
    if not folder.is_dir():
        return frozenset()
    # This import loads cryptography.
    from lfield.authority.ledger import issued_hosts

    return issued_hosts(folder)
