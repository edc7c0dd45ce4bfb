"""Calls that begin now, and waiting in a monitor: `async arm.lift(1.0)`, `wait until (x) within (5.0);`.

`async`, `wait` and `until` are keywords only in these forms; elsewhere they are ordinary names.
"""

from __future__ import annotations

from collections.abc import Callable

from lfield.lang.parser.token_stream import TokenStream
from lfield.lang.scanner import TokenKind
from lfield.lang.syntax import Async, Expr, Stmt, WaitUntil

#: The tokens that follow the first name of a call.
_BEHIND_NAME = (".", "[", "(")


def at_async(s: TokenStream) -> bool:
    """Whether `async call` begins here."""
    following = s.ahead(1)
    is_operand = following.kind is TokenKind.NAME or following.text == "this"
    return s.at("async") and is_operand and s.ahead(2).text in _BEHIND_NAME


def async_call(s: TokenStream, operand: Callable[[TokenStream], Expr]) -> Expr:
    """`async` and the call after it."""
    keyword = s.advance()
    with s.nested():
        call = operand(s)
    return s.bounded(Async(keyword.span.to(call.span), call.height + 1, keyword.span, call))


def at_wait_until(s: TokenStream) -> bool:
    """Whether `wait until` and a condition begin here; `wait until;` declares a variable."""
    return s.at("wait") and s.ahead(1).text == "until" and s.ahead(2).text not in (";", "=", ",")


def wait_until(s: TokenStream, parenthesised: Callable[[TokenStream, str | None], Expr]) -> Stmt:
    """`wait until (condition);` or `wait until (condition) within (seconds);`."""
    start = s.advance().span
    keyword = start.to(s.advance().span)
    condition, seconds = parenthesised(s, "write the condition in parentheses: wait until (...);"), None
    if s.at("within"):
        s.advance()
        seconds = parenthesised(s, None)
    s.semicolon()
    return WaitUntil(keyword, condition, seconds)
