"""External or damaged files: bundles, programs, journals, dumps, and texts."""

from __future__ import annotations

import atexit
import hashlib
import random
import shutil
import struct
import tempfile
import zlib
from collections.abc import Sequence
from contextlib import closing, suppress
from functools import cache
from pathlib import Path
from typing import Any

import msgspec
from decoder_corpus import fixed
from decoder_missions import DEPLOYMENT, DEVICES, PROGRAM, mission
from decoder_target import Target
from targets_of_links import NoObservations, assert_no_bug_in_lfield, pack, transfers, unpack

from lfield.bytecode import encoding
from lfield.capability.condition_compiler import compile_query
from lfield.cli.views.journal_view import journal_lines
from lfield.clock import ManualClock
from lfield.driver.plugins import discover
from lfield.errors import LfieldError, ProgramError
from lfield.host.context import HostContext
from lfield.host.core import HostCore
from lfield.host.events.event_recorder import EventRecorder
from lfield.journal.file_journal import FileJournal
from lfield.journal.journal_loader import JournalOwner
from lfield.journal.readonly_view import open_read_only
from lfield.journal.records import (
    CoordinatorRecord,
    FenceRecord,
    JournalEntry,
    PendingCallRecord,
    ProgramRecord,
    RecordError,
    RecordKey,
    StartCounter,
    _check,
    decode_record,
    encode_record,
)
from lfield.lang.deployment import parse_deployment
from lfield.lang.frontend import check_text
from lfield.mission import bundle
from lfield.mission.bindings_file import read_bindings
from lfield.mission.mission import needed_devices
from lfield.operator.query_parser import parse_query
from lfield.replication.membership.overlay import Overlay
from lfield.vm.inspection import dump_file
from lfield.vm.inspection.block_view import view

#: The folder of the fuzzer's files, in memory if possible.
FOLDER = Path(tempfile.mkdtemp(prefix="lfield-fuzz-", dir="/dev/shm" if Path("/dev/shm").is_dir() else None))
atexit.register(shutil.rmtree, FOLDER, ignore_errors=True)
OWNER = JournalOwner("mission", "alpha", "this computer")


# -- bundles and programs -------------------------------------------------------------------------------


def decode_bundle(data: bytes) -> None:
    """Decode a bundle with correct digests; the input is the tree of its parts. Valid bundles run briefly."""
    try:
        parts = [pack(part) if part else b"" for part in unpack(data)]
    except (msgspec.MsgspecError, ValueError, RecursionError, TypeError, OverflowError):
        return
    rows = [(name, len(p), hashlib.sha256(p).digest()) for name, p in zip(bundle.PARTS, parts, strict=False)]
    table = pack(rows)
    head = struct.pack("<4sHHI32s", b"LFMB", bundle.VERSION, 0, len(table), hashlib.sha256(table).digest())
    try:
        decoded = bundle.decode(head + table + b"".join(parts))
    except LfieldError as error:
        str(error)
        return
    clock, name = ManualClock(), decoded.team.hosts[0]
    neighbours = Overlay(decoded.team.hosts, 0, is_full_mesh=decoded.registry is not None)
    core = HostCore(
        HostContext(
            decoded,
            name,
            7,
            clock,
            NoObservations(),
            random.Random(1),
            10.0,
            neighbours,
            EventRecorder(clock),
        )
    )
    core.start_resources(first=True)
    core.start_coordinators(first=True)
    for _ in range(6):
        pause = core.run()
        assert_no_bug_in_lfield(core.drain_effects())
        clock.advance(pause or 0.0)
    core.hello()
    bundle.encode(decoded)


def decode_bundle_bytes(data: bytes) -> None:
    """Decode the raw bytes of a bundle file."""
    try:
        bundle.decode(data)
    except LfieldError as error:
        str(error)


def decode_program(data: bytes) -> None:
    """Decode a program file with a correct checksum: core and debug information, each as a tree."""
    try:
        core, debug = (pack(part) for part in unpack(data))
    except (msgspec.MsgspecError, ValueError, RecursionError, TypeError, OverflowError):
        return
    body = core + debug
    head = struct.pack("<4sHH32sI", b"LFLP", encoding.VERSION, 0, hashlib.sha256(body).digest(), len(core))
    try:
        encoding.decode(head + body)
    except LfieldError as error:
        str(error)


