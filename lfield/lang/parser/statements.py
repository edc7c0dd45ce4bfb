"""Statements (appendix A; `for`, `break`, `continue`, `together`, `within`, `reserve` and `finally` added).

The last four are keywords only where their block follows; elsewhere they are ordinary names.
"""

from __future__ import annotations

from collections.abc import Callable

from lfield.lang import messages
from lfield.lang.parser.concurrency import at_async, at_wait_until, wait_until
from lfield.lang.parser.expressions import expression, parenthesised
from lfield.lang.parser.foreign.foreign_syntax import (
    at_except,
    at_floor_division,
    at_foreign_each,
    at_foreign_statement,
    at_walrus,
    block_ahead,
    foreign_each,
    foreign_statement,
    semicolon_hint,
    skip_except,
    walrus,
)
from lfield.lang.parser.foreign.foreign_words import FOREIGN_STATEMENTS, FOREIGN_SYMBOLS
from lfield.lang.parser.foreign.python_blocks import report_colon, skip_python_block
from lfield.lang.parser.local_variables import (
    counting_for,
    declaration,
    each,
    evaluated,
    for_start,
)
from lfield.lang.parser.token_stream import MEMBER_KEYWORDS, TokenStream, UnclosedBrace
from lfield.lang.parser.type_names import at_declaration, parameter_modifier, type_name
from lfield.lang.scanner import Token, TokenKind
from lfield.lang.syntax import (
    Bad,
    BadStmt,
    BlockStmt,
    Break,
    Catch,
    Continue,
    Each,
    Empty,
    Expr,
    For,
    If,
    Reserve,
    Return,
    Stmt,
    Throw,
    Together,
    Try,
    While,
    Within,
)
from lfield.text.source_text import Span
from lfield.text.suggestions import closest

_CATCH = "write catch (Exception e) { ... }"
#: Words before `{` or `(...) {` that a typing mistake may hide.
_HEADS = ("if", "else", "while", "for", "try", "catch", "together", "within", "reserve", "finally")


def block(s: TokenStream) -> list[Stmt]:
    """`{ ... }`: its statements. Ends at the matching brace, or before a member, which shows that it is
    missing.
    """
    opening = s.expect("{")
    body: list[Stmt] = []
    while not s.at("}"):
        if s.at_end() or _at_member(s):
            _unclosed(s, opening)
        body.append(statement(s))
    _note_indentation(s, opening)
    s.advance()
    return body


def statement(s: TokenStream) -> Stmt:
    """One statement; after a mistake a BadStmt, with the stream at the next one."""
    start = s.current.span
    found: list[Stmt] = []

    def parse() -> None:
        with s.nested():
            found.append(_STATEMENTS.get(s.current.text, _simple)(s))

    if not s.attempt(parse, s.skip_statement):
        return BadStmt(start)
    return found[0]


def _at_member(s: TokenStream) -> bool:
    """Whether a member or a unit begins here, which cannot be inside a body."""
    if not s.at(*MEMBER_KEYWORDS) or (s.at("init") and s.ahead(2).text not in ("string", "String")):
        return False
    return s.first_on_line() or s.previous.text in "{};"


def _unclosed(s: TokenStream, opening: Token) -> None:
    s.report(messages.UNCLOSED_BRACE, s.suspect or opening.span)
    raise UnclosedBrace


def _note_indentation(s: TokenStream, opening: Token) -> None:
    """Record the first brace whose closing brace has another indentation: probably its own is missing."""
    if s.suspect is None and s.first_on_line() and s.current.span.line > opening.span.line:
        line = opening.span.source.line_text(opening.span.line)
        if len(line) - len(line.lstrip()) != s.current.span.column - 1:
            s.set_suspect(opening.span)


def _block(s: TokenStream) -> Stmt:
    start = s.current.span
    body = block(s)
    return BlockStmt(start.to(s.previous.span), body)


def _empty(s: TokenStream) -> Stmt:
    return Empty(s.advance().span)


def _if(s: TokenStream) -> Stmt:
    """`if` with all its `else if`; they do not nest, however many there are."""
    found: list[If] = []
    while not found or _at_further(s):
        start = s.advance().span
        condition = parenthesised(s)
        found.append(If(start, condition, _body(s, start, condition), None))
    otherwise = _body(s, s.advance().span) if s.at("else") else None
    while found:
        found[-1].otherwise = otherwise
        otherwise = found.pop()
    assert otherwise is not None
    return otherwise


