"""Writing the files that commands name."""

from __future__ import annotations

import os
import tempfile
from contextlib import suppress
from pathlib import Path

from lfield.errors import OutputFileError


def write_bytes(path: Path, data: bytes) -> None:
    """Write a file atomically. Raises OutputFileError.

    A device or pipe is written to, never replaced.
    """
    temporary: Path | None = None
    try:
        if path.exists() and not path.is_file():
            path.write_bytes(data)
            return
        with tempfile.NamedTemporaryFile(dir=path.parent, delete=False) as stream:
            temporary = Path(stream.name)
            stream.write(data)
        temporary.chmod(0o644)
        os.replace(temporary, path)
    except OSError as error:
        if temporary is not None:
            temporary.unlink(missing_ok=True)
        raise OutputFileError(str(path), error.strerror or str(error)) from None


class RecordingFile:
    """A new file that grows until it is closed, readable at any time up to the last `flush`.

    An existing file is never overwritten; a device or pipe is written to. When the disk is full, the bytes
    since the last flush are removed, and `trailer` is written if possible; from then on all methods raise
    OutputFileError.
    """

    #: Bytes that are collected between two flushes before they are written.
    _BUFFER = 1 << 20

    def __init__(self, path: Path, trailer: bytes = b"") -> None:
        """Raises OutputFileError."""
        self._path, self._trailer, self._buffer = path, trailer, bytearray()
        self._failure: OutputFileError | None = None
        #: Bytes up to the last flush, and bytes that were written since.
        self._flushed = self._written = 0
        existing = os.O_EXCL if not path.exists() or path.is_file() else 0
        try:
            self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC | existing, 0o644)
        except FileExistsError:
            raise OutputFileError(str(path), "the file exists: remove it, or name another one") from None
        except OSError as error:
            raise self._error(error) from None

    def write(self, data: bytes) -> None:
        """Append bytes."""
        self._check()
        self._buffer += data
        if len(self._buffer) >= self._BUFFER:
            self._write_buffer()

    def flush(self) -> None:
        """Write all bytes so far."""
        self._write_buffer()
        self._flushed, self._written = self._flushed + self._written, 0

    def _write_buffer(self) -> None:
        self._check()
        data, self._buffer = self._buffer, bytearray()
        try:
            while data:
                written = os.write(self._file, data)
                self._written += written
                del data[:written]
        except OSError as error:
            self._failure = self._error(error)
            # A pipe cannot be cut.
            with suppress(OSError):
                self._write_trailer()
            raise self._failure from None

    def _check(self) -> None:
        if self._failure is not None:
            raise self._failure

    def _write_trailer(self) -> None:
        os.ftruncate(self._file, self._flushed)
        os.lseek(self._file, 0, os.SEEK_END)
        if os.write(self._file, self._trailer) < len(self._trailer):
            os.ftruncate(self._file, self._flushed)

    def close(self) -> None:
        """Close the file; what was not flushed is not written."""
        try:
            os.close(self._file)
        except OSError as error:
            raise self._error(error) from None

    def _error(self, error: OSError) -> OutputFileError:
        return OutputFileError(str(self._path), error.strerror or str(error))
