"""`lfield build`: a mission to one file that robots run (`mission.lfm`), or a program to a program file."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from lfield.cli.mission_argument import add_bindings, add_program
from lfield.errors import UsageError

if TYPE_CHECKING:
    from lfield.mission.build_inputs import InputRecorder
    from lfield.mission.mission import Mission


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        "file",
        metavar="FILE",
        type=Path,
        help="deployment (.dL) or program (.L) to compile, or bundle (.lfm) to rebuild with other bindings",
    )
    parser.add_argument(
        "-o",
        "--output",
        metavar="FILE",
        type=Path,
        help="output file (default: FILE.lfm, or FILE.lb for a program)",
    )
    add_program(parser)
    add_bindings(parser)
    parser.add_argument(
        "--capabilities",
        metavar="FILE",
        type=Path,
        help="registry of the mission (default: MISSION.capabilities.yaml)",
    )
    parser.add_argument("--sim", action="store_true", help="bind simulated devices in place of the real ones")
    # For `lfield up`, which caches the bundle: names of files are unchanged, and the inputs are written to a
    # file; an error is also a JSON object (lfield/cli/main.py).
    parser.add_argument("--inputs", metavar="FILE", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--json", action="store_true", help=argparse.SUPPRESS)


def run(args: argparse.Namespace) -> int:
    """Write the file and print its path and identity."""
    if args.file.suffix in (".dL", ".lfm"):
        return _build_bundle(args)
    if args.file.suffix != ".L" and args.file.is_file():
        raise UsageError(f"{args.file} is neither a deployment (.dL) nor a program (.L) nor a bundle (.lfm)")
    if args.program or args.devices or args.capabilities or args.sim:
        raise UsageError(f"{args.file} is a program: build the bundle of a deployment (.dL) to bind devices")
    return _build_program(args)


def _build_program(args: argparse.Namespace) -> int:
    from lfield.bytecode.encoding import encode
    from lfield.cli.output_files import write_bytes
    from lfield.mission.loader import compile_file

    program, warnings = compile_file(args.file)
    for warning in warnings:
        print(warning.render(), file=sys.stderr)
    output = args.output or args.file.with_suffix(".lb")
    data = encode(program)
    write_bytes(output, data)
    print(f"{output}: {len(data)} bytes, program {program.digest.hex()[:16]}", file=sys.stderr)
    return 0


def _build_bundle(args: argparse.Namespace) -> int:
    from lfield.cli.output_files import write_bytes
    from lfield.mission import bundle

    watch = _input_recorder() if args.inputs else None
    mission = _mission(args)
    output = args.output or args.file.with_suffix(bundle.SUFFIX)
    if watch is not None:
        write_bytes(output, bundle.encode(mission))
        _write_inputs(args, watch)
        return 0
    from lfield.mission.relocation import companion_files, relocate

    for warning in mission.warnings:
        print(warning, file=sys.stderr)
    mission = relocate(mission, args.file.parent, (args.devices or args.file).parent)
    data = bundle.encode(mission)
    write_bytes(output, data)
    _print_summary(output, data, mission, companion_files(mission))
    return 0


def _mission(args: argparse.Namespace) -> Mission:
    from lfield.mission import bundle
    from lfield.mission.loader import load_mission, rebound

    if args.file.suffix != bundle.SUFFIX:
        return load_mission(
            args.file, args.program, args.devices, simulate=args.sim, capabilities=args.capabilities
        )
    if args.program or args.capabilities:
        raise UsageError(f"{args.file} is a bundle, which has its program and registry: give the .dL file")
    if args.devices is None and args.output is None:
        raise UsageError(f"{args.file} is a bundle: give it other bindings with --devices, or a name with -o")
    mission = bundle.read(args.file)
    if args.devices is not None:
        return rebound(mission, args.devices, simulate=args.sim)
    return mission.on_fakes() if args.sim else mission


def _print_summary(output: Path, data: bytes, mission: Mission, extra_files: list[str]) -> None:
    from lfield.mission import bundle
    from lfield.wire.fields import short_digest

    digest = short_digest(bundle.contents(data).digest)
    hosts = ", ".join(mission.team.hosts)
    print(f"{output}: {len(data)} bytes, bundle {digest}, for {hosts}", file=sys.stderr)
    if extra_files:
        print(f"copy to the same folder: {', '.join(extra_files)}", file=sys.stderr)


def _input_recorder() -> InputRecorder:
    from lfield.mission.build_inputs import InputRecorder

    return InputRecorder()


def _write_inputs(args: argparse.Namespace, watch: InputRecorder) -> None:
    """Write the inputs of the bundle, and the missing files that would be inputs."""
    import msgspec

    from lfield.capability.registry_reader.registry_files import shipped_folder
    from lfield.mission.loader import ACCESS, CAPABILITIES, DEVICES

    candidates = [args.file.with_suffix(suffix) for suffix in (ACCESS, CAPABILITIES, DEVICES)]
    inputs = watch.inputs([*candidates, shipped_folder()], args.inputs.parent)
    args.inputs.write_bytes(msgspec.msgpack.encode(inputs))
