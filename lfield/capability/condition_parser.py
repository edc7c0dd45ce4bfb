"""Parses conditions over attributes: `payload >= 2.0 && environment == aerial`.

The scanner and the expression parser are those of L, so precedence, literals, escapes and comments are the
same. This module maps their syntax tree to that of conditions. Its errors are L's; hints that only help in a
program are replaced. A host imports this module only for a condition that a program computes at run time:
bundles carry the trees of all others.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TypeVar

from msgspec import Struct

from lfield.capability.condition_tree import (
    MAX_HEIGHT,
    MAX_LIMIT,
    ConditionBinary,
    ConditionCall,
    ConditionExpr,
    ConditionLiteral,
    ConditionMember,
    ConditionName,
    ConditionParameter,
    ConditionUnary,
    ConditionUnsupported,
    Mistake,
)
from lfield.lang import messages, syntax
from lfield.lang.parser.expressions import expression
from lfield.lang.parser.token_stream import ParsingAborted, SyntaxRecovery, TokenStream
from lfield.lang.scanner import KEYWORDS, TokenKind, scan
from lfield.text.source_text import Diagnostic, Diagnostics, Source, Span

#: The longest text that is read, in characters.
MAX_LENGTH = 2000

#: Hints by code, which replace those that apply to programs only.
_HINTS: Mapping[str, str] = {
    messages.NOT_TEXT.code: "write it as an escape: \\0 or \\u{...}",
    messages.MISSING_CLOSE.code: "add it, or remove the opening bracket",
    **dict.fromkeys((messages.TOO_DEEP.code, messages.NO_TERNARY.code, messages.CAST.code), ""),
}
#: Names that may follow an expression.
_END_WORDS = ("order", "limit", "asc", "desc")
_NUMBERS = (TokenKind.INT, TokenKind.REAL)

_Parsed = TypeVar("_Parsed")


class ParsedQuery(Struct, frozen=True):
    """A query as written: a condition with its text, keys to order by (True: descending), a limit."""

    condition: ConditionExpr | None = None
    text: str = ""
    order: tuple[tuple[ConditionExpr, bool], ...] = ()
    limit: int | None = None


class _ConditionError(Exception):
    """An expression of L that is not a condition, or text after the condition."""

    def __init__(self, place: Span, message: str, hint: str = "") -> None:
        super().__init__(message)
        self.mistake = Mistake(place.start, place.end, message, hint)


def parse_condition(text: str) -> tuple[ConditionExpr | None, list[Mistake]]:
    """The tree of a text, or None and the mistakes. Names are not resolved."""
    return _parse(text, _condition)


def parse_query(text: str, *, parameters: bool = False) -> tuple[ParsedQuery | None, list[Mistake]]:
    """`payload >= 2 order by distance(12, 4), battery desc limit 100`; each part may be left out.

    With `parameters`, `$kg` is a value that the program passes.
    """
    return _parse(text, _query, parameters=parameters)


def _parse(
    text: str, parse: Callable[[TokenStream], _Parsed], *, parameters: bool = False
) -> tuple[_Parsed | None, list[Mistake]]:
    """The result, or None and the first mistake: later ones could be its consequences."""
    if len(text) > MAX_LENGTH:
        return None, [Mistake(0, len(text), f"this is longer than {MAX_LENGTH} characters")]
    if not text.strip():
        return None, [
            Mistake(0, len(text), "the condition is empty", "write a condition, as in payload >= 2.0")
        ]
    diagnostics, mistakes = Diagnostics(), list[Mistake]()
    scanned = scan(Source("", text), diagnostics, end="the end of the text", parameters=parameters)
    stream = TokenStream(scanned, diagnostics, _END_WORDS)
    result = None
    try:
        result = parse(stream)
    except (SyntaxRecovery, ParsingAborted):
        pass
    except _ConditionError as error:
        mistakes.append(error.mistake)
    mistakes = [_mistake(diagnostic, parameters) for diagnostic in diagnostics.in_order()[:1]] or mistakes
    return (None if mistakes else result), mistakes


def _mistake(found: Diagnostic, parameters: bool) -> Mistake:
    hint = _HINTS.get(found.code, found.hint)
    if parameters and found.span.text.startswith("$"):
        hint = "a parameter is $ and the name of a variable, as in payload >= $kg"
    return Mistake(found.span.start, found.span.end, found.message, hint)


# --- around the expressions -----------------------------------------------------------------------------


def _condition(s: TokenStream) -> ConditionExpr:
    found = _expression(s)
    _end(s)
    return found


def _query(s: TokenStream) -> ParsedQuery:
    condition = None if _at_order(s) or _at_limit(s) else _expression(s)
    text = s.current.span.source.text[: s.current.span.start]
    order: list[tuple[ConditionExpr, bool]] = []
    if _at_order(s):
        s.advance()
        while not order or s.at(","):
            s.advance()
            order.append((_expression(s), _is_descending(s)))
    limit = _limit(s) if s.at("limit") else None
    _end(s)
    return ParsedQuery(condition, text, tuple(order), limit)


def _at_order(s: TokenStream) -> bool:
    return s.at("order") and s.ahead(1).text == "by"


def _at_limit(s: TokenStream) -> bool:
    """Whether a limit follows, valid or not; `limit -1` is one too, not a difference."""
    following = s.ahead(1)
    if not s.at("limit"):
        return False
    if following.text == "-":
        return s.ahead(2).kind in _NUMBERS and s.ahead(3).kind is TokenKind.END
    return following.kind in _NUMBERS or following.kind is TokenKind.END


def _is_descending(s: TokenStream) -> bool:
    return s.advance().text == "desc" if s.at("asc", "desc") else False


def _limit(s: TokenStream) -> int:
    keyword, token = s.advance(), s.advance()
    if token.kind is TokenKind.INT and isinstance(token.value, int) and 1 <= token.value <= MAX_LIMIT:
        return token.value
    place = keyword.span if token.kind is TokenKind.END else token.span
    raise _ConditionError(place, f"a limit is a whole number from 1 to {MAX_LIMIT}", "such as limit 100")


def _end(s: TokenStream) -> None:
    if not s.at_end():
        hint = s.unit_hint() or "the condition ends before it"
        raise _ConditionError(s.current.span, f"{s.current} is not expected here", hint)


# --- from the tree of L to that of conditions -------------------------------------------------------------


def _expression(s: TokenStream) -> ConditionExpr:
    found = _mapped(expression(s), 1)
    if found.height > MAX_HEIGHT:
        raise _too_deep(found.span)
    return found


def _too_deep(place: Span) -> _ConditionError:
    return _ConditionError(place, f"this is nested more than {MAX_HEIGHT} levels deep")


def _mapped(raw: syntax.Expr, depth: int) -> ConditionExpr:
    """The condition; `depth` is the number of operators around it, on which L sets no limit in a chain."""
    if depth > MAX_HEIGHT:
        raise _too_deep(raw.span)
    if (parameter := _parameter(raw)) is not None:
        return parameter
    match raw:
        case syntax.Literal_(value=value):
            return ConditionLiteral(raw.span, 1, value)
        case syntax.Name(name=name):
            return ConditionName(raw.span, 1, name)
        case syntax.Unary(operator=operator):
            operand = _mapped(raw.operand, depth + 1)
            return ConditionUnary(raw.span, operand.height + 1, operator, operand)
        case syntax.Binary(operator="&&" | "||"):
            return _chain(raw, depth)
        case syntax.Binary():
            return _binary(raw, _mapped(raw.left, depth + 1), _mapped(raw.right, depth + 1))
        case syntax.Member():
            return _member(raw, depth)
        case syntax.Call(function=function):
            called = (
                _member(function, depth + 1)
                if isinstance(function, syntax.Member)
                else ConditionName(function.span, 1, function.name)
            )
            mapped_arguments = [_mapped(argument, depth + 1) for argument in raw.arguments]
            height = 1 + max([called.height, *(argument.height for argument in mapped_arguments)])
            return ConditionCall(raw.span, height, called, mapped_arguments)
        case syntax.Assign(operator="="):
            raise _ConditionError(raw.sign, "'=' is an assignment", "compare with ==")
        case syntax.Assign(operator=operator):
            raise _ConditionError(raw.sign, f"a condition has no operator '{operator}'")
        case _:
            return ConditionUnsupported(raw.span, 1)


def _parameter(raw: syntax.Expr) -> ConditionParameter | None:
    """`$kg`, `$at[0].north`, `$mass[g]`; None for anything else."""
    if not raw.span.text.startswith("$"):
        return None
    match raw:
        case syntax.Index(array=array, index=index) if not _is_index(index):
            inner = _parameter(array)
            return None if inner is None else ConditionParameter(raw.span, 1, inner.path, index.span.text)
        case syntax.Name() | syntax.Member() | syntax.Index():
            _check_path(raw)
            return ConditionParameter(raw.span, 1, raw.span.text[1:])
        case syntax.Call():
            hint = "put the result into a variable, and the variable into the query"
            raise _ConditionError(raw.span, "a parameter is a variable, not a call", hint)
    return None


def _is_index(raw: syntax.Expr) -> bool:
    """Whether the expression in brackets is an index, and not a unit."""
    return isinstance(raw, syntax.Literal_) or raw.span.text.startswith("$")


def _check_path(raw: syntax.Expr) -> None:
    """Refuses invalid parts of a path of names and indexes."""
    match raw:
        case syntax.Member(object=owner):
            _check_path(owner)
        case syntax.Index(array=array, index=index) if _is_index(index):
            _check_path(array)
            if not isinstance(index, syntax.Literal_) or isinstance(index.value, bool | float | None):
                _check_path(index)
        case syntax.Name(name=name) if name.startswith("$") and name[1:] not in KEYWORDS:
            return
        case _:
            message = "a parameter is a variable with its fields and elements"
            raise _ConditionError(
                raw.span, message, "such as $kg, $victim.north or $at[0]; $mass[g] in grams"
            )


def _member(raw: syntax.Member, depth: int) -> ConditionMember:
    owner = _mapped(raw.object, depth + 1)
    return ConditionMember(raw.span, owner.height + 1, owner, raw.name, raw.place)


def _binary(raw: syntax.Binary, left: ConditionExpr, right: ConditionExpr) -> ConditionBinary:
    height, span = 1 + max(left.height, right.height), left.span.to(right.span)
    return ConditionBinary(span, height, raw.operator, raw.sign, left, right)


def _chain(last: syntax.Binary, depth: int) -> ConditionExpr:
    """A chain of && or ||, which means the same however it is grouped: as the lowest tree possible."""
    signs, first = [last], last.left
    while isinstance(first, syntax.Binary) and first.operator == last.operator:
        signs.append(first)
        first = first.left
    signs.reverse()
    operands = [_mapped(raw, depth + 1) for raw in (first, *(sign.right for sign in signs))]
    return _balanced(operands, signs)


def _balanced(operands: Sequence[ConditionExpr], signs: Sequence[syntax.Binary]) -> ConditionExpr:
    if len(operands) == 1:
        return operands[0]
    middle = len(operands) // 2
    left, right = (
        _balanced(operands[:middle], signs[: middle - 1]),
        _balanced(operands[middle:], signs[middle:]),
    )
    return _binary(signs[middle - 1], left, right)
