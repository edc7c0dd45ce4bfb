"""Runs command lines in this process, and masks output that differs from run to run."""

from __future__ import annotations

import io
import re
import shlex
import socket
from collections.abc import Iterable
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

from golden_files import MOST, shortened

from lfield import __version__
from lfield.cli.main import main

ROOT = Path(__file__).parents[2]
#: A placeholder in command lines: the output folder of a case.
FOLDER = "OUT"
#: Masked texts: those that a refactoring may change, and those that depend on the time of the run.
MASKS = (
    (re.compile(r"\d{4}-\d\d-\d\d \d\d:\d\d(:\d\d)?( UTC)?"), "TIME"),
    (re.compile(r"\b\d\d:\d\d:\d\d\.\d{3}\b"), "TIME"),
    (re.compile(rf"\b{re.escape(__version__)}\b"), "VERSION"),
    (re.compile(rf"\({re.escape(socket.gethostname())}\)"), "(COMPUTER)"),
    (re.compile(r"searched \S+( and \S+)*"), "searched FOLDERS"),
    # The bytes of bundles contain names of Python modules, and messages.
    (re.compile(r"(\d+ bytes, )?bundle( +)[0-9a-f]{16}"), r"bundle\2DIGEST"),
    (re.compile(r"(?<=          )(drivers|texts) +\d+ bytes  [0-9a-f]{16}"), r"\1 DIGEST"),
    # Keys and lists of keys.
    (re.compile(r"((?:authority|certificate|good|revoked) +)[0-9a-f]{12}\b"), r"\1ID"),
    (re.compile(r"(?<=list )\d{10}"), "NUMBER"),
    # Python 3.12 and later uses other quotes.
    (re.compile(r"\(choose from [^)]*\)"), "(choose from CHOICES)"),
)


def transcript(lines: Iterable[str], folder: Path) -> str:
    """The command lines, each with its output and exit status; `folder` replaces OUT."""
    return "".join(recorded(line, folder) for line in lines)


def recorded(line: str, folder: Path, most: int = MOST) -> str:
    """One command line with its output, shortened to a number of characters."""
    words = [word.replace(FOLDER, str(folder)) for word in shlex.split(line)]
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        status = main(words)
    output = prefixed("| ", shortened(masked(out.getvalue(), folder), most))
    output += prefixed("! ", shortened(masked(err.getvalue(), folder), most))
    return f"$ lfield {line}\n{output}= {status}\n"


def prefixed(prefix: str, text: str) -> str:
    """Every line with a prefix."""
    return "".join(f"{prefix}{line}".rstrip() + "\n" for line in text.splitlines())


def masked(text: str, folder: Path) -> str:
    """The text with its variable parts masked."""
    text = text.replace(str(folder), FOLDER).replace(str(ROOT), "ROOT")
    for pattern, mask in MASKS:
        text = pattern.sub(mask, text)
    return text
