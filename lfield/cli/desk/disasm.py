"""`lfield disasm FILE`: lists the program of a program file or bundle, or an L program once compiled."""

from __future__ import annotations

import argparse
from pathlib import Path


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare its options."""
    parser.add_argument("file", metavar="FILE", type=Path, help="a program file, a bundle, or FILE.L")


def run(args: argparse.Namespace) -> int:
    """Print the listing."""
    from lfield.bytecode.disassemble import disassemble
    from lfield.mission.load import load_program

    print(disassemble(load_program(args.file)), end="")
    return 0
