"""Escapes control characters in text from programs, files and other hosts before it reaches a terminal.

Such text may contain control sequences that move the cursor, rename the window, overwrite other lines or
reverse the direction of writing. They are shown as escapes of L, `\\u{1b}`, so that a reader sees the
characters of the text. Bundles, logs, devices and other hosts contain such text, and every command prints
some of it: `EscapingStream` escapes the text where it leaves the process. Streams that are not terminals get
the bytes unchanged.
"""

from __future__ import annotations

import codecs
import re
import unicodedata
from typing import Any, TextIO, cast

#: Unicode categories without a visible sign: control, format, surrogate, private use, unassigned, separators.
_CONTROL_CATEGORIES = frozenset({"Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp"})
_SHORT = {"\n": "\\n", "\t": "\\t", "\r": "\\r", "\0": "\\0"}
_HALVES = re.compile("[\ud800-\udfff]")
#: The `errors` handler that shows characters missing in an encoding in the same form.
ESCAPES = "lfield.escapes"
#: Layout characters of a text with several lines.
LAYOUT = "\n\t"


def escape(text: str, keep: str = LAYOUT) -> str:
    """The text with every control character, except those to `keep`, as an escape of L."""
    if text.isprintable():
        return text
    return "".join(ch if ch in keep or _is_printable(ch) else _escaped(ch) for ch in text)


def escape_line(text: str) -> str:
    """As `escape`, for text that must stay on one line: a cell of a table, a value among others."""
    return escape(text, "")


def escape_indented(text: str) -> str:
    """As `escape`, for a log entry or error with several lines: all except the first are indented, so that a
    text cannot imitate another entry.
    """
    first, *more = escape(text).split("\n")
    if any(line[:1].strip() for line in more):
        more = [f"    {line}" if line else "" for line in more]
    return "\n".join([first, *more])


def printable_argument(argument: str) -> str:
    """An argument of the command line, or a file name, as text that can be stored and sent.

    Python represents bytes that are not UTF-8 by lone surrogates, which cannot be encoded: `\\u{dcff}`.
    """
    return _HALVES.sub(lambda half: _escaped(half[0]), argument)


def truncate(text: str, limit: int) -> str:
    """The text cut to `limit` characters, the last one is `…` if the text is longer."""
    return text if len(text) <= limit else f"{text[: limit - 1]}…"


class EscapingStream:
    """A text stream to a terminal; control characters except newline and tab are shown as escapes of L.

    All other methods are delegated to the `stream`.
    """

    def __init__(self, stream: TextIO) -> None:
        self.stream = stream

    def write(self, text: str, /) -> int:
        """Write the escaped text."""
        self.stream.write(escape(text))
        return len(text)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.stream, name)


def escaping_stream(stream: TextIO) -> TextIO:
    """The stream, wrapped in an `EscapingStream` if it is a terminal."""
    if isinstance(stream, EscapingStream) or not stream.isatty():
        return stream
    return cast("TextIO", EscapingStream(stream))


def unescaped_stream(stream: TextIO) -> TextIO:
    """The stream below an `EscapingStream`, for a program that writes its own control sequences."""
    return stream.stream if isinstance(stream, EscapingStream) else stream


def _unencodable(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    return "".join(map(_escaped, error.object[error.start : error.end])), error.end


codecs.register_error(ESCAPES, _unencodable)


def _is_printable(character: str) -> bool:
    return character.isprintable() or unicodedata.category(character) not in _CONTROL_CATEGORIES


def _escaped(character: str) -> str:
    return _SHORT.get(character) or f"\\u{{{ord(character):x}}}"
