"""A whole file: includes, units, constants, enums and functions."""

from __future__ import annotations

from lfield.lang import messages
from lfield.lang.parser.declarations import members, unit
from lfield.lang.parser.foreign.foreign_words import FOREIGN_UNITS
from lfield.lang.parser.token_stream import UNIT_KEYWORDS, ParsingAborted, SyntaxRecovery, TokenStream
from lfield.lang.parser.top_level import at_top_level, top_level
from lfield.lang.scanner import TokenKind, scan
from lfield.lang.syntax import Include, ParsedFile
from lfield.lang.tree import UnitKind
from lfield.text.source_text import Diagnostics, Source
from lfield.text.suggestions import closest

_KINDS: dict[str, UnitKind] = {"resource": "resource", "coordinator": "coordinator", "class": "class"}
#: Members that come after the last unit: a `}` too many closed it.
_STRAY_MEMBERS = ("portal", "private", "public", "init")
#: Statements of other languages that need no replacement in L.
_IMPORTS = ("import", "package", "using", "from", "use", "typedef")


def parse_file(source: Source, found: Diagnostics) -> ParsedFile:
    """The syntax tree of a source, as far as it could be read. Mistakes go to `found`."""
    scanned = scan(source, found)
    file = ParsedFile(source, broken=scanned.cut)
    s = TokenStream(scanned, found)
    try:
        while not s.at_end():
            if not s.attempt(lambda: _top_level(s, file), s.skip_unit):
                file.broken = True
    except ParsingAborted:
        file.broken = True
    file.types, file.called = s.types, s.called
    return file


def _top_level(s: TokenStream, file: ParsedFile) -> None:
    if s.at("include"):
        file.includes.append(_include(s))
        s.semicolon()
    elif s.at(*UNIT_KEYWORDS):
        file.units.append(unit(s, _KINDS[s.advance().text]))
    elif at_top_level(s):
        top_level(s, file)
    elif s.at("}"):
        s.report(messages.EXTRA_BRACE, s.current.span)
        s.advance()
    elif s.at(*_STRAY_MEMBERS) and s.ahead(1).text not in UNIT_KEYWORDS and file.units:
        s.report(messages.EXTRA_BRACE, s.previous.span)
        members(s, file.units[-1], s.previous.span)
    else:
        _unknown_unit(s, file)


def _unknown_unit(s: TokenStream, file: ParsedFile) -> None:
    """Handle tokens that begin no unit: a misspelt keyword, foreign syntax, or garbage."""
    token = s.current
    close = closest(token.text, (*UNIT_KEYWORDS, "include")) if s.at_name() else None
    if close in UNIT_KEYWORDS and s.ahead(1).kind is TokenKind.NAME:
        s.report(messages.MISSPELT_KEYWORD, token.span, keyword=token.text, close=close)
        s.advance()
        file.units.append(unit(s, _KINDS[close]))
        return
    if token.text == ";":
        s.advance()
        s.report(messages.EXPECTED_UNIT, token.span, hint="leave the ; out: a unit ends with }", found=token)
        return
    if (
        token.text in FOREIGN_UNITS
        and token.kind is TokenKind.KEYWORD
        and s.ahead(1).text not in UNIT_KEYWORDS
    ):
        raise s.fail(messages.EXPECTED_UNIT, hint=FOREIGN_UNITS[token.text], found=token)
    if token.text in FOREIGN_UNITS:
        s.report(messages.FOREIGN_KEYWORD, token.span, keyword=token.text, instead=FOREIGN_UNITS[token.text])
        if s.ahead(1).text in UNIT_KEYWORDS:
            s.advance()
            return
        if token.text == "template":
            while not (s.at_end() or s.at(">", "{", ";")):
                s.advance()
            s.accept(">")
            return
        if token.text in _IMPORTS:
            s.skip_unit()
            return
        raise SyntaxRecovery
    hint = f"did you mean '{close}'?" if close else None
    raise s.fail(messages.EXPECTED_UNIT, hint=hint, found=token)


def _include(s: TokenStream) -> Include:
    """`include "path"` or `include <path>`."""
    start = s.advance().span
    if s.current.kind is TokenKind.STRING:
        token = s.advance()
        return Include(str(token.value), False, token.span)
    if not s.at("<"):
        raise s.fail(messages.INCLUDE_SYNTAX)
    opening = s.advance().span
    while not s.at(">"):
        if s.at_end() or s.first_on_line():
            raise s.fail(messages.INCLUDE_SYNTAX)
        s.advance()
    span = opening.to(s.advance().span)
    return Include(span.text[1:-1].strip(), True, start.to(span))
