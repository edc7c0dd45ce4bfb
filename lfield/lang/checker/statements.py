"""Second pass: statements."""

from __future__ import annotations

from collections.abc import Iterable
from copy import copy

from lfield.lang import messages, syntax, tree
from lfield.lang.checker.conversions import conversion_cost, require_type, unknown, widened, with_article
from lfield.lang.checker.expressions import (
    assigned,
    assignment,
    condition,
    evaluated,
    map_target,
    target,
    value,
)
from lfield.lang.checker.library.collection_calls import map_keys, set_element
from lfield.lang.checker.operators import binary
from lfield.lang.checker.scope import BodyContext
from lfield.lang.checker.together import (
    check_coordinator_block,
    check_reserve_operand,
    check_wait_place,
    check_wait_seconds,
    check_within_seconds,
)
from lfield.lang.checker.visibility import visible_type
from lfield.lang.language_library import ARRAY_LENGTH
from lfield.lang.tree_traversal import left_spine
from lfield.lang.types import BOOLEAN, EXCEPTION, INT, NULL, UNKNOWN, VOID, ArrayType, ClassType, MapType
from lfield.text.source_text import Span

_NO_RESULT_HINTS: dict[tree.MethodKind, str] = {
    "portal": "write emit T after its parameters",
    "init": "write return;",
    "loop": "write return;",
    "constructor": "write return;",
}


def statements(body: BodyContext, raw: Iterable[syntax.Stmt]) -> list[tree.Stmt]:
    """Statements for the compiler; none for `;`."""
    checked = [_statement(body, stmt) for stmt in raw]
    return [stmt for stmt in checked if stmt is not None]


def _statement(body: BodyContext, raw: syntax.Stmt) -> tree.Stmt | None:
    match raw:
        case syntax.Evaluate():
            return _evaluate(body, raw)
        case syntax.Declare():
            return _declare(body, raw)
        case syntax.If():
            return _if(body, raw)
        case syntax.BlockStmt():
            return tree.BlockStmt(raw.span, _branch(body, raw))
        case syntax.Return():
            return _return(body, raw)
        case syntax.While():
            return tree.Loop(raw.span, condition(body, raw.condition), _loop_body(body, raw.body), [])
        case syntax.For():
            return _for(body, raw)
        case syntax.Each():
            return _each(body, raw)
        case syntax.Break():
            _in_loop(body, raw.span, "break")
            return tree.Break(raw.span)
        case syntax.Continue():
            _in_loop(body, raw.span, "continue")
            return tree.Continue(raw.span)
        case syntax.Throw():
            return _throw(body, raw)
        case syntax.Try():
            return _try(body, raw)
        case syntax.Together():
            check_coordinator_block(body, raw.span)
            return tree.Together(raw.span, _branch(body, raw.body))
        case syntax.Within():
            check_coordinator_block(body, raw.span)
            return tree.Within(raw.span, check_within_seconds(body, raw.seconds), _branch(body, raw.body))
        case syntax.Reserve():
            check_coordinator_block(body, raw.span)
            return tree.Reserve(raw.span, check_reserve_operand(body, raw.target), _branch(body, raw.body))
        case syntax.WaitUntil():
            check_wait_place(body, raw.span)
            seconds = None if raw.seconds is None else check_wait_seconds(body, raw.seconds)
            return tree.WaitUntil(raw.span, condition(body, raw.condition), seconds)
        case syntax.BadStmt():
            body.scope.mark_uncertain()
    return None


def _if(body: BodyContext, raw: syntax.If) -> tree.If:
    """An `if` whose `otherwise` is the next one, as often as `else if` follows."""
    ladder = [
        *left_spine(raw, lambda rung: rung.otherwise if isinstance(rung.otherwise, syntax.If) else None),
        raw,
    ]
    branch: list[tree.Stmt] = _branch(body, ladder[0].otherwise)
    for rung in ladder:
        if isinstance(rung.then, syntax.Empty):
            body.report(messages.EMPTY_BRANCH, rung.then.span)
        branch = [tree.If(rung.span, condition(body, rung.condition), _branch(body, rung.then), branch)]
    (first,) = branch
    assert isinstance(first, tree.If)
    return first


def _branch(body: BodyContext, raw: syntax.Stmt | None) -> list[tree.Stmt]:
    """A statement in a scope of its own; of a block, its statements."""
    if raw is None:
        return []
    body.enter()
    found = statements(body, raw.body if isinstance(raw, syntax.BlockStmt) else [raw])
    body.leave()
    return found


