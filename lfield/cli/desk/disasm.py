"""`lfield disasm FILE`: lists a program: of a program file, of L text, of a deployment or bundle."""

from __future__ import annotations

import argparse
from pathlib import Path


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare its options."""
    parser.add_argument(
        "file",
        metavar="FILE",
        type=Path,
        help="a program file, L text, a deployment or a bundle",
    )


def run(args: argparse.Namespace) -> int:
    """Print the listing."""
    from lfield.bytecode.disassemble import disassemble
    from lfield.mission.load import load_program

    print(disassemble(load_program(args.file)), end="")
    return 0
