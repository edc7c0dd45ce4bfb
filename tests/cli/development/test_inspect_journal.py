"""`lfield inspect` of a journal: its coordinators, their states, and its damage."""

from __future__ import annotations

import asyncio
import io
import json
import re
import sqlite3
from collections.abc import Sequence
from contextlib import closing, redirect_stderr, redirect_stdout
from pathlib import Path
from typing import NamedTuple

import pytest

from lfield.cli.main import main
from lfield.clock import ManualClock
from lfield.journal.file_journal import FileJournal
from lfield.journal.journal_loader import JournalOwner
from lfield.journal.records import (
    CoordinatorRecord,
    EmergencyStopFlag,
    FenceRecord,
    PauseFlag,
    PendingCallRecord,
    ProgramRecord,
    Record,
    ReservationRecord,
    RunMarker,
    StartCounter,
)
from lfield.vm.inspection import dump_file

DUMP = Path(__file__).parents[2] / "formats" / "dump-0.3.block"

SHOWN = """\
journal   of barn in harvest
identity  IDENTITY
starts    4
run       not ended
paused    until 'lfield resume'
stopped   until 'lfield estop --lift': the emergency stop was pressed: fog
program   PROGRAM, SIZE bytes
fence     left: no start before 2

boss, start 3: EXITED: ended
  as of     2027-01-15 08:00:00 UTC
  transfer  0, after 0 hops
  ended     died on field: MathException: division by zero

boss, start 4: PREPARED: migrating, unconfirmed
  as of     2027-01-15 08:00:00 UTC
  transfer  7, after 5 hops
  sent to   field, memory 000000000000002a
  block     BLOCK bytes of program PROGRAM
STACK
digger, start 1: ABSENT: rejected
  as of     2027-01-15 08:00:00 UTC
  transfer  2, after 0 hops
  refused   LimitException: too large

scout, start 1: RUN: here
  as of     2027-01-15 08:00:00 UTC
  transfer  1, after 1 hop
  block     8 bytes of program 0909090909090909
  stack not shown: the program is not in this journal
"""


class Said(NamedTuple):
    status: int
    out: str
    err: str


def inspect(path: Path, *options: str) -> Said:
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        status = main(["inspect", str(path), *options])
    return Said(status, out.getvalue(), err.getvalue())


def journal(folder: Path) -> FileJournal:
    owner = JournalOwner("harvest", "barn", "this computer")
    return FileJournal(folder / "host.journal", owner, print, ManualClock(1_800_000_000.0))


def pages() -> Sequence[Record]:
    record, program, _ = dump_file.decode(DUMP.read_bytes())
    digest = program.digest
    return (
        StartCounter(4),
        RunMarker(True),
        PauseFlag(True),
        EmergencyStopFlag("the emergency stop was pressed: fog"),
        ProgramRecord(digest, record.program, record.members, record.types, record.hosts),
        FenceRecord("left", 2),
        CoordinatorRecord("scout", 1, "RUN", 1, 1, program=b"\t" * 32, block=bytes(8)),
        CoordinatorRecord(
            "boss",
            4,
            "PREPARED",
            7,
            5,
            target="field",
            receiver_memory=42,
            program=digest,
            block=record.block,
        ),
        CoordinatorRecord(
            "boss", 3, "EXITED", outcome="died", detail="MathException: division by zero", ended_on="field"
        ),
        CoordinatorRecord("digger", 1, "ABSENT", 2, kind="LimitException", reason="too large"),
    )


def kept(folder: Path) -> FileJournal:
    path = journal(folder)
    asyncio.run(path.persist(pages()))
    return path


def sql(folder: Path, statement: str) -> None:
    with closing(sqlite3.connect(folder / "host.journal")) as connection, connection:
        connection.execute(statement)


def test_all_records_are_shown_while_a_host_has_the_journal_and_after(tmp_path: Path) -> None:
    path = kept(tmp_path)
    record, program, _ = dump_file.decode(DUMP.read_bytes())
    stack = re.search(r"thread.*?\n(?=\nfields)", inspect(DUMP).out, re.DOTALL)
    assert stack
    expected = (
        SHOWN.replace("IDENTITY", f"{path.identity:016x}")
        .replace("PROGRAM", program.digest.hex()[:16])
        .replace("SIZE", str(len(record.program)))
        .replace("BLOCK", str(len(record.block)))
        .replace("STACK", "".join(f"  {line}\n" for line in stack[0].splitlines()))
    )
    assert "at Loader." in expected
    assert inspect(tmp_path) == Said(0, expected, "")
    path.close()
    assert inspect(tmp_path / "host.journal") == Said(0, expected, "")


def test_all_records_are_shown_as_json(tmp_path: Path) -> None:
    path = kept(tmp_path)
    path.close()
    dumped = json.loads(inspect(DUMP, "--json").out)
    status, out, err = inspect(tmp_path, "--json")
    assert (status, err) == (0, "")
    found = json.loads(out)
    assert (found["kind"], found["host"], found["deployment"]) == ("journal", "barn", "harvest")
    by_key = {(each["record"], each.get("agent"), each.get("generation")): each for each in found["records"]}
    assert len(by_key) == len(pages())
    boss = by_key["copy", "boss", 4]
    assert (boss["state"], boss["target"], boss["hops"]) == ("PREPARED", "field", 5)
    assert boss["threads"] == dumped["threads"] != []
    assert by_key["copy", "scout", 1]["threads"] is None
    assert "threads" not in by_key["copy", "boss", 3]
    assert by_key["copy", "scout", 1]["block"] == "00" * 8
    assert by_key["program", None, None]["code"] == {
        "bytes": len(dump_file.decode(DUMP.read_bytes())[0].program)
    }


