"""For any bytes in a file, a command ends with a documented status and a one-sentence message."""

from __future__ import annotations

import asyncio
import io
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from lfield import exit_status
from lfield.cli.main import main
from lfield.clock import ManualClock
from lfield.journal.file_journal import FileJournal
from lfield.journal.journal_loader import JournalOwner
from lfield.journal.records import CoordinatorRecord, StartCounter

FORMATS = Path(__file__).parents[2] / "formats"

# : Valid files: a small mission with every part, and files of earlier releases.
GOOD = {
    "mission.L": b"""include <mavlink/copter.L>;
resource Sky {
    Mavlink fc;
    init(string[] arg) { }
    portal climb(real up) emit real { fc.takeoff(up); return up; }
    portal descend(real down) emit real { fc.land(); return down; }
}
coordinator Boss { init(string[] arg) { findSky(arg[1]).climb(3.0); } }
""",
    "mission.dL": b"//Sky:sky@alpha\n//Boss:boss@bravo?sky\n",
    "mission.devices.yaml": b"""silence: 0.3
agents:
  sky:
    heap: 64 KiB
    devices:
      fc:
        {driver: mavlink, endpoint: "udp:127.0.0.1:9", limits: {speed: 5.0}, waivers: [device_watchdog]}
""",
    "mission.capabilities.yaml": b"""registry: 1
providers:
  Sky:
    meaning: a copter of our own
    attributes: {payload: 300 g, environment: [aerial]}
    live: {battery: fc.battery}
    serves: {Climb: {}}
agents:
  sky: {payload: 0.8, tools: [sling]}
""",
    "hello.lb": (FORMATS / "program-0.3.lb").read_bytes(),
    "hello.block": (FORMATS / "dump-0.3.block").read_bytes(),
    "kept/setup-1.json": b"""{"version": 2, "entries": [{"when": "now", "identity": "a copter",
"changes": [{"name": "FS_GCS_ENABLE", "was": 0.0, "now": 5.0}], "binding": {"agent": "sky", "field": "fc",
"type": "Mavlink", "driver": "mavlink", "endpoint": "udp:127.0.0.1:9"}}]}""",
}
#: Command lines, and the file with changed bytes. An unknown host ends commands that a valid file would let
#: continue: they start no process and open no device. `build` first builds the bundle for `up`.
COMMANDS = {
    "check mission.L": "mission.L",
    "check mission.dL": "mission.dL",
    "build mission.L -o out.lb": "mission.L",
    "build mission.dL -o out.lfm": "mission.dL",
    "build mission.dL --devices mission.devices.yaml -o out.lfm": "mission.devices.yaml",
    "build mission.dL --program hello.lb -o out.lfm": "hello.lb",
    "disasm mission.L": "mission.L",
    "disasm hello.lb": "hello.lb",
    "inspect hello.block": "hello.block",
    "inspect host.journal": "host.journal",
    "inspect mission.lfm": "mission.lfm",
    "inspect mission.dL": "mission.dL",
    "up --deploy mission.lfm --host nobody": "mission.lfm",
    "capabilities check mission.capabilities.yaml": "mission.capabilities.yaml",
    "capabilities check mission.capabilities.yaml --program mission.L": "mission.L",
    "capabilities show Lift --capabilities mission.capabilities.yaml": "mission.capabilities.yaml",
    "query Lift mission.dL --files": "mission.dL",
    "query Lift mission.dL --files --explain": "mission.capabilities.yaml",
    "query Lift mission.lfm --files --json": "mission.lfm",
    "doctor --deploy mission.dL --devices mission.devices.yaml --host nobody": "mission.devices.yaml",
    "setup --deploy mission.lfm --host nobody": "mission.lfm",
    "setup --deploy mission.dL --devices mission.devices.yaml --host nobody": "mission.devices.yaml",
    "setup mavlink --devices mission.devices.yaml --endpoint nowhere": "mission.devices.yaml",
    "setup --apply kept/setup-1.json": "kept/setup-1.json",
    "kit mavlink --devices mission.devices.yaml --endpoint nowhere": "mission.devices.yaml",
}
#: The statuses of such a command: success, no offers, and the documented ones for files.
ENDS = {exit_status.DONE, exit_status.USAGE, exit_status.DATA, exit_status.NO_INPUT}

# : Bytes with a meaning in one of the formats.
TEXTS = [
    "",
    "\0",
    "\n",
    "\t",
    "{",
    "}",
    "[",
    ":",
    "- ",
    "&a ",
    "*a",
    "<<: ",
    '"',
    "'",
    "//",
    "/*",
    "#",
    "@",
    "?",
]
TEXTS += ["-1", "1e999", ".nan", "null", "é\u202e\ud7ff", "!!python/name:os.system ", "9" * 40, "[" * 200]
PIECES = [*(text.encode() for text in TEXTS), b"\xff", b"\xed\xa0\x80"]
cuts = st.tuples(st.floats(0, 1), st.integers(0, 40), st.sampled_from(PIECES) | st.binary(max_size=4))

# : Further statuses for files that a mutation has left unchanged.
ALSO = {"query": {exit_status.FAILED}, "setup": {exit_status.UNAVAILABLE}, "kit": {exit_status.UNAVAILABLE}}


def mutated(good: bytes, edits: list[tuple[float, int, bytes]]) -> bytes:
    """The bytes with some of them replaced, from a fraction of the length."""
    for part, length, piece in edits:
        at = int(part * len(good))
        good = good[:at] + piece + good[at + length :]
    return good


@pytest.fixture(scope="module")
def mission(tmp_path_factory: pytest.TempPathFactory):
    """Write a folder of valid files and change to it; internal errors are raised."""
    folder = tmp_path_factory.mktemp("any")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.setenv("LFIELD_TRACEBACK", "1")
        (folder / "kept").mkdir(mode=0o700)
        for name, data in GOOD.items():
            (folder / name).write_bytes(data)
        assert said("build mission.dL -o mission.lfm")[0] == exit_status.DONE
        keep_pages(folder)
        yield folder


def keep_pages(folder: Path) -> None:
    """A journal with a few pages."""
    owner = JournalOwner("mission", "alpha", "this computer")
    journal = FileJournal(folder / "host.journal", owner, print, ManualClock())
    asyncio.run(
        journal.persist(
            [StartCounter(1), CoordinatorRecord("boss", 1, "RUN", program=bytes(32), block=bytes(5000))]
        )
    )
    journal.close()


def said(line: str) -> tuple[int, str]:
    """The status of a command in this process, and its messages."""
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        status = main(line.split())
    return status, err.getvalue()


@pytest.mark.few(3)
@pytest.mark.parametrize("line", COMMANDS)
@settings(max_examples=3, suppress_health_check=list(HealthCheck))
@given(data=st.one_of(st.binary(max_size=200), st.lists(cuts, min_size=1, max_size=4)))
def test_no_bytes_cause_a_traceback(
    mission: Path, line: str, data: bytes | list[tuple[float, int, bytes]]
) -> None:
    path = mission / COMMANDS[line]
    good = path.read_bytes()
    path.write_bytes(data if isinstance(data, bytes) else mutated(good, data))
    try:
        status, output = said(line)
    finally:
        path.write_bytes(good)
    assert status in ENDS | ALSO.get(line.partition(" ")[0], set()), output
    assert output or status in (exit_status.DONE, exit_status.FAILED)