def _loop_body(body: BodyContext, raw: syntax.Stmt) -> list[tree.Stmt]:
    with body.loop():
        return _branch(body, raw)


def _declare(body: BodyContext, raw: syntax.Declare) -> tree.Stmt:
    """Declare a local, which is in scope after its value."""
    kind = visible_type(body.symbols, body.unit, raw.type)
    initial = None if raw.value is None else assigned(body, raw.value, kind)
    local = body.declare(raw.name, kind, raw.place)
    return tree.Declare(raw.span, local, initial)


def _evaluate(body: BodyContext, raw: syntax.Evaluate) -> tree.Stmt:
    """A call, an assignment or `new`; any other expression has no effect."""
    if isinstance(raw.value, syntax.Assign) and raw.value.operator != "=":
        return _update(body, raw.value)
    if isinstance(raw.value, syntax.Assign):
        return tree.Evaluate(raw.span, assignment(body, raw.value))
    expression = evaluated(body, raw.value)
    if isinstance(expression, tree.Async):
        body.report(messages.FUTURE_DROPPED, raw.span, type=expression.type, call=_call_text(raw.span.text))
        return tree.Evaluate(raw.span, unknown(raw.span))
    if (
        not isinstance(raw.value, syntax.Call | syntax.New | syntax.Async | syntax.Bad)
        and expression.type is not UNKNOWN
    ):
        compares = isinstance(raw.value, syntax.Binary) and raw.value.operator == "=="
        body.report(messages.NO_EFFECT, raw.span, hint="did you mean = ?" if compares else None)
    return tree.Evaluate(raw.span, expression)


def _call_text(call: str) -> str:
    """The text of a call for a hint."""
    return call if len(call) <= 40 and "\n" not in call else "async ..."


def _update(body: BodyContext, raw: syntax.Assign) -> tree.Stmt:
    """`target += value`: `target = target + value`, with the expressions in the target evaluated once."""
    held: list[tree.Stmt] = []
    written = syntax.Binary(raw.span, raw.height, raw.operator[0], raw.sign, raw.target, raw.value)
    if (element := map_target(body, raw.target)) is not None:
        operand = value(body, raw.value)
        element.object = _reusable(held, element.object)
        element.arguments = [_reusable(held, argument) for argument in element.arguments]
        sum_of_both = require_type(body.symbols, binary(body, written, copy(element), operand), element.type)
        held.append(tree.Evaluate(raw.span, set_element(body, raw.span, element, sum_of_both)))
        return tree.BlockStmt(raw.span, held)
    place = target(body, raw.target)
    operand = value(body, raw.value)
    if place is None:
        return tree.Evaluate(raw.span, unknown(raw.span))
    match place:
        case tree.FieldGet():
            place.object = _reusable(held, place.object)
        case tree.Element():
            place.array, place.index = _reusable(held, place.array), _reusable(held, place.index)
    result = require_type(body.symbols, binary(body, written, copy(place), operand), place.type)
    held.append(tree.Evaluate(raw.span, tree.Assign(raw.span, place.type, place, result)))
    return tree.BlockStmt(raw.span, held)


def _reusable(before: list[tree.Stmt], expr: tree.Expr) -> tree.Expr:
    """The value of an expression for several uses in one statement, which changes no local meanwhile."""
    return (
        expr
        if isinstance(expr, tree.This | tree.LocalGet | tree.Literal_)
        else _in_hidden_local(before, expr)
    )


def _in_hidden_local(before: list[tree.Stmt], expr: tree.Expr) -> tree.Expr:
    """The value of an expression in a local that has no name in L."""
    local = tree.Local("", expr.type, expr.span)
    before.append(tree.Declare(expr.span, local, expr))
    return tree.LocalGet(expr.span, expr.type, local)


