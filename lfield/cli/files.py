"""Reading and writing the files that commands name."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

from lfield.errors import InputFileError, OutputFileError


def read_bytes(path: Path, most: int) -> bytes:
    """A file's bytes; raises InputFileError, also when there are more than `most`."""
    try:
        with path.open("rb") as stream:
            data = stream.read(most + 1)
    except OSError as error:
        raise InputFileError(str(path), error.strerror or str(error)) from None
    if len(data) > most:
        raise InputFileError(str(path), f"it is larger than {most >> 20} MiB")
    return data


def write_bytes(path: Path, data: bytes) -> None:
    """Write a whole file or leave what was there; raises OutputFileError.

    What is no plain file (a device, a pipe) is written to, never replaced.
    """
    try:
        if path.exists() and not path.is_file():
            path.write_bytes(data)
            return
        with tempfile.NamedTemporaryFile(dir=path.parent or Path(), delete=False) as stream:
            temporary = Path(stream.name)
            stream.write(data)
        temporary.chmod(0o644)
        os.replace(temporary, path)
    except OSError as error:
        if "temporary" in locals():
            temporary.unlink(missing_ok=True)
        raise OutputFileError(str(path), error.strerror or str(error)) from None
