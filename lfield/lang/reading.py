"""Files as bytes and as text, with the errors a user can act on."""

from __future__ import annotations

from pathlib import Path

from lfield.errors import InputFileError
from lfield.source import Source, Span


def read_bytes(path: Path) -> bytes:
    """The bytes of a file. Raises InputFileError."""
    try:
        return path.read_bytes()
    except (OSError, ValueError) as error:
        raise InputFileError(str(path), reason(error)) from None


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
