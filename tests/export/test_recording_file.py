"""The file of a recording: never overwritten, readable after each flush, complete on a full disk."""

from __future__ import annotations

import errno
import io
import os
from pathlib import Path

import pytest
from export_script import FRAMED, flight, readable
from mcap.reader import make_reader

from lfield.cli.event_recording import event_recording
from lfield.cli.output_files import RecordingFile
from lfield.errors import OutputFileError
from lfield.export.mcap_writer import END_WITHOUT_SUMMARY, McapRecording
from lfield.operator.dashboard.event_feed import FeedNotice
from lfield.operator.dashboard.timeline.event_timeline import DatedEvent


def test_a_file_that_exists_is_kept(tmp_path):
    path = tmp_path / "flight.mcap"
    path.write_bytes(b"precious")
    with pytest.raises(OutputFileError):
        RecordingFile(path)
    (tmp_path / "dangling").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(OutputFileError):
        RecordingFile(tmp_path / "dangling")
    assert path.read_bytes() == b"precious"
    assert not (tmp_path / "elsewhere").exists()


@pytest.mark.parametrize("path", [Path("/nowhere/at/all.mcap"), Path("/")])
def test_a_path_that_cannot_be_written_is_an_error(path):
    with pytest.raises(OutputFileError):
        RecordingFile(path)


def test_a_device_is_written_to():
    file = RecordingFile(Path("/dev/full"))
    file.write(b"x")
    with pytest.raises(OutputFileError):
        file.flush()
    with pytest.raises(OutputFileError):
        file.flush()
    file.close()


class FullDisk:
    """A disk with so many bytes free, counted in the calls of one file."""

    def __init__(self, free: int) -> None:
        self.free, self.write_bytes = free, os.write

    def write(self, file: int, data: bytes) -> int:
        if self.free <= 0:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        written = self.write_bytes(file, bytes(data[: self.free]))
        self.free -= written
        return written


@pytest.mark.parametrize("free", [3000, 9000, 14000])
def test_a_recording_on_a_full_disk_is_complete_up_to_the_last_flush(free, tmp_path, monkeypatch):
    path, disk = tmp_path / "flight.mcap", FullDisk(free)
    file = RecordingFile(path, END_WITHOUT_SUMMARY)
    recording = McapRecording(FRAMED, file)
    monkeypatch.setattr(os, "write", disk.write)
    flushed = 0

    def fly() -> None:
        nonlocal flushed
        while True:
            for item in flight():
                recording.add(item)
                recording.flush()
                flushed = recording.messages

    truncate = os.ftruncate

    def free_space(handle: int, size: int) -> None:
        disk.free += os.fstat(handle).st_size - size
        truncate(handle, size)

    monkeypatch.setattr(os, "ftruncate", free_space)
    with pytest.raises(OutputFileError):
        fly()
    with pytest.raises(OutputFileError):
        recording.finish()
    file.close()
    data = path.read_bytes()
    assert flushed > 0
    assert readable(data) == flushed
    if data.endswith(END_WITHOUT_SUMMARY):
        assert len(list(make_reader(io.BytesIO(data)).iter_messages())) == flushed


def test_an_interrupted_recording_is_complete(tmp_path, capsys):
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
