"""What is read from files that others have made or spoiled: bundles, programs, journals, dumps, and texts."""

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
from targets_of_links import Nothing, no_bug_of_ours, pack, transfers, unpack

from lfield.bytecode import encoding
from lfield.capability.matching.expression import compile_wish
from lfield.cli.views.journal_view import journal_lines
from lfield.clock import ManualClock
from lfield.driver.plugins import discover
from lfield.errors import LfieldError, ProgramError
from lfield.host.core import HostCore
from lfield.journal.file import FileJournal
from lfield.journal.opening import Owner
from lfield.journal.pages import (
    BegunPage,
    CopyPage,
    Entry,
    Fence,
    Key,
    PageError,
    ProgramPage,
    Starts,
    _check,
    entry,
    page_of,
)
from lfield.journal.reading import see
from lfield.lang.deployment import parse_deployment
from lfield.lang.frontend import check_text
from lfield.mission import bundle
from lfield.mission.bindings_file import read_bindings
from lfield.mission.mission import needed_devices
from lfield.mobility.neighbours import Neighbourhood
from lfield.operator.question import read_question
from lfield.vm.inspect import dump
from lfield.vm.inspect.decode import view

#: Where files of fuzzers lie: in memory, where there is such a place.
FOLDER = Path(tempfile.mkdtemp(prefix="lfield-fuzz-", dir="/dev/shm" if Path("/dev/shm").is_dir() else None))
atexit.register(shutil.rmtree, FOLDER, ignore_errors=True)
OWNER = Owner("mission", "alpha", "this computer")


# -- bundles and programs -------------------------------------------------------------------------------


def take_bundle(data: bytes) -> None:
    """A bundle whose digests are right; the input is its parts as one tree. A sound one runs for a while."""
    try:
        parts = [pack(part) if part else b"" for part in unpack(data)]
    except (msgspec.MsgspecError, ValueError, RecursionError, TypeError, OverflowError):
        return
    rows = [(name, len(p), hashlib.sha256(p).digest()) for name, p in zip(bundle.PARTS, parts, strict=False)]
    table = pack(rows)
    head = struct.pack("<4sHHI32s", b"LFMB", bundle.VERSION, 0, len(table), hashlib.sha256(table).digest())
    try:
        made = bundle.decode(head + table + b"".join(parts))
    except LfieldError as error:
        str(error)
        return
    clock, name = ManualClock(), made.team.hosts[0]
    neighbours = Neighbourhood(made.team.hosts, 0, everybody=made.registry is not None)
    core = HostCore(made, name, 7, clock, Nothing(), random.Random(1), 10.0, neighbours)
    core.start_resources(first=True)
    core.start_coordinators(first=True)
    for _ in range(6):
        pause = core.run()
        no_bug_of_ours(core.take())
        clock.advance(pause or 0.0)
    core.hello()
    bundle.encode(made)


def take_bundle_bytes(data: bytes) -> None:
    """A file that should be a bundle."""
    try:
        bundle.decode(data)
    except LfieldError as error:
        str(error)


def take_program(data: bytes) -> None:
    """A program file whose checksum is right: core and debug information, each as a tree."""
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


def take_dump(data: bytes) -> None:
    """What `lfield inspect` shows of an agent that died somewhere; the checksum is right."""
    try:
        record, program, block = dump.decode(_dump_head() + struct.pack("<I", zlib.crc32(data)) + data)
        view(block, program, record.members)
    except LfieldError as error:
        str(error)


@cache
def _dump_head() -> bytes:
    return _a_dump()[:8]


# -- journals -------------------------------------------------------------------------------------------


def take_page(data: bytes) -> None:
    """A page of a journal: its key and its body, whose checksum is right; and then is not."""
    try:
        kind, name, number, version, body = unpack(data)
        key, body = Key(kind, name, number), pack(body)
        check = _check(key, 1.0, version, body)
        with suppress(PageError):
            page_of(Entry(key, 1.0, version, body, check ^ 1))
        page_of(Entry(key, 1.0, version, body, check))
    except PageError as error:
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
        # What is no entry: SQLite's columns have types.
        return


def take_journal(data: bytes) -> None:
    """The files of a journal: the length of its database in four bytes, that, and its log."""
    size = int.from_bytes(data[:4], "big")
    shutil.rmtree(FOLDER / "journal", ignore_errors=True)
    (FOLDER / "journal").mkdir(mode=0o700)
    path = FOLDER / "journal" / "host.journal"
    path.write_bytes(data[4 : 4 + size])
    path.with_name("host.journal-wal").write_bytes(data[4 + size :])
    # It is salvaged in a copy, for which SQLite would wait until it is on a disk.
    elsewhere, tempfile.tempdir = tempfile.tempdir, str(FOLDER)
    try:
        _look_at(path)
    finally:
        tempfile.tempdir = elsewhere