def decode_dump(data: bytes) -> None:
    """Show the dump of a failed agent as `lfield inspect` does; the checksum is correct."""
    try:
        record, program, block = dump_file.decode(_dump_head() + struct.pack("<I", zlib.crc32(data)) + data)
        view(block, program, record.members)
    except LfieldError as error:
        str(error)


@cache
def _dump_head() -> bytes:
    return _a_dump()[:8]


# -- journals -------------------------------------------------------------------------------------------


def decode_page(data: bytes) -> None:
    """Decode a page of a journal, key and body, with a correct checksum, then with a wrong one."""
    try:
        kind, name, number, version, body = unpack(data)
        key, body = RecordKey(kind, name, number), pack(body)
        check = _check(key, 1.0, version, body)
        with suppress(RecordError):
            decode_record(JournalEntry(key, 1.0, version, body, check ^ 1))
        decode_record(JournalEntry(key, 1.0, version, body, check))
    except RecordError as error:
        str(error)
    except (
        msgspec.MsgspecError,
        ValueError,
        TypeError,
        RecursionError,
        AttributeError,
        struct.error,
        OverflowError,
    ):
        # Not an entry: SQLite's columns have types.
        return


def decode_journal(data: bytes) -> None:
    """Decode the files of a journal: the length of its database in four bytes, the database, the log."""
    size = int.from_bytes(data[:4], "big")
    shutil.rmtree(FOLDER / "journal", ignore_errors=True)
    (FOLDER / "journal").mkdir(mode=0o700)
    path = FOLDER / "journal" / "host.journal"
    path.write_bytes(data[4 : 4 + size])
    path.with_name("host.journal-wal").write_bytes(data[4 + size :])
    # The repair writes a copy, which SQLite would sync to the disk.
    elsewhere, tempfile.tempdir = tempfile.tempdir, str(FOLDER)
    try:
        _inspect(path)
    finally:
        tempfile.tempdir = elsewhere


def _inspect(path: Path) -> None:
    """Read the journal as `lfield inspect` does, then as its host does."""
    with suppress(LfieldError):
        list(journal_lines(open_read_only(path)))
    with suppress(LfieldError):
        FileJournal(path, OWNER, lambda told: None, ManualClock()).close()


# -- texts ----------------------------------------------------------------------------------------------


def _text(data: bytes) -> str:
    return data.decode("utf-8", "replace")


def shown(error: ProgramError) -> None:
    """Render each diagnostic of the error."""
    for finding in error.diagnostics:
        assert finding.render()


def decode_query(data: bytes) -> None:
    """Parse and compile a query to the registry."""
    registry = mission().registry
    assert registry is not None
    for ask in (
        lambda: parse_query(_text(data), registry),
        lambda: compile_query(_text(data), registry.attributes),
    ):
        try:
            ask()
        except ProgramError as error:
            shown(error)
        except LfieldError as error:
            str(error)


def decode_deployment(data: bytes) -> None:
    """Decode a deployment."""
    try:
        parse_deployment("mission.dL", _text(data), dict(mission().program.units))
    except ProgramError as error:
        shown(error)


def decode_program_text(data: bytes) -> None:
    """Decode a program in L."""
    for finding in check_text(_text(data), "mission.L").diagnostics:
        finding.render()


def decode_bindings(data: bytes) -> None:
    """Decode a devices file."""
    path = FOLDER / "mission.devices.yaml"
    path.write_bytes(data)
    loaded = mission()
    try:
        read_bindings(path, needed_devices(loaded.program, loaded.team), discover(), hosts=loaded.team.hosts)
    except LfieldError as error:
        str(error)


# -- seeds ----------------------------------------------------------------------------------------------


def _parts() -> list[Any]:
    parts = bundle.contents(bundle.encode(mission())).parts
    return [unpack(part) if part else 0 for part in parts.values()]


def _bundles() -> list[bytes]:
    """A valid bundle, and bundles with one error at each place."""
    data = bundle.encode(mission())
    found, table = bundle.contents(data), pack([["program", 0, bytes(32)]])

    def headed(table: bytes, version: int = bundle.VERSION) -> bytes:
        digest = hashlib.sha256(table).digest()
        return struct.pack("<4sHHI32s", b"LFMB", version, 0, len(table), digest) + table

    of_parts = [[*row] for row in found.table]
    longer = pack([[*of_parts[0][:1], 1 << 20, of_parts[0][2]], *of_parts[1:]])
    wrong = [
        headed(b"", 9),
        headed(b"\xc1"),
        headed(table),
        headed(longer),
        data[:-1] + b"\xc1",
        data[:60],
        b"LF",
    ]
    return [data, *wrong]


