"""The tokens of conditions over attributes: those of L, whose literals, escapes and comments they have."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import lru_cache

from lfield.capability.condition import Mistake
from lfield.text.source import Source, Span


@dataclass(frozen=True, slots=True)
class Token:
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


class Stop(Exception):
    """There is a mistake: what follows could only repeat it."""

    def __init__(self, place: Span, message: str, hint: str = "") -> None:
        self.mistake = Mistake(place.start, place.end, message, hint)


@lru_cache(maxsize=1)
def _scanner() -> re.Pattern[str]:
    return re.compile(_TOKEN, re.VERBOSE | re.ASCII)


def tokens(source: Source) -> list[Token]:
    """The tokens of a text, an end behind the last. Raises Stop."""
    found = [
        _token(match, Span(source, *match.span()))
        for match in _scanner().finditer(source.text)
        if match.lastgroup != "space"
    ]
    end = len(source.text)
    return [*found, Token("end", "", Span(source, end, end))]


def _token(match: re.Match[str], span: Span) -> Token:
    group, text = match.lastgroup or "", match.group()
    match group:
        case "int":
            # Twenty digits are out of range already; more would only cost time.
            return Token("number", text, span, int((text.lstrip("0") or "0")[:20]))
        case "real":
            return Token("number", text, span, float(text))
        case "string":
            return Token("string", text, span, _decoded(span))
        case "name" | "symbol":
            return Token(group, text, span)
    message, hint = _NO_TOKENS[group]
    raise Stop(span, message.format(text[:40]), hint)


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
        raise Stop(
            where, f"{match.group()} is not an escape", r"the escapes are \n \t \r \0 \" \\ and \u{...}"
        )

    return _ESCAPE.sub(replace, span.text[1:-1])
