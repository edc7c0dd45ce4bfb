"""`lfield test`: run the tests of missions in virtual time and draw the tracks."""

from __future__ import annotations

import argparse
import importlib.util
import inspect
import os
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from lfield import exit_status
from lfield.errors import PluginError
from lfield.text.terminal_escape import unescaped_stream

#: What pytest ends with, as our statuses: passed, failed, interrupted, broken, misused, nothing found.
_STATUSES = (
    exit_status.DONE, exit_status.FAILED, exit_status.INTERRUPTED, exit_status.SOFTWARE, exit_status.USAGE,
    exit_status.NO_INPUT,
)  # fmt: skip


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """What to test, and where pictures go."""
    parser.add_argument("paths", nargs="*", metavar="PATH", help="test files or directories (default: .)")
    parser.add_argument(
        "-k", default="", metavar="WORDS", help="run only tests whose names match, as in pytest"
    )
    parser.add_argument("-x", action="store_true", help="stop after the first failure")
    parser.add_argument("-q", action="store_true", help="print less")
    parser.add_argument("-v", action="store_true", help="print the name of each test")
    parser.add_argument("-s", action="store_true", help="show the output of tests")
    parser.add_argument(
        "--tracks",
        type=Path,
        default=Path("tracks"),
        metavar="DIR",
        help="directory for the pictures (default: tracks)",
    )


def run(args: argparse.Namespace) -> int:
    """Run pytest with `lfield.testing.plugin`. Raises PluginError where pytest is not installed."""
    try:
        import pytest
    except ImportError:
        raise PluginError("'lfield test' needs pytest: pip install 'lfield[desk]'") from None
    # A plugin that the project's configuration names too is loaded once.
    options = ["-p", "lfield.testing.plugin", "--tracks", os.path.abspath(args.tracks)]
    options += [flag for flag in ("-x", "-q", "-v", "-s") if getattr(args, flag[1:])]
    options += ["-k", args.k] if args.k else []
    # It has colours of its own.
    sys.stdout, sys.stderr = unescaped_stream(sys.stdout), unescaped_stream(sys.stderr)
    if missing := _missing_plugins(args.paths):
        # The options of a project that configures absent plugins would be unknown to pytest.
        options = ["-c", os.devnull, "--rootdir", os.getcwd(), *options]
        print(f"lfield: pytest configuration ignored: {', '.join(missing)} not installed", file=sys.stderr)
    return _STATUSES[int(pytest.main([*options, *args.paths]))]


#: Options that pytest plugins add, each with the module of its plugin.
_PLUGIN_OPTIONS = {
    "-n": "xdist",
    "--numprocesses": "xdist",
    "--dist": "xdist",
    "--maxprocesses": "xdist",
    "--timeout": "pytest_timeout",
    "--timeout-method": "pytest_timeout",
    "--cov": "pytest_cov",
    "--asyncio-mode": "pytest_asyncio",
    "--reruns": "pytest_rerunfailures",
    "--benchmark-disable": "pytest_benchmark",
    "--randomly-seed": "pytest_randomly",
}


def _missing_plugins(paths: Sequence[str]) -> list[str]:
    """The modules of plugins that the surrounding project's `addopts` needs and that are not installed."""
    from _pytest.config.findpaths import determine_setup

    setup: dict[str, Any] = {
        "inifile": None,
        "override_ini": None,
        "args": list(paths),
        "rootdir_cmd_arg": None,
        "invocation_dir": Path.cwd(),
    }
    # pytest has no public function for this, and not every version has all of these parameters.
    known = inspect.signature(determine_setup).parameters
    _, _, settings, *_ = determine_setup(**{name: setup[name] for name in setup if name in known})
    found = settings.get("addopts", "")
    given: object = getattr(found, "value", found)
    listed = given if isinstance(given, list) else []
    options = shlex.split(given) if isinstance(given, str) else [str(option) for option in listed]
    needed = {
        _PLUGIN_OPTIONS[name] for option in options if (name := option.partition("=")[0]) in _PLUGIN_OPTIONS
    }
    return sorted(name for name in needed if importlib.util.find_spec(name) is None)
