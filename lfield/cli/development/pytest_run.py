"""Runs pytest with the surrounding project's configuration, or without the parts that pytest refuses.

That project may need plugins that are not installed here.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Generator, Sequence
from typing import Any

import pytest

#: The parts without which pytest is tried, with their options, from none to all of the configuration.
_ATTEMPTS = {
    "": (),
    "addopts and required_plugins of the pytest configuration": (
        "-o", "addopts=", "-o", "required_plugins=", "-o", "minversion=",
    ),
    "pytest configuration": ("-c", os.devnull, "--rootdir", "."),
}  # fmt: skip
#: The variables whose options and plugins pytest adds to those of its configuration.
_VARIABLES = ("PYTEST_ADDOPTS", "PYTEST_PLUGINS")


class _RefusedError(Exception):
    """Pytest has refused its configuration, its command line or a plugin, and has printed no message."""


class _Startup:
    """A pytest plugin that reports a refusal as an exception, before pytest prints it.

    The plugin also declares settings of plugins that are not installed: pytest would warn about each, and
    fail if the configuration is strict or makes warnings errors. `notice` is printed when pytest has accepted
    all settings.
    """

    def __init__(self, notice: str) -> None:
        self._notice = notice
        self._parser: pytest.Parser

    def pytest_addoption(self, parser: pytest.Parser) -> None:
        self._parser = parser

    @pytest.hookimpl(wrapper=True)
    def pytest_cmdline_parse(self) -> Generator[None, Any, Any]:
        try:
            return (yield)
        except (Exception, pytest.fail.Exception) as error:
            raise _RefusedError(_reason(str(error))) from error

    @pytest.hookimpl(tryfirst=True)
    def pytest_cmdline_main(self, config: pytest.Config) -> None:
        if self._notice:
            print(f"lfield: {self._notice}", file=sys.stderr)
        # pytest has no public list of them.
        for name in getattr(config, "_get_unknown_ini_keys", tuple)():
            self._parser.addini(name, "of a plugin that is not installed")


def _reason(message: str) -> str:
    """The reason in a message of pytest, which begins with its usage and ends with its files."""
    return message.rpartition(" error: ")[2].strip().partition("\n")[0]


def run_pytest(arguments: Sequence[str]) -> int:
    """Run pytest with these arguments; returns its exit status."""
    reason = ""
    for ignored, options in _ATTEMPTS.items():
        if ignored:
            for name in _VARIABLES:
                os.environ.pop(name, None)
        notice = f"{ignored} ignored: {reason}" if ignored else ""
        try:
            return int(pytest.main([*options, *arguments], plugins=[_Startup(notice)]))
        except _RefusedError as error:
            reason = reason or str(error)
    # The configuration is not the cause, so pytest reports it.
    return int(pytest.main([*options, *arguments]))
