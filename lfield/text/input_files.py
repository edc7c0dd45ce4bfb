"""Reading files that users name: with a size limit, and errors a user can act on. This is a base module.

A named pipe is also read, and the read waits for its writer, as in other programs.
"""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path
from typing import BinaryIO

from lfield.errors import InputFileError
from lfield.text.source_text import Source, Span

#: The largest file of a program, or deployment, in bytes.
MAX_TEXT = 16 << 20
_CHUNK = 1 << 20


def require_file(path: Path) -> None:
    """Check that a file exists before other files are named after it. Raises InputFileError."""
    try:
        if stat.S_ISDIR(path.stat().st_mode):
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
    except (OSError, ValueError) as error:
        raise InputFileError(str(path), error_reason(error)) from None


def read_bytes(path: Path, limit: int) -> bytes:
    """The bytes of a file. Raises InputFileError, also for more than `limit` bytes."""
    try:
        return read_within(path, limit)
    except (OSError, ValueError) as error:
        raise InputFileError(str(path), error_reason(error)) from None


def read_within(path: Path, limit: int) -> bytes:
    """The bytes of a file, with system errors: OSError (EFBIG above the limit), ValueError for an invalid
    file name.
    """
    data = read_head(path, limit + 1)
    if len(data) > limit:
        raise OSError(errno.EFBIG, os.strerror(errno.EFBIG))
    return data


def read_head(path: Path, limit: int) -> bytes:
    """At most `limit` bytes from the start of a file, with system errors."""
    with path.open("rb") as stream:
        return read_up_to(stream, limit)


def read_up_to(stream: BinaryIO, limit: int) -> bytes:
    """At most `limit` remaining bytes of a stream.

    Python would allocate memory for a single read of `limit` bytes at once.
    """
    pieces: list[bytes] = []
    while limit > 0 and (piece := stream.read(min(limit, _CHUNK))):
        pieces.append(piece)
        limit -= len(piece)
    return b"".join(pieces)


def error_reason(error: OSError | ValueError) -> str:
    """The reason why a file cannot be read, in a few words."""
    if isinstance(error, OSError) and error.strerror:
        return error.strerror.lower()
    return "not a file name"


def invalid_byte(name: str, error: UnicodeDecodeError) -> tuple[Span, str]:
    """The position where a file stops being UTF-8, in a source that ends there, and the invalid byte."""
    readable = error.object[: error.start].decode("utf-8")
    source = Source(name, readable + "\N{REPLACEMENT CHARACTER}")
    return Span(source, len(readable), len(readable) + 1), f"0x{error.object[error.start]:02X}"
