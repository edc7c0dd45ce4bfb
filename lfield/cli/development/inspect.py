"""`lfield inspect FILE`: a dumped agent with its L stack and heap; a journal; or the parts of a mission."""

from __future__ import annotations

import argparse
import json
import os
from pathlib import Path
from typing import TYPE_CHECKING

from lfield.errors import KeysError, UsageError

if TYPE_CHECKING:
    from lfield.mission.bundle import BundleContents
    from lfield.vm.inspection.block_view import BlockView


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        "file",
        metavar="FILE",
        type=Path,
        help="dump (from 'lfield up --dump DIR'), journal, directory of a journal, bundle or deployment",
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def run(args: argparse.Namespace) -> int:
    """Print the contents of the file."""
    from lfield.journal.journal import FILE_NAME
    from lfield.mission import bundle

    if os.path.isdir(args.file) and args.file.name != FILE_NAME:
        return _show_folder(args.file, as_json=args.json)
    # Files that were moved aside are named after the journal.
    if FILE_NAME in args.file.name:
        return _show_journal(args.file, as_json=args.json)
    if args.file.suffix in (bundle.SUFFIX, ".dL"):
        return _show_mission(args.file, as_json=args.json)
    if args.file.suffix in (".L", ".lb"):
        raise UsageError(
            f"{args.file} is a program: 'lfield disasm {args.file}' shows it, and 'lfield inspect "
            f"{args.file.with_suffix('.dL')}' the mission of its deployment"
        )
    return _show_dump(args.file, as_json=args.json)


def _show_dump(file: Path, *, as_json: bool) -> int:
    from lfield.cli.views.journal_view import interval_line, thread_lines
    from lfield.errors import BlockError
    from lfield.text.input_files import read_bytes
    from lfield.text.terminal_escape import escape
    from lfield.vm.inspection import dump_file
    from lfield.vm.inspection.block_view import view

    try:
        record, program, block = dump_file.decode(read_bytes(file, dump_file.MAX_SIZE))
    except BlockError as error:
        raise BlockError(f"{file}: {error.reason}", word=error.word) from None
    block_view = view(block, program, record.members)
    if as_json:
        from lfield.cli.views.inspection_json import dump_data

        print(json.dumps(dump_data(record, block_view, program.digest)))
        return 0
    trail = " → ".join(record.hosts[n] if 0 <= n < len(record.hosts) else str(n) for n in block_view.trail)
    print(f"agent     {block_view.id} ({block_view.kind} {block_view.type})")
    print(f"on        {record.host}, after {block_view.hops} hop(s): {trail}")
    if block_view.interval:
        print(interval_line(block_view.interval))
    print(f"program   {program.digest.hex()[:16]}")
    if record.reason:
        print("why       " + escape(record.reason).replace("\n", "\n          "))
    for thread in block_view.threads:
        print("\n" + "\n".join(thread_lines(thread)))
    _print_state(block_view, record.limit)
    return 0


def _print_state(block_view: BlockView, limit: int) -> None:
    print(f"\nfields of {block_view.id}")
    for name, value in block_view.fields:
        print(f"       {name} = {value}")
    print(f"\nheap: {block_view.used} of {limit} bytes")
    for name, count, size in block_view.heap:
        print(f"  {size:>9} bytes  {count:>6} × {name}")


def _show_folder(folder: Path, *, as_json: bool) -> int:
    """Print the journal in a folder. Raises InputFileError if there is none."""
    from lfield.errors import InputFileError
    from lfield.journal.journal import FILE_NAME
    from lfield.text.input_files import error_reason

    file = folder / FILE_NAME
    try:
        file.lstat()
    except FileNotFoundError:
        raise InputFileError(str(folder), f"the folder has no {FILE_NAME}") from None
    except OSError as error:
        raise InputFileError(str(folder), error_reason(error)) from None
    return _show_journal(file, as_json=as_json)


def _show_journal(file: Path, *, as_json: bool) -> int:
    """Print the readable records, then raise for the damaged ones."""
    from lfield.cli.views.journal_view import journal_lines
    from lfield.errors import DamagedFileError
    from lfield.journal.readonly_view import open_read_only
    from lfield.text.terminal_escape import escape

    journal = open_read_only(file)
    if as_json:
        from lfield.cli.views.inspection_json import journal_data

        print(json.dumps(journal_data(journal)))
    else:
        for line in journal_lines(journal):
            print(escape(line))
    if journal.fault:
        raise DamagedFileError(str(file), f"damaged; the readable records are above: {journal.fault}")
    if journal.damaged:
        count = len(journal.damaged)
        raise DamagedFileError(str(file), f"{count} damaged page{'s' * (count > 1)}")
    return 0


def _show_mission(file: Path, *, as_json: bool) -> int:
    """Print the parts of a bundle, or of the bundle that a deployment would give."""
    from lfield.mission import bundle
    from lfield.mission.loader import load_mission
    from lfield.text.suggestions import listed
    from lfield.wire.fields import short_digest

    if file.suffix == bundle.SUFFIX:
        data = bundle.read_file(file)
        mission = bundle.read(file)
    else:
        mission = load_mission(file)
        data = bundle.encode(mission)
    contents = bundle.contents(data)
    if as_json:
        from lfield.cli.views.inspection_json import mission_data

        signed = _signed(contents) if file.suffix == bundle.SUFFIX else None
        print(json.dumps(mission_data(mission, contents, signed)))
        return 0
    print(f"bundle    {short_digest(contents.digest)} of {mission.name}")
    if file.suffix == bundle.SUFFIX:
        print(f"signed    {_signed(contents)}")
    for part in contents.table:
        print(f"          {part.name:<9}{part.size:>9} bytes  {part.digest.hex()[:16]}")
    for number, host in enumerate(mission.team.hosts):
        agents = mission.team.members_on(number)
        print(f"\nhost {host} at {mission.team.addresses[number]}{'' if agents else ', a witness'}")
        for member in agents:
            print(f"  {member.kind} {member.id} ({member.type})")
            for device in mission.bindings.of([member.id]):
                print(f"    {device.field} = {device.type} by {device.driver} at {device.endpoint}")
    if mission.fenced:
        print(f"\nrecovery of {listed(sorted(mission.fenced))} by {mission.recovery}")
    if mission.access.file:
        names = [person.name for person in mission.access.people]
        names += [caller.name for caller in mission.access.callers]
        print(f"\n{mission.access.file} restricts the rights of: {listed(dict.fromkeys(names))}")
    for name, driver in mission.drivers.by_driver.items():
        print(f"\ndriver {name} of {driver.to_install}")
    return 0


def _signed(contents: BundleContents) -> str:
    """The signer of a bundle, verified with the keys on this computer."""
    from lfield.authority.keystore import local_folders, read_trusted
    from lfield.authority.peer_verification import format_time

    if not contents.signature:
        return "no"
    folders = local_folders(os.environ)
    if not folders:
        return "yes, signer unknown: no keys on this computer"
    # Importing cryptography is slow; unsigned bundles do not need it.
    from lfield.authority.bundle_signature import verify_bundle

    try:
        signer, at = verify_bundle(contents.digest, contents.signature, read_trusted(folders[0]))
    except KeysError as error:
        return f"not verified: {error}"
    return f"by {signer}, {format_time(at)}"
