"""Reading files that users name: bounded, with the errors a user can act on. A base module.

A named pipe is read too, and waits for its writer, as with any other program.
"""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path
from typing import BinaryIO

from lfield.errors import InputFileError
from lfield.text.source import Source, Span

#: The largest file of a program, or deployment, in bytes.
MAX_TEXT = 16 << 20
_PIECE = 1 << 20


def look_at(path: Path) -> None:
    """See that there is such a file before others are named after it. Raises InputFileError."""
    try:
        if stat.S_ISDIR(path.stat().st_mode):
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
    except (OSError, ValueError) as error:
        raise InputFileError(str(path), reason(error)) from None


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
        return read_up_to(stream, most)


def read_up_to(stream: BinaryIO, most: int) -> bytes:
    """All that is left of a stream, `most` bytes of it if there are so many.

    Asked for so many at once, Python would first have the memory for all of them.
    """
    pieces: list[bytes] = []
    while most > 0 and (piece := stream.read(min(most, _PIECE))):
        pieces.append(piece)
        most -= len(piece)
    return b"".join(pieces)


def reason(error: OSError | ValueError) -> str:
    """Why a file cannot be read, in a few words."""
    if isinstance(error, OSError) and error.strerror:
        return error.strerror.lower()
    return "not a file name"


def bad_byte(name: str, error: UnicodeDecodeError) -> tuple[Span, str]:
    """Where a file stops being UTF-8, in a source that ends there, and the byte that is wrong."""
    readable = error.object[: error.start].decode("utf-8")
    source = Source(name, readable + "\N{REPLACEMENT CHARACTER}")
    return Span(source, len(readable), len(readable) + 1), f"0x{error.object[error.start]:02X}"
