"""Whether a space is between two tokens of a line.

Operators have a space on both sides, brackets none inside. A parenthesis has a space before it in `if (a)`,
none in `f(a)`.
"""

from __future__ import annotations

from lfield.editor.layout.statement_structure import Placed, TokenRole
from lfield.lang.scanner import TokenKind

#: Keywords before a parenthesis of an expression; after all other ones and after names are arguments.
_BEFORE_GROUP = ("return", "throw", "if", "while", "for", "catch", "else", "emit", "new", "try", "include")
_TIGHT = (",", ";", ".")


def is_spaced(left: Placed, right: Placed) -> bool:
    """Whether a space is between two neighbours of a line."""
    if left.item.is_comment or right.item.is_comment:
        return _is_comment_spaced(left, right)
    if _symbol(right) in _TIGHT or _symbol(left) == ".":
        return False
    if left.is_unary:
        # Without the space it would be another token.
        return right.is_unary and left.item.text == right.item.text == "-"
    if left.opens_bracket or right.role is TokenRole.CLOSE_BRACKET:
        return False
    if _symbol(right) == "(":
        return right.is_head or not _is_called(left)
    if _symbol(right) == "[":
        return not _ends_operand(left)
    if _symbol(right) == ":":
        return right.enclosing == "("
    return True


def _is_comment_spaced(left: Placed, right: Placed) -> bool:
    if right.item.is_comment:
        return not left.opens_bracket
    return right.role is not TokenRole.CLOSE_BRACKET and _symbol(right) not in (",", ";")


def _symbol(placed: Placed) -> str:
    """The text of a symbol, '' for all other tokens."""
    return placed.item.text if placed.item.kind is TokenKind.SYMBOL else ""


def _is_called(left: Placed) -> bool:
    """Whether a parenthesis after a token has arguments or parameters."""
    if left.item.kind is TokenKind.KEYWORD:
        return left.item.text not in _BEFORE_GROUP
    return _ends_operand(left)


def _ends_operand(left: Placed) -> bool:
    """Whether a token may be the end of a name, a type or an operand."""
    if left.role is TokenRole.CLOSE_BRACKET:
        return True
    if left.item.kind is TokenKind.SYMBOL:
        return False
    return left.item.kind is not TokenKind.KEYWORD or left.item.text not in _BEFORE_GROUP