def _program_parts() -> list[Any]:
    program = mission().program
    return [unpack(encoding.encode_core(program)), unpack(pack(program.debug))]


def _pages() -> Sequence[Any]:
    block, program = transfers()[0][1], mission().program
    return (
        CoordinatorRecord("tom", 1, "RUN", 3, 2, "", "", "", 0, "", "", "", program.digest, block),
        CoordinatorRecord("ann", 1, "PREPARED", 3, 2, "", "", "bravo", 9, "", "", "", program.digest, block),
        CoordinatorRecord("ann", 2, "EXITED", 3, 2, outcome="died", detail="why", ended_on="bravo"),
        PendingCallRecord("tom", 1, 2, "bell", "ring", "done", b"\0" * 8, program.digest),
        StartCounter(4),
        FenceRecord("idle", 3),
        ProgramRecord(program.digest, encoding.encode(program), ("bell",), ("Bell",), ("alpha",)),
    )


def _entries() -> list[Any]:
    found = [encode_record(page, 1.0) for page in _pages()]
    return [(*each.key, each.version, unpack(each.body)) for each in found]


def _a_dump() -> bytes:
    clock = ManualClock()
    from targets_of_links import host

    core = host("alpha", clock, 7)
    core.start_coordinators(first=True)
    core.run()
    agent = core.machine.agents["tom"]
    team, program = core.team, core.mission.program
    return dump_file.encode("alpha", "why", agent.limits.heap, team.members, team.hosts, program, agent.block)


def _journals() -> list[bytes]:
    folder = FOLDER / "seed"
    folder.mkdir(mode=0o700, exist_ok=True)
    path = folder / "host.journal"
    with closing(FileJournal(path, OWNER, lambda told: None, ManualClock())) as journal:
        fresh = path.read_bytes()
        journal._commit([([page], ()) for page in _pages()[:6]])
        log, database = path.with_name("host.journal-wal").read_bytes(), path.read_bytes()
    content = path.read_bytes()
    return [len(d).to_bytes(4, "big") + d + w for d, w in ((fresh, b""), (database, log), (content, b""))]


_QUESTIONS = (
    b"Lift where payload >= 2.0 && battery > 0.1 order by battery desc limit 5",
    b"Lift where distance(here) < 3.0 || environment == terrestrial",
    b"Lift where payload in {1.0}",
)
_OF_BUNDLES = ("tom", "alpha", "Bell", "dynamixel", *range(30))
_OF_QUESTIONS = (
    "Lift",
    " where ",
    "payload",
    "&&",
    "||",
    "!",
    "(",
    ")",
    "order by ",
    "limit ",
    "9" * 40,
    "1e999",
)
_OF_QUESTIONS += ("distance(", "in ", "{", '"')
_OF_TEAMS = ("//", "@", ":", "?", "&", "%41", "%ff", "%", "65536", "\n", "é", "Bell", "Walker")
_OF_PROGRAMS = ("together", "reserve", "within", "{", "}", "(", ")", ";", "[", "]", "class", "new", '"', "/*")
_OF_BINDINGS = (": ", "\n", "  ", "- ", "{", "}", "[", "]", "&a", "*a", "!!python/object", "near", "devices")
_OF_BINDINGS += ("1e999", ".nan", "2001-01-01", "0x10", "'")

TARGETS = (
    Target("bundle", lambda: [pack(_parts())], decode_bundle, True, _OF_BUNDLES, share=4),
    Target("bundle-file", _bundles, decode_bundle_bytes),
    Target("program", lambda: [pack(_program_parts())], decode_program, True, (*range(60), "Bell", "ring")),
    Target("dump", lambda: [_a_dump()[12:]], decode_dump, True),
    Target("page", lambda: list(map(pack, _entries())), decode_page, True, ("tom", "copy", "begun", "RUN")),
    Target("journal", lambda: fixed("journal", _journals), decode_journal),
    Target("question", lambda: _QUESTIONS, decode_query, tokens=_OF_QUESTIONS),
    Target("deployment", lambda: [DEPLOYMENT.encode()], decode_deployment, tokens=_OF_TEAMS),
    Target("program-text", lambda: [PROGRAM.encode()], decode_program_text, tokens=_OF_PROGRAMS),
    Target("bindings", lambda: [DEVICES.encode()], decode_bindings, tokens=_OF_BINDINGS, share=5),
)
