"""Expressions: appendix A with the precedence of C and Java."""

from __future__ import annotations

import math

from lfield.lang import messages
from lfield.lang.parser.concurrency import async_call, at_async
from lfield.lang.parser.foreign.foreign_syntax import (
    at_cast,
    at_walrus,
    at_word_operator,
    at_word_prefix,
    cast,
    foreign_init,
    lacks_operator,
    std_member,
    walrus,
    word_operator,
    word_prefix,
)
from lfield.lang.parser.foreign.foreign_words import (
    FOREIGN_NAMES,
    FOREIGN_SYMBOLS,
    JOIN,
    WORD_OPERATORS,
    WORD_PREFIXES,
)
from lfield.lang.parser.foreign.python_blocks import bare_condition_hint, skip_bare_condition
from lfield.lang.parser.token_stream import PRIMITIVES, SyntaxRecovery, TokenStream
from lfield.lang.parser.type_names import brackets, element_name
from lfield.lang.scanner import FOREIGN_OPERATORS, Token, TokenKind
from lfield.lang.syntax import (
    Assign,
    Bad,
    Binary,
    Call,
    Elements,
    Expr,
    Index,
    Literal_,
    Member,
    Name,
    New,
    NewArray,
    This,
    TypeName,
    Unary,
)
from lfield.text.source_text import Span

#: Binary operators from the weakest to the strongest; all of them group to the left.
PRECEDENCE = {
    "||": 1,
    "&&": 2,
    "==": 3,
    "!=": 3,
    "<": 4,
    "<=": 4,
    ">": 4,
    ">=": 4,
    "+": 5,
    "-": 5,
    "*": 6,
    "/": 6,
    "%": 6,
}

INT_LIMIT = 2**63

#: The correct form instead of an operator that L does not have.
INSTEAD = {
    "===": "write ==",
    "!==": "write !=",
    "&": "write && for a condition; L has no bit operators",
    "|": "write || for a condition; L has no bit operators",
    "=>": "write >= to compare; L has no lambda expressions: write a method",
    "->": "members are reached with a dot: object.name",
    "::": "members are reached with a dot: object.name",
}
#: `=`, and the operators that calculate with the old value.
ASSIGNMENTS = ("=", "+=", "-=", "*=", "/=", "%=")


def expression(s: TokenStream) -> Expr:
    """Any expression, assignments included; the checker decides where those are allowed."""
    with s.nested():
        left = _binary(s, 1)
        if s.at(*ASSIGNMENTS):
            sign = s.advance()
            value = expression(s)
            height = 1 + max(left.height, value.height)
            return s.bounded(Assign(left.span.to(value.span), height, sign.text, sign.span, left, value))
        if s.at("?") or (s.at("if") and not s.first_on_line()):
            return _ternary(s, left)
        if s.at("::"):
            raise std_member(s)
        if at_walrus(s):
            raise walrus(s)
        if s.at(*FOREIGN_OPERATORS):
            return _foreign(s, left)
        return left


def _elements(s: TokenStream, start: Span, element_type: TypeName | None) -> Expr:
    """`{a, {b, c}}`."""
    opening = s.advance()
    elements: list[Expr] = []
    with s.nested():
        while not s.at("}") and (not elements or s.accept(",")):
            elements.append(expression(s))
            if s.at(":"):
                instead = "a map begins empty: new map<string, int>(), then m[key] = value;"
                s.report(messages.FOREIGN_OPERATOR, s.current.span, operator=":", instead=instead)
                while not (s.at_end() or s.at("}", ";")):
                    s.advance()
                s.accept("}")
                raise SyntaxRecovery
    s.close("}", opening)
    height = 1 + max((element.height for element in elements), default=0)
    return s.bounded(Elements(start.to(s.previous.span), height, element_type, elements))


def parenthesised(s: TokenStream, hint: str | None = None) -> Expr:
    """`(condition)`. A mistake inside is skipped, so that the statement after it is still read."""
    opening = s.current
    if not s.at("("):
        hint = hint or bare_condition_hint(s)
        s.report(messages.EXPECTED_SYMBOL, opening.span, hint=hint, what="'('", found=opening)
        skip_bare_condition(s)
        return Bad(opening.span, 1)
    found: list[Expr] = []

    def parse() -> None:
        s.advance()
        found.append(expression(s))
        s.close(")", opening)

    if not s.attempt(parse, lambda: s.skip_parentheses(1)):
        return Bad(opening.span, 1)
    return found[0]


def arguments(s: TokenStream) -> list[Expr]:
    """`(a, b)`."""
    opening = s.expect("(")
    found: list[Expr] = []
    if not s.at(")"):
        found.append(expression(s))
        while s.accept(","):
            found.append(expression(s))
    if lacks_operator(s):
        raise s.fail(messages.EXPECTED_SYMBOL, hint=JOIN, what="')'", found=s.current)
    s.close(")", opening)
    return found


