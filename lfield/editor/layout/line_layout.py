"""Converts tokens and comments to lines, with their starts and indentation.

Line breaks within a statement are those of the source. A statement begins a line, unless it is in a block
that the source has on one line.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import accumulate

from msgspec import Struct, field

from lfield.editor.layout.source_items import INDENT, SourceItem, width
from lfield.editor.layout.spacing import is_spaced
from lfield.editor.layout.statement_structure import Placed, StatementStructure, TokenRole


class Row(Struct):
    """A line: its indentation, its tokens and comments, and whether a blank line is before it.

    `first` is the index of its first item in the source.
    """

    indent: int
    first: int
    is_behind_blank: bool = False
    pieces: list[Placed] = field(default_factory=list)

    @property
    def code(self) -> Sequence[Placed]:
        """The pieces without a comment at the end of the line."""
        return self.pieces[:-1] if self.trailing is not None else self.pieces

    @property
    def trailing(self) -> Placed | None:
        """The comment after code that ends the line."""
        last = self.pieces[-1]
        return last if len(self.pieces) > 1 and last.item.ends_line else None

    def text(self, count: int | None = None) -> str:
        """The line without a comment at its end, or its first `count` pieces."""
        pieces = self.code[:count]
        line = " " * self.indent
        for at, piece in enumerate(pieces):
            if at and is_spaced(pieces[at - 1], piece):
                line += " "
            line += _shifted(piece.item, line) if "\n" in piece.item.text else piece.item.text
        return line

    def width(self, count: int | None = None) -> int:
        """The end of that text in columns; of a comment with several lines the last one counts."""
        return len(self.text(count).rpartition("\n")[2])


def _shifted(comment: SourceItem, before: str) -> str:
    """A comment of several lines, which move with the first one."""
    shift = len(before.rpartition("\n")[2]) - comment.column
    first, *further = comment.text.split("\n")
    lines = [first.rstrip()]
    for line in further:
        text = line.strip()
        indent = width(line[: len(line) - len(line.lstrip())]) + shift
        lines.append(" " * max(indent, 0) + text if text else "")
    return "\n".join(lines)


class LineLayout:
    """One pass over the items of a source; `rows` is the result."""

    def __init__(self, items: Sequence[SourceItem]) -> None:
        self.rows: list[Row] = []
        self._placed = StatementStructure(items).placed
        self._breaks = [0, *accumulate(item.breaks for item in items)]
        #: The blocks that are open, and of the brackets in this statement the indentation of their lines.
        self._blocks: list[int] = []
        self._brackets: list[int] = []
        self._hanging: set[int] = set()
        self._statement_indent = 0
        for index, placed in enumerate(self._placed):
            if placed.item.is_comment:
                self._add_comment(index, placed)
            else:
                self._add_token(index, placed)

    # --- comments ---------------------------------------------------------------------------------------

    def _add_comment(self, index: int, placed: Placed) -> None:
        if self.rows and placed.item.breaks == 0:
            self._append(placed)
            return
        following = self._following(index)
        if following is None:
            self._start_line(index, 0)
        elif following.role is TokenRole.CLOSE:
            self._start_line(index, following.level + 1)
        elif following.role in (TokenRole.STATEMENT, TokenRole.CLAUSE, TokenRole.BODY):
            self._start_line(index, following.level)
        else:
            self._continue_line(index)
        self._append(placed)

    def _following(self, index: int) -> Placed | None:
        """The next token."""
        while index < len(self._placed) and self._placed[index].item.is_comment:
            index += 1
        return self._placed[index] if index < len(self._placed) else None

    # --- tokens -----------------------------------------------------------------------------------------

    def _add_token(self, index: int, placed: Placed) -> None:
        if placed.role is TokenRole.CLOSE:
            is_first = self._is_expanded(self._blocks.pop())
        else:
            is_first = self._is_first_on_line(index, placed) and not self._is_behind_leading_comment(placed)
        if is_first:
            self._start_line(index, placed.level)
        elif self._continues(index, placed):
            self._continue_line(index)
        self._append(placed)
        if placed.is_block:
            self._blocks.append(index)

    def _is_first_on_line(self, index: int, placed: Placed) -> bool:
        """Whether a statement, body or clause begins a line."""
        match placed.role:
            case TokenRole.STATEMENT:
                is_open = not self._blocks or self._is_expanded(self._blocks[-1])
                return is_open and not placed.item.is_symbol(";")
            case TokenRole.BODY:
                return placed.must_break
            case TokenRole.CLAUSE:
                return self._is_clause_first(index, placed)
        return False

    def _is_clause_first(self, index: int, placed: Placed) -> bool:
        """Whether `else`, `catch` or `finally` begins a line: not after a brace that begins one."""
        before = self._placed[index - 1]
        if (
            before.role is TokenRole.CLOSE
            and self._is_expanded(before.partner)
            and before.level == placed.level
        ):
            return False
        return placed.must_break or placed.item.breaks > 0 or before.item.ends_line

    def _is_expanded(self, opening: int) -> bool:
        """Whether the statements of a block have lines of their own: the block has a line break."""
        closing = self._placed[opening].partner
        return self._breaks[closing + 1] > self._breaks[opening + 1]

    def _is_behind_leading_comment(self, placed: Placed) -> bool:
        """Whether `/* ... */` begins the line and the token is after it."""
        last = self.rows[-1].pieces[-1].item if self.rows else None
        is_leading = last is not None and len(self.rows[-1].pieces) == 1 and last.is_comment
        return is_leading and last is not None and not last.ends_line and placed.item.breaks == 0

    def _continues(self, index: int, placed: Placed) -> bool:
        """Whether a line break within a statement is before the token."""
        if not self.rows:
            return True
        if self.rows[-1].pieces[-1].item.ends_line:
            return True
        if placed.role is not TokenRole.INNER and placed.role is not TokenRole.CLOSE_BRACKET:
            return False
        if placed.item.breaks == 0 or placed.item.is_symbol(";", ","):
            return False
        return placed.role is TokenRole.INNER or placed.partner in self._hanging

    # --- lines ------------------------------------------------------------------------------------------

    def _start_line(self, index: int, level: int) -> None:
        """Begin a line with a statement, a comment before one, or a brace."""
        self._brackets.clear()
        self._statement_indent = level * INDENT
        placed = self._placed[index]
        may_be_apart = placed.item.is_comment or placed.role is TokenRole.STATEMENT
        is_inside = bool(self.rows) and not self.rows[-1].code[-1].is_block
        self.rows.append(Row(level * INDENT, index, may_be_apart and is_inside and placed.item.breaks > 1))

    def _continue_line(self, index: int) -> None:
        """Begin a line within a statement."""
        placed = self._placed[index]
        if index and self._placed[index - 1].opens_bracket:
            self._hanging.add(index - 1)
        if placed.role is TokenRole.CLOSE_BRACKET and self._brackets:
            indent = self._brackets[-1]
        elif self._brackets:
            indent = self._brackets[-1] + INDENT
        else:
            indent = self._statement_indent + (0 if placed.role is TokenRole.OPEN else INDENT)
        self.rows.append(Row(indent, index))

    def _append(self, placed: Placed) -> None:
        """Add a piece to the current line."""
        self.rows[-1].pieces.append(placed)
        if placed.opens_bracket:
            self._brackets.append(self.rows[-1].indent)
        elif placed.role is TokenRole.CLOSE_BRACKET and self._brackets:
            self._brackets.pop()
