"""A whole file: includes, units, constants, enums and functions.

`const` and `enum` are keywords only at the beginning of such a declaration.
"""

from __future__ import annotations

from lfield.lang import messages
from lfield.lang.parser.declarations import function, members, unit
from lfield.lang.parser.expressions import expression
from lfield.lang.parser.foreign_words import FOREIGN_UNITS, METHOD_WORDS
from lfield.lang.parser.token_stream import (
    PRIMITIVES,
    UNIT_KEYWORDS,
    ParsingAborted,
    SyntaxRecovery,
    TokenStream,
)
from lfield.lang.parser.type_names import at_generic, type_name
from lfield.lang.scanner import TokenKind, scan
from lfield.lang.syntax import BAD_TYPE, Constant, Enumeration, EnumMember, Include, ParsedFile
from lfield.lang.tree import UnitKind
from lfield.text.source_text import Diagnostics, Source
from lfield.text.suggestions import closest

_CONST, _ENUM = "const", "enum"
_NAME = TokenKind.NAME
_KINDS: dict[str, UnitKind] = {"resource": "resource", "coordinator": "coordinator", "class": "class"}
#: Members that come after the last unit: a `}` too many closed it.
_STRAY_MEMBERS = ("portal", "private", "public", "init")
#: Statements of other languages that need no replacement in L.
_IMPORTS = ("import", "package", "using", "from", "use", "typedef")


def parse_file(source: Source, found: Diagnostics) -> ParsedFile:
    """The syntax tree of a source. Mistakes go to `found`; what could be read is returned."""
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
    elif _at_top_level(s):
        _declaration(s, file)
    elif s.at("}"):
        s.report(messages.EXTRA_BRACE, s.current.span)
        s.advance()
    elif s.at(*_STRAY_MEMBERS) and s.ahead(1).text not in UNIT_KEYWORDS and file.units:
        s.report(messages.EXTRA_BRACE, s.previous.span)
        members(s, file.units[-1], s.previous.span)
    else:
        _unknown_unit(s, file)


def _unknown_unit(s: TokenStream, file: ParsedFile) -> None:
    """Something that begins no unit: a misspelt keyword, a habit, or garbage."""
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


# --- constants, enums, functions ------------------------------------------------------------------------


def _at_top_level(s: TokenStream) -> bool:
    """Whether a constant, an enum or a function begins here."""
    return _at_constant(s) or _at_enum(s) or _at_function(s)


def _declaration(s: TokenStream, file: ParsedFile) -> None:
    """The constant, enum or function here, added to the file."""
    if _at_constant(s):
        _constant(s, file)
    elif _at_enum(s):
        file.enums.append(_enumeration(s))
    else:
        function(s, file.functions)


def _at_constant(s: TokenStream) -> bool:
    if not s.at(_CONST) or s.ahead(2).text == "(":
        return False
    return s.ahead(1).text in PRIMITIVES or s.ahead(1).kind is _NAME


def _at_enum(s: TokenStream) -> bool:
    if not s.at(_ENUM) or s.ahead(2).text == "(":
        return False
    return s.ahead(1).kind is _NAME or s.ahead(1).text in ("class", "{")


def _at_function(s: TokenStream) -> bool:
    """Whether a type, a name and a parenthesis begin here."""
    if at_generic(s):
        return True
    if s.at_name() and (s.at(*METHOD_WORDS) or (s.at(*FOREIGN_UNITS) and not s.at(_CONST, _ENUM))):
        return False
    if not (s.at_name() or s.at("void", *PRIMITIVES)):
        return False
    at = 1
    while s.ahead(at).text == "[" and s.ahead(at + 1).text == "]":
        at += 2
    return s.ahead(at).kind is _NAME and s.ahead(at + 1).text == "("


def _constant(s: TokenStream, file: ParsedFile) -> None:
    """`const real NAME = 5.0;`, added to the file."""
    s.advance()
    if s.ahead(1).text in ("=", ";"):
        raise s.fail(messages.CONSTANT_SHAPE, name=s.current.text)
    declared = type_name(s, "a constant")
    name = s.expect_name("the name of the constant")
    if not s.at("="):
        s.report(messages.CONSTANT_SHAPE, name.span, name=name.text)
        file.broken = True
        s.semicolon()
        return
    s.advance()
    file.constants.append(Constant(declared, name.text, expression(s), name.span))
    if s.at(",") and declared.name != BAD_TYPE:
        raise s.fail(messages.ONE_VARIABLE)
    s.semicolon()


def _enumeration(s: TokenStream) -> Enumeration:
    """`enum Phase { SEARCH, LIFT, HOME }`."""
    s.advance()
    if s.at("class"):
        instead = "write enum Name { A, B }; a member is always written with its enum: Name.A"
        s.report(messages.FOREIGN_KEYWORD, s.current.span, keyword="enum class", instead=instead)
        s.advance()
    name = s.expect_name("the name of the enum")
    s.expect("{")
    if s.at("}"):
        s.report(messages.EMPTY_ENUM, name.span, name=name.text)
    members = [] if s.at("}") else [_member(s, name.text)]
    while s.accept(","):
        if s.at("}"):
            hint = "leave the last comma out"
            s.report(
                messages.EXPECTED_NAME,
                s.current.span,
                hint=hint,
                what="the name of a member",
                found=s.current,
            )
            break
        members.append(_member(s, name.text))
    s.expect("}")
    return Enumeration(name.text, members, name.span)


def _member(s: TokenStream, enum: str) -> EnumMember:
    name = s.expect_name("the name of a member")
    if s.at("=", "("):
        instead = f"a member has no value of its own; {enum}.{name.text}.ordinal() is its place, from 0"
        s.report(messages.FOREIGN_OPERATOR, s.current.span, operator=s.current.text, instead=instead)
        while not (s.at_end() or s.at(",", "}", "{", ";")):
            s.advance()
    return EnumMember(name.text, name.span)