def _binary(s: TokenStream, weakest: int) -> Expr:
    """Operators of at least this precedence."""
    left = _unary(s)
    while (strength := _strength(s)) >= weakest:
        if at_word_operator(s):
            left = _word_binary(s, left, strength)
            continue
        sign = s.advance()
        with s.nested():
            right = _binary(s, strength + 1)
        height = max(left.height, 1 + right.height)
        span = left.span.to(right.span)
        left = s.bounded(Binary(span, height, sign.text, sign.span, left, right))
    return left


def _strength(s: TokenStream) -> int:
    """The precedence of the operator here; 0 for none."""
    if (strength := PRECEDENCE.get(s.current.text, 0)) or not s.at_name() or not at_word_operator(s):
        return strength
    return PRECEDENCE.get(WORD_OPERATORS[s.current.text][0], PRECEDENCE["=="])


def _word_binary(s: TokenStream, left: Expr, strength: int) -> Expr:
    """`a and b`: reported, and read as `a && b`."""
    place, operator = word_operator(s)
    with s.nested():
        is_none = operator in ("==", "!=") and s.at("None")
        right = Literal_(s.advance().span, 1, None) if is_none else _binary(s, strength + 1)
    height = max(left.height, 1 + right.height)
    span = left.span.to(right.span)
    if not operator:
        return s.bounded(Bad(span, height))
    return s.bounded(Binary(span, height, operator, place, left, right))


def _unary(s: TokenStream) -> Expr:
    if s.at("-") and s.ahead(1).kind in (TokenKind.INT, TokenKind.REAL):
        sign = s.advance()
        return _number(s.advance(), s, sign)
    if s.at("-", "!"):
        sign = s.advance()
        with s.nested():
            operand = _unary(s)
        return s.bounded(Unary(sign.span.to(operand.span), operand.height + 1, sign.text, operand))
    if s.at("++", "--", "~"):
        return _foreign(s, Bad(s.current.span, 1))
    if at_async(s):
        return async_call(s, _postfix)
    if at_word_prefix(s):
        token = word_prefix(s)
        with s.nested():
            operand = _unary(s)
        is_not = token.text == "not"
        return s.bounded(Unary(operand.span, operand.height + 1, "!", operand)) if is_not else operand
    if s.at_name() and at_cast(s):
        raise cast(s)
    if arrow := _lambda_arrow(s):
        raise _lambda(s, arrow)
    return _postfix(s)


def _lambda_arrow(s: TokenStream) -> int:
    """The number of tokens before the arrow of `() -> 1`, `(x, y) => x` or `x -> 1`; 0 without one."""
    if s.at_name():
        is_pointer = s.ahead(2).kind is TokenKind.NAME  # `p->next`
        return 1 if s.ahead(1).text == "->" and not is_pointer else 0
    if not s.at("("):
        return 0
    at = 1
    while s.ahead(at).text in (",", *PRIMITIVES) or s.ahead(at).kind is TokenKind.NAME:
        at += 1
    # `(n) => 3` may be a misspelt `>=`.
    arrows = ("->",) if at == 2 else ("->", "=>")
    return at + 1 if s.ahead(at).text == ")" and s.ahead(at + 1).text in arrows else 0


def _lambda(s: TokenStream, arrow: int) -> SyntaxRecovery:
    """Report a lambda expression and skip it up to its arrow, or its block; raise the returned exception."""
    for _ in range(arrow):
        s.advance()
    sign = s.advance()
    s.report(messages.FOREIGN_OPERATOR, sign.span, operator=sign.text, instead=WORD_PREFIXES["lambda"])
    if s.at("{"):
        s.skip_braces()
    return SyntaxRecovery()


def _postfix(s: TokenStream) -> Expr:
    """A primary expression with its calls, members and indexes."""
    operand = _primary(s)
    while True:
        if s.at("."):
            s.advance()
            if s.at("init") and isinstance(operand, Name) and operand.name in FOREIGN_NAMES:
                raise foreign_init(s, operand.name)
            name = s.expect_name("the name of a member")
            operand = Member(operand.span.to(name.span), operand.height, operand, name.text, name.span)
        elif s.at("("):
            operand = _call(s, operand)
        elif s.at("["):
            opening = s.advance()
            index = expression(s)
            if s.at(":"):
                instead = "write a.slice(from, to); for text s.substring(from, to)"
                raise s.fail(messages.FOREIGN_OPERATOR, operator=":", instead=instead)
            s.close("]", opening)
            height = max(operand.height, 1 + index.height)
            operand = Index(operand.span.to(s.previous.span), height, operand, index)
        else:
            return operand
        s.bounded(operand)


def _call(s: TokenStream, function: Expr) -> Expr:
    if not isinstance(function, Name | Member):
        raise s.fail(messages.NOT_A_CALL)
    if isinstance(function, Name):
        s.called.add(function.name)
    call_arguments = arguments(s)
    height = max([function.height, *(1 + a.height for a in call_arguments)])
    return Call(function.span.to(s.previous.span), height, function, call_arguments)


