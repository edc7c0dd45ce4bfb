"""Chains: sums, `a && b && c`, calls on what a call gave, `else if` after `else if`.

Their trees are deep on one side only, and people write them as long as they like: they are no nesting.
Whoever walks a tree and would call itself for that side goes through `chain` first, so none is too long.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import TypeVar

from lfield.lang import syntax, tree

Node = TypeVar("Node")


def chain(top: Node, following: Callable[[Node], Node | None]) -> list[Node]:
    """All that follow the top one, the last of them first."""
    found: list[Node] = []
    node = following(top)
    while node is not None:
        found.append(node)
        node = following(node)
    found.reverse()
    return found


def first_written(expr: syntax.Expr) -> syntax.Expr | None:
    """The part of an expression that begins where it begins and is a whole expression before it."""
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


def first_evaluated(expr: tree.Expr) -> tree.Expr | None:
    """The part whose value is the first thing that an expression needs, whatever the others give."""
    match expr:
        case tree.Binary():
            return expr.left
        case tree.Logical(right=tree.LocalGet()):
            # Reading a local does nothing and cannot fail, so both sides are read.
            return expr.left
        case tree.FieldGet() | tree.Call():
            return expr.object
        case tree.PortalCall():
            return expr.proxy
        case tree.Element():
            return expr.array
        case tree.ToReal():
            return expr.operand
        case tree.Library(arguments=[first, *_]):
            return first
    return None


def terms(expr: tree.Logical) -> list[tree.Expr]:
    """What one operator joins: a, b and c of `a && b && c`."""
    found: list[tree.Expr] = []
    node: tree.Expr = expr
    while isinstance(node, tree.Logical) and node.op == expr.op:
        found.append(node.right)
        node = node.left
    return [node, *reversed(found)]


def further(one: tree.If) -> tree.If | None:
    """The `else if` of an `if`."""
    match one.otherwise:
        case [tree.If() as following]:
            return following
    return None


def parts(expr: tree.Expr) -> list[tree.Expr]:
    """The expressions directly inside one."""
    match expr:
        case tree.Assign():
            return [expr.target, expr.value]
        case tree.Binary() | tree.Logical():
            return [expr.left, expr.right]
        case tree.Not() | tree.Negate() | tree.ToReal():
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
        case tree.New() | tree.Library() | tree.DeviceCall():
            return expr.arguments
        case tree.NewArray():
            return expr.lengths
        case tree.Elements():
            return expr.elements
        case tree.Find(id=tree.Expr() as argument) | tree.Query(constraint=tree.Expr() as argument):
            return [argument]
    return []


def values(one: tree.Stmt) -> list[tree.Expr]:
    """The expressions directly in a statement, outside of the bodies it has."""
    match one:
        case tree.Evaluate() | tree.Throw():
            return [one.value]
        case tree.Declare(value=tree.Expr() as value) | tree.Return(value=tree.Expr() as value):
            return [value]
        case tree.If() | tree.Loop():
            return [one.condition]
        case tree.Within():
            return [one.seconds]
        case tree.Reserve():
            return [one.who]
        case tree.Begin():
            return [one.call] if one.target is None else [one.call, one.target]
    return []


def bodies(one: tree.Stmt) -> list[list[tree.Stmt]]:
    """The bodies directly in a statement; those of its `catch` clauses are among them."""
    match one:
        case tree.Block() | tree.Together() | tree.Within() | tree.Reserve():
            return [one.body]
        case tree.If():
            return [one.then, one.otherwise]
        case tree.Loop():
            return [one.body, one.step]
        case tree.Try():
            return [one.body, *(clause.body for clause in one.catches), one.last or []]
    return []


def statements(body: Sequence[tree.Stmt]) -> Iterator[tree.Stmt]:
    """All statements of a body, those inside others too."""
    waiting = list(body)
    while waiting:
        one = waiting.pop()
        yield one
        for inner in bodies(one):
            waiting += inner


def inside(expr: tree.Expr) -> Iterator[tree.Expr]:
    """An expression and all expressions inside it."""
    waiting = [expr]
    while waiting:
        one = waiting.pop()
        yield one
        waiting += parts(one)
