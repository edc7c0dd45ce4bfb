"""Text of programs, files and other hosts on its way to a terminal: what that would obey is shown, not done.

A program prints what it likes, a peer sends what it likes. A terminal takes some characters as orders: they
move the cursor, rename the window, write over what stood there, turn the direction of writing. They are shown
as L writes them in a text, `\\u{1b}`, so that whoever reads on knows what was meant.

Bundles, logs, devices and other hosts carry such texts, and every command prints some of them: `Terminal`
shows them so where they leave the process. Where a stream is no terminal its bytes go out unchanged.
"""

from __future__ import annotations

import codecs
import re
import unicodedata
from typing import Any, TextIO, cast

#: Kinds of characters that are no signs to be read: controls, formats, halves of a pair, and unassigned ones.
_OBEYED = frozenset({"Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp"})
_SHORT = {"\n": "\\n", "\t": "\\t", "\r": "\\r", "\0": "\\0"}
_HALVES = re.compile("[\ud800-\udfff]")
#: The `errors` of a stream that shows what its encoding does not have in the same way.
ESCAPES = "lfield.escapes"
#: What lays out a text of several lines.
LAYOUT = "\n\t"


def visible(text: str, keep: str = LAYOUT) -> str:
    """The text with every character that a terminal would obey as an escape of L, but for those to `keep`."""
    if text.isprintable():
        return text
    return "".join(ch if ch in keep or _is_sign(ch) else _escaped(ch) for ch in text)


def in_one_line(text: str) -> str:
    """The same for what must stay on its line: a cell of a table, a value among others."""
    return visible(text, "")


def continued(text: str) -> str:
    """The same for an entry of a log, or an error, that may have lines: all but the first stand further in.

    So nobody puts words into a line that looks like another entry.
    """
    first, *more = visible(text).split("\n")
    if any(line[:1].strip() for line in more):
        more = [f"    {line}" if line else "" for line in more]
    return "\n".join([first, *more])


def as_text(word: str) -> str:
    """A word of the command line, or the name of a file, as text that can be kept and sent.

    Where its bytes are no UTF-8, Python has a half of a pair for each, which nothing encodes: `\\u{dcff}`.
    """
    return _HALVES.sub(lambda half: _escaped(half[0]), word)


def clipped(text: str, most: int) -> str:
    """At most so many characters of a text, the last one `…` where it is longer."""
    return text if len(text) <= most else f"{text[: most - 1]}…"


class Terminal:
    """A text stream to a terminal; control characters but newline and tab are shown as escapes of L.

    Everything else is done by the `stream` itself.
    """

    def __init__(self, stream: TextIO) -> None:
        self.stream = stream

    def write(self, text: str, /) -> int:
        """Write the text as it is shown."""
        self.stream.write(visible(text))
        return len(text)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.stream, name)


def on_terminal(stream: TextIO) -> TextIO:
    """The stream, as a `Terminal` where it is one."""
    if isinstance(stream, Terminal) or not stream.isatty():
        return stream
    return cast("TextIO", Terminal(stream))


def unguarded(stream: TextIO) -> TextIO:
    """The stream below a `Terminal`, for a program with control sequences of its own."""
    return stream.stream if isinstance(stream, Terminal) else stream


def _unencodable(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    return "".join(map(_escaped, error.object[error.start : error.end])), error.end


codecs.register_error(ESCAPES, _unencodable)


def _is_sign(character: str) -> bool:
    return character.isprintable() or unicodedata.category(character) not in _OBEYED


def _escaped(character: str) -> str:
    return _SHORT.get(character) or f"\\u{{{ord(character):x}}}"
