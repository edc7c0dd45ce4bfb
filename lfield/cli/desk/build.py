"""`lfield build FILE.L [-o FILE]`: compiles a program to a program file."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare its options."""
    parser.add_argument("file", metavar="FILE.L", type=Path, help="the program")
    parser.add_argument("-o", "--output", metavar="FILE", type=Path, help="default: FILE.lb beside it")


def run(args: argparse.Namespace) -> int:
    """Write the program file and say where it is and what its identity is."""
    from lfield.bytecode.encoding import encode
    from lfield.cli.files import write_bytes
    from lfield.mission.load import compile_file

    program, warnings = compile_file(args.file)
    for warning in warnings:
        print(warning.render(), file=sys.stderr)
    output = args.output or args.file.with_suffix(".lb")
    data = encode(program)
    write_bytes(output, data)
    print(f"{output}: {len(data)} bytes, program {program.digest.hex()[:16]}", file=sys.stderr)
    return 0
