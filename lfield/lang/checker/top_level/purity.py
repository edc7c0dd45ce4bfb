"""Purity of functions: the result depends on the arguments alone, and no other value changes.

A function has no unit, so it has no fields, devices and proxies. Other effects are found in its checked body:
output, the clock, random numbers, other threads, objects of classes (their methods may do any of these), and
changes of an array or object that the caller has. The last is a flow-insensitive taint analysis of the
parameters, and of every variable that may refer to a part of their values. A function creates no objects
of classes, so an exception that it catches may be its caller's.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from lfield.lang import messages, tree
from lfield.lang.checker.symbols import Function, Symbols
from lfield.lang.language_library import GROWTH
from lfield.lang.standard_library.instances import LIBRARY_FILE
from lfield.lang.tree_traversal import all_statements, descendants, statement_expressions
from lfield.lang.types import ArrayType, ClassType, MapType, Type
from lfield.text.source_text import Span

_OUTPUT, _THREADS, _CLOCK = "writes output", "lets other threads run", "reads the clock"
_RANDOM, _STATE = "uses random numbers", "reads the state of its coordinator"
#: The effects of instructions of the library, besides computing.
_EFFECTS = {
    **{f"{verb}_{kind}": _OUTPUT for verb in ("print", "write") for kind in ("int", "float", "str", "bool")},
    **{"yield": _THREADS, "sleep": _THREADS, "now": _CLOCK, "lived": _CLOCK, "hops": _STATE},
    **{"heartbeat_interval": _STATE, "random": _RANDOM, "random_int": _RANDOM},
}
#: Methods of arrays and maps in L that change them.
_CHANGING = frozenset({"sort", "sortByKey", "set", "remove"})


def check_purity(symbols: Symbols, function: Function) -> None:
    """Report impure expressions in the checked body of a function."""
    name = function.head.name
    changes = _Changes(function.head)
    for statement in all_statements(function.head.body):
        if isinstance(statement, tree.WaitUntil):
            symbols.report(messages.IMPURE, statement.span, function=name, what=_THREADS)
    for expr in _expressions(function.head.body):
        if (effect := _effect(expr)) is not None:
            symbols.report(messages.IMPURE, _place(expr), function=name, what=effect)
        if (changed := changes.target(expr)) is not None:
            effect = f"'{changed.text}'"
            symbols.report(messages.CHANGES_ARGUMENT, changed, function=name, what=effect)


def _expressions(body: Iterable[tree.Stmt]) -> Iterator[tree.Expr]:
    for statement in all_statements(list(body)):
        for expr in statement_expressions(statement):
            yield from descendants(expr)


def _place(expr: tree.Expr) -> Span:
    """The name of a called function, without its arguments."""
    span = expr.span
    end = span.text.find("(")
    return Span(span.source, span.start, span.start + end) if end > 0 else span


def _effect(expr: tree.Expr) -> str | None:
    """The effect of an expression that no function may have, or None."""
    match expr:
        case tree.LibraryCall(operation=operation):
            return _EFFECTS.get(operation)
        case tree.New(constructor=tree.Method() as constructor) if not isinstance(expr.type, MapType):
            return f"creates an object of {constructor.unit.name}, whose constructor may do anything"
        case tree.Call(method=method) if not _is_computed(expr):
            return f"calls {method.unit.name}.{method.name}, a method of an object, which may do anything"
    return None


def _is_computed(call: tree.Call) -> bool:
    """Whether a call is one of a function, of the library for arrays, or of a map."""
    return call.method.unit.function or isinstance(call.object.type, MapType)


class _Changes:
    """The variables of a function that may refer to values of its caller, or to values that contain them."""

    def __init__(self, head: tree.Method) -> None:
        statements = [*all_statements(head.body)]
        caught = [
            clause.local for each in statements if isinstance(each, tree.Try) for clause in each.catches
        ]
        self._argument_locals = {local for local in (*head.parameters, *caught) if _is_mutable(local.type)}
        self._holding: set[tree.Local] = set()
        expressions = [*_expressions(head.body)]
        declared = [stmt for stmt in statements if isinstance(stmt, tree.Declare)]
        before = -1
        while before != (before := len(self._argument_locals) + len(self._holding)):
            for stmt in declared:
                if stmt.value is not None:
                    self._assign(stmt.local, stmt.value)
            for expr in expressions:
                self._spread(expr)

    def target(self, expr: tree.Expr) -> Span | None:
        """The place of a caller's value that an expression itself changes, or None."""
        changed = _changed_by(expr)
        return changed.span if changed is not None and self._is_given(changed) else None

    def _spread(self, expr: tree.Expr) -> None:
        """Follow the values that an expression stores."""
        match expr:
            case tree.Assign(target=tree.LocalGet(local=local), value=value):
                self._assign(local, value)
            case tree.Assign(target=target, value=value):
                self._put(target, [value])
            case tree.LibraryCall(operation=operation, arguments=[array, *rest]) if operation in GROWTH:
                self._put(array, rest)
            case tree.Call(object=owner, method=method, arguments=arguments) if method.name == "set":
                self._put(owner, arguments)

    def _assign(self, local: tree.Local, value: tree.Expr) -> None:
        if self._is_given(value):
            self._argument_locals.add(local)
        if self._is_holding(value):
            self._holding.add(local)
        if local in self._holding:  # a value that is stored in one later is in the other, too
            self._holding.update(_arrays_in(value))

    def _put(self, target: tree.Expr, values: Iterable[tree.Expr]) -> None:
        """Record values that are stored in a part of a target."""
        if any(map(self._leads, values)):
            self._holding.update(_arrays_in(target))

    def _is_given(self, expr: tree.Expr) -> bool:
        """Whether a value may belong to the caller."""
        if not _is_mutable(expr.type):
            return False
        match expr:
            case tree.LocalGet(local=local):
                return local in self._argument_locals
            case tree.FieldGet(object=inner) | tree.Element(array=inner):
                return self._leads(inner)
            case tree.Assign(value=inner):
                return self._is_given(inner)
            case tree.Call(object=owner) if isinstance(owner.type, MapType):
                return expr.method.name == "get" and self._leads(owner)
            case tree.Call(method=method, arguments=arguments):
                return not _is_of_library(method) and any(map(self._leads, arguments))
            case tree.LibraryCall(arguments=[array, *_]):
                return self._leads(array)
        return False

    def _is_holding(self, expr: tree.Expr) -> bool:
        """Whether a part of a value may belong to the caller."""
        match expr:
            case tree.LocalGet(local=local):
                return local in self._holding
            case tree.Assign(value=inner):
                return self._is_holding(inner)
            case tree.Elements(elements=parts):
                return any(map(self._leads, parts))
            case tree.Call(object=owner, arguments=arguments):
                return _has_mutable_parts(expr.type) and any(map(self._leads, (owner, *arguments)))
        return False

    def _leads(self, expr: tree.Expr) -> bool:
        return self._is_given(expr) or self._is_holding(expr)


