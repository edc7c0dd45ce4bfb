"""Statements. Unreachable ones are not compiled; `try` costs no instruction without an exception."""

from __future__ import annotations

from lfield.bytecode.program import Handler
from lfield.compiler.async_variants.async_methods import SettleResult
from lfield.compiler.constant_folding import fold
from lfield.compiler.coordination_blocks import CoordinationEmitter
from lfield.compiler.exit_paths import ExitPaths
from lfield.compiler.exit_paths import LoopLabels as Around
from lfield.compiler.expressions import ExpressionEmitter
from lfield.compiler.method_frame import Label, MethodFrame
from lfield.lang import types
from lfield.lang.tree import (
    Assign,
    BlockStmt,
    Break,
    Catch,
    Continue,
    Declare,
    Evaluate,
    Expr,
    If,
    Local,
    LocalGet,
    Loop,
    Reserve,
    Return,
    StartCall,
    Stmt,
    Throw,
    Together,
    Try,
    WaitUntil,
    Within,
)
from lfield.lang.tree_traversal import statement_expressions, subexpressions
from lfield.lang.types import Type


class StatementEmitter:
    """The statements of one method."""

    def __init__(self, frame: MethodFrame) -> None:
        self._frame = frame
        self._code = frame.code
        self._expressions = ExpressionEmitter(frame)
        self._exit_paths = ExitPaths(frame)
        self._parallel = CoordinationEmitter(frame, self._expressions, self._exit_paths)

    def block(self, body: list[Stmt]) -> None:
        """Statements with a scope of their own."""
        with self._frame.slots.scope():
            for stmt in body:
                if self._code.reachable:
                    self._statement(stmt)

    def _statement(self, stmt: Stmt) -> None:
        self._code.set_line(stmt.span.line)
        self._parallel.start_before(stmt)
        match stmt:
            case Evaluate():
                self._prepare(stmt.value)
                self._expressions.effect(stmt.value)
            case Declare():
                self._declare(stmt)
            case If():
                self._if(stmt)
            case Loop():
                self._loop(stmt)
            case Break():
                self._exit_paths.jump(self._exit_paths.loop.end)
            case Continue():
                self._exit_paths.jump(self._exit_paths.loop.step)
            case Return():
                self._return(stmt)
            case Throw():
                self._prepare(stmt.value)
                thrown = self._expressions.value(stmt.value)
                self._code.emit("throw", thrown)
                self._frame.slots.release(thrown)
            case BlockStmt():
                self.block(stmt.body)
            case _:
                self._guarded(stmt)

    def _guarded(self, stmt: Stmt) -> None:
        """Statements with exit paths of their own, and the calls of a `together`."""
        match stmt:
            case Try():
                self._parallel.without_collecting(lambda: self._try(stmt))
            case Together():
                self._parallel.together(stmt, lambda: self.block(stmt.body))
            case Within():
                self._prepare(stmt.seconds)
                self._parallel.within(stmt, lambda: self.block(stmt.body))
            case Reserve():
                self._prepare(stmt.target)
                self._parallel.reserve(stmt, lambda: self.block(stmt.body))
            case WaitUntil():
                self._prepare(*statement_expressions(stmt))
                self._parallel.wait_until(stmt, self._branch)
            case StartCall():
                self._prepare(*statement_expressions(stmt))
                self._parallel.collect_call(stmt)
            case SettleResult():
                self._prepare(stmt.value)
                self._parallel.settle_result(stmt)

    def _prepare(self, *exprs: Expr) -> None:
        """Called before every expression: collects the locals that it assigns."""
        self._frame.set_changing(frozenset().union(*map(_changed_inside, exprs)))

    def _branch(self, condition: Expr, when: bool, label: Label) -> None:
        self._code.set_line(condition.span.line)
        self._parallel.start_before_value(condition)
        self._prepare(condition)
        self._expressions.branch(condition, when, label)

    def _declare(self, stmt: Declare) -> None:
        kind = self._frame.tables.type_index(stmt.local.type)
        if stmt.value is not None:
            self._prepare(stmt.value)
            # The local may be written early: its initialiser cannot read it.
            self._expressions.value(stmt.value, self._frame.slots.declare(stmt.local, kind)[0])
            return
        slot, used = self._frame.slots.declare(stmt.local, kind)
        if used or self._exit_paths.is_in_loop:  # otherwise `frame` has just cleared it
            self._code.emit("move", slot, self._frame.constant(_zero(stmt.local.type)))

    def _if(self, stmt: If) -> None:
        end = Label()
        rest: list[Stmt] = [stmt]
        while self._code.reachable and (rung := _single_if(rest)) is not None:
            rest = self._rung(rung, end)
        self.block(rest)
        self._code.place(end)

    def _rung(self, stmt: If, end: Label) -> list[Stmt]:
        """One `if` of an else-if chain; returns the statements to compile when its condition is false."""
        constant = fold(stmt.condition)
        if isinstance(constant, bool):
            return stmt.then if constant else stmt.otherwise
        leave = None if stmt.otherwise else self._leaving(stmt.then)
        if leave is not None:
            self._branch(stmt.condition, True, leave)
            return []
        otherwise = Label()
        self._branch(stmt.condition, False, otherwise)
        self.block(stmt.then)
        if stmt.otherwise:
            self._code.jump("jmp", end)
        self._code.place(otherwise)
        return stmt.otherwise

    def _leaving(self, body: list[Stmt]) -> Label | None:
        """The label that a body of only `break` or `continue` jumps to."""
        match body:
            case [Break()]:
                label = self._exit_paths.loop.end
            case [Continue()]:
                label = self._exit_paths.loop.step
            case [BlockStmt(body=inner)]:
                return self._leaving(inner)
            case _:
                return None
        return None if self._exit_paths.crossed_guard(label) else label

    def _loop(self, stmt: Loop) -> None:
        """The test comes last, so a round costs one jump. There is none for a constant true condition."""
        constant = fold(stmt.condition)
        if constant is False:
            return
        body, step, test, end = Label(), Label(), Label(), Label()
        if constant is not True:
            self._code.jump("jmp", test)
        self._code.place(body, entered=True)
        with self._exit_paths.loop_body(Around(step, end)):
            self.block(stmt.body)
            self._code.place(step)
            self.block(stmt.step)
        self._code.place(test)
        self._branch(stmt.condition, True, body)
        self._code.place(end)

    def _return(self, stmt: Return) -> None:
        if stmt.value is None:
            self._exit_paths.emit_return(None)
            return
        self._prepare(stmt.value)
        self._exit_paths.emit_return(self._expressions.operand(stmt.value))

    def _try(self, stmt: Try) -> None:
        last = stmt.last
        if last is None:
            self._caught(stmt)
            return
        guard = self._exit_paths.open()
        self._caught(stmt)
        self._exit_paths.close(guard, lambda: self.block(last), through=True)

    def _caught(self, stmt: Try) -> None:
        """Protect the body with one handler per catch (chapter V).

        An inner try adds its rows before the outer one, so the innermost handler is found first; and no catch
        is in the range that it serves.
        """
        start = self._code.position
        self.block(stmt.body)
        end = self._code.position
        if start == end:
            return
        after = Label()
        for clause in stmt.catches:
            self._code.jump("jmp", after)
            self._catch(clause, start, end)
        self._code.place(after)

    def _catch(self, clause: Catch, start: int, end: int) -> None:
        frame = self._frame
        with frame.slots.scope():
            slot, _ = frame.slots.declare(clause.local, frame.tables.type_index(clause.local.type))
            class_number = frame.tables.class_index(clause.local.type.name)
            frame.handlers.append(Handler(start, end, self._code.position, class_number, slot))
            self._code.place(Label(), entered=True)
            self.block(clause.body)


def _single_if(body: list[Stmt]) -> If | None:
    match body:
        case [If() as stmt]:
            return stmt
    return None


def _changed_inside(root: Expr) -> frozenset[Local]:
    """The locals assigned inside an expression, as in `f(i, i = 2)`.

    An assignment that is the whole statement happens last and does not count.
    """
    found: set[Local] = set()
    waiting = [root.value] if isinstance(root, Assign) and isinstance(root.target, LocalGet) else [root]
    while waiting:
        expr = waiting.pop()
        if isinstance(expr, Assign) and isinstance(expr.target, LocalGet):
            found.add(expr.target.local)
        waiting.extend(subexpressions(expr))
    return frozenset(found)


def _zero(kind: Type) -> bool | int | float | None:
    """The initial value of a variable of a type."""
    return {types.BOOLEAN: False, types.INT: 0, types.REAL: 0.0}.get(kind)
