"""Reads conditions over attributes: `payload >= 2.0 && environment == aerial`.

They are written as expressions are in L, with its precedence, literals, escapes and comments; a test holds
this reader against that of the language. It is one of its own since robots read conditions too, for
`findLift("...")` takes any text, and robots have no front end.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TypeVar

from lfield.capability.condition import (
    Binary,
    Call,
    Expr,
    Literal_,
    Meaningless,
    Member,
    Mistake,
    Name,
    Unary,
)
from lfield.capability.condition_tokens import Stop, Token, tokens
from lfield.text.source import Source, Span

#: The longest text that is read, in characters, and how deep it may nest: trees are walked recursively.
MAX_LENGTH, MAX_NESTING = 2000, 100
#: The most offers that can be asked for.
MAX_LIMIT = 1000


# --- the parser ---------------------------------------------------------------------------------------

#: Binary operators from the weakest to the strongest; all of them group to the left.
_PRECEDENCE: Mapping[str, int] = {
    "||": 1,
    "&&": 2,
    **dict.fromkeys(("==", "!="), 3),
    **dict.fromkeys(("<", "<=", ">", ">="), 4),
    **dict.fromkeys(("+", "-"), 5),
    **dict.fromkeys(("*", "/", "%"), 6),
}
#: Those of which a chain means the same however it is grouped, in three-valued logic too.
_CHAINED = ("||", "&&")
#: Operators of other languages, and what to write instead.
_INSTEAD = {
    "===": "write ==",
    "!==": "write !=",
    "&": "write &&",
    "|": "write ||",
    "=>": "did you mean >= ?",
    **dict.fromkeys(("->", "::"), "members are reached with a point"),
}
_FOREIGN = frozenset(
    (*_INSTEAD, "++", "--", "+=", "-=", "*=", "/=", "%=", "&=", "|=", "^=", "<<", ">>", "^", "~")
)
#: Operators of other languages that are words.
_WORDS = {"and": "write &&", "or": "write ||", "not": "write !", "in": "write set == member"}
#: What can name nothing: the reserved words of L (appendix A); a test compares them with the scanner's.
RESERVED_WORDS = frozenset(
    (
        *("resource", "coordinator", "class", "include", "init", "portal", "emit", "synchronized"),
        *("public", "private", "boolean", "int", "real", "string", "void"),
        *("if", "else", "while", "for", "break", "continue", "return", "try", "catch", "throw"),
        *("new", "this", "true", "false", "null"),
    )
)
_CONSTANTS = {"true": True, "false": False, "null": None}
_INT_LIMIT = 2**63


_Read = TypeVar("_Read")


@dataclass(frozen=True, slots=True)
class Written:
    """A wish as it is written: a condition with its text, keys to order by (True: descending), a limit."""

    condition: Expr | None = None
    text: str = ""
    order: tuple[tuple[Expr, bool], ...] = ()
    limit: int | None = None


def parse(text: str) -> tuple[Expr | None, list[Mistake]]:
    """The tree of a text, or None and what is wrong. What its names mean is not looked at."""
    return _parsed(text, lambda parser: parser.whole())


def parse_wish(text: str) -> tuple[Written | None, list[Mistake]]:
    """`payload >= 2 order by distance(12, 4), battery desc limit 100`, each part of which may be left out."""
    return _parsed(text, lambda parser: parser.wish())


def _parsed(text: str, read: Callable[[_Parser], _Read]) -> tuple[_Read | None, list[Mistake]]:
    if len(text) > MAX_LENGTH:
        return None, [Mistake(0, len(text), f"this is longer than {MAX_LENGTH} characters")]
    if not text.strip():
        return None, [Mistake(0, len(text), "nothing is written here", "such as payload >= 2.0")]
    try:
        return read(_Parser(tokens(Source("", text)))), []
    except Stop as stop:
        return None, [stop.mistake]


class _Parser:
    """One run over the tokens of one text; every method raises Stop at a mistake."""

    def __init__(self, tokens: list[Token]) -> None:
        self._tokens, self._at, self._depth = tokens, 0, 0

    def whole(self) -> Expr:
        """The one expression that the text is."""
        found = self._expression()
        self._end()
        return found

    def wish(self) -> Written:
        """A condition, what to order by, and how many."""
        condition = None if self._sees_words("order", "by") or self._sees_limit() else self._expression()
        text = self._next.span.source.text[: self._next.span.start]
        order: list[tuple[Expr, bool]] = []
        if self._sees_words("order", "by"):
            self._at += 1
            while not order or self._sees(","):
                self._advance()
                order.append((self._expression(), self._descends()))
        limit = self._limited() if self._next.text == "limit" else None
        self._end()
        return Written(condition, text, tuple(order), limit)

    def _sees_words(self, first: str, second: str) -> bool:
        following = self._tokens[min(self._at + 1, len(self._tokens) - 1)]
        return self._next.kind == following.kind == "name" and (self._next.text, following.text) == (
            first,
            second,
        )

    def _sees_limit(self) -> bool:
        """Whether there is a limit, right or wrong: a number below 0, too, which would be a difference."""
        if self._next.kind != "name" or self._next.text != "limit":
            return False
        behind = self._tokens[self._at + 1 :]
        if behind[0].text == "-":
            return [token.kind for token in behind[1:]] == ["number", "end"]
        return behind[0].kind in ("number", "end")

    def _descends(self) -> bool:
        found = self._next.kind == "name" and self._next.text
        if found in ("asc", "desc"):
            self._advance()
        return found == "desc"

    def _limited(self) -> int:
        word, token = self._advance(), self._advance()
        if token.kind == "number" and isinstance(token.value, int) and 1 <= token.value <= MAX_LIMIT:
            return token.value
        place = word.span if token.kind == "end" else token.span
        raise Stop(place, f"a limit is a whole number from 1 to {MAX_LIMIT}", "such as limit 100")

    def _end(self) -> None:
        if self._next.kind != "end":
            before = self._tokens[self._at - 1]
            hint = _WORDS.get(self._next.text) or _WORDS.get(before.text, "the condition ends before it")
            raise Stop(self._next.span, f"{self._next} is not expected here", hint)

    @property
    def _next(self) -> Token:
        return self._tokens[self._at]

    def _advance(self) -> Token:
        token = self._next
        self._at = min(self._at + 1, len(self._tokens) - 1)
        return token

    def _sees(self, *symbols: str) -> bool:
        return self._next.kind != "string" and self._next.text in symbols

    def _close(self, symbol: str, opening: Token) -> Token:
        if not self._sees(symbol):
            end = self._tokens[self._at - 1].span.end
            place = Span(opening.span.source, end, end)
            raise Stop(place, f"missing {symbol} after this", f"it closes the {opening.text}")
        return self._advance()

    @contextmanager
    def _nested(self) -> Iterator[None]:
        """One level deeper, up to MAX_NESTING."""
        self._depth += 1
        self._limit(self._depth, self._next.span)
        try:
            yield
        finally:
            self._depth -= 1

    def _limit(self, depth: int, place: Span) -> None:
        if depth > MAX_NESTING:
            raise Stop(place, f"this is nested more than {MAX_NESTING} levels deep")

    def _bounded(self, found: Expr) -> Expr:
        self._limit(self._depth + found.height, found.span)
        return found

    # --- expressions --------------------------------------------------------------------------------------

    def _expression(self) -> Expr:
        with self._nested():
            found = self._binary(1)
        if self._sees("="):
            raise Stop(self._next.span, "'=' would assign", "compare with ==")
        if self._sees("?"):
            raise Stop(self._next.span, "L has no ? : expression")
        self._check_operator()
        return found

    def _check_operator(self) -> None:
        sign = self._next
        if sign.kind == "symbol" and sign.text in _FOREIGN:
            raise Stop(sign.span, f"a condition has no operator {sign.text}", _INSTEAD.get(sign.text, ""))

    def _binary(self, weakest: int) -> Expr:
        """Operators of at least this precedence."""
        left = self._unary()
        while self._next.kind == "symbol" and (strength := _PRECEDENCE.get(self._next.text, 0)) >= weakest:
            operands, signs = [left], [self._advance()]
            operands.append(self._operand(strength + 1))
            while signs[0].text in _CHAINED and self._sees(signs[0].text):
                signs.append(self._advance())
                operands.append(self._operand(strength + 1))
            left = self._bounded(_chain(operands, signs))
        return left

    def _operand(self, weakest: int) -> Expr:
        with self._nested():
            return self._binary(weakest)

    def _unary(self) -> Expr:
        if self._sees("-") and self._tokens[self._at + 1].kind == "number":
            sign = self._advance()
            return _number(self._advance(), sign)
        if self._sees("-", "!"):
            sign = self._advance()
            with self._nested():
                operand = self._unary()
            span = sign.span.to(operand.span)
            return self._bounded(Unary(span, operand.height + 1, sign.text, operand))
        self._check_operator()
        return self._postfix()

    def _postfix(self) -> Expr:
        """A primary expression with its calls and members."""
        found = self._primary()
        while self._sees(".", "(", "["):
            opening = self._advance()
            if opening.text == ".":
                found = self._member(found)
            elif opening.text == "(":
                found = self._call(found, opening)
            else:
                index = self._expression()
                end = self._close("]", opening)
                height = 1 + max(found.height, index.height)
                found = Meaningless(found.span.to(end.span), height)
            self._bounded(found)
        return found

    def _member(self, owner: Expr) -> Expr:
        name = self._next
        if name.kind != "name" or name.text in RESERVED_WORDS:
            raise Stop(name.span, f"expected the name of a member, found {name}")
        self._advance()
        return Member(owner.span.to(name.span), owner.height + 1, owner, name.text, name.span)

    def _call(self, function: Expr, opening: Token) -> Expr:
        if not isinstance(function, Name | Member):
            raise Stop(opening.span, "only a name can be called", "write name(...)")
        given, end = self._arguments(opening)
        height = 1 + max([function.height, *(argument.height for argument in given)])
        return Call(function.span.to(end.span), height, function, given)

    def _arguments(self, opening: Token) -> tuple[list[Expr], Token]:
        found: list[Expr] = []
        if not self._sees(")"):
            found.append(self._expression())
            while self._sees(","):
                self._advance()
                found.append(self._expression())
        return found, self._close(")", opening)

    def _primary(self) -> Expr:
        token = self._advance()
        match token.kind, token.text:
            case "number", _:
                return _number(token, None)
            case "string", _:
                return Literal_(token.span, 1, token.value)
            case "name", "true" | "false" | "null":
                return Literal_(token.span, 1, _CONSTANTS[token.text])
            case "name", "this":
                return Meaningless(token.span, 1)
            case "name", "new" if self._next.kind == "name":
                return Meaningless(token.span.to(self._postfix().span), 1)
            case "name", word if word in RESERVED_WORDS:
                raise Stop(token.span, f"expected an expression, found {token}", f"'{word}' is a word of L")
            case "name", _:
                return Name(token.span, 1, token.text)
            case "symbol", "(":
                inner = self._expression()
                self._close(")", token)
                return inner
        raise Stop(token.span, f"expected an expression, found {token}")


def _chain(operands: Sequence[Expr], signs: Sequence[Token]) -> Expr:
    """What stands between signs of one kind, as low a tree as can be: a long chain is no nesting."""
    if len(operands) == 1:
        return operands[0]
    middle = len(operands) // 2
    left, right = _chain(operands[:middle], signs[: middle - 1]), _chain(operands[middle:], signs[middle:])
    sign = signs[middle - 1]
    height = 1 + max(left.height, right.height)
    return Binary(left.span.to(right.span), height, sign.text, sign.span, left, right)


def _number(token: Token, minus: Token | None) -> Expr:
    """A number with its sign: the smallest int has no positive counterpart."""
    value, span = token.value, token.span if minus is None else minus.span.to(token.span)
    assert isinstance(value, int | float)
    signed = value if minus is None else -value
    too_large = math.isinf(signed) if isinstance(signed, float) else not -_INT_LIMIT <= signed < _INT_LIMIT
    if too_large:
        raise Stop(span, f"the number {span.text[:30]} does not fit into 64 bits")
    return Literal_(span, 1, signed)
