"""Splits a DBC file into statements with positions. Pure.

Tolerates what tools write: texts over several lines, a missing ';' at the end; other text is reported and
skipped.
"""

from __future__ import annotations

import re
from collections.abc import Iterator

from msgspec import Struct

from lfield.driver import Diagnostics, Source, Span
from lfield_can.dbc import findings

#: Statements that end with their line.
_LINES = frozenset({"BO_", "SG_", "BS_", "VERSION"})
#: Statements that end where the next one starts: the list of nodes may have a line for each.
_LISTS = frozenset({"BU_"})
#: Statements that end with ';'.
_ENDED = frozenset(
    {
        "BA_", "BA_DEF_", "BA_DEF_DEF_", "BA_DEF_DEF_REL_", "BA_DEF_REL_", "BA_DEF_SGTYPE_", "BA_REL_",
        "BA_SGTYPE_", "BO_TX_BU_", "BU_BO_REL_", "BU_EV_REL_", "BU_SG_REL_", "CAT_", "CAT_DEF_", "CM_",
        "ENVVAR_DATA_", "EV_", "EV_DATA_", "FILTER", "SGTYPE_", "SGTYPE_VAL_", "SG_MUL_VAL_",
        "SIGTYPE_VALTYPE_", "SIG_GROUP_", "SIG_TYPE_REF_", "SIG_VALTYPE_", "VAL_", "VAL_TABLE_",
    }
)  # fmt: skip
KEYWORDS = _LINES | _LISTS | _ENDED | {"NS_"}
_TOKEN = re.compile(r"[^\s:;\"]+")
_BLANK = re.compile(r"(?:\s|//[^\n]*)+")
#: The list of new symbols after NS_: words, one or several per line.
_SYMBOLS = re.compile(r"\s*:?(?:[ \t]*\n[ \t]+[A-Z_0-9]+(?=\s*\n)|[ \t]+[A-Z_0-9]+(?=[ \t]|\n))*")
#: A line that starts with a statement; the next quote, end of a statement, or such a line.
_STATEMENT_START = r"\n(?=[ \t]*(?:" + "|".join(sorted(KEYWORDS, key=len, reverse=True)) + r")[\s:])"
_NEXT, _NEXT_LINE = re.compile(f'"|;|{_STATEMENT_START}'), re.compile(f"{_STATEMENT_START}|$")
#: The end of a text; \" does not end it, unless only the end of the statement follows.
_CLOSED = re.compile(r'(?<!\\)"|\\"(?=\s*(?:;\s*$|;\s*\n))')

# Patterns of the parts of statements, and their forms in errors.
NUMBER = r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?"
#: An end of a range, which some tools write as a non-number if there is none.
END = rf"{NUMBER}(?![.#0-9])|[-+]?(?i:inf(?:inity)?|nan|[0-9]\.#(?:INF|IND|QNAN|SNAN)[0-9]*)"
MESSAGE = re.compile(r"\s*(?P<id>[0-9]+)[ \t]*(?P<name>[^\s:]*)[ \t]*:[ \t]*(?P<length>[0-9]+)(?=\s|$)")
MESSAGE_FORM = "write BO_ ID NAME: LENGTH SENDER, as in BO_ 256 Motor: 8 Host"
#: The parts of a signal, with their names in errors.
SIGNAL_PARTS = (
    (re.compile(r"\s*(?P<name>[^\s:]*)[ \t]*(?P<mux>M|m[0-9]+M?|m)?[ \t]*:"), "a name and ':'"),
    (
        re.compile(r"\s*(?P<start>[0-9]+)\s*\|\s*(?P<length>[0-9]+)\s*"),
        "its first bit and its length, as 8|16",
    ),
    (re.compile(r"@\s*(?P<order>[01])\s*(?P<sign>[-+])"), "its order of bytes and its sign, as @1+"),
    (
        re.compile(rf"\s*\(\s*(?P<scale>{NUMBER})\s*,\s*(?P<offset>{NUMBER})\s*\)"),
        "its factor and offset, as (0.1,0)",
    ),
    (
        re.compile(rf"\s*\[\s*(?P<low>{END})?\s*\|\s*(?P<high>{END})?\s*\]"),
        "its range, as [0|100]",
    ),
    (re.compile(r'\s*"(?P<unit>(?:[^"\\\n]|\\.)*)"'), "its unit in double quotes"),
)
SIGNAL_FORM = 'write SG_ NAME : START|LENGTH@1+ (FACTOR,OFFSET) [LOW|HIGH] "UNIT" RECEIVER'
VALTYPE = re.compile(r"\s*([0-9]+)\s+(\S+?)\s*:?\s*([0-9])\s*$")
MULTIPLEXED = re.compile(r"\s*([0-9]+)\s+(\S+)\s+(\S+)((?:\s*,?\s*[0-9]+\s*-\s*[0-9]+)+)\s*$")
RANGE = re.compile(r"([0-9]+)\s*-\s*([0-9]+)")
NAMED_VALUES = re.compile(r"\s*([0-9]+)\s+([^\s\"]+)\s")
ATTRIBUTE = re.compile(
    r'\s*"(?P<name>\w+)"\s+(?:BO_|SG_)\s+(?P<id>[0-9]+)\s+(?P<signal>[^\s"]+\s+)?"?(?P<value>[^"]*?)"?\s*$'
)


class Statement(Struct, frozen=True):
    """One statement: its keyword, its rest, and the position of that in the source."""

    keyword: str
    body: str
    at: int


def statements(source: Source, diagnostics: Diagnostics) -> Iterator[Statement]:
    """All statements; other text is reported to `diagnostics`."""
    text, at = source.text, 0
    while True:
        blank = _BLANK.match(text, at)
        at = blank.end() if blank else at
        if at >= len(text):
            return
        token = _TOKEN.match(text, at)
        keyword = token[0] if token else text[at]
        start = at + len(keyword)
        if keyword == "NS_":
            symbols = _SYMBOLS.match(text, start)
            at = symbols.end() if symbols else start
            continue
        if keyword in _ENDED:
            end = _end(source, at, start, diagnostics)
        else:
            end = text.find("\n", start)
            end = len(text) if end < 0 else end
            if keyword in _LISTS and (match := _NEXT_LINE.search(text, start)):
                end = match.start()
            elif keyword not in _LINES and keyword != ";":
                diagnostics.add(findings.UNKNOWN.at(Span(source, at, start), keyword=keyword))
        yield Statement(keyword, text[start:end], start)
        at = end + 1 if text[end : end + 1] == ";" else end


def _end(source: Source, opening: int, start: int, diagnostics: Diagnostics) -> int:
    """The end of a statement that should end with ';'."""
    text, at = source.text, start
    while (match := _NEXT.search(text, at)) and match[0] == '"':
        closed = _CLOSED.search(text, match.end())
        if closed is None:
            diagnostics.add(findings.UNCLOSED_TEXT.at(Span(source, match.start(), match.end())))
            return len(text)
        at = closed.end()
    if match and match[0] == ";":
        return match.start()
    diagnostics.add(findings.UNENDED.at(Span(source, opening, start)))
    return match.start() if match else len(text)
