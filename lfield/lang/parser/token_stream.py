"""The tokens of a file as the parser reads them, with recovery after a syntax error.

`fail` reports and raises `SyntaxRecovery`, which a statement, a member or a unit catches to continue at its
next boundary. `ParsingAborted` ends the file: later tokens could only repeat the same mistake.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import Self

from msgspec.structs import replace

from lfield.lang import messages
from lfield.lang.scanner import UNIT_HINT, Scan, Token, TokenKind, is_unit
from lfield.lang.syntax import Expr
from lfield.text.message_tables import FindingKind
from lfield.text.source_text import Diagnostic, Diagnostics, Span

#: The maximum nesting of statements and expressions together; the checker and the compiler walk them
#: recursively. Chains (tree_traversal.py) are no nesting.
MAX_NESTING = 100

PRIMITIVES = ("boolean", "int", "real", "string")
UNIT_KEYWORDS = ("resource", "coordinator", "class")
#: Keywords that begin a member and nothing inside a body: there, a brace is missing before them.
MEMBER_KEYWORDS = ("portal", "private", "public", "init", *UNIT_KEYWORDS)
#: Keywords that begin a statement or a local declaration.
STATEMENT_KEYWORDS = ("if", "while", "for", "break", "continue", "return", "try", "throw", *PRIMITIVES)


#: The kinds of the last token of an operand, and its texts where those are no names or literals.
_OPERANDS, _OPERAND_ENDS = (
    (TokenKind.NAME, TokenKind.INT, TokenKind.REAL, TokenKind.STRING),
    (")", "this", "true", "false", "null"),
)


class SyntaxRecovery(Exception):
    """A reported syntax error: unwind to the next place where parsing can continue."""


class UnclosedBrace(Exception):
    """A body met the next member: unwind to the unit; it is reported."""


class ParsingAborted(Exception):
    """Parsing this file ends here; it is reported."""


class TokenStream:
    """A cursor over the tokens, with reporting. `end_words` are names that may follow an expression."""

    def __init__(self, scanned: Scan, found: Diagnostics, end_words: Collection[str] = ()) -> None:
        self._tokens, self._bad_lines, self._found = scanned.tokens, scanned.bad_lines, found
        self._at, self.end_words = 0, end_words
        #: The next token.
        self.current = self._tokens[0]
        self.depth = 0
        self.broken = False
        #: The first brace of this member whose closing brace has another indentation.
        self.suspect: Span | None = None
        #: The names of types, and of functions that are called by their bare name.
        self.types: set[str] = set()
        self.called: set[str] = set()

    # --- looking and moving ---------------------------------------------------------------------------

    @property
    def previous(self) -> Token:
        """The previous token (the first token, at the start)."""
        return self._tokens[max(self._at - 1, 0)]

    def ahead(self, count: int) -> Token:
        """The token at an offset from the current one, or END."""
        return self._tokens[min(self._at + count, len(self._tokens) - 1)]

    def at(self, *texts: str) -> bool:
        """Whether the current token is one of these symbols or words."""
        return self.current.text in texts

    def at_name(self) -> bool:
        return self.current.kind is TokenKind.NAME

    def at_end(self) -> bool:
        """Whether everything is read."""
        return self.current.kind is TokenKind.END

    def first_on_line(self) -> bool:
        """Whether the current token begins its line."""
        return self._at == 0 or self.current.span.line > self.previous.span.line

    def lacks_parenthesis(self) -> bool:
        """Whether a block or a statement begins in the parentheses after the word here: a `)` is missing."""
        ahead, depth = 1, 0
        while (depth := depth + {"(": 1, ")": -1}.get(self.ahead(ahead).text, 0)) > 0:
            token, ahead = self.ahead(ahead), ahead + 1
            right = self.ahead(ahead)
            # `new int[] {` begins the elements of an array.
            is_index = token.text == "]" and self.ahead(ahead - 2).text != "["
            is_operand = token.kind in _OPERANDS or token.text in _OPERAND_ENDS or is_index
            if is_operand and (right.text == "{" or right.kind in (TokenKind.NAME, TokenKind.KEYWORD)):
                return True
            if right.kind is TokenKind.END or right.text == ";":
                return False
        return False

    def advance(self) -> Token:
        """Take the current token."""
        token = self.current
        if token.kind is not TokenKind.END:
            self._at += 1
            self.current = self._tokens[self._at]
        return token

    def accept(self, text: str) -> bool:
        """Take the current token if it matches."""
        if not self.at(text):
            return False
        self.advance()
        return True

    # --- expectations ---------------------------------------------------------------------------------

    def expect(self, text: str) -> Token:
        """Take this symbol or word, or fail."""
        if not self.at(text):
            raise self.fail(messages.EXPECTED_SYMBOL, what=f"'{text}'", found=self.current)
        return self.advance()

    def expect_name(self, description: str, hint: str | None = None) -> Token:
        """Take a name, or fail."""
        if self.current.kind is TokenKind.KEYWORD:
            raise self.fail(messages.RESERVED_NAME, keyword=self.current.text)
        if not self.at_name():
            raise self.fail(messages.EXPECTED_NAME, hint=hint, what=description, found=self.current)
        return self.advance()

    def semicolon(self, hint: str | None = None) -> None:
        """Take the `;` that ends a statement; at the end of a line a missing one is reported and assumed."""
        if self.accept(";"):
            return
        self.report(messages.MISSING_SEMICOLON, self.after_previous(), hint=self.unit_hint() or hint)
        if not (self.first_on_line() or self.at("}", "{")):
            raise SyntaxRecovery

    def close(self, symbol: str, opening: Token) -> None:
        """Consume a closing bracket; a missing one is reported and assumed."""
        if self.accept(symbol):
            return
        self.report(
            messages.MISSING_CLOSE,
            self.after_previous(),
            hint=self.unit_hint(),
            symbol=symbol,
            opening=opening.text,
            line=opening.span.line,
        )
        if not self.at(";", "{"):
            raise SyntaxRecovery

    def close_angle(self) -> None:
        """Take a `>`: of `>>` the first half, the other one remains."""
        token = self.current
        if not self.at(">>"):
            self.expect(">")
            return
        middle = token.span.start + 1
        source = token.span.source
        halves = Span(source, token.span.start, middle), Span(source, middle, token.span.end)
        self._tokens[self._at : self._at + 1] = [replace(token, text=">", span=half) for half in halves]
        self.current = self._tokens[self._at]
        self.advance()

    def after_previous(self) -> Span:
        """The place right after the previous token, where a token is missing."""
        end = self.previous.span.end
        return Span(self.previous.span.source, end, end)

    def unit_hint(self) -> str | None:
        """The hint for a number that is followed by its unit; None for other tokens."""
        is_number = self.previous.kind in (TokenKind.INT, TokenKind.REAL)
        return UNIT_HINT if is_number and is_unit(self.current) else None

    # --- reporting ------------------------------------------------------------------------------------

    def report(self, message: FindingKind, span: Span, *, hint: str | None = None, **values: object) -> None:
        """Report, unless the scanner found the mistake of this line already."""
        self.broken = True
        if not self._bad_lines.intersection((span.line, self.current.span.line)):
            self.add_finding(message.at(span, hint=hint, **values))

    def reset_broken(self) -> bool:
        """Begin a part whose mistakes are its own; returns whether there were mistakes before it."""
        before, self.broken = self.broken, False
        return before

    def restore_broken(self, before: bool) -> None:
        """End that part: its mistakes also count for the whole."""
        self.broken = self.broken or before

    def set_suspect(self, brace: Span | None) -> None:
        """Remember an opening brace that is probably not closed; None at the start of a member."""
        self.suspect = brace

    def add_finding(self, diagnostic: Diagnostic) -> None:
        """Report a finding even if its line already has one."""
        self.broken = True
        self._found.add(diagnostic)

    def fail(self, message: FindingKind, *, hint: str | None = None, **values: object) -> SyntaxRecovery:
        """Report at the current token; raise the returned exception."""
        self.report(message, self.current.span, hint=hint, **values)
        return SyntaxRecovery()

    # --- nesting --------------------------------------------------------------------------------------

    def nested(self) -> Self:
        """Enter a deeper level until its `with` ends, up to MAX_NESTING. No generator: every operator has
        one.
        """
        self.depth += 1
        self._limit(self.depth, self.current.span)
        return self

    def __enter__(self) -> None:
        """Has no effect: `nested` has already added the level."""

    def __exit__(self, *_: object) -> None:
        self.depth -= 1

    def bounded(self, expression: Expr) -> Expr:
        """The expression. Raises a finding if its tree is too high for recursive visitors."""
        self._limit(self.depth + expression.height, expression.span)
        return expression

    def _limit(self, depth: int, span: Span) -> None:
        if depth > MAX_NESTING:
            self.report(messages.TOO_DEEP, span, limit=MAX_NESTING)
            raise ParsingAborted

    # --- recovery after a mistake ---------------------------------------------------------------------

    def attempt(self, parse: Callable[[], None], skip: Callable[[], None]) -> bool:
        """Parse a part; after a mistake, skip the rest of it. Returns whether it had no mistake."""
        try:
            parse()
        except SyntaxRecovery:
            skip()
            return False
        return True

    def skip_statement(self) -> None:
        """Skip to the next statement: after a `;`, or before a brace or a keyword that begins a line."""
        while not self.at_end() and not self.at("{", "}"):
            if self.accept(";"):
                return
            self.advance()
            if self.first_on_line() and self.at(*STATEMENT_KEYWORDS, *MEMBER_KEYWORDS):
                return

    def skip_member(self) -> None:
        """Skip to the next member: after a `;` or a whole `{ ... }`, or before a word that begins a
        member.
        """
        while not self.at_end() and not self.at("}"):
            if self.accept(";"):
                return
            if self.at("{"):
                self.skip_braces()
                return
            self.advance()
            if self.first_on_line() and self.at(*MEMBER_KEYWORDS):
                return

    def skip_unit(self) -> None:
        """Skip to the next unit."""
        while not self.at_end():
            if self.at("{"):
                self.skip_braces()
                self.accept(";")
                return
            self.advance()
            if self.accept(";") or self.at(*UNIT_KEYWORDS, "include"):
                return

    def skip_braces(self) -> None:
        """Skip past the `}` that closes the `{` here, or to the end."""
        depth = 0
        while not self.at_end():
            depth += {"{": 1, "}": -1}.get(self.advance().text, 0)
            if depth == 0:
                return

    def skip_parentheses(self, depth: int) -> None:
        """Skip past the `)` that closes `depth` open `(`, or to a brace, a `;` or the end."""
        while depth > 0 and not self.at_end() and not self.at("{", "}", ";"):
            depth += {"(": 1, ")": -1}.get(self.advance().text, 0)
