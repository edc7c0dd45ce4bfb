"""Reads conditions over attributes: `payload >= 2.0 && environment == aerial`.

They are written as expressions are in L, with its precedence, literals, escapes and comments; a test holds
this reader against that of the language. It is one of its own since robots read conditions too, for
`findLift("...")` takes any text, and robots have no front end.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache

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
from lfield.text.source import Source, Span

#: The longest text that is read, in characters, and how deep it may nest: trees are walked recursively.
MAX_LENGTH, MAX_NESTING = 2000, 100


# --- tokens -------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class _Token:
    """`kind` is number, string, name, symbol or end; `value` that of a literal."""

    kind: str
    text: str
    span: Span
    value: int | float | str | None = None

    def __str__(self) -> str:
        if self.kind == "end":
            return "the end of the text"
        if self.kind == "string":
            return "text"
        return f"'{self.text}'" if len(self.text) <= 40 else "a very long word"


#: Compiled when the first condition is read: most missions have none.
_TOKEN = r"""
      (?P<space>         [\ \t\r\n\f]++ | //[^\n]*+ | /\*(?s:.*?)\*/ )
    | (?P<open_comment>  /\*(?s:.*) )
    | (?P<real>          (?: \d*+\.\d++ (?:[eE][+-]?\d++)?+ | \d++[eE][+-]?\d++ ) (?![\w.]) )
    | (?P<int>           \d++ (?![\w.]) )
    | (?P<bad_number>    \.?\d[\w.]*+ )
    | (?P<name>          [A-Za-z_]\w*+ )
    | (?P<string>        "(?: [^"\\\n]++ | \\[^\n] )*+" )
    | (?P<open_string>   "[^\n]*+ )
    | (?P<quoted>        '[^'\n]*+'?+ | [“”„«][^“”»"\n]*+[“”»"] )
    | (?P<symbol>        ===|!==|&&|\|\||==|!=|<=|>=|\+\+|--|[-+*/%&|^]=|->|=>|::|<<|>>
                         |[-+*/%=!<>&|^~?:;,.(){}\[\]] )
    | (?P<illegal>       (?s:.) )
    """
_ESCAPE = re.compile(r"\\(u\{[0-9a-fA-F]{1,6}\}|u\{?|.)", re.DOTALL)
_SIMPLE_ESCAPES = {"n": "\n", "t": "\t", "r": "\r", "0": "\0", '"': '"', "\\": "\\"}

#: What is wrong with what is no token, and what to do.
_NO_TOKENS = {
    "open_comment": ("this comment is never closed", "close it with */"),
    "bad_number": ("'{}' is not a number", "write 12 or 1.5 or 1e3"),
    "open_string": ("this text is not closed", 'close it with "'),
    "quoted": ("text stands in straight double quotes", ""),
    "illegal": ("the character {!r} has no meaning here", "text stands in double quotes"),
}


class _Stop(Exception):
    """There is a mistake: what follows could only repeat it."""

    def __init__(self, place: Span, message: str, hint: str = "") -> None:
        self.mistake = Mistake(place.start, place.end, message, hint)


@lru_cache(maxsize=1)
def _scanner() -> re.Pattern[str]:
    return re.compile(_TOKEN, re.VERBOSE | re.ASCII)


def _tokens(source: Source) -> list[_Token]:
    tokens = [
        _token(match, Span(source, *match.span()))
        for match in _scanner().finditer(source.text)
        if match.lastgroup != "space"
    ]
    end = len(source.text)
    return [*tokens, _Token("end", "", Span(source, end, end))]


def _token(match: re.Match[str], span: Span) -> _Token:
    group, text = match.lastgroup or "", match.group()
    match group:
        case "int":
            # Twenty digits are out of range already; more would only cost time.
            return _Token("number", text, span, int((text.lstrip("0") or "0")[:20]))
        case "real":
            return _Token("number", text, span, float(text))
        case "string":
            return _Token("string", text, span, _decoded(span))
        case "name" | "symbol":
            return _Token(group, text, span)
    message, hint = _NO_TOKENS[group]
    raise _Stop(span, message.format(text[:40]), hint)


def _decoded(span: Span) -> str:
    """The text of a string literal with its escapes replaced."""

    def replace(match: re.Match[str]) -> str:
        escape = match.group(1)
        if escape in _SIMPLE_ESCAPES:
            return _SIMPLE_ESCAPES[escape]
        number = int(escape[2:-1], 16) if escape.endswith("}") and len(escape) > 3 else -1
        if 0 <= number < 0xD800 or 0xE000 <= number <= 0x10FFFF:
            return chr(number)
        start = span.start + 1 + match.start()
        where = Span(span.source, start, start + len(match.group()))
        raise _Stop(
            where, f"{match.group()} is not an escape", r"the escapes are \n \t \r \0 \" \\ and \u{...}"
        )

    return _ESCAPE.sub(replace, span.text[1:-1])


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


def parse(text: str) -> tuple[Expr | None, list[Mistake]]:
    """The tree of a text, or None and what is wrong. What its names mean is not looked at."""
    if len(text) > MAX_LENGTH:
        return None, [Mistake(0, len(text), f"this is longer than {MAX_LENGTH} characters")]
    if not text.strip():
        return None, [Mistake(0, len(text), "nothing is written here", "such as payload >= 2.0")]
    try:
        return _Parser(_tokens(Source("", text))).whole(), []
    except _Stop as stop:
        return None, [stop.mistake]


class _Parser:
    """One run over the tokens of one text; every method raises _Stop at a mistake."""

    def __init__(self, tokens: list[_Token]) -> None:
        self._tokens, self._at, self._depth = tokens, 0, 0

    def whole(self) -> Expr:
        """The one expression that the text is."""
        found = self._expression()
        if self._next.kind != "end":
            before = self._tokens[self._at - 1]
            hint = _WORDS.get(self._next.text) or _WORDS.get(before.text, "the condition ends before it")
            raise _Stop(self._next.span, f"{self._next} is not expected here", hint)
        return found

    @property
    def _next(self) -> _Token:
        return self._tokens[self._at]

    def _advance(self) -> _Token:
        token = self._next
        self._at = min(self._at + 1, len(self._tokens) - 1)
        return token

    def _sees(self, *symbols: str) -> bool:
        return self._next.kind != "string" and self._next.text in symbols

    def _close(self, symbol: str, opening: _Token) -> _Token:
        if not self._sees(symbol):
            end = self._tokens[self._at - 1].span.end
            place = Span(opening.span.source, end, end)
            raise _Stop(place, f"missing {symbol} after this", f"it closes the {opening.text}")
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
            raise _Stop(place, f"this is nested more than {MAX_NESTING} levels deep")

    def _bounded(self, found: Expr) -> Expr:
        self._limit(self._depth + found.height, found.span)
        return found

    # --- expressions --------------------------------------------------------------------------------------

    def _expression(self) -> Expr:
        with self._nested():
            found = self._binary(1)
        if self._sees("="):
            raise _Stop(self._next.span, "'=' would assign", "compare with ==")
        if self._sees("?"):
            raise _Stop(self._next.span, "L has no ? : expression")
        self._check_operator()
        return found

    def _check_operator(self) -> None:
        sign = self._next
        if sign.kind == "symbol" and sign.text in _FOREIGN:
            raise _Stop(sign.span, f"a condition has no operator {sign.text}", _INSTEAD.get(sign.text, ""))

    def _binary(self, weakest: int) -> Expr:
        """Operators of at least this precedence."""
        left = self._unary()
        while self._next.kind == "symbol" and (strength := _PRECEDENCE.get(self._next.text, 0)) >= weakest:
            sign = self._advance()
            with self._nested():
                right = self._binary(strength + 1)
            height = 1 + max(left.height, right.height)
            span = left.span.to(right.span)
            left = self._bounded(Binary(span, height, sign.text, sign.span, left, right))
        return left

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
            raise _Stop(name.span, f"expected the name of a member, found {name}")
        self._advance()
        return Member(owner.span.to(name.span), owner.height + 1, owner, name.text, name.span)

    def _call(self, function: Expr, opening: _Token) -> Expr:
        if not isinstance(function, Name | Member):
            raise _Stop(opening.span, "only a name can be called", "write name(...)")
        given, end = self._arguments(opening)
        height = 1 + max([function.height, *(argument.height for argument in given)])
        return Call(function.span.to(end.span), height, function, given)

    def _arguments(self, opening: _Token) -> tuple[list[Expr], _Token]:
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
                raise _Stop(token.span, f"expected an expression, found {token}", f"'{word}' is a word of L")
            case "name", _:
                return Name(token.span, 1, token.text)
            case "symbol", "(":
                inner = self._expression()
                self._close(")", token)
                return inner
        raise _Stop(token.span, f"expected an expression, found {token}")


def _number(token: _Token, minus: _Token | None) -> Expr:
    """A number with its sign: the smallest int has no positive counterpart."""
    value, span = token.value, token.span if minus is None else minus.span.to(token.span)
    assert isinstance(value, int | float)
    signed = value if minus is None else -value
    too_large = math.isinf(signed) if isinstance(signed, float) else not -_INT_LIMIT <= signed < _INT_LIMIT
    if too_large:
        raise _Stop(span, f"the number {span.text[:30]} does not fit into 64 bits")
    return Literal_(span, 1, signed)