def _look_at(path: Path) -> None:
    """As `lfield inspect` does, and then as a host that has it."""
    with suppress(LfieldError):
        list(journal_lines(see(path)))
    with suppress(LfieldError):
        FileJournal(path, OWNER, lambda told: None, ManualClock()).close()


# -- texts ----------------------------------------------------------------------------------------------


def _text(data: bytes) -> str:
    return data.decode("utf-8", "replace")


def shown(error: ProgramError) -> None:
    """What is wrong is told with a caret."""
    for finding in error.diagnostics:
        assert finding.render()


def take_question(data: bytes) -> None:
    """What somebody asks of the registry."""
    registry = mission().registry
    assert registry is not None
    for ask in (
        lambda: read_question(_text(data), registry),
        lambda: compile_wish(_text(data), registry.attributes),
    ):
        try:
            ask()
        except ProgramError as error:
            shown(error)
        except LfieldError as error:
            str(error)


def take_deployment(data: bytes) -> None:
    """A deployment."""
    try:
        parse_deployment("mission.dL", _text(data), dict(mission().program.units))
    except ProgramError as error:
        shown(error)


def take_program_text(data: bytes) -> None:
    """A program in L."""
    for finding in check_text(_text(data), "mission.L").diagnostics:
        finding.render()


def take_bindings(data: bytes) -> None:
    """A devices file."""
    path = FOLDER / "mission.devices.yaml"
    path.write_bytes(data)
    made = mission()
    try:
        read_bindings(path, needed_devices(made.program, made.team), discover(), hosts=made.team.hosts)
    except LfieldError as error:
        str(error)


# -- seeds ----------------------------------------------------------------------------------------------


def _parts() -> list[Any]:
    parts = bundle.contents(bundle.encode(mission())).parts
    return [unpack(part) if part else 0 for part in parts.values()]


def _bundles() -> list[bytes]:
    """A good one, and one that is wrong at each of its places."""
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
        CopyPage("tom", 1, "RUN", 3, 2, "", "", "", 0, "", "", "", program.digest, block),
        CopyPage("ann", 1, "PREPARED", 3, 2, "", "", "bravo", 9, "", "", "", program.digest, block),
        CopyPage("ann", 2, "EXITED", 3, 2, outcome="died", detail="why", ended_on="bravo"),
        BegunPage("tom", 1, 2, "bell", "ring", "done", b"\0" * 8, program.digest),
        Starts(4),
        Fence("idle", 3),
        ProgramPage(program.digest, encoding.encode(program), ("bell",), ("Bell",), ("alpha",)),
    )


def _entries() -> list[Any]:
    found = [entry(page, 1.0) for page in _pages()]
    return [(*each.key, each.version, unpack(each.body)) for each in found]


def _a_dump() -> bytes:
    clock = ManualClock()
    from targets_of_links import host

    core = host("alpha", clock, 7)
    core.start_coordinators(first=True)
    core.run()
    agent = core.machine.agents["tom"]
    team, program = core.team, core.mission.program
    return dump.encode("alpha", "why", agent.limits.heap, team.members, team.hosts, program, agent.block)


def _journals() -> list[bytes]:
    folder = FOLDER / "seed"
    folder.mkdir(mode=0o700, exist_ok=True)
    path = folder / "host.journal"
    with closing(FileJournal(path, OWNER, lambda told: None, ManualClock())) as journal:
        fresh = path.read_bytes()
        journal._commit([([page], ()) for page in _pages()[:6]])
        log, database = path.with_name("host.journal-wal").read_bytes(), path.read_bytes()
    whole = path.read_bytes()
    return [len(d).to_bytes(4, "big") + d + w for d, w in ((fresh, b""), (database, log), (whole, b""))]


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
    Target("bundle", lambda: [pack(_parts())], take_bundle, True, _OF_BUNDLES, share=4),
    Target("bundle-file", _bundles, take_bundle_bytes),
    Target("program", lambda: [pack(_program_parts())], take_program, True, (*range(60), "Bell", "ring")),
    Target("dump", lambda: [_a_dump()[12:]], take_dump, True),
    Target("page", lambda: list(map(pack, _entries())), take_page, True, ("tom", "copy", "begun", "RUN")),
    Target("journal", lambda: fixed("journal", _journals), take_journal),
    Target("question", lambda: _QUESTIONS, take_question, words=_OF_QUESTIONS),
    Target("deployment", lambda: [DEPLOYMENT.encode()], take_deployment, words=_OF_TEAMS),
    Target("program-text", lambda: [PROGRAM.encode()], take_program_text, words=_OF_PROGRAMS),
    Target("bindings", lambda: [DEVICES.encode()], take_bindings, words=_OF_BINDINGS, share=5),
)
