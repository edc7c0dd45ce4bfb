"""DBC files as tools write them, made fit for `cantools`, which refuses a file for trifles. Pure."""

from __future__ import annotations

import re

#: Bit 31 of an id says that it has 29 bits; many files leave it out.
_EXTENDED, _STANDARD, _LONGEST = 1 << 31, 0x7FF, 0x1FFFFFFF
_MESSAGE = re.compile(r"[ \t]*BO_[ \t]+(\d+)")
_SIGNAL = re.compile(r"[ \t]*SG_[ \t]+([^\s:]+)")
_VALUES = re.compile(r'^[ \t]*VAL_[ \t]+(\d+)[ \t]+(\S+)(?:"[^"]*"|[^";])*;', re.MULTILINE)
_ID = re.compile(
    r'^([ \t]*(?:BO_|VAL_|SIG_VALTYPE_|SG_MUL_VAL_|BO_TX_BU_|(?:CM_|BA_ "\w+") (?:BO_|SG_))[ \t]+)(\d+)',
    re.MULTILINE,
)


def decoded(data: bytes) -> str:
    """The text of a file: UTF-8 with a mark or without, or what Vector's tools write."""
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("cp1252", errors="replace")


def mended(text: str) -> str:
    """The text without names for values of absent signals, and with bit 31 in every id that needs it."""
    places, message = set(), ""
    for line in text.splitlines():
        if match := _MESSAGE.match(line):
            message = match[1]
        elif match := _SIGNAL.match(line):
            places.add((message, match[1]))
    text = _VALUES.sub(lambda match: match[0] if (match[1], match[2]) in places else "", text)
    return _ID.sub(lambda match: match[1] + _with_bit(int(match[2])), text)


def _with_bit(identifier: int) -> str:
    return str(identifier | _EXTENDED if _STANDARD < identifier <= _LONGEST else identifier)