def _at_further(s: TokenStream) -> bool:
    """Whether an `else if` follows; the stream is then at its `if`. That of another language is reported."""
    keyword = s.current.text
    if s.at_name() and keyword in ("elif", "elsif", "elseif", "elseIf"):
        if s.ahead(1).text == "(":
            s.report(
                messages.FOREIGN_KEYWORD, s.current.span, keyword=keyword, instead=FOREIGN_STATEMENTS[keyword]
            )
        return True
    if s.at("else") and s.ahead(1).text == "if":
        s.advance()
        return True
    return False


def _body(s: TokenStream, head: Span, condition: Expr | None = None) -> Stmt:
    """The statement after a head. A block of Python is skipped, and reported unless its condition was."""
    if not s.at(":"):
        return statement(s)
    if not isinstance(condition, Bad):
        report_colon(s)
    skip_python_block(s, head)
    return BadStmt(head)


def _else(s: TokenStream) -> Stmt:
    raise s.fail(messages.ELSE_WITHOUT_IF)


def _catch(s: TokenStream) -> Stmt:
    raise s.fail(messages.CATCH_WITHOUT_TRY)


def _while(s: TokenStream) -> Stmt:
    start = s.advance().span
    condition = parenthesised(s)
    return While(start, condition, _body(s, start, condition))


def _for(s: TokenStream) -> Stmt:
    """Both forms of `for`; a mistake in the head is skipped with the head."""
    where = s.advance().span
    if at_foreign_each(s):
        foreign_each(s)
        return BlockStmt(where, [BadStmt(where), _body(s, where, Bad(where, 1))])
    loop: For | Each = For(where, None, None, None, Empty(where))

    def head() -> None:
        nonlocal loop
        opening = s.expect("(")
        start = for_start(s)
        loop = each(s, where, start) if s.at(":", "in", "of") else counting_for(s, where, start)
        s.close(")", opening)

    def skip() -> None:
        while not s.at_end() and not s.at("{", "}", ")"):
            s.advance()
        s.accept(")")

    is_parsed = s.attempt(head, skip)
    loop.body = _body(s, where, None if is_parsed else Bad(where, 1))
    return loop if is_parsed else BadStmt(where)


def _break(s: TokenStream) -> Stmt:
    span = s.advance().span
    s.semicolon()
    return Break(span)


def _continue(s: TokenStream) -> Stmt:
    span = s.advance().span
    s.semicolon()
    return Continue(span)


def _return(s: TokenStream) -> Stmt:
    span = s.advance().span
    nothing = s.at(";", "}") or (s.first_on_line() and s.at(*_STATEMENTS))
    value = None if nothing else expression(s)
    s.semicolon()
    return Return(span, value)


def _throw(s: TokenStream) -> Stmt:
    span = s.advance().span
    value = expression(s)
    s.semicolon()
    return Throw(span, value)


def _try(s: TokenStream) -> Stmt:
    span = s.advance().span
    body = _body(s, span)
    if at_except(s):
        while at_except(s):
            skip_except(s)
            _body(s, span, Bad(span, 1))
        return BlockStmt(span, [BadStmt(span), body])
    if not s.at("catch") and not isinstance(body, BadStmt) and not _at_finally(s):
        s.report(messages.TRY_WITHOUT_CATCH, span)
    catches: list[Catch] = []
    while s.at("catch"):
        catches.extend(_catch_clause(s))
    if not _at_finally(s):
        return Try(span, body, catches, None)
    return Try(span, body, catches, _braced(s, s.advance()))


def _catch_clause(s: TokenStream) -> list[Catch]:
    """One catch; None when its head has a mistake, then its body is skipped."""
    opening = s.advance()
    clauses: list[Catch] = []

    def head() -> None:
        if not s.at("("):
            raise s.fail(messages.EXPECTED_SYMBOL, hint=_CATCH, what="'('", found=s.current)
        s.advance()
        if s.at("."):
            raise s.fail(messages.EXPECTED_NAME, hint=_CATCH, what="a type", found=s.current)
        parameter_modifier(s)
        caught = type_name(s, "a catch")
        if s.at("as") and s.ahead(1).kind is s.current.kind:
            raise s.fail(messages.EXPECTED_SYMBOL, hint=_CATCH, what="')'", found=s.current)
        name = s.expect_name("a name for the exception", _CATCH)
        clauses.append(Catch(caught, name.text, name.span, Empty(opening.span)))
        s.close(")", opening)

    is_parsed = s.attempt(head, lambda: s.skip_parentheses(1))
    body = statement(s)
    for clause in clauses:
        clause.body = body
    return clauses if is_parsed else []


