"""The tokens and comments of a program, with the white space between them measured."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

from msgspec import Struct

from lfield.lang.parser.type_names import GENERIC_TYPES
from lfield.lang.scanner import Token, TokenKind, scan
from lfield.text.source_text import Diagnostics, Source

#: The width of a tab in the source, and of one level of indentation.
INDENT = 4
#: The text between two tokens is white space and these.
_COMMENT = re.compile(r"//[^\n]*|/\*(?s:.*?)\*/")
_SPACE = re.compile(r"\s+")


class SourceItem(Struct, frozen=True):
    """A token or a comment (kind None).

    `breaks` are the line breaks before it. `column` is its first column, `indent` the first column of the
    text of its line, both counted from 0. `pad` are the spaces between it and the item before it.
    """

    text: str
    kind: TokenKind | None
    breaks: int
    column: int
    indent: int
    pad: int

    @property
    def is_comment(self) -> bool:
        """Whether the item is a comment."""
        return self.kind is None

    @property
    def ends_line(self) -> bool:
        """Whether a line break must follow."""
        return self.kind is None and self.text.startswith("//")

    def is_symbol(self, *texts: str) -> bool:
        """Whether the item is one of these symbols or keywords."""
        return self.kind in (TokenKind.SYMBOL, TokenKind.KEYWORD) and self.text in texts


def source_items(source: Source) -> list[SourceItem]:
    """All tokens and comments of a source without syntax errors, in order."""
    text, end = source.text, 0
    items: list[SourceItem] = []
    for start, stop, kind in _pieces(text, scan(source, Diagnostics()).tokens):
        first = text.rfind("\n", 0, start) + 1
        line = text[first:start]
        column, breaks = width(line), text.count("\n", end, start)
        written = text[start:stop]
        if kind is None:
            written = written.rstrip().replace("\r", "")
        elif written.startswith("<") and len(written) > 2:
            # The path of an include.
            written = f"<{written[1:-1].strip()}>"
        elif kind is TokenKind.NAME and written.endswith(">"):
            # The type of a map.
            written = _SPACE.sub("", written).replace(",", ", ")
        indent = width(line[: len(line) - len(line.lstrip())])
        pad = 0 if breaks else column - width(text[first:end])
        items.append(SourceItem(written, kind, breaks, column, indent, pad))
        end = stop
    return items


def width(line: str) -> int:
    """The columns of a text without line breaks, with tabs."""
    return len(line.expandtabs(INDENT))


def _pieces(text: str, tokens: Sequence[Token]) -> Iterator[tuple[int, int, TokenKind | None]]:
    """Start, end and kind of each token and comment. The path in `include <path>` is one token."""
    end, at = 0, 0
    while at < len(tokens):
        start, stop, kind = tokens[at].span.start, tokens[at].span.end, tokens[at].kind
        for comment in _COMMENT.finditer(text, end, start):
            yield comment.start(), comment.end(), None
        if kind is TokenKind.END:
            return
        if at and tokens[at].text == "<" and tokens[at - 1].text == "include":
            at = next(n for n in range(at, len(tokens)) if tokens[n].text == ">")
            stop, kind = tokens[at].span.end, TokenKind.STRING
        if tokens[at].text in GENERIC_TYPES and (last := _end_of_type(text, tokens, at)):
            at, stop = last, tokens[last].span.end
        yield start, stop, kind
        end, at = stop, at + 1


def _end_of_type(text: str, tokens: Sequence[Token], at: int) -> int:
    """The last token of `map<string, int>` or `future<real>` that begins at a token; 0 for any other name."""
    if tokens[at + 1].text != "<":
        return 0
    if (
        tokens[at].text == "map"
        and tokens[at + 2].text not in ("string", "int")
        and tokens[at + 3].text != ","
    ):
        return 0
    depth, last = 0, at
    while depth or last == at:
        last += 1
        if tokens[last].kind is TokenKind.END or tokens[last].text in (";", "{", "}", "("):
            return 0
        sign = tokens[last].text
        if tokens[last].kind is TokenKind.SYMBOL and sign not in ("<", ">", ">>", ",", "[", "]"):
            return 0
        depth += {"<": 1, ">": -1, ">>": -2}.get(sign, 0)
    commented = _COMMENT.search(text, tokens[at].span.start, tokens[last].span.end)
    return 0 if commented else last


def same_content(before: Sequence[SourceItem], after: Sequence[SourceItem]) -> bool:
    """Whether two texts differ in white space only, so that they are compiled to the same program."""
    return [_content(item) for item in before] == [_content(item) for item in after]


def _content(item: SourceItem) -> tuple[TokenKind | None, list[str]]:
    lines = item.text.split("\n") if item.is_comment else [item.text]
    return item.kind, [line.strip() if item.is_comment else line for line in lines]
