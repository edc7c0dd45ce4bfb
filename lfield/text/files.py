"""Reading files that users name: bounded, with the errors a user can act on. A base module."""

from __future__ import annotations

import errno
import os
from pathlib import Path

from lfield.errors import InputFileError


def read_bytes(path: Path, most: int) -> bytes:
    """A file's bytes. Raises InputFileError, also when there are more than `most`."""
    try:
        return read_within(path, most)
    except (OSError, ValueError) as error:
        raise InputFileError(str(path), reason(error)) from None


def read_within(path: Path, most: int) -> bytes:
    """The same with the system's own errors: OSError (EFBIG over the bound), ValueError for no file name."""
    data = read_head(path, most + 1)
    if len(data) > most:
        raise OSError(errno.EFBIG, os.strerror(errno.EFBIG))
    return data


def read_head(path: Path, most: int) -> bytes:
    """The first bytes of a file, `most` of them if there are so many, with the system's own errors."""
    with path.open("rb") as stream:
        return stream.read(most)


def reason(error: OSError | ValueError) -> str:
    """Why a file cannot be read, in a few words."""
    if isinstance(error, OSError) and error.strerror:
        return error.strerror.lower()
    return "not a file name"
