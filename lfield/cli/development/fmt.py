"""`lfield fmt FILE...`: programs and deployments in one layout, with the same code and comments."""

from __future__ import annotations

import argparse
import os
import stat
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from lfield import exit_status
from lfield.errors import OutputFileError, ProgramError, UsageError

if TYPE_CHECKING:
    from lfield.errors import ReportableFinding
    from lfield.text.source_text import Source

_STDIN = Path("-")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        "files",
        metavar="FILE",
        nargs="+",
        type=Path,
        help="programs (.L) and deployments (.dL), which are changed in place; - for a program on stdin, "
        "which is printed",
    )
    parser.add_argument(
        "--check",
        action="store_true",
        help="change no file; print the files that would change, and end with status 1 if there are any",
    )


def run(args: argparse.Namespace) -> int:
    """Format the files without syntax errors. Raises ProgramError with the errors of the other ones."""
    changed = False
    findings: list[ReportableFinding] = []
    for path in args.files:
        try:
            changed |= _format(path, check=args.check)
        except ProgramError as error:
            findings.extend(error.diagnostics)
    if findings:
        raise ProgramError(findings)
    return exit_status.FAILED if args.check and changed else exit_status.DONE


def _format(path: Path, *, check: bool) -> bool:
    """Format a file; returns whether it changes. Raises ProgramError, InputFileError, OutputFileError."""
    from lfield.text.input_files import MAX_TEXT, read_bytes, read_up_to

    data = read_up_to(sys.stdin.buffer, MAX_TEXT) if path == _STDIN else read_bytes(path, MAX_TEXT)
    formatted = _formatted(path, data)
    is_changed = formatted != data
    if path == _STDIN and not check:
        print(formatted.decode("utf-8"), end="")
    elif is_changed:
        if not check:
            _replace(path, formatted)
        print(path)
    return is_changed


def _formatted(path: Path, data: bytes) -> bytes:
    from lfield.editor.layout.formatter import format_deployment, format_program

    if path.suffix == ".dL":
        return format_deployment(_source(path, data)).encode("utf-8")
    if path.suffix == ".L" or path == _STDIN:
        return format_program(_source(path, data)).encode("utf-8")
    raise UsageError(f"{path} is neither a program (.L) nor a deployment (.dL)")


def _source(path: Path, data: bytes) -> Source:
    """The text of a file. Raises ProgramError if it is not UTF-8."""
    from lfield.lang import messages
    from lfield.text.input_files import invalid_byte
    from lfield.text.source_text import Source

    try:
        return Source(str(path), data.decode("utf-8-sig"))
    except UnicodeDecodeError as error:
        where, byte = invalid_byte(str(path), error)
        raise ProgramError([messages.NOT_UTF8.at(where, byte=byte)]) from None


def _replace(path: Path, data: bytes) -> None:
    """Write the file atomically, with its mode; a link stays a link. Raises OutputFileError."""
    from lfield.cli.output_files import write_bytes

    target = Path(os.path.realpath(path))
    if not os.access(target, os.W_OK):
        raise OutputFileError(str(path), "permission denied")
    write_bytes(target, data, mode=stat.S_IMODE(target.stat().st_mode))
