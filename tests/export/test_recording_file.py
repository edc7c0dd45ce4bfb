"""The file of a recording: never overwritten, readable after each flush, complete on a full disk."""

from __future__ import annotations

import errno
import io
import os
from pathlib import Path

import pytest
from mcap.reader import make_reader
from sample_flight import FRAMED, by_topic, flight

from lfield.cli.event_recording import event_recording
from lfield.cli.output_files import RecordingFile
from lfield.errors import OutputFileError
from lfield.export.mcap_writer import END_WITHOUT_SUMMARY, McapRecording
from lfield.operator.dashboard.event_feed import FeedNotice
from lfield.operator.dashboard.timeline.event_timeline import DatedEvent


def test_existing_file_is_kept(tmp_path):
    path = tmp_path / "flight.mcap"
    path.write_bytes(b"content")
    with pytest.raises(OutputFileError):
        RecordingFile(path)
    (tmp_path / "dangling").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(OutputFileError):
        RecordingFile(tmp_path / "dangling")
    assert path.read_bytes() == b"content"
    assert not (tmp_path / "elsewhere").exists()


@pytest.mark.parametrize("path", [Path("/nowhere/at/all.mcap"), Path("/")])
def test_unwritable_path_is_an_error(path):
    with pytest.raises(OutputFileError):
        RecordingFile(path)


def test_write_error_of_a_device_file_is_raised_at_each_flush():
    file = RecordingFile(Path("/dev/full"))
    file.write(b"x")
    with pytest.raises(OutputFileError):
        file.flush()
    with pytest.raises(OutputFileError):
        file.flush()
    file.close()


class SmallDisk:
    """A disk with `size` bytes and one file."""

    def __init__(self, size: int) -> None:
        self.size, self.write_bytes = size, os.write

    def write(self, file: int, data: bytes) -> int:
        free = self.size - os.lseek(file, 0, os.SEEK_CUR)
        if free <= 0:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return self.write_bytes(file, data[:free])


@pytest.mark.parametrize("size", [3000, 9000, 14000])
def test_recording_on_a_full_disk_is_complete_up_to_the_last_flush(size, tmp_path, monkeypatch):
    path = tmp_path / "flight.mcap"
    file = RecordingFile(path, END_WITHOUT_SUMMARY)
    recording = McapRecording(FRAMED, file)
    monkeypatch.setattr(os, "write", SmallDisk(size).write)
    flushed = 0

    def record() -> None:
        nonlocal flushed
        while True:
            for item in flight():
                recording.add(item)
                recording.flush()
                flushed = recording.messages

    with pytest.raises(OutputFileError):
        record()
    with pytest.raises(OutputFileError):
        recording.finish()
    file.close()
    data = path.read_bytes()
    assert flushed > 0
    assert len(data) <= size
    assert sum(map(len, by_topic(data).values())) == flushed


def test_recording_is_valid_after_each_flush(tmp_path):
    path = tmp_path / "flight.mcap"
    file = RecordingFile(path, END_WITHOUT_SUMMARY)
    recording = McapRecording(FRAMED, file)
    for item in flight():
        recording.add(item)
        recording.flush()
        assert sum(map(len, by_topic(path.read_bytes()).values())) == recording.messages
    recording.finish()
    file.finish()
    file.close()
    data = path.read_bytes()
    assert make_reader(io.BytesIO(data)).get_summary() is not None
    assert len(data) == recording.size


def test_interrupted_recording_is_complete(tmp_path, capsys):
    path = tmp_path / "flight.mcap"

    def record() -> None:
        with event_recording(path, FRAMED) as recording:
            assert recording is not None
            for item in flight():
                if isinstance(item, DatedEvent):
                    recording.add(item)
            recording.add(FeedNotice("alpha", "unreachable: gone"))
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        record()
    summary = make_reader(io.BytesIO(path.read_bytes())).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    assert f"{summary.statistics.message_count} messages" in capsys.readouterr().err