def _together(s: TokenStream) -> Stmt:
    token = s.advance()
    return Together(token.span, _braced(s, token))


def _within(s: TokenStream) -> Stmt:
    token = s.advance()
    seconds = parenthesised(s, "write the seconds in parentheses: within (30) { ... }")
    return Within(token.span, seconds, _braced(s, token, seconds))


def _reserve(s: TokenStream) -> Stmt:
    token = s.advance()
    resource = parenthesised(s, "write the resource in parentheses: reserve (arm) { ... }")
    return Reserve(token.span, resource, _braced(s, token, resource))


def _finally(s: TokenStream) -> Stmt:
    raise s.fail(messages.FINALLY_WITHOUT_TRY)


def _at_finally(s: TokenStream) -> bool:
    return s.at("finally") and _is_soft_keyword(s)


def _braced(s: TokenStream, keyword: Token, head: Expr | None = None) -> Stmt:
    """The block after a word; a statement without braces is reported."""
    if s.at(":"):
        return _body(s, keyword.span, head)
    if s.at("("):
        hint = FOREIGN_SYMBOLS.get(s.current.text)
        raise s.fail(messages.EXPECTED_SYMBOL, hint=hint, what="'{'", found=s.current)
    if not s.at("{"):
        s.report(messages.NEEDS_BODY, keyword.span, what=keyword.text)
    return statement(s)


def _is_soft_keyword(s: TokenStream) -> bool:
    """Whether the word here begins its block, or tokens follow that cannot follow a name."""
    following = s.ahead(1)
    if following.kind is TokenKind.NAME:
        return s.ahead(2).text in ("(", ".", "{")
    if following.kind in (TokenKind.INT, TokenKind.REAL) or following.text == ":":
        return True
    return following.kind is TokenKind.KEYWORD or block_ahead(s) > 0 or s.lacks_parenthesis()


def _simple(s: TokenStream) -> Stmt:
    """A declaration or an expression with its `;`."""
    if s.at_name():
        keyword = s.current.text
        if keyword in _SOFT_KEYWORDS and _is_soft_keyword(s):
            return _SOFT_KEYWORDS[keyword](s)
        if at_wait_until(s):
            return wait_until(s, parenthesised)
        if at_async(s):
            statement = evaluated(s)
            s.semicolon(semicolon_hint(s))
            return statement
        if keyword in FOREIGN_STATEMENTS and at_foreign_statement(s):
            return foreign_statement(s, keyword)
        if block_ahead(s) and (close := closest(keyword, _HEADS)):
            return _misspelt(s, keyword, close)
    statement = declaration(s) if at_declaration(s) else evaluated(s)
    if at_walrus(s):
        raise walrus(s)
    is_division = not s.at(";") and at_floor_division(s)
    s.semicolon(semicolon_hint(s))
    return BadStmt(statement.span) if is_division else statement


def _misspelt(s: TokenStream, keyword: str, close: str) -> Stmt:
    """`whlie (...) {` or `esle {`: reported; only its block is read."""
    span = s.current.span
    s.report(messages.MISSPELT_KEYWORD, span, keyword=keyword, close=close)
    for _ in range(block_ahead(s)):
        s.advance()
    return BlockStmt(span, [BadStmt(span), statement(s)])


_STATEMENTS: dict[str, Callable[[TokenStream], Stmt]] = {
    "{": _block,
    ";": _empty,
    "if": _if,
    "else": _else,
    "catch": _catch,
    "while": _while,
    "for": _for,
    "break": _break,
    "continue": _continue,
    "return": _return,
    "throw": _throw,
    "try": _try,
}
_SOFT_KEYWORDS: dict[str, Callable[[TokenStream], Stmt]] = {
    "together": _together,
    "within": _within,
    "reserve": _reserve,
    "finally": _finally,
}
