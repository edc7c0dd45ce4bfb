"""Constants, enums and functions, which are declared beside the units.

`const` and `enum` are keywords only at the beginning of such a declaration.
"""

from __future__ import annotations

from lfield.lang import messages
from lfield.lang.parser.declarations import function
from lfield.lang.parser.expressions import expression
from lfield.lang.parser.foreign.foreign_words import FOREIGN_UNITS, METHOD_WORDS
from lfield.lang.parser.token_stream import PRIMITIVES, TokenStream
from lfield.lang.parser.type_names import at_generic, type_name
from lfield.lang.scanner import TokenKind
from lfield.lang.syntax import BAD_TYPE, Constant, Enumeration, EnumMember, ParsedFile

CONST, ENUM = "const", "enum"
_NAME = TokenKind.NAME


def at_top_level(s: TokenStream) -> bool:
    """Whether a constant, an enum or a function begins here."""
    return _at_constant(s) or _at_enum(s) or _at_function(s)


def top_level(s: TokenStream, file: ParsedFile) -> None:
    """The constant, enum or function here, added to the file."""
    if _at_constant(s):
        _constant(s, file)
    elif _at_enum(s):
        file.enums.append(_enumeration(s))
    else:
        function(s, file.functions)


def _at_constant(s: TokenStream) -> bool:
    if not s.at(CONST) or s.ahead(2).text == "(":
        return False
    return s.ahead(1).text in PRIMITIVES or s.ahead(1).kind is _NAME


def _at_enum(s: TokenStream) -> bool:
    if not s.at(ENUM) or s.ahead(2).text == "(":
        return False
    return s.ahead(1).kind is _NAME or s.ahead(1).text in ("class", "{", *PRIMITIVES)


def _at_function(s: TokenStream) -> bool:
    """Whether a type, a name and a parenthesis begin here."""
    if at_generic(s):
        return True
    if s.at_name() and (s.at(*METHOD_WORDS) or (s.at(*FOREIGN_UNITS) and not s.at(CONST, ENUM))):
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
