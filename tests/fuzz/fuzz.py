"""Compares two engines with random programs: see `engine_fuzzer/command_line.py`."""

from __future__ import annotations

import sys

from engine_fuzzer.command_line import main

if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
