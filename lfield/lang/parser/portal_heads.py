"""Portals with the result type before the name or before `portal`, as in other languages."""

from __future__ import annotations

from lfield.lang import messages
from lfield.lang.parser.foreign.foreign_words import METHOD_WORDS
from lfield.lang.parser.token_stream import PRIMITIVES, TokenStream
from lfield.lang.parser.type_names import AFTER_TYPE, result_type
from lfield.lang.scanner import TokenKind
from lfield.lang.syntax import BAD_TYPE, TypeName

#: The signs inside a type.
_TYPE_SIGNS = ("[", "]", "<", ">", ">>", ",", "::")
#: The signs that a name of a type follows.
_BEFORE_TYPE = ("<", ",", "::")


def misplaced_result(s: TokenStream) -> TypeName | None:
    """Report the type before the name of a portal, as in `portal real p()`; the type, or None without one."""
    first = s.current
    if s.at("async", *METHOD_WORDS) and s.ahead(1).kind is TokenKind.NAME:
        token = s.advance()
        s.report(messages.FOREIGN_KEYWORD, token.span, keyword=token.text, instead="leave it out")
        return None
    is_type = s.at_name() and (s.ahead(1).kind is TokenKind.NAME or s.ahead(1).text in AFTER_TYPE)
    if not is_type and not s.at("emit", "void", *PRIMITIVES):
        return None
    if s.accept("emit") and s.at_name() and s.ahead(1).text == "(":
        written, result = "...", None
    else:
        result = result_type(s)
        if result.name == BAD_TYPE:
            return result  # The type is reported.
        written = str(result)
    name = s.current.text if s.at_name() else "name"
    hint = f"the type follows the parameters: portal {name}(...) emit {written}"
    if written == "void":
        hint, result = f"a portal without emit returns nothing: portal {name}(...)", None
    span = first.span.to(s.previous.span)
    s.report(messages.EXPECTED_NAME, span, hint=hint, what="the name of the portal", found=first)
    return result


def at_misplaced_portal(s: TokenStream) -> bool:
    """Whether `real portal f(` or `emit real portal f(` begins here."""
    at = 1 if s.at("emit") else 0
    while s.ahead(at).text in _TYPE_SIGNS or (_is_type_word(s, at) and _may_have_type(s, at)):
        at += 1
    is_portal = at > 0 and s.ahead(at).text == "portal" and s.ahead(at).span.line == s.current.span.line
    return is_portal and s.ahead(at + 1).kind is TokenKind.NAME and s.ahead(at + 2).text == "("


def _is_type_word(s: TokenStream, at: int) -> bool:
    token = s.ahead(at)
    return token.kind is TokenKind.NAME or token.text in (*PRIMITIVES, "void")


def _may_have_type(s: TokenStream, at: int) -> bool:
    """Whether the token `at` places ahead is the first one, or is behind `emit` or a sign."""
    return at == 0 or s.ahead(at - 1).text in ("emit", *_BEFORE_TYPE)


def misplaced_portal(s: TokenStream, modifier: str) -> TypeName | None:
    """Report `real portal f()` or `emit real portal f()`; the type, with the stream at the name."""
    first = s.current
    is_emit = s.accept("emit")
    has_type = not s.at("portal")
    result = result_type(s) if has_type else TypeName(first.span, BAD_TYPE)
    portal = s.expect("portal")
    if has_type and result.name == BAD_TYPE:
        return result  # The type is reported.
    is_void = result.name == "void"
    result_text = "" if is_void else f" emit {result if has_type else '...'}"
    hint = f"write portal {modifier}{s.current.text}(...){result_text}"
    if is_emit:
        s.report(messages.EXPECTED_MEMBER, first.span, hint=hint, found=first)
    else:
        s.report(messages.RESERVED_NAME, portal.span, hint=hint, keyword=portal.text)
    return None if is_void else result
