"""Characters to tokens (appendix A, completed with comments, escapes and reals)."""

from __future__ import annotations

import re
from enum import Enum

from msgspec import Struct, field

from lfield.lang import messages
from lfield.text.message_tables import FindingKind
from lfield.text.source_text import Diagnostics, Source, Span

#: Reserved words; `specific` is a word only after `resource` or `coordinator` in the head of a class.
KEYWORDS = frozenset(
    (
        *("resource", "coordinator", "class", "include", "init", "portal", "emit", "synchronized"),
        *("public", "private", "boolean", "int", "real", "string", "void"),
        *("if", "else", "while", "for", "break", "continue", "return", "try", "catch", "throw"),
        *("new", "this", "true", "false", "null"),
    )
)

#: Operators of C and Java that L does not have; they are tokens, so that the parser can report them.
FOREIGN_OPERATORS = frozenset(
    (
        *("++", "--", "&=", "|=", "^="),
        *("===", "!==", "<<", ">>", "&", "|", "^", "~", "->", "=>", "::"),
    )
)


#: A regular expression of the units that other languages write after a number, and the hint for them.
_UNITS = "ms|s|min|h|[cmk]?m|deg|rad|[kmu]?g|k?Hz|[NVAW]"
UNIT_HINT = "numbers have no units: write the value in SI units, such as m, s and rad"


class TokenKind(Enum):
    """The kind of a token. Keywords and operators are distinguished by their text."""

    NAME = "name"
    KEYWORD = "keyword"
    INT = "int"
    REAL = "real"
    STRING = "string"
    SYMBOL = "symbol"
    END = "end"


class Token(Struct, eq=False):
    """One token; `value` is the number or the text (escapes decoded) of a literal, or the name of END."""

    kind: TokenKind
    text: str
    span: Span
    value: int | float | str | None = None

    def __str__(self) -> str:
        """The token in an error message."""
        if self.kind is TokenKind.END:
            return str(self.value)
        if self.kind is TokenKind.STRING:
            return "text"
        return f"'{self.text}'" if len(self.text) <= 40 else "a very long word"


class Scan(Struct):
    """All tokens of a source, END last, and the lines on which the scanner found a mistake.

    The parser reports no mistakes on those lines, so that one mistake is reported once. `cut` means that
    a part of the text was unreadable and may have contained anything.
    """

    tokens: list[Token] = field(default_factory=list)
    bad_lines: set[int] = field(default_factory=set)
    cut: bool = False


_TOKEN = re.compile(
    r"""
      (?P<space>         [\ \t\r\n\f]++ | //[^\n]*+ )
    | (?P<comment>       /\*(?s:.*?)\*/ )
    | (?P<open_comment>  /\*(?s:.*) )
    | (?P<real>          (?: \d*+\.\d++ (?:[eE][+-]?\d++)?+ | \d++[eE][+-]?\d++ ) (?![\w.]) )
    | (?P<int>           \d++ (?![\w.]) )
    | (?P<bad_number>    \.?\d[\w.]*+ )
    | (?P<name>          [A-Za-z_]\w*+ )
    | (?P<string>        "(?: [^"\\\n]++ | \\[^\n] )*+" )
    | (?P<open_string>   "[^\n]*+ )
    | (?P<quoted>        '[^'\n]*+'?+ | [“”„«][^“”»"\n]{0,1000}+[“”»"] )
    | (?P<symbol>        ===|!==|&&|\|\||==|!=|<=|>=|\+\+|--|[-+*/%&|^]=|->|=>|::|<<|>>
                         |[-+*/%=!<>&|^~?:;,.(){}\[\]] )
    | (?P<hash>          \#[^\n]*+ )
    | (?P<decorator>     @[A-Za-z_][\w.]*+ )
    | (?P<illegal>       (?: [^\x00-\x7f] | [@`$\\\x00-\x08\x0b\x0e-\x1f\x7f] )++ )
    """,
    re.VERBOSE | re.ASCII,
)
#: The same pattern with parameters of queries, `$kg`, as names.
_QUERY_TOKEN = re.compile(
    _TOKEN.pattern.replace("(?P<name>          [A-Za-z_]", r"(?P<name>  \$?+[A-Za-z_]"), re.VERBOSE | re.ASCII
)
_SKIPPED = frozenset({"space", "comment"})
_NOT_TEXT = re.compile("[\0\ud800-\udfff]")
_ESCAPE = re.compile(r"\\(u\{[0-9a-fA-F]{1,6}\}|u\{?|.)", re.DOTALL)
_SIMPLE_ESCAPES = {"n": "\n", "t": "\t", "r": "\r", "0": "\0", '"': '"', "\\": "\\"}


def scan(
    source: Source, found: Diagnostics, *, end: str = "the end of the file", parameters: bool = False
) -> Scan:
    """All tokens of the source. Errors go to `found`; only a file that is not text stops the scan.

    With `parameters`, `$kg` is a name.
    """
    scanner = _Scanner(source, found, _QUERY_TOKEN if parameters else _TOKEN)
    scanner.run(end)
    return scanner.result


