"""The files of a guard's recording: names and modes, restarts, rotation, and disk errors."""

from __future__ import annotations

import asyncio
import resource
import sys
import time
from contextlib import contextmanager
from pathlib import Path

import pytest

# For thing_guard, the in-memory guard of the shell's tests.
sys.path.insert(0, str(Path(__file__).parents[1]))
from thing_guard import Output, guard_of, known_thing

from lfield.driver.binding import DeviceBinding
from lfield.driver.device import Device
from lfield.guard.messages import Beat, GuardCall, GuardRecording, Note, OpenDevices, Stop, encode
from lfield.guard.recording.guard_records import framed
from lfield.guard.recording.guard_replay import replay_guard
from lfield.guard.recording.guard_segments import read_segment, rings_in, telemetry_in
from lfield.manifest import Instruction, Quantity
from lfield.recording.folders import guard_folder
from lfield.recording.ring_writer import FILES, RingWriter
from lfield.simulate.jumping_loop import JumpingLoop, LoopClock

THING = known_thing(Instruction("rise"), telemetry=(Quantity("height", "real", "m"),))
BINDING = DeviceBinding(
    agent="a", field="lift", type="Thing", driver="thing", endpoint="here", safe_state="off",
    waivers=["device_watchdog"],
)  # fmt: skip
RECORDS, WIRE = "guard", "wire"


class Lift(Device):
    """A device whose driver logs its wire."""

    async def _open(self):
        self.log(b"hello")
        return "a lift"

    async def _make_safe(self, state):
        self.log(b"safe")

    async def do_rise(self):
        self.log(b"rise")
        self.publish(height=2.0)

    def log(self, data):
        self._reports._driver.wire_log.log_bytes(data, is_sent=True)


@pytest.fixture
def folder(tmp_path):
    """The guard's folder inside a recording folder, as the host creates it."""
    path = guard_folder(tmp_path, "a.lift")
    path.mkdir()
    return path


def run_guard(folder, limit=1 << 20, calls=1, scenario=None):
    """Runs a guard that records into a folder; returns its sent messages."""

    async def flight():
        output = Output()
        shell = guard_of(Lift, output)
        recording = GuardRecording(str(folder), limit, "run 7")
        shell.data_received(encode(OpenDevices([BINDING], "", 9.0, THING, [], recording)))
        await asyncio.sleep(0.1)
        for token in range(1, calls + 1):
            now = LoopClock().monotonic()
            shell.data_received(encode(Beat(now)))
            shell.data_received(encode(GuardCall(token, "a.lift", "rise", [], now, now + 9.0)))
            await asyncio.sleep(0.05)
        if scenario is not None:
            await scenario(output)
        shell.data_received(encode(Stop("the host is stopping")))
        assert await shell.exit == 0
        await shell.close()
        return output.received

    with asyncio.Runner(loop_factory=JumpingLoop) as runner:
        return runner.run(flight())


def failures_in(received):
    return [note.text for note in received if isinstance(note, Note) and note.code == "recording-ended"]


async def wait_for_both_failures(output):
    """Waits in real time for the notes of both writer threads."""
    end = time.monotonic() + 5.0
    while len(failures_in(output.received)) < 2:
        assert time.monotonic() < end
        time.sleep(0.005)
        await asyncio.sleep(0.0)


def test_guard_records_decisions_telemetry_and_wire(folder):
    received = run_guard(folder, calls=30)
    assert failures_in(received) == []
    names = sorted(path.name for path in folder.iterdir())
    assert names == [f"{RECORDS}-000001.lfrec", f"{WIRE}-000001.hex.log"]
    assert {path.stat().st_mode & 0o777 for path in folder.iterdir()} == {0o600}
    ((device, paths),) = rings_in(folder.parent).items()
    result = replay_guard(paths)
    assert (device, result.differences, result.cut) == ("a.lift", 0, {})
    assert result.digests > 100
    assert [(value.quantity, value.value, value.unit) for value in telemetry_in(paths)] == [
        ("height", 2.0, "m")
    ]
    assert len((folder / names[1]).read_text().splitlines()) == 1 + 32


def test_restarted_guard_continues_the_ring(folder):
    run_guard(folder)
    run_guard(folder)
    ((_, paths),) = rings_in(folder.parent).items()
    assert [path.name for path in paths] == [f"{RECORDS}-000001.lfrec", f"{RECORDS}-000002.lfrec"]
    assert [read_segment(path).start.number for path in paths] == [0, 0]
    assert replay_guard(paths).differences == 0


def test_full_ring_stays_within_its_limit_and_is_replayable(folder):
    limit = 400_000
    run_guard(folder, limit, calls=3000)
    ((_, paths),) = rings_in(folder.parent).items()
    assert 2 < len(paths) <= FILES + 1
    assert paths[0].name != f"{RECORDS}-000001.lfrec"
    assert sum(path.stat().st_size for path in folder.iterdir()) <= limit
    result = replay_guard(paths)
    assert (result.differences, result.cut, result.missing) == (0, {}, [])
    assert next(iter(telemetry_in(paths))).value == 2.0


def test_ring_smaller_than_the_guard_state_still_has_records(folder):
    """A file whose first record is larger than its share of the limit still takes further records."""
    run_guard(folder, 4 * 6400, calls=300)
    ((_, paths),) = rings_in(folder.parent).items()
    first = read_segment(paths[0])
    size = len(framed(first.start))
    assert size > 6400 // FILES
    assert len(paths) > 1
    assert paths[0].stat().st_size >= 3 * size


@contextmanager
def file_size_limit(size):
    """Limits each file to `size` bytes, like a full disk."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def test_full_disk_ends_each_log_with_one_note_not_the_guard(folder):
    with file_size_limit(64):
        received = run_guard(folder, scenario=wait_for_both_failures)
    found = failures_in(received)
    assert len(found) == 2
    assert any(f"{folder.name}/{RECORDS}.lfrec" in text for text in found)
    assert any(f"{WIRE}.hex.log" in text for text in found)
    ((_, paths),) = rings_in(folder.parent).items()
    assert replay_guard(paths).missing == paths


@pytest.mark.parametrize("place", ["removed", "a file", "/proc/self"])
def test_unwritable_folder_ends_the_logs_not_the_guard(folder, place):
    (folder / "a file").touch()
    received = run_guard(folder / place, scenario=wait_for_both_failures)
    assert len(failures_in(received)) == 2


def test_slow_disk_ends_the_ring(tmp_path, monkeypatch):
    monkeypatch.setattr("lfield.recording.ring_writer.MAX_PENDING", 100)
    monkeypatch.setattr("lfield.recording.ring_writer.FLUSH_INTERVAL", 3600.0)
    failures = []
    ring = RingWriter(tmp_path, "x", ".log", 1 << 20, failures.append)
    for _ in range(10):
        ring.append(bytes(30))
    assert len(failures) == 1
    assert ring.failure == failures[0]
    assert not ring.is_full
    ring.close()


def test_ring_deletes_the_oldest_files_including_those_of_an_earlier_process(tmp_path):
    for number in (3, 4):
        (tmp_path / f"x-{number:06d}.log").write_bytes(bytes(40))
    (tmp_path / "x-other-000001.log").write_bytes(bytes(40))
    ring = RingWriter(tmp_path, "x", ".log", 100, pytest.fail, b"head")
    ring.start_file(bytes(26))
    ring.start_file()
    ring.append(bytes(36))
    ring.close()
    sizes = {path.name: path.stat().st_size for path in tmp_path.iterdir()}
    assert sizes == {"x-000005.log": 30, "x-000006.log": 40, "x-other-000001.log": 40}
