"""Writing the files that commands name."""

from __future__ import annotations

import os
import stat
import tempfile
from contextlib import suppress
from pathlib import Path

from lfield.errors import OutputFileError


def write_bytes(path: Path, data: bytes, mode: int = 0o644) -> None:
    """Write a file atomically, with these access rights. Raises OutputFileError.

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
        temporary.chmod(mode)
        os.replace(temporary, path)
    except OSError as error:
        if temporary is not None:
            temporary.unlink(missing_ok=True)
        raise OutputFileError(str(path), error.strerror or str(error)) from None


class RecordingFile:
    """A new file that grows, and is complete after each `flush`: it then ends with `trailer`.

    The next bytes replace the trailer. So the process may be killed at any time, and the disk may become
    full. An existing file is never overwritten; a device or pipe is written to, without a trailer. After a
    first OutputFileError all methods raise it again.
    """

    def __init__(self, path: Path, trailer: bytes = b"") -> None:
        """Raises OutputFileError."""
        self._path, self._buffer = path, bytearray()
        self._failure: OutputFileError | None = None
        #: The size of the file without the trailer.
        self._size = 0
        existing = os.O_EXCL if not path.exists() or path.is_file() else 0
        try:
            self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC | existing, 0o644)
            self._is_regular = stat.S_ISREG(os.fstat(self._file).st_mode)
        except FileExistsError:
            raise OutputFileError(str(path), "the file exists: remove it, or name another one") from None
        except OSError as error:
            raise self._error(error) from None
        self._trailer = trailer if self._is_regular else b""

    def write(self, data: bytes) -> None:
        """Append bytes."""
        if self._failure is not None:
            raise self._failure
        self._buffer += data

    def flush(self) -> None:
        """Write all bytes so far, and the trailer."""
        if self._buffer or self._failure is not None:
            self._write_buffer(self._trailer)

    def finish(self) -> None:
        """Write all bytes so far: they are the end of the file."""
        self._write_buffer(b"")

    def _write_buffer(self, trailer: bytes) -> None:
        if self._failure is not None:
            raise self._failure
        data, self._buffer = bytes(self._buffer), bytearray()
        try:
            # In one call, so that a process that is killed leaves the old or the new end.
            self._write(data + trailer)
        except OSError as error:
            self._failure = self._error(error)
            with suppress(OSError):
                self._write(self._trailer)
            raise self._failure from None
        self._size += len(data)

    def _write(self, data: bytes) -> None:
        """Write after the bytes that were flushed."""
        if self._is_regular:
            os.lseek(self._file, self._size, os.SEEK_SET)
        size = len(data)
        while data:
            data = data[os.write(self._file, data) :]
        if self._is_regular:
            os.ftruncate(self._file, self._size + size)

    def close(self) -> None:
        """Close the file; bytes that were not flushed are not written."""
        try:
            os.close(self._file)
        except OSError as error:
            raise self._error(error) from None

    def _error(self, error: OSError) -> OutputFileError:
        return OutputFileError(str(self._path), error.strerror or str(error))
