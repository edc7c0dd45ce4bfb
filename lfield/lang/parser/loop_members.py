"""Loops of resources: `loop name at 10.0 priority 2 when (condition) { ... }`.

Elsewhere these words are names.
"""

from __future__ import annotations

from lfield.lang import messages
from lfield.lang.parser.expressions import expression, parenthesised
from lfield.lang.parser.statements import block
from lfield.lang.parser.token_stream import SyntaxRecovery, TokenStream
from lfield.lang.scanner import TokenKind
from lfield.lang.syntax import LoopHead, Method, Unit

LOOP, PRIORITY, WHEN = "loop", "priority", "when"
RATES = ("at", "every")
#: All words that are keywords in the head of a loop only.
LOOP_WORDS = (LOOP, *RATES, PRIORITY, WHEN)


def at_loop(s: TokenStream) -> bool:
    """Whether a loop begins here: no field or method has two names before one of these."""
    if not (s.at_name() and s.at(LOOP)):
        return False
    is_nameless = s.ahead(1).text in RATES and s.ahead(2).text not in (";", "=", "(", ",")
    return is_nameless or (s.ahead(1).kind is TokenKind.NAME and s.ahead(2).text in (*LOOP_WORDS, "{"))


def loop_member(s: TokenStream, owner: Unit) -> None:
    """A loop, added to its unit as a method."""
    s.advance()
    if s.at(*RATES) and s.ahead(1).text not in LOOP_WORDS:
        raise s.fail(messages.EXPECTED_NAME, what="the name of the loop", found=s.current)
    name = s.expect_name("the name of the loop")
    method = Method("loop", name.text, [], None, False, False, name.span)
    owner.methods.append(method)
    before = s.reset_broken()
    try:
        method.loop = _head(s, name.text)
        method.body = block(s)
    finally:
        method.end = s.previous.span
        method.broken = s.broken
        s.restore_broken(before)


def _head(s: TokenStream, name: str) -> LoopHead:
    if not s.at(*RATES):
        raise s.fail(messages.LOOP_RATE, name=name)
    is_periodic = s.advance().text == "every"
    if s.at("{"):
        raise s.fail(messages.LOOP_RATE, name=name)
    head = LoopHead(expression(s), is_periodic)
    while s.at(PRIORITY, WHEN):
        if s.at(PRIORITY) and head.place is None:
            s.advance()
            _priority(s, head)
        elif s.at(WHEN) and head.condition is None:
            s.advance()
            head.condition = parenthesised(s)
        else:
            raise s.fail(messages.EXPECTED_SYMBOL, what="'{'", found=s.current)
    if s.at(*RATES):
        raise s.fail(messages.LOOP_RATE, name=name)
    return head


def _priority(s: TokenStream, head: LoopHead) -> None:
    start = s.current.span
    sign = -1 if s.accept("-") else 1
    if s.current.kind is not TokenKind.INT:
        s.report(messages.LOOP_PRIORITY, s.current.span)
        raise SyntaxRecovery
    number = s.advance()
    head.priority, head.place = sign * int(number.text), start.to(number.span)
