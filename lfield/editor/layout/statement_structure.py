"""The starts and ends of statements, blocks and clauses, found from the tokens alone.

Only statements whose body may have no braces are known here. So a new statement of L with braces needs no
change.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import Enum, auto

from msgspec import Struct, field

from lfield.editor.layout.source_items import SourceItem
from lfield.lang.parser.loop_members import LOOP, LOOP_WORDS, RATES
from lfield.lang.parser.top_level import ENUM
from lfield.lang.scanner import TokenKind

#: Statements with parentheses, and a body that may be a single statement.
_HEADS = ("if", "while", "for", "catch")
#: The words that continue a statement after its body, with the statements.
_CLAUSES = {"else": ("if",), "catch": ("try", "catch"), "finally": ("try", "catch")}
#: The last tokens of an operand, besides names and literals.
_OPERAND_ENDS = (")", "]", "this", "true", "false", "null")
_OPERANDS = (TokenKind.NAME, TokenKind.INT, TokenKind.REAL, TokenKind.STRING)
_PAIRS = {"(": ")", "[": "]", "{": "}"}
#: The tokens before the brace of the elements of an array.
_BEFORE_ELEMENTS = ("=", "(", "[", ",", "return", ":")


class TokenRole(Enum):
    """The role of a token in the layout."""

    #: The first token of a statement, a member or a unit.
    STATEMENT = auto()
    #: The first token of a body without braces.
    BODY = auto()
    #: `else`, `catch` or `finally` after a body.
    CLAUSE = auto()
    #: The brace that opens a block.
    OPEN = auto()
    #: The brace that closes a block.
    CLOSE = auto()
    #: The token that closes a bracket of an expression or of parameters.
    CLOSE_BRACKET = auto()
    #: Any other token.
    INNER = auto()


class Placed(Struct):
    """A token or comment with its place.

    `level` is the indentation of a line that begins with it. `partner` is the index of the other bracket, -1
    for no bracket. `enclosing` is the innermost bracket around it in its statement. `is_head` is of the
    parenthesis of `if` and the like; a STATEMENT may also be a block (`is_block`).
    """

    item: SourceItem
    role: TokenRole = TokenRole.INNER
    level: int = 0
    partner: int = -1
    enclosing: str = ""
    is_unary: bool = False
    is_head: bool = False
    is_block: bool = False
    #: For a BODY or CLAUSE: whether it begins a line because of the source.
    must_break: bool = False

    @property
    def opens_bracket(self) -> bool:
        """Whether the token opens a bracket of an expression or of parameters."""
        return self.item.is_symbol("(", "[", "{") and not self.is_block


class _Head(Struct):
    """A statement that has no body yet: `if`, `else`, `try`. `is_broken`: its body has its own line."""

    kind: str
    level: int
    opening: int = -1
    is_broken: bool = False


class _Block(Struct):
    """A block that is open, with the unfinished statement in it, whose first token is `first`.

    `next` is the role of its next token, `ends` the end of its statements: `,` between members of an enum.
    """

    level: int
    ends: str = ";"
    heads: list[_Head] = field(default_factory=list)
    brackets: list[str] = field(default_factory=list)
    next: TokenRole = TokenRole.STATEMENT
    clause_level: int = 0
    is_body_broken: bool = False
    first: int = 0

    def statement_level(self) -> int:
        """The indentation of the innermost statement that is not finished."""
        return self.heads[-1].level if self.heads else self.level

    def push(self, head: _Head, following: TokenRole) -> None:
        """Begin a statement with a body."""
        self.heads.append(head)
        self.next = following

    def finish(self, following: str) -> None:
        """End a statement, and those whose body it is, unless the following token continues one of them."""
        owners = _CLAUSES.get(following, ())
        self.next, self.is_body_broken = TokenRole.STATEMENT, False
        while self.heads:
            head = self.heads.pop()
            self.is_body_broken |= head.is_broken
            if head.kind in owners:
                self.next, self.clause_level = TokenRole.CLAUSE, head.level
                return


class StatementStructure:
    """One pass over the items of a source without syntax errors; `placed` is the result."""

    def __init__(self, items: Sequence[SourceItem]) -> None:
        self.placed = [Placed(item) for item in items]
        self._tokens = [n for n, item in enumerate(items) if not item.is_comment]
        self._texts = ["" if items[n].kind is TokenKind.STRING else items[n].text for n in self._tokens]
        self._partners = self._matched()
        self._blocks = [_Block(0)]
        for at in range(len(self._tokens)):
            self._place(at)

    def _matched(self) -> dict[int, int]:
        """The other bracket of each bracket."""
        found: dict[int, int] = {}
        waiting: list[int] = []
        for at, text in enumerate(self._texts):
            if text in _PAIRS:
                waiting.append(at)
            elif text in _PAIRS.values() and waiting:
                opening = waiting.pop()
                found[opening], found[at] = at, opening
        return found

    def _text(self, at: int) -> str:
        return self._texts[at] if 0 <= at < len(self._texts) else ""

    def _item(self, at: int) -> Placed:
        return self.placed[self._tokens[at]]

    def _place(self, at: int) -> None:
        text, placed, block = self._texts[at], self._item(at), self._blocks[-1]
        if at in self._partners:
            placed.partner = self._tokens[self._partners[at]]
        is_priority = not block.brackets and self._is_word_of_loop(block, at - 1)
        is_sign = is_priority or not self._is_operand_end(at - 1)
        placed.is_unary = text == "!" or (text == "-" and is_sign)
        if block.brackets:
            self._place_inside(block, at, text)
        elif text == "}" and len(self._blocks) > 1:
            self._blocks.pop()
            placed.role, placed.level = TokenRole.CLOSE, block.level - 1
            self._blocks[-1].finish(self._text(at + 1))
        else:
            self._place_outside(block, at, text)

    def _is_operand_end(self, at: int) -> bool:
        return self._text(at) in _OPERAND_ENDS or (at >= 0 and self._item(at).item.kind in _OPERANDS)

    def _is_word_of_loop(self, block: _Block, at: int) -> bool:
        """Whether a token is a word in the head of a loop, and no name."""
        is_loop = self._text(block.first) == LOOP and self._text(block.first + 2) in RATES
        return is_loop and self._text(at) in LOOP_WORDS

    def _place_inside(self, block: _Block, at: int, text: str) -> None:
        """A token within brackets of a statement."""
        placed = self._item(at)
        placed.level, placed.enclosing = block.statement_level(), block.brackets[-1]
        if text in _PAIRS:
            block.brackets.append(text)
        elif text == _PAIRS[block.brackets[-1]]:
            placed.role = TokenRole.CLOSE_BRACKET
            block.brackets.pop()
            placed.enclosing = block.brackets[-1] if block.brackets else ""
            if block.heads and block.heads[-1].opening == self._partners[at]:
                block.next = TokenRole.BODY

    def _place_outside(self, block: _Block, at: int, text: str) -> None:
        """A token of a statement, outside all brackets."""
        placed = self._item(at)
        placed.role = role = block.next
        block.first = at if role is TokenRole.STATEMENT else block.first
        placed.level = block.clause_level if role is TokenRole.CLAUSE else block.statement_level()
        placed.must_break = role is TokenRole.CLAUSE and block.is_body_broken
        if role is TokenRole.BODY and self._is_body_broken(at, text):
            block.heads[-1].is_broken = placed.must_break = True
            placed.level += 1
        block.next = TokenRole.INNER
        if text == "{" and self._is_block(at, role):
            placed.is_block = True
            if role is not TokenRole.STATEMENT:
                placed.role = TokenRole.OPEN
            self._blocks.append(_Block(placed.level + 1, "," if self._text(at - 2) == ENUM else ";"))
        elif text in _PAIRS:
            block.brackets.append(text)
            placed.is_head = self._is_head(at, block)
        elif text == block.ends:
            block.finish(self._text(at + 1))
        elif role is not TokenRole.INNER:
            self._place_head(block, at, text, placed.level)

    def _place_head(self, block: _Block, at: int, text: str, level: int) -> None:
        """The first token of a statement, a body or a clause."""
        if text in _HEADS:
            block.push(_Head(text, level, at + 1), TokenRole.INNER)
        elif text in ("try", "else", "finally") and (text != "finally" or self._text(at + 1) == "{"):
            block.push(_Head(text, level), TokenRole.BODY)

    def _is_head(self, at: int, block: _Block) -> bool:
        """Whether a parenthesis belongs to `if`, `within` or the like: the body follows it."""
        if block.heads and block.heads[-1].opening == at:
            return True
        if self._is_word_of_loop(block, at - 1):
            return True
        if (self._text(at - 2), self._text(at - 1)) in (("wait", "until"), (")", "within")):
            return True
        before = self._item(at - 1)
        is_first = before.item.kind is TokenKind.NAME and before.role in (TokenRole.STATEMENT, TokenRole.BODY)
        return is_first and self._text(self._partners[at] + 1) == "{"

    def _is_block(self, at: int, role: TokenRole) -> bool:
        """Whether a brace outside all brackets opens a block, and not the elements of an array."""
        if role is not TokenRole.INNER:
            return True
        if self._text(at - 1) in _BEFORE_ELEMENTS:
            return False
        first = at - 1
        while self._text(first) in ("[", "]"):
            first -= 1
        return self._text(first - 1) != "new"

    def _is_body_broken(self, at: int, text: str) -> bool:
        """Whether a body without braces has a line of its own; `else if` has one line."""
        index = self._tokens[at]
        if self.placed[index - 1].item.ends_line:
            return text != "{"
        is_further = text == "if" and self._text(at - 1) == "else"
        return text != "{" and not is_further and self._has_break(at)

    def _has_break(self, at: int) -> bool:
        """Whether the source has a line break between a token and the one before it."""
        return any(self.placed[n].item.breaks for n in range(self._tokens[at - 1] + 1, self._tokens[at] + 1))
