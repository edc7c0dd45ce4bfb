"""Line breaks in lines that are too long."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from lfield.editor.layout.line_layout import Row
from lfield.editor.layout.statement_structure import Placed, TokenRole

#: The most characters of a line, without a comment at its end.
MAX_WIDTH = 120
#: Binary operators before which a line may be broken; the weakest first.
_STRENGTHS = {
    "||": 1,
    "&&": 2,
    **dict.fromkeys(("==", "!=", "<", "<=", ">", ">="), 3),
    **dict.fromkeys(("+", "-"), 4),
    **dict.fromkeys(("*", "/", "%"), 5),
}


def further_breaks(rows: Sequence[Row]) -> set[int]:
    """The indices of items that must begin a line; one for each line that is too long and can be broken."""
    found = (_further_break(row) for row in rows if row.width() > MAX_WIDTH)
    return {index for index in found if index is not None}


def _further_break(row: Row) -> int | None:
    """The next break: a block in one line gets several lines, a body its own one; else in the statement."""
    pieces = row.code
    for at, placed in enumerate(pieces[:-1]):
        if placed.is_block and pieces[at + 1].role is not TokenRole.CLOSE:
            return row.first + at + 1
    for at, placed in enumerate(pieces[1:], 1):
        is_further = pieces[at - 1].item.is_symbol("else") and placed.item.is_symbol("if")
        if placed.role is TokenRole.BODY and not is_further:
            return row.first + at
    return _break_in_statement(row, pieces)


def _break_in_statement(row: Row, pieces: Sequence[Placed]) -> int | None:
    """The last place that fits, of those within the fewest brackets and at the weakest operators."""
    best: tuple[tuple[int, int], int] | None = None
    for at, rank in _candidates(pieces):
        if row.width(at) > MAX_WIDTH:
            break
        if best is None or rank <= best[0]:
            best = rank, at
    return None if best is None else row.first + best[1]


def _candidates(pieces: Sequence[Placed]) -> Iterator[tuple[int, tuple[int, int]]]:
    """The places where a line may be broken: the brackets around them, and the strength of the operator."""
    depth = 0
    for at, placed in enumerate(pieces):
        before = pieces[at - 1] if at else None
        if before is not None:
            if before.opens_bracket:
                depth += 1
            if placed.role is TokenRole.CLOSE_BRACKET:
                depth -= 1
            if placed.role is not TokenRole.INNER or placed.item.is_symbol(";", ","):
                continue
            if before.item.is_symbol(",", ";") and placed.enclosing:
                yield at, (depth, 0)
            elif placed.item.is_symbol(*_STRENGTHS) and not placed.is_unary:
                yield at, (depth, _STRENGTHS[placed.item.text])
