"""`lfield disasm FILE`: lists a program: of a program file, of L text, of a deployment or bundle.

With `--wasm` the listing is the WebAssembly text for the engine, indented, with the instructions above it.
"""

from __future__ import annotations

import argparse
from pathlib import Path


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        "file",
        metavar="FILE",
        type=Path,
        help="program, deployment or bundle",
    )
    parser.add_argument(
        "--wasm", action="store_true", help="print WebAssembly text, with byte code as comments"
    )


def run(args: argparse.Namespace) -> int:
    """Print the listing."""
    from lfield.bytecode.disassembler import disassemble
    from lfield.mission.loader import load_program

    program = load_program(args.file)
    if args.wasm:
        from lfield.vm.wasm.wasm_listing import listing

        print(listing(program), end="")
    else:
        print(disassemble(program), end="")
    return 0
