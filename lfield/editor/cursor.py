"""The tokens around a position in a program: the chain of names, the method, and the variables in scope.

All results are found from tokens, so that they are available for a text with syntax errors, as during typing.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from msgspec import Struct

from lfield.editor.program_model import ProgramModel
from lfield.editor.program_parts import ProgramPart
from lfield.lang import syntax
from lfield.lang.parser.token_stream import PRIMITIVES, ParsingAborted, SyntaxRecovery, TokenStream
from lfield.lang.parser.type_names import result_type
from lfield.lang.scanner import Token, TokenKind, scan
from lfield.lang.syntax import BAD_TYPE, TypeName
from lfield.text.source_text import Diagnostics, Source, Span

_OPENING = {")": "(", "]": "["}
#: The token after the name in a declaration of a local variable, a parameter or a caught exception.
_AFTER_NAME = ("=", ";", ":", ",", ")")


class DeclaredLocal(Struct, frozen=True):
    """A local variable or parameter as written: its type, and the token of its name."""

    type: TypeName
    token: Token


class Cursor(Struct):
    """A token of a part, by its index, with the unit and the method around it.

    The method may be a function of the top level: then there is no unit.
    """

    part: ProgramPart
    index: int
    unit: syntax.Unit | None
    method: syntax.Method | None

    @property
    def tokens(self) -> Sequence[Token]:
        """The tokens of the part."""
        return self.part.tokens

    @property
    def token(self) -> Token:
        """The token itself."""
        return self.tokens[self.index]

    def text(self, distance: int) -> str:
        """The text of the token at a distance; '' of a string, and beyond the ends."""
        at = self.index + distance
        if not 0 <= at < len(self.tokens) or self.tokens[at].kind is TokenKind.STRING:
            return ""
        return self.tokens[at].text

    def moved(self, index: int) -> Cursor:
        """The same with another token of the part."""
        return cursor_at_token(self.part, index)

    def owner(self) -> str:
        """The expression before the dot before the token; '' without one."""
        if self.text(-1) != ".":
            return ""
        first = _operand_start(self.tokens, self.index - 2)
        return self.part.source.text[self.tokens[first].span.start : self.tokens[self.index - 2].span.end]

    def call(self) -> str:
        """The expression from the owner to the end of the arguments of the token; '' without arguments."""
        last = _closing(self.tokens, self.index + 1) if self.text(1) == "(" else -1
        if last < 0:
            return ""
        first = _operand_start(self.tokens, self.index - 2) if self.text(-1) == "." else self.index
        return self.part.source.text[self.tokens[first].span.start : self.tokens[last].span.end]

    def called(self) -> str:
        """The name of the function or method among whose arguments the token is; '' outside of arguments."""
        depth = 0
        for at in range(self.index - 1, -1, -1):
            text = self.tokens[at].text if self.tokens[at].kind is not TokenKind.STRING else ""
            if text in (";", "{", "}"):
                return ""
            depth += (text in (")", "]")) - (text in ("(", "["))
            if depth < 0:
                return self.tokens[at - 1].text if at and text == "(" else ""
        return ""

    def locals(self) -> dict[str, DeclaredLocal]:
        """The parameters and variables of the method that are in scope before the token, by name."""
        if self.method is None:
            return {}
        at = next(n for n, token in enumerate(self.tokens) if token.span.start >= self.method.span.start)
        scopes: list[dict[str, DeclaredLocal]] = [{}]
        while at < self.index:
            text = self.tokens[at].text if self.tokens[at].kind is not TokenKind.STRING else ""
            if text == "{":
                scopes.append({})
            elif text == "}" and len(scopes) > 1:
                scopes.pop()
            elif (declared := _declaration(self.tokens, at)) is not None:
                scopes[-1][declared.token.text] = declared
            at += 1
        return {name: local for scope in scopes for name, local in scope.items()}

    def local_here(self) -> DeclaredLocal | None:
        """The variable whose declaration has the token as its name."""
        found = None
        for at in range(self.index - 1, max(self.index - 20, -1), -1):
            if self.method is None or self.tokens[at].text in (";", "{", "}", "="):
                break
            declared = _declaration(self.tokens, at)
            if declared is not None and declared.token is self.token:
                found = declared
        return found


def cursor_at(model: ProgramModel, path: Path, offset: int) -> Cursor | None:
    """The token at an offset of a file: a name that ends there counts too. None outside the program."""
    file = model.files.get(path)
    if file is None or not file.parts:
        return None
    part = file.part_at(offset)
    at = offset - part.source.place.offset
    index = next((n for n, token in enumerate(part.tokens) if token.span.end >= at), len(part.tokens) - 1)
    following = part.tokens[index + 1] if index + 1 < len(part.tokens) else None
    if following is not None and following.span.start <= at and following.kind is TokenKind.NAME:
        index += 1
    return cursor_at_token(part, index)


def cursor_at_token(part: ProgramPart, index: int) -> Cursor:
    """A token of a part with its unit and method."""
    start = part.tokens[index].span.start
    unit = next((candidate for candidate in reversed(part.file.units) if candidate.span.start <= start), None)
    method = next((function for function in part.file.functions if _is_within(function, start)), None)
    if method is not None:
        return Cursor(part, index, None, method)
    for candidate in unit.methods if unit is not None else ():
        if candidate.span.start <= start and (method is None or candidate.span.start > method.span.start):
            method = candidate
    if method is not None and start > method.end.end and not method.broken:
        method = None
    return Cursor(part, index, unit, method)


def _is_within(function: syntax.Method, start: int) -> bool:
    """Whether a place is between the name of a function and its end."""
    return function.span.start <= start <= function.end.end


def _operand_start(tokens: Sequence[Token], at: int) -> int:
    """The first token of the operand that ends at a token: `a.b(c)[0]`."""
    while at >= 0:
        text = tokens[at].text if tokens[at].kind is not TokenKind.STRING else ""
        if text in _OPENING:
            at = _opening(tokens, at)
            if at > 0 and (tokens[at - 1].kind is TokenKind.NAME or tokens[at - 1].text in (")", "]")):
                at -= 1
                continue
        if at > 1 and tokens[at - 1].text == ".":
            at -= 2
            continue
        if at > 0 and tokens[at - 1].text == "new":
            at -= 1
        return max(at, 0)
    return 0


def _opening(tokens: Sequence[Token], at: int) -> int:
    """The bracket that belongs to a closing one."""
    depth = 0
    while at >= 0:
        text = tokens[at].text if tokens[at].kind is not TokenKind.STRING else ""
        depth += (text in (")", "]", "}")) - (text in ("(", "[", "{"))
        if depth == 0:
            return at
        at -= 1
    return 0


def _closing(tokens: Sequence[Token], at: int) -> int:
    """The bracket that belongs to an opening one; -1 without one in the statement."""
    depth = 0
    for index in range(at, len(tokens)):
        text = tokens[index].text if tokens[index].kind is not TokenKind.STRING else ""
        depth += (text in ("(", "[", "{")) - (text in (")", "]", "}"))
        if depth == 0:
            return index
        if text == ";":
            return -1
    return -1


def _declaration(tokens: Sequence[Token], at: int) -> DeclaredLocal | None:
    """The variable whose declaration begins with a token: `T name =`, `T[] name;`."""
    first = tokens[at]
    if first.kind is not TokenKind.NAME and first.text not in PRIMITIVES:
        return None
    if at > 0 and tokens[at - 1].text in (".", "new"):
        return None
    after, dimensions = _behind_arguments(tokens, at), 0
    while after + 1 < len(tokens) and tokens[after].text == "[" and tokens[after + 1].text == "]":
        after, dimensions = after + 2, dimensions + 1
    if after + 1 >= len(tokens) or tokens[after].kind is not TokenKind.NAME:
        return None
    if tokens[after + 1].text not in _AFTER_NAME:
        return None
    if tokens[at + 1].text == "<":
        return DeclaredLocal(_written_type(first.span.to(tokens[after - 1].span)), tokens[after])
    return DeclaredLocal(TypeName(first.span, first.text, dimensions), tokens[after])


def _behind_arguments(tokens: Sequence[Token], at: int) -> int:
    """The token after the name of a type and its `<...>`."""
    depth, after = 0, at + 1
    while after < len(tokens) and (text := tokens[after].text) and (depth or text == "<"):
        if text in (";", "(", ")", "{", "}"):
            return at + 1
        depth += text.count("<") - text.count(">")
        after += 1
        if depth <= 0:
            break
    # A negative depth: the type is an argument of another type.
    return after if depth == 0 else len(tokens)


def _written_type(span: Span) -> TypeName:
    """A type with arguments, such as `map<string, int>[]`."""
    discarded = Diagnostics()
    try:
        return result_type(TokenStream(scan(Source("", span.text), discarded), discarded))
    except (SyntaxRecovery, ParsingAborted):
        return TypeName(span, BAD_TYPE)
