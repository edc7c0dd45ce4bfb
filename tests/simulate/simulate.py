"""Deterministic simulation testing of whole teams: see `simulation_testing/command_line.py`."""

from __future__ import annotations

import sys

from simulation_testing.command_line import main

if __name__ == "__main__":
    sys.exit(main())