def _each(body: BodyContext, raw: syntax.Each) -> tree.Stmt:
    """`for (T x : array)`: the array and its length are evaluated once, then an index loop iterates over
    it.
    """
    span = raw.array.span
    array = value(body, raw.array)
    if isinstance(array.type, MapType):
        array = map_keys(body, array)
    kind = visible_type(body.symbols, body.unit, raw.type)
    element_type = array.type.element if isinstance(array.type, ArrayType) else UNKNOWN
    if element_type is UNKNOWN and array.type is not UNKNOWN:
        body.report(messages.EACH_ARRAY, span, given=with_article(array.type))
    elif conversion_cost(element_type, kind) is None:
        body.report(messages.EACH_ELEMENT, raw.type.span, given=element_type, expected=with_article(kind))
    statements_of_loop: list[tree.Stmt] = []
    items = _in_hidden_local(statements_of_loop, array)
    count = _in_hidden_local(statements_of_loop, tree.LibraryCall(span, INT, ARRAY_LENGTH, [items]))
    index = tree.LocalGet(span, INT, tree.Local("", INT, span))
    statements_of_loop.append(tree.Declare(span, index.local, tree.Literal_(span, INT, 0)))
    following = tree.Binary(span, INT, "+", index, tree.Literal_(span, INT, 1))
    body.enter()
    local = body.declare(raw.name, kind, raw.place)
    element = widened(tree.Element(span, element_type, items, index), kind)
    inner = [tree.Declare(raw.place, local, element), *_loop_body(body, raw.body)]
    body.leave()
    step: list[tree.Stmt] = [tree.Evaluate(span, tree.Assign(span, INT, index, following))]
    statements_of_loop.append(tree.Loop(raw.span, tree.Binary(span, BOOLEAN, "<", index, count), inner, step))
    return tree.BlockStmt(raw.span, statements_of_loop)


def _for(body: BodyContext, raw: syntax.For) -> tree.Stmt:
    """A block with the start and a loop; without a condition it is true."""
    body.enter()
    start = statements(body, [] if raw.start is None else [raw.start])
    test: tree.Expr = tree.Literal_(raw.span, BOOLEAN, True)
    if raw.condition is not None:
        test = condition(body, raw.condition)
    step = statements(body, [] if raw.step is None else [raw.step])
    inner = _loop_body(body, raw.body)
    body.leave()
    return tree.BlockStmt(raw.span, [*start, tree.Loop(raw.span, test, inner, step)])


def _in_loop(body: BodyContext, span: Span, keyword: str) -> None:
    if body.loops == 0:
        body.report(messages.LOOP_ONLY, span, keyword=keyword)
    elif body.loops == body.last:
        body.report(messages.LEAVES_FINALLY, span, keyword=keyword)


def _return(body: BodyContext, raw: syntax.Return) -> tree.Stmt:
    if body.last is not None:
        body.report(messages.LEAVES_FINALLY, raw.span, keyword="return")
    method = body.method
    name, expected = f"{method.kind} {method.name}" if method.kind != "init" else "init", method.result
    if raw.value is None:
        if expected not in (VOID, UNKNOWN):
            body.report(messages.RETURN_SOMETHING, raw.span, method=name, expected=with_article(expected))
        return tree.Return(raw.span, None)
    if expected == VOID:
        if evaluated(body, raw.value).type is not UNKNOWN:
            hint = _NO_RESULT_HINTS.get(method.kind)
            body.report(messages.RETURN_NOTHING, raw.value.span, hint=hint, method=name)
        return tree.Return(raw.span, None)
    result = require_type(
        body.symbols, value(body, raw.value), expected, messages.RETURN_MISMATCH, method=name
    )
    return tree.Return(raw.span, result)


def _throw(body: BodyContext, raw: syntax.Throw) -> tree.Stmt:
    thrown = value(body, raw.value)
    if not isinstance(thrown.type, ClassType) and thrown.type not in (NULL, UNKNOWN):
        body.report(messages.THROW_TYPE, raw.value.span, given=with_article(thrown.type))
        thrown = unknown(raw.span)
    return tree.Throw(raw.span, require_type(body.symbols, thrown, EXCEPTION))


def _try(body: BodyContext, raw: syntax.Try) -> tree.Try:
    tried = _branch(body, raw.body)
    catches = [_catch(body, clause) for clause in raw.catches]
    return tree.Try(raw.span, tried, catches, None if raw.last is None else _finally(body, raw.last))


def _finally(body: BodyContext, raw: syntax.Stmt) -> list[tree.Stmt]:
    """The code of a `finally`; no jump in it leaves it."""
    with body.finally_clause():
        return _branch(body, raw)


def _catch(body: BodyContext, raw: syntax.Catch) -> tree.Catch:
    kind = visible_type(body.symbols, body.unit, raw.type)
    if not isinstance(kind, ClassType) and kind is not UNKNOWN:
        body.report(messages.CATCH_TYPE, raw.type.span, given=kind)
        kind = UNKNOWN
    body.enter()
    local = body.declare(raw.name, kind, raw.place)
    caught = _branch(body, raw.body)
    body.leave()
    return tree.Catch(local, caught)
