"""A guard process in its sandbox records, is killed, and is restarted."""

from __future__ import annotations

import asyncio
import time

import can
import pytest

from lfield.guard.messages import GuardRecording
from lfield.guard.recording import guard_inputs as inputs
from lfield.guard.recording.guard_records import InputRecord
from lfield.guard.recording.guard_replay import replay_guard
from lfield.guard.recording.guard_segments import read_segment, rings_in, telemetry_in
from lfield.recording.folders import create_folder
from lfield.testing.driver_bench import bind, guarded, running_fake
from lfield_can import PLUGIN

pytestmark = pytest.mark.process


def finished_calls(folder):
    """The tokens of the calls whose results are on the disk."""
    records = [record for paths in rings_in(folder).values() for record in read_segment(paths[-1]).records]
    events = [record.input for record in records if isinstance(record, InputRecord)]
    return [event.token for event in events if isinstance(event, inputs.CallFinished)]


def logged_bytes(folder):
    return sum(path.stat().st_size for path in folder.glob("guard-*/wire-*"))


async def until(condition):
    end = time.monotonic() + 60.0
    while not condition():
        assert time.monotonic() < end
        await asyncio.sleep(0.02)


@pytest.mark.few(0)
def test_killed_guard_leaves_a_recording_that_the_next_one_continues(tmp_path):
    folder = create_folder(tmp_path / "rec", "north", 7, 0.0)

    async def scenario():
        bound = bind(
            PLUGIN, "CanAxis", agent="winch", field="axis", endpoint=fake.endpoint,
            options={"node": 3, "protocol": "odrive"}, waivers=["no_homing", "device_watchdog"],
        )  # fmt: skip
        recording = GuardRecording(str(folder), 1 << 20, "run 7")
        async with guarded(bound, recording=recording) as (axis,):
            await axis.call("release")
            # A kill may lose the last second: wait until the call and some frames are on the disk.
            await until(lambda: finished_calls(folder) and logged_bytes(folder))
            await axis.kill_guard()
        return [note for note in axis.notes if "recording" in note]

    with running_fake("can", "--device", "odrive:3") as fake:
        assert asyncio.run(scenario()) == []
    ((device, paths),) = rings_in(folder).items()
    result = replay_guard(paths)
    assert (device, len(paths), result.differences, result.missing) == ("winch.axis", 2, 0, [])
    start = read_segment(paths[0]).start
    assert (start.host, start.incarnation, start.run) == ("north", "00000007", "run 7")
    assert "velocity" in {value.quantity for value in telemetry_in(paths)}
    logs = sorted(folder.glob("guard-winch.axis/wire-*.candump.log"))
    assert len(logs) == 2
    directions = []
    for log in logs:
        with can.LogReader(log) as reader:
            directions.append({message.is_rx for message in reader})
    # Only the second guard commands the safe state.
    assert directions == [{True}, {True, False}]
    assert {path.stat().st_mode & 0o777 for path in folder.glob("*/*")} == {0o600}
