"""The columns of comments after code: those that are below each other in the source stay so."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from msgspec import Struct

from lfield.editor.layout.line_layout import Row


class _Aligned(Struct, frozen=True):
    """A comment with its row; `end` is the end of the code before it, 0 without code.

    `column` and `pad`, the spaces before it, are those of the source; `shift` is the movement of its row.
    """

    row: int
    column: int
    end: int
    shift: int
    pad: int


def comment_columns(rows: Sequence[Row]) -> dict[int, int]:
    """The column of the comment of each row that has one after code, or below such a one."""
    found: dict[int, int] = {}
    for group in _groups(rows):
        column = max(comment.end + 1 for comment in group)
        if is_aligned := any(comment.pad > 1 for comment in group):
            column = max(column, group[0].column + group[0].shift)
        for comment in group:
            found[comment.row] = (
                column if is_aligned else comment.end + 1 if comment.end else found[comment.row - 1]
            )
    return found


def _groups(rows: Sequence[Row]) -> Iterator[list[_Aligned]]:
    """Comments in consecutive rows that begin in the same column of the source."""
    group: list[_Aligned] = []
    for number, row in enumerate(rows):
        comment = _aligned(number, row)
        is_below = (
            group and comment is not None and not row.is_behind_blank and comment.column == group[-1].column
        )
        if group and not is_below:
            yield group
            group = []
        if comment is not None and (is_below or comment.end):
            group.append(comment)
    if group:
        yield group


def _aligned(number: int, row: Row) -> _Aligned | None:
    """The comment of a row that may be aligned: after code, or alone in the row."""
    last = row.pieces[-1].item
    if not last.ends_line:
        return None
    if row.trailing is None:
        return _Aligned(number, last.column, 0, 0, 0) if len(row.pieces) == 1 else None
    line = row.text().rpartition("\n")[2]
    indent = len(line) - len(line.lstrip())
    return _Aligned(number, last.column, len(line), indent - last.indent, last.pad)
