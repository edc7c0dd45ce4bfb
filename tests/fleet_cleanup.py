"""Closes the simulated fleets that a test leaves running.

The tasks of a killed process must not be unwound, so they stay in memory until `Fleet.close`. Without it, the
fleets of all tests fill gigabytes, and each garbage collection visits them.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from typing import Any

import pytest


class FleetCleanup:
    """Records the fleets that are created during the call of a test, and closes them after it."""

    def __init__(self) -> None:
        self._created: list[Any] = []
        self._is_recording = self._is_installed = False

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_call(self, item: pytest.Item) -> Iterator[None]:
        """Close the fleets after the test; those of fixtures may live longer."""
        self._install()
        self._is_recording = True
        try:
            return (yield)
        finally:
            self._is_recording = False
            for fleet in self._created:
                fleet.close()
            self._created.clear()

    def _install(self) -> None:
        # Only where a test has imported the module, which loads slowly.
        module = sys.modules.get("lfield.simulate.host_fleet")
        if self._is_installed or module is None:
            return
        self._is_installed = True
        make = module.Fleet.__init__

        def record(fleet: Any, *given: Any, **options: Any) -> None:
            make(fleet, *given, **options)
            if self._is_recording:
                self._created.append(fleet)

        module.Fleet.__init__ = record
