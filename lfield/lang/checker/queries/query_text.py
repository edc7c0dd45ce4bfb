"""The text of a query, if the compiler knows it: a literal, a constant, or a sum of those."""

from __future__ import annotations

from msgspec import Struct

from lfield.lang import tree
from lfield.lang.tree_traversal import left_spine
from lfield.lang.types import STRING
from lfield.text.source_text import Span


class QueryText(Struct, frozen=True):
    """A text with the expressions of its parts, each with its first character."""

    text: str
    pieces: tuple[tuple[int, tree.Literal_], ...]

    def place(self, start: int, end: int) -> Span:
        """The place of some characters in the program.

        In a literal with escapes the offsets are not those of the file: then the whole literal is marked.
        """
        first, piece = next(
            (start_and_piece for start_and_piece in reversed(self.pieces) if start_and_piece[0] <= start),
            self.pieces[0],
        )
        span, text = piece.span, str(piece.value)
        if span.text != f'"{text}"' or end > first + len(text):
            return span
        inside = span.start + 1 - first
        return Span(span.source, inside + start, inside + end)


def query_text(expr: tree.Expr) -> QueryText | None:
    """The text of an expression; None if it is known only at run time."""
    text = ""
    pieces: list[tuple[int, tree.Literal_]] = []
    for piece in text_pieces(expr):
        if not isinstance(piece, tree.Literal_) or not isinstance(piece.value, str):
            return None
        pieces.append((len(text), piece))
        text += piece.value
    return QueryText(text, tuple(pieces))


def text_pieces(expr: tree.Expr) -> list[tree.Expr]:
    """The operands of a sum of texts, from left to right."""
    links = [*left_spine(expr, _left), expr]
    found = [links[0]]
    for link in links[1:]:
        assert isinstance(link, tree.Binary)
        found += text_pieces(link.right) if _is_sum(link.right) else [link.right]
    return found


def _left(expr: tree.Expr) -> tree.Expr | None:
    return expr.left if isinstance(expr, tree.Binary) and _is_sum(expr) else None


def _is_sum(expr: tree.Expr) -> bool:
    return isinstance(expr, tree.Binary) and expr.op == "+" and expr.type == STRING
