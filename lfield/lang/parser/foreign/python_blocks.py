"""Blocks of Python: a head that ends in `:`, and an indented body. Each is reported once and skipped."""

from __future__ import annotations

import re

from lfield.lang import messages
from lfield.lang.parser.foreign.foreign_words import FOREIGN_SYMBOLS, FOREIGN_VALUES
from lfield.lang.parser.token_stream import TokenStream
from lfield.lang.scanner import TokenKind
from lfield.text.source_text import Span

#: Words that continue the statement of a Python block at the same indentation.
_CLAUSES = ("elif", "else", "except", "finally", "case")
_ELSE_IF = ("elif", "elsif", "elseif", "elseIf")
#: A condition that a hint can show in L: names, numbers, comparisons and these words, without brackets.
_SIMPLE_CONDITION = re.compile(r"(?:[\w.]++|[<>!=]=|[<>]|\s)++")
_FOREIGN_TERMS = {"and": "&&", "or": "||", "is not": "!=", "is": "==", **FOREIGN_VALUES}
_FOREIGN_TERM = re.compile(rf"\b(?:{'|'.join(_FOREIGN_TERMS)})\b")
_LONGEST = 30
_TRY = "write try { ... } catch (Exception e) { ... }"


def _head_length(s: TokenStream) -> int:
    """The number of tokens before the `:` or `{` that ends the head on this line; -1 if there is none."""
    count, depth, line = 0, 0, s.current.span.line
    while (token := s.ahead(count)).span.line == line and token.kind is not TokenKind.END:
        if depth == 0 and token.text in (":", "{"):
            return count
        depth += {"(": 1, "[": 1, ")": -1, "]": -1}.get(token.text, 0)
        if token.text in (";", "}", "?") or depth < 0:
            return -1
        count += 1
    return -1


def bare_condition_hint(s: TokenStream) -> str:
    """The hint for `while True:` and `if x {`: the stream is at the condition without parentheses."""
    length = _head_length(s)
    if length <= 0:
        return "a condition is in parentheses"
    keyword = "else if" if s.previous.text in _ELSE_IF else s.previous.text
    return f"write {keyword} ({_in_l(s.current.span.to(s.ahead(length - 1).span).text)}) {{ ... }}"


def _in_l(condition: str) -> str:
    """A short condition of Python in L, or `...`."""
    terms = condition.split()
    if not _SIMPLE_CONDITION.fullmatch(condition) or len(condition) > _LONGEST or "in" in terms:
        return "..."
    if "not" in terms and "is not" not in condition:
        return f"!{terms[1]}" if terms[0] == "not" and len(terms) == 2 else "..."
    if condition in ("0", "1"):
        return "true" if condition == "1" else "false"
    return _FOREIGN_TERM.sub(lambda match: _FOREIGN_TERMS[match.group()], condition)


def skip_bare_condition(s: TokenStream) -> None:
    """Skip to the `:` or `{` after a condition without parentheses, or past the `)` that lacks its `(`."""
    if (length := _head_length(s)) < 0:
        s.skip_parentheses(1)
    for _ in range(length):
        s.advance()


def report_colon(s: TokenStream) -> None:
    """Report the `:` between a head and its body."""
    hint = _TRY if s.previous.text == "try" else FOREIGN_SYMBOLS[":"]
    s.report(messages.EXPECTED_SYMBOL, s.current.span, hint=hint, what="'{'", found=s.current)


def skip_python_block(s: TokenStream, head: Span) -> None:
    """Skip the body of the block whose head is on that line, and its further clauses."""
    text = head.source.line_text(head.line)
    column, depth = len(text) - len(text.lstrip()) + 1, 0
    s.accept(":")
    while not s.at_end():
        ended = s.first_on_line() and s.current.span.column <= column and not s.at(*_CLAUSES)
        if depth == 0 and (ended or s.at("}")):
            return
        depth += {"{": 1, "}": -1}.get(s.advance().text, 0)
