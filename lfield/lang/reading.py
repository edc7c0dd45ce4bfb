"""Program and deployment files as text."""

from __future__ import annotations

from lfield.text.source import Source, Span

#: The largest file of a program, or deployment, in bytes.
MAX_BYTES = 16 << 20


def bad_byte(name: str, error: UnicodeDecodeError) -> tuple[Span, str]:
    """Where a file stops being UTF-8, in a source that ends there, and the byte that is wrong."""
    readable = error.object[: error.start].decode("utf-8")
    source = Source(name, readable + "\N{REPLACEMENT CHARACTER}")
    return Span(source, len(readable), len(readable) + 1), f"0x{error.object[error.start]:02X}"
