"""Which locals a statement assigns in the middle of an expression, as in `f(i, i = 2)`."""

from __future__ import annotations

from lfield.lang.tree import (
    Assign,
    Binary,
    Call,
    DeviceCall,
    Element,
    Expr,
    FieldGet,
    Find,
    Library,
    Local,
    LocalGet,
    Logical,
    Negate,
    New,
    NewArray,
    Not,
    PortalCall,
    Query,
    ToReal,
)


def changed_inside(root: Expr) -> frozenset[Local]:
    """The locals assigned inside; an assignment that is the whole statement happens last and is none."""
    found: set[Local] = set()
    waiting = [root.value] if isinstance(root, Assign) and isinstance(root.target, LocalGet) else [root]
    while waiting:
        expr = waiting.pop()
        if isinstance(expr, Assign) and isinstance(expr.target, LocalGet):
            found.add(expr.target.local)
        waiting.extend(_parts(expr))
    return frozenset(found)


def _parts(expr: Expr) -> list[Expr]:
    match expr:
        case Assign():
            return [expr.target, expr.value]
        case Binary() | Logical():
            return [expr.left, expr.right]
        case Not() | Negate() | ToReal():
            return [expr.operand]
        case FieldGet():
            return [expr.object]
        case Element():
            return [expr.array, expr.index]
        case Call():
            return [expr.object, *expr.arguments]
        case PortalCall():
            return [expr.proxy, *expr.arguments]
        case New() | Library() | DeviceCall():
            return expr.arguments
        case NewArray():
            return expr.lengths
        case Find(id=Expr() as argument) | Query(constraint=Expr() as argument):
            return [argument]
    return []