class _Scanner:
    """One run over one source."""

    def __init__(self, source: Source, found: Diagnostics, token: re.Pattern[str]) -> None:
        self.source, self.found, self.pattern = source, found, token
        self.result = Scan()

    def run(self, end_name: str) -> None:
        text = self.source.text
        end = self.span(len(text), len(text))
        if alien := _NOT_TEXT.search(text):
            where = self.span(alien.start(), alien.end())
            self.error(messages.NOT_TEXT, where, character=f"U+{ord(alien.group()):04X}")
            self.result.bad_lines.add(end.line)
            self.result.cut = True
        else:
            for match in self.pattern.finditer(text):
                group = str(match.lastgroup)
                if group not in _SKIPPED:
                    self.token(group, match.group(), self.span(*match.span()))
        self.result.tokens.append(Token(TokenKind.END, "", end, end_name))

    def token(self, group: str, text: str, span: Span) -> None:
        """Append the token of one match, or report it."""
        match group:
            case "symbol":
                self.append(TokenKind.SYMBOL, text, span)
            case "name":
                self.append(TokenKind.KEYWORD if text in KEYWORDS else TokenKind.NAME, text, span)
            case "int":
                # Twenty digits are out of range already; more would only cost time.
                self.append(TokenKind.INT, text, span, int((text.lstrip("0") or "0")[:20]))
            case "real":
                self.append(TokenKind.REAL, text, span, float(text))
            case "string":
                self.append(TokenKind.STRING, text, span, self.decoded(text, span))
            case _:
                self.mistake(group, text, span)

    def mistake(self, group: str, text: str, span: Span) -> None:
        """Report an invalid token and replace it by the token that was probably intended."""
        match group:
            case "open_comment":
                opening = self.span(span.start, span.start + 2)
                self.error(messages.UNCLOSED_COMMENT, opening)
                self.result.bad_lines.add(self.span(span.end, span.end).line)
                self.result.cut = True
            case "bad_number":
                self.error(messages.BAD_NUMBER, span, hint=_number_hint(text), text=text[:40])
                self.append(TokenKind.INT, text, span, 0)
            case "open_string":
                self.error(messages.UNCLOSED_STRING, span)
                self.append(TokenKind.STRING, text, span, "")
            case "quoted":
                self.error(messages.SINGLE_QUOTES, span, text=text.strip("'“”„«»\""))
                self.append(TokenKind.STRING, text, span, "")
            case _:
                where = self.span(span.start, span.start + 1) if group == "hash" else span
                self.error(
                    messages.ILLEGAL_CHARACTER,
                    where,
                    hint=_character_hint(text),
                    character=_character_text(text[0]),
                )

    def decoded(self, text: str, span: Span) -> str:
        """The text of a string literal with its escapes replaced."""

        def replace(match: re.Match[str]) -> str:
            escape = match.group(1)
            if escape in _SIMPLE_ESCAPES:
                return _SIMPLE_ESCAPES[escape]
            number = int(escape[2:-1], 16) if escape.endswith("}") and len(escape) > 3 else -1
            if 0 <= number < 0xD800 or 0xE000 <= number <= 0x10FFFF:
                return chr(number)
            start = span.start + 1 + match.start()
            where = self.span(start, start + len(match.group()))
            self.error(messages.BAD_ESCAPE, where, escape=match.group())
            return ""

        return _ESCAPE.sub(replace, text[1:-1])

    def append(self, kind: TokenKind, text: str, span: Span, value: int | float | str | None = None) -> None:
        self.result.tokens.append(Token(kind, text, span, value))

    def error(self, message: FindingKind, span: Span, *, hint: str | None = None, **values: object) -> None:
        self.found.add(message.at(span, hint=hint, **values))
        self.result.bad_lines.add(span.line)

    def span(self, start: int, end: int) -> Span:
        return Span(self.source, start, end)


def _character_text(character: str) -> str:
    """A character for a message: itself with its number, or only the number when it cannot be seen."""
    number = f"U+{ord(character):04X}"
    return f"'{character}' ({number})" if character.isprintable() and not character.isspace() else number


def _number_hint(text: str) -> str | None:
    """The correct form instead of a number of another language; None for the usual hint."""
    if re.fullmatch(r"0[xX][0-9a-fA-F]{1,15}|0[bB][01]{1,60}|0[oO][0-7]{1,20}", text):
        return f"L has only decimal numbers: write {int(text, 0)}"
    plain = text.replace("_", "")
    if plain != text and plain.isdigit():
        return f"write {plain[:40]}"
    if suffixed := re.fullmatch(r"(\d+(?:\.\d+)?)[fFdDlLuU]{1,3}", text):
        return f"write {suffixed[1][:40]}"
    if re.fullmatch(rf"\d+(\.\d+)?({_UNITS})", text):
        return UNIT_HINT
    return None


def is_unit(token: Token) -> bool:
    """Whether a name is the sign of a unit, which a number of another language may have."""
    return token.kind is TokenKind.NAME and re.fullmatch(_UNITS, token.text) is not None


def _character_hint(text: str) -> str | None:
    """The hint for characters that word processors and web pages insert; None for the usual one."""
    character = text[0]
    if character in "“”„‟«»":
        return 'write the straight quote "'
    if character in "‘’":
        return "remove it; a string is in straight double quotes"
    if character in "–—−":
        return "write the minus sign -"
    if character == "#":
        if re.match(r"#\s*include\b", text):
            return 'leave out the # and end with ; as in include "file.L"; (L has no headers of C and C++)'
        if re.match(r"#\s*(define|pragma|ifdef|ifndef|if|else|endif|undef)\b", text):
            return "L has no preprocessor; leave the line out. A comment begins with //"
        return "a comment begins with //"
    if character == "@" and len(text) > 1:
        return "L has no decorators and annotations; leave it out"
    if character.isspace() or not character.isprintable():
        return "it cannot be seen; replace it by a plain space"
    return None
