"""Traversal of trees without recursion along chains: sums, `a && b && c`, method calls on results, `else if`.

A chain is deep on one side only and may be of any length, so a recursive visitor iterates over `left_spine`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import TypeVar

from lfield.lang import syntax, tree

Node = TypeVar("Node")


def left_spine(top: Node, following: Callable[[Node], Node | None]) -> list[Node]:
    """All nodes that follow the top one, the last of them first."""
    found: list[Node] = []
    node = following(top)
    while node is not None:
        found.append(node)
        node = following(node)
    found.reverse()
    return found


def leftmost_operand(expr: syntax.Expr) -> syntax.Expr | None:
    """The operand with which the text of an expression begins."""
    match expr:
        case syntax.Binary():
            return expr.left
        case syntax.Member():
            return expr.object
        case syntax.Index():
            return expr.array
        case syntax.Call(function=syntax.Member() as function):
            return function.object
    return None


def first_evaluated_operand(expr: tree.Expr) -> tree.Expr | None:
    """The operand that is evaluated first."""
    match expr:
        case tree.Binary():
            return expr.left
        case tree.Logical(right=tree.LocalGet()):
            # Reading a local has no effect and cannot fail, so both sides are read.
            return expr.left
        case tree.FieldGet() | tree.Call():
            return expr.object
        case tree.PortalCall():
            return expr.proxy
        case tree.Element():
            return expr.array
        case tree.ToReal() | tree.Relabel():
            return expr.operand
        case tree.LibraryCall(arguments=[first, *_]):
            return first
    return None


def chain_operands(expr: tree.Logical) -> list[tree.Expr]:
    """The operands of one operator: a, b and c of `a && b && c`."""
    found: list[tree.Expr] = []
    node: tree.Expr = expr
    while isinstance(node, tree.Logical) and node.op == expr.op:
        found.append(node.right)
        node = node.left
    return [node, *reversed(found)]


def else_if(stmt: tree.If) -> tree.If | None:
    """The `else if` of an `if`."""
    match stmt.otherwise:
        case [tree.If() as following]:
            return following
    return None


def subexpressions(expr: tree.Expr) -> list[tree.Expr]:
    """The expressions directly inside one."""
    match expr:
        case tree.Assign():
            return [expr.target, expr.value]
        case tree.Binary() | tree.Logical():
            return [expr.left, expr.right]
        case tree.Not() | tree.Negate() | tree.ToReal() | tree.Relabel():
            return [expr.operand]
        case tree.FieldGet():
            return [expr.object]
        case tree.Element():
            return [expr.array, expr.index]
        case tree.Call():
            return [expr.object, *expr.arguments]
        case tree.PortalCall():
            return [expr.proxy, *expr.arguments]
        case tree.DeviceCall(device=tree.Expr() as device):
            return [device, *expr.arguments]
        case tree.New() | tree.LibraryCall() | tree.DeviceCall():
            return expr.arguments
        case tree.NewArray():
            return expr.lengths
        case tree.Elements():
            return expr.elements
        case tree.Find(id=tree.Expr() as argument):
            return [argument]
        case tree.Query(constraint=constraint, size=size):
            return [argument for argument in (constraint, size) if argument is not None]
        case tree.Async():
            return [expr.call]
    return []


def statement_expressions(stmt: tree.Stmt) -> list[tree.Expr]:
    """The expressions directly in a statement, outside of the bodies it has."""
    match stmt:
        case tree.Evaluate() | tree.Throw():
            return [stmt.value]
        case tree.Declare(value=tree.Expr() as value) | tree.Return(value=tree.Expr() as value):
            return [value]
        case tree.If() | tree.Loop():
            return [stmt.condition]
        case tree.Within():
            return [stmt.seconds]
        case tree.WaitUntil():
            return [stmt.condition] if stmt.seconds is None else [stmt.seconds, stmt.condition]
        case tree.Reserve():
            return [stmt.target]
        case tree.StartCall():
            return [stmt.call] if stmt.target is None else [stmt.call, stmt.target]
    return []


def nested_bodies(stmt: tree.Stmt) -> list[list[tree.Stmt]]:
    """The bodies directly in a statement; those of its `catch` clauses are among them."""
    match stmt:
        case tree.BlockStmt() | tree.Together() | tree.Within() | tree.Reserve():
            return [stmt.body]
        case tree.If():
            return [stmt.then, stmt.otherwise]
        case tree.Loop():
            return [stmt.body, stmt.step]
        case tree.Try():
            return [stmt.body, *(clause.body for clause in stmt.catches), stmt.last or []]
    return []


def all_statements(body: Sequence[tree.Stmt]) -> Iterator[tree.Stmt]:
    """All statements of a body, those inside others too."""
    waiting = list(body)
    while waiting:
        stmt = waiting.pop()
        yield stmt
        for inner in nested_bodies(stmt):
            waiting += inner


def descendants(expr: tree.Expr) -> Iterator[tree.Expr]:
    """An expression and all expressions inside it."""
    waiting = [expr]
    while waiting:
        part = waiting.pop()
        yield part
        waiting += subexpressions(part)