def test_a_damaged_journal_as_json_ends_with_the_error(tmp_path: Path) -> None:
    kept(tmp_path).close()
    sql(tmp_path, "UPDATE pages SET kept = kept + 1 WHERE name = 'digger'")
    output = inspect(tmp_path, "--json")
    found, error = map(json.loads, output.out.splitlines())
    assert "the copy of digger, start 1" in found["damaged"][0]["what"]
    assert (output.status, error["exit_status"]) == (65, 65)


def test_a_folder_without_a_journal_is_reported(tmp_path: Path) -> None:
    output = inspect(tmp_path)
    assert (output.status, output.out) == (66, "")
    assert output.err == f"lfield: cannot read {tmp_path}: the folder has no host.journal\n"
    file = tmp_path / "host.journal"
    file.symlink_to("nowhere")
    for named in (tmp_path, file):
        output = inspect(named)
        assert output == Said(66, "", f"lfield: cannot read {file}: it is a link that leads nowhere\n")
    file.unlink()
    file.mkdir()
    for named in (tmp_path, file):
        assert inspect(named).err == f"lfield: cannot read {file}: it is a folder\n"


def test_a_damaged_page_is_named_and_all_others_are_shown(tmp_path: Path) -> None:
    kept(tmp_path).close()
    sql(tmp_path, "UPDATE pages SET kept = kept + 1 WHERE name = 'digger'")
    output = inspect(tmp_path)
    assert output.status == 65
    assert "scout, start 1: RUN" in output.out
    assert (
        "\ndamaged: the copy of digger, start 1, stored 2027-01-15 08:00:01 UTC: its checksum" in output.out
    )
    assert output.err.endswith("host.journal: 1 damaged page\n")
    journal(tmp_path).close()
    output = inspect(tmp_path)
    assert (output.status, output.err) == (0, "")
    assert "\nmoved aside: the copy of digger, start 1" in output.out


def test_pending_calls_are_shown_with_their_state(tmp_path: Path) -> None:
    path = journal(tmp_path)
    under_way, ended = (
        PendingCallRecord("boss", 4, 1, "left", "lift"),
        PendingCallRecord("boss", 4, 2, "right", "lift", "done", bytes(16)),
    )
    asyncio.run(path.persist([under_way, ended]))
    path.close()
    as_of = "  as of     2027-01-15 08:00:00 UTC\n"
    assert (
        f"\nboss, start 4: call 1 started: left.lift\n{as_of}  outcome   unknown: the call was running\n"
        f"\nboss, start 4: call 2 started: right.lift\n{as_of}"
        "  outcome   completed; the result is waiting for its caller, 16 bytes\n"
    ) in inspect(tmp_path).out
    sql(tmp_path, "UPDATE pages SET body = x'00' WHERE number = 2")
    damaged = inspect(tmp_path)
    assert damaged.status == 65
    assert "damaged: call 2 started here by start 4 of boss, stored" in damaged.out


def test_reservations_are_shown(tmp_path: Path) -> None:
    path = journal(tmp_path)
    asyncio.run(path.persist([ReservationRecord("arm", 41, "boss", 4), ReservationRecord("leg", 7)]))
    path.close()
    out = inspect(tmp_path).out
    assert "reserved  arm, number 41: boss, start 4\n" in out
    assert "reserved  leg, number 7: free\n" in out
    sql(tmp_path, "UPDATE pages SET body = x'00' WHERE name = 'arm'")
    damaged = inspect(tmp_path)
    assert damaged.status == 65
    assert "damaged: the reservation of arm, stored" in damaged.out


def test_the_rest_of_a_truncated_journal_is_shown(tmp_path: Path) -> None:
    kept(tmp_path).close()
    path = tmp_path / "host.journal"
    path.write_bytes(path.read_bytes()[:-4096])
    output = inspect(path)
    assert output.status == 65
    assert output.out.startswith("journal   of barn in harvest\n")
    assert "starts    4\n" in output.out
    assert "damaged; the readable records are above" in output.err


@pytest.mark.parametrize(
    ("statement", "data", "says"),
    [
        ("PRAGMA user_version = 7", None, "it has format 7, this lfield reads format 1"),
        ("PRAGMA application_id = 7", None, ""),
        (None, b"no journal", "not a journal, or completely damaged: file is not a database"),
        (None, b"", "not a journal"),
    ],
)
def test_a_file_of_another_format_is_one_sentence(
    tmp_path: Path, statement: str | None, data: bytes | None, says: str
) -> None:
    kept(tmp_path).close()
    if statement is not None:
        sql(tmp_path, statement)
    if data is not None:
        (tmp_path / "host.journal").write_bytes(data)
    output = inspect(tmp_path)
    assert output.status == 65
    assert says in output.err
    assert len(output.err.splitlines()) == 1
