"""Decoding of other tools' text files, and logging of reader warnings. Pure.

DBC and EDS files do not declare an encoding. Vector's tools write the code page of the computer (cp1252 in
the west, Shift-JIS in Japan), others UTF-8 or UTF-16, with and without a byte order mark.
"""

from __future__ import annotations

import codecs
from collections.abc import Callable, Sequence

from lfield.driver import Diagnostic
from lfield_can import log_messages

_MARKS = (
    (codecs.BOM_UTF8, "utf-8"),
    (codecs.BOM_UTF32_LE, "utf-32-le"),
    (codecs.BOM_UTF32_BE, "utf-32-be"),
    (codecs.BOM_UTF16_LE, "utf-16-le"),
    (codecs.BOM_UTF16_BE, "utf-16-be"),
)
#: First bytes of hiragana and katakana in Shift-JIS; in cp1252 a low quote and a florin sign.
_KANA = (0x82, 0x83)
#: Number of these bytes from which a text counts as Japanese.
_MANY_KANA = 3
#: Warnings per file that are logged.
MAX_WARNINGS = 10


def decode_text(data: bytes) -> str:
    """The text of a file with normalised line ends. Never raises: every byte has some character."""
    return _decoded(data).replace("\r\n", "\n").replace("\r", "\n")


def _decoded(data: bytes) -> str:
    for mark, encoding in _MARKS:
        if data.startswith(mark):
            return data[len(mark) :].decode(encoding, errors="replace")
    if encoding := _unmarked_utf16(data):
        return data.decode(encoding, errors="replace")
    for encoding in ("utf-8", *(("cp932",) if _is_japanese(data) else ()), "cp1252"):
        try:
            return data.decode(encoding)
        except UnicodeDecodeError:
            continue
    return data.decode("latin-1")


def _unmarked_utf16(data: bytes) -> str:
    """The kind of UTF-16 without a mark, or '': every other byte of the keywords of both formats is 0."""
    head = data[:64]
    if len(head) < 4 or b"\0" not in head:
        return ""
    if not any(head[0::2]) and all(head[1::2]):
        return "utf-16-be"
    return "utf-16-le" if not any(head[1::2]) and all(head[0::2]) else ""


def _is_japanese(data: bytes) -> bool:
    """Whether bytes that are not UTF-8 are more likely Shift-JIS than cp1252."""
    if sum(map(data.count, _KANA)) >= _MANY_KANA:
        return True
    try:
        data.decode("cp1252")
    except UnicodeDecodeError:
        return True
    return False


def log_warnings(warnings: Sequence[Diagnostic], path: str, note: Callable[[str], None]) -> None:
    """Logs one line per warning, `file:line:column: warning[CODE]: sentence; hint`; only the first ones."""
    ordered = sorted(warnings, key=lambda warning: warning.code)
    for warning in ordered[:MAX_WARNINGS]:
        place = f"{warning.span.source.name}:{warning.span.line}:{warning.span.column}"
        note(
            log_messages.FILE_WARNING.line(
                place=place, kind=warning.code, reason=warning.message, hint=warning.hint
            )
        )
    if others := len(ordered[MAX_WARNINGS:]):
        note(log_messages.FILE_WARNINGS.line(path=path, count=others))