def _primary(s: TokenStream) -> Expr:
    token = s.current
    match token.kind, token.text:
        case ((TokenKind.INT | TokenKind.REAL), _):
            return _number(s.advance(), s, None)
        case TokenKind.STRING, _:
            return Literal_(s.advance().span, 1, token.value)
        case TokenKind.NAME, _:
            return Name(s.advance().span, 1, token.text)
        case _, "true" | "false":
            return Literal_(s.advance().span, 1, token.text == "true")
        case _, "null":
            return Literal_(s.advance().span, 1, None)
        case _, "this":
            return This(s.advance().span, 1)
        case _, "new":
            return _new(s)
        case _, "(":
            return _group(s)
        case _, "{":
            return _elements(s, token.span, None)
        case _, "init":
            raise s.fail(messages.INIT_CALLED)
    if s.at(*PRIMITIVES, "void"):
        raise s.fail(messages.CAST)
    raise s.fail(messages.EXPECTED_EXPRESSION, hint=FOREIGN_SYMBOLS.get(token.text), found=token)


def _group(s: TokenStream) -> Expr:
    opening = s.advance()
    inner = expression(s)
    s.close(")", opening)
    return inner


def _number(token: Token, s: TokenStream, minus: Token | None) -> Expr:
    """A number with its sign: the smallest int has no positive counterpart."""
    value, span = token.value, token.span if minus is None else minus.span.to(token.span)
    assert isinstance(value, int | float)
    signed = value if minus is None else -value
    if isinstance(signed, int) and not -INT_LIMIT <= signed < INT_LIMIT:
        s.report(messages.NUMBER_RANGE, span, text=_shortened(span), type="int")
        signed = 0
    elif isinstance(signed, float) and math.isinf(signed):
        s.report(messages.NUMBER_RANGE, span, text=_shortened(span), type="real")
        signed = 0.0
    return Literal_(span, 1, signed)


def _shortened(span: Span) -> str:
    return span.text if len(span.text) <= 40 else f"{span.text[:30]}..."


def _new(s: TokenStream) -> Expr:
    """`new C(args)`, `new T[n]`, `new T[n][m]`, `new T[n][]`."""
    start = s.advance().span
    if s.at("void"):
        raise s.fail(messages.VOID_VALUE_TYPE, what="new")
    created_type = element_name(s, "a type after new")
    if s.at("("):
        call_arguments = arguments(s)
        height = 1 + max((a.height for a in call_arguments), default=0)
        return s.bounded(New(start.to(s.previous.span), height, created_type, call_arguments))
    if not s.at("["):
        hint = (
            f"write new {created_type}[10]; only classes have constructors"
            if created_type.name in PRIMITIVES
            else None
        )
        raise s.fail(messages.NEW_NEEDS, hint=hint, type=created_type)
    return _new_array(s, start, created_type)


def _new_array(s: TokenStream, start: Span, element_type: TypeName) -> Expr:
    if s.ahead(1).text == "]":
        brackets(s, element_type)
        if s.at("{"):
            return _elements(s, start, element_type)
        raise s.fail(messages.ARRAY_LENGTH_MISSING, type=element_type.name)
    lengths: list[Expr] = []
    while s.at("[") and s.ahead(1).text != "]":
        opening = s.advance()
        lengths.append(expression(s))
        s.close("]", opening)
    element_type.dimensions = len(lengths)
    brackets(s, element_type)
    height = 1 + max(length.height for length in lengths)
    return s.bounded(NewArray(start.to(s.previous.span), height, element_type, lengths))


def _ternary(s: TokenStream, condition: Expr) -> Expr:
    """`a ? b : c`, or `b if a else c`: reported, and skipped as a whole."""
    s.report(messages.NO_TERNARY, s.advance().span)
    expression(s)
    if s.accept(":") or s.accept("else"):
        expression(s)
    return Bad(condition.span.to(s.previous.span), condition.height)


def _foreign(s: TokenStream, left: Expr) -> Expr:
    """An operator that L does not have: reported, and skipped with its right side."""
    sign = s.advance()
    target = left.span.text if isinstance(left, Name | Member | Index) else s.current.text
    instead = INSTEAD.get(sign.text, "L has no bit operators")
    if sign.text in ("++", "--"):
        instead = f"write {target} {sign.text[0]}= 1"
    if sign.text == "<<" and target in ("cout", "cerr"):
        s.report(messages.FOREIGN_OPERATOR, sign.span, operator=sign.text, instead="write print(...)")
        raise SyntaxRecovery
    s.report(messages.FOREIGN_OPERATOR, sign.span, operator=sign.text, instead=instead)
    if sign.text not in ("++", "--") or isinstance(left, Bad):
        expression(s)
    return Bad(left.span.to(s.previous.span), left.height)