def _changed_by(expr: tree.Expr) -> tree.Expr | None:
    """The array, map or object that an expression changes, or None."""
    match expr:
        case tree.Assign(target=tree.Element(array=owner)):
            return owner
        case tree.Assign(target=tree.FieldGet(object=owner)):
            return owner
        case tree.LibraryCall(operation=operation, arguments=[array, *_]) if operation in GROWTH:
            return array
        case tree.Call(object=owner, method=method) if isinstance(owner.type, MapType):
            return owner if method.name in _CHANGING else None
        case tree.Call(method=method, arguments=[array, *_]) if _is_of_library(method):
            return array if method.name in _CHANGING else None
    return None


def _is_of_library(method: tree.Method) -> bool:
    """Whether a method is of the library for arrays and enums."""
    return method.span.source.name == LIBRARY_FILE


def _arrays_in(expr: tree.Expr) -> Iterator[tree.Local]:
    """The variables of an expression whose parts its value may share."""
    for part in descendants(expr):
        if isinstance(part, tree.LocalGet) and _is_mutable(part.local.type):
            yield part.local


def _is_mutable(kind: Type) -> bool:
    return isinstance(kind, ArrayType | ClassType)


def _has_mutable_parts(kind: Type) -> bool:
    return not isinstance(kind, ArrayType) or _is_mutable(kind.element)
