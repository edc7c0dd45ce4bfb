"""Second pass: statements and the bodies made of them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from lfield.lang import messages, syntax, tree
from lfield.lang.checker.conversion import expect, shown, unknown
from lfield.lang.checker.expressions import assigned, assignment, condition, evaluated, value
from lfield.lang.checker.flow import check_flow
from lfield.lang.checker.scope import Body, Scope
from lfield.lang.checker.symbols import Symbols
from lfield.lang.checker.visibility import visible_type
from lfield.lang.types import BOOLEAN, NULL, UNKNOWN, VOID, ClassType
from lfield.text.source import Span

_NO_RESULT_HINTS: dict[tree.MethodKind, str] = {
    "portal": "write emit T after its parameters",
    "init": "write return;",
    "constructor": "write return;",
}


def check_body(
    symbols: Symbols,
    method: tree.Method,
    written: syntax.Method | None,
    initialisers: list[tuple[tree.Field, syntax.Expr]],
) -> None:
    """Fill the body of a method: the field initialisers (for init and constructors), then what is written."""
    before = len(symbols.found.found)
    body = Body(symbols, method.unit, method, Scope())
    method.body.extend(_initialise(body, field, raw) for field, raw in initialisers)
    if written is None:
        return
    body.scope = Scope(None, {p.name: p for p in method.parameters})
    for raw in written.body:
        method.body.extend(statement(body, raw))
    if len(symbols.found.found) == before and not written.broken:
        check_flow(symbols, method)


def _initialise(body: Body, field: tree.Field, raw: syntax.Expr) -> tree.Stmt:
    """`field = value;`: the values of fields are set before anything else happens."""
    given = assigned(body, raw, field.type)
    target = tree.FieldGet(field.span, field.type, body.this(field.span), field)
    return tree.Evaluate(raw.span, tree.Assign(raw.span, field.type, target, given))


def statement(body: Body, raw: syntax.Stmt) -> list[tree.Stmt]:
    """One statement as the compiler sees it; nothing for `;`."""
    return _CHECKS[type(raw)](body, raw)


def _branch(body: Body, raw: syntax.Stmt) -> list[tree.Stmt]:
    """A statement in a scope of its own; a block gives its statements."""
    body.enter()
    inner = raw.body if isinstance(raw, syntax.Block) else [raw]
    found = [made for one in inner for made in statement(body, one)]
    body.leave()
    return found


def _loop_body(body: Body, raw: syntax.Stmt) -> list[tree.Stmt]:
    body.loops += 1
    found = _branch(body, raw)
    body.loops -= 1
    return found


def _bad(body: Body, raw: syntax.BadStmt) -> list[tree.Stmt]:
    body.scope.uncertain = True
    return []


def _empty(body: Body, raw: syntax.Empty) -> list[tree.Stmt]:
    return []


def _block(body: Body, raw: syntax.Block) -> list[tree.Stmt]:
    return [tree.Block(raw.span, _branch(body, raw))]


def _declare(body: Body, raw: syntax.Declare) -> list[tree.Stmt]:
    """A local comes into scope after its value."""
    kind = visible_type(body.symbols, body.unit, raw.type)
    given = None if raw.value is None else assigned(body, raw.value, kind)
    local = body.declare(raw.name, kind, raw.place)
    return [tree.Declare(raw.span, local, given)]


def _evaluate(body: Body, raw: syntax.Evaluate) -> list[tree.Stmt]:
    """A call, an assignment or `new`; anything else does nothing."""
    if isinstance(raw.value, syntax.Assign):
        return [tree.Evaluate(raw.span, assignment(body, raw.value))]
    found = evaluated(body, raw.value)
    if not isinstance(raw.value, syntax.Call | syntax.New | syntax.Bad) and found.type is not UNKNOWN:
        compares = isinstance(raw.value, syntax.Binary) and raw.value.operator == "=="
        body.report(messages.NO_EFFECT, raw.span, hint="did you mean = ?" if compares else None)
    return [tree.Evaluate(raw.span, found)]


def _if(body: Body, raw: syntax.If) -> list[tree.Stmt]:
    test = condition(body, raw.condition)
    then = _branch(body, raw.then)
    otherwise = _branch(body, raw.otherwise) if raw.otherwise is not None else []
    return [tree.If(raw.span, test, then, otherwise)]


def _while(body: Body, raw: syntax.While) -> list[tree.Stmt]:
    test = condition(body, raw.condition)
    return [tree.Loop(raw.span, test, _loop_body(body, raw.body), [])]


def _for(body: Body, raw: syntax.For) -> list[tree.Stmt]:
    """A block with the start and a loop; without a condition it is true."""
    body.enter()
    start = statement(body, raw.start) if raw.start is not None else []
    test: tree.Expr = tree.Literal_(raw.span, BOOLEAN, True)
    if raw.condition is not None:
        test = condition(body, raw.condition)
    step = statement(body, raw.step) if raw.step is not None else []
    inner = _loop_body(body, raw.body)
    body.leave()
    return [tree.Block(raw.span, [*start, tree.Loop(raw.span, test, inner, step)])]


def _break(body: Body, raw: syntax.Break) -> list[tree.Stmt]:
    _in_loop(body, raw.span, "break")
    return [tree.Break(raw.span)]


def _continue(body: Body, raw: syntax.Continue) -> list[tree.Stmt]:
    _in_loop(body, raw.span, "continue")
    return [tree.Continue(raw.span)]


def _in_loop(body: Body, span: Span, word: str) -> None:
    if body.loops == 0:
        body.report(messages.LOOP_ONLY, span, word=word)


def _return(body: Body, raw: syntax.Return) -> list[tree.Stmt]:
    method = body.method
    name, wanted = f"{method.kind} {method.name}" if method.kind != "init" else "init", method.result
    if raw.value is None:
        if wanted not in (VOID, UNKNOWN):
            body.report(messages.RETURN_SOMETHING, raw.span, method=name, wanted=shown(wanted))
        return [tree.Return(raw.span, None)]
    if wanted == VOID:
        evaluated(body, raw.value)
        hint = _NO_RESULT_HINTS.get(method.kind)
        body.report(messages.RETURN_NOTHING, raw.value.span, hint=hint, method=name)
        return [tree.Return(raw.span, None)]
    given = expect(body.symbols, value(body, raw.value), wanted, messages.RETURN_MISMATCH, method=name)
    return [tree.Return(raw.span, given)]


def _throw(body: Body, raw: syntax.Throw) -> list[tree.Stmt]:
    thrown = value(body, raw.value)
    if not isinstance(thrown.type, ClassType) and thrown.type not in (NULL, UNKNOWN):
        body.report(messages.THROW_TYPE, raw.value.span, given=shown(thrown.type))
        thrown = unknown(raw.span)
    return [tree.Throw(raw.span, thrown)]


def _try(body: Body, raw: syntax.Try) -> list[tree.Stmt]:
    inner = _branch(body, raw.body)
    return [tree.Try(raw.span, inner, [_catch(body, clause) for clause in raw.catches])]


def _catch(body: Body, raw: syntax.Catch) -> tree.Catch:
    kind = visible_type(body.symbols, body.unit, raw.type)
    if not isinstance(kind, ClassType) and kind is not UNKNOWN:
        body.report(messages.CATCH_TYPE, raw.type.span, given=kind)
        kind = UNKNOWN
    body.enter()
    local = body.declare(raw.name, kind, raw.place)
    caught = _branch(body, raw.body)
    body.leave()
    return tree.Catch(local, caught)


_CHECKS: dict[type[syntax.Stmt], Callable[[Body, Any], list[tree.Stmt]]] = {
    syntax.BadStmt: _bad,
    syntax.Empty: _empty,
    syntax.Block: _block,
    syntax.Declare: _declare,
    syntax.Evaluate: _evaluate,
    syntax.If: _if,
    syntax.While: _while,
    syntax.For: _for,
    syntax.Break: _break,
    syntax.Continue: _continue,
    syntax.Return: _return,
    syntax.Throw: _throw,
    syntax.Try: _try,
}
