"""Syntax trees of the project's files: scopes, assignments and the classes of objects. Pure."""

from __future__ import annotations

import ast
from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache

#: Statements and expressions that a rule examines.
KEPT = (
    *(ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef, ast.Import, ast.Call, ast.withitem),
    *(ast.Assign, ast.AugAssign, ast.AnnAssign, ast.Delete, ast.For, ast.AsyncFor, ast.comprehension),
)
#: Nodes that contain no such statements.
LEAVES = (ast.Name, ast.Constant, ast.expr_context, ast.operator, ast.cmpop, ast.boolop, ast.unaryop)

Trees = Mapping[str, ast.Module]
"""Syntax trees by file, as `lfield/vm/machine.py`."""


@dataclass(frozen=True, slots=True)
class Finding:
    """One violation: rule, place, name and problem."""

    rule: str
    file: str
    line: int
    name: str
    problem: str

    def __str__(self) -> str:
        return f"{self.file}:{self.line}: {self.problem}"


@dataclass(frozen=True, slots=True)
class Scope:
    """The place of a statement: the innermost class around it and the functions within that class."""

    cls: ast.ClassDef | None = None
    functions: tuple[ast.FunctionDef | ast.AsyncFunctionDef, ...] = ()


def nodes(tree: ast.AST) -> Iterator[ast.AST]:
    """All nodes but contexts and operators, in no order. `ast.walk` takes four times as long."""
    left = [tree]
    while left:
        yield (node := left.pop())
        for value in vars(node).values():
            if isinstance(value, ast.AST):
                if value._fields:
                    left.append(value)
            elif isinstance(value, list):
                left += [each for each in value if isinstance(each, ast.AST) and each._fields]


@cache
def scoped(tree: ast.Module) -> tuple[tuple[ast.AST, Scope], ...]:
    """The nodes of a file that a rule examines, each with its scope, in the order of the text."""
    found = []
    left: list[tuple[ast.AST, Scope]] = [(tree, Scope())]
    while left:
        node, around = left.pop()
        inner = around
        if isinstance(node, KEPT):
            found.append((node, around))
            if isinstance(node, ast.ClassDef):
                inner = Scope(node)
            elif isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                inner = Scope(around.cls, (*around.functions, node))
        below: list[tuple[ast.AST, Scope]] = []
        for field in node._fields:
            value = getattr(node, field, None)
            for each in value if isinstance(value, list) else (value,):
                if isinstance(each, ast.AST) and not isinstance(each, LEAVES):
                    below.append((each, inner))
        left += below[::-1]
    return tuple(found)


def assignments(tree: ast.Module) -> Iterator[tuple[int, ast.expr, str, Scope]]:
    """Each assignment to an attribute of an object other than `self` and `cls`: line, object, name, scope."""
    for node, scope in scoped(tree):
        for target in targets(node):
            if isinstance(target, ast.Attribute) and not of_self(target):
                yield target.lineno, target.value, target.attr, scope


def targets(node: ast.AST) -> Iterator[ast.expr]:
    """The targets that a node assigns or deletes, including `setattr` with a constant name."""
    match node:
        case ast.Assign(targets=found) | ast.Delete(targets=found):
            yield from (each for target in found for each in unpacked(target))
        case ast.AugAssign(target=target) | ast.AnnAssign(target=target):
            yield target
        case ast.For(target=target) | ast.AsyncFor(target=target) | ast.comprehension(target=target):
            yield from unpacked(target)
        case ast.withitem(optional_vars=ast.expr() as target):
            yield from unpacked(target)
        case ast.Call(args=[base, ast.Constant(value=str(name)), *_]) if is_setter(node.func):
            yield ast.copy_location(ast.Attribute(base, name, ast.Store()), node)


def unpacked(target: ast.expr) -> Iterator[ast.expr]:
    match target:
        case ast.Tuple(elts=parts) | ast.List(elts=parts):
            yield from (each for part in parts for each in unpacked(part))
        case ast.Starred(value=part):
            yield from unpacked(part)
        case _:
            yield target


def is_setter(function: ast.expr) -> bool:
    """`setattr`, `delattr`, `object.__setattr__`."""
    names = ("setattr", "delattr", "object.__setattr__", "object.__delattr__")
    return ast.unparse(function) in names


def of_self(node: ast.Attribute) -> bool:
    return isinstance(node.value, ast.Name) and node.value.id in ("self", "cls")


def classes(tree: ast.Module) -> list[ast.ClassDef]:
    return [node for node, _ in scoped(tree) if isinstance(node, ast.ClassDef)]


def is_record(cls: ast.ClassDef) -> bool:
    """Whether a class is a dataclass or struct without methods; properties and `__str__` are allowed."""
    return is_dataclass(cls) and not any(
        isinstance(each, ast.FunctionDef | ast.AsyncFunctionDef)
        and not each.name.startswith("__")
        and "property" not in [ast.unparse(mark) for mark in each.decorator_list]
        for each in cls.body
    )


def is_dataclass(cls: ast.ClassDef) -> bool:
    """Whether a class is a dataclass or a msgspec struct; a struct that inherits from another has options."""
    marks = [ast.unparse(each) for each in cls.decorator_list]
    is_struct = any(last_name(each) == "Struct" for each in cls.bases)
    return (
        is_struct
        or any(each.startswith(("dataclass", "dataclasses.d")) for each in marks)
        or any(each.arg in ("frozen", "eq") for each in cls.keywords)
    )


def is_frozen(cls: ast.ClassDef) -> bool:
    """Whether a dataclass or struct is frozen."""
    options = [*map(ast.unparse, cls.decorator_list), *map(ast.unparse, cls.keywords)]
    return any("frozen=True" in each for each in options)


def attributes(tree: ast.Module) -> list[tuple[ast.ClassDef, frozenset[str], frozenset[str]]]:
    """Each class, names that its body declares (fields, methods, slots), and names assigned on `self`."""
    own: dict[ast.ClassDef | None, set[str]] = defaultdict(set)
    for node, scope in scoped(tree):
        own[scope.cls] |= {
            each.attr for each in targets(node) if isinstance(each, ast.Attribute) and of_self(each)
        }
    return [(cls, frozenset(in_body(cls)), frozenset(own[cls])) for cls in classes(tree)]


def in_body(cls: ast.ClassDef) -> Iterator[str]:
    """The names that the body of a class declares."""
    for node in cls.body:
        match node:
            case ast.AnnAssign(target=ast.Name(id=name)):
                yield name
            case ast.FunctionDef(name=name) | ast.AsyncFunctionDef(name=name):
                yield name
            case ast.Assign(targets=[ast.Name(id="__slots__")], value=value):
                yield from (each.value for each in ast.walk(value) if isinstance(each, ast.Constant))
            case ast.Assign(targets=names):
                yield from (each.id for each in names if isinstance(each, ast.Name))


def modules(tree: ast.Module) -> frozenset[str]:
    """The names by which a file imports whole modules."""
    return frozenset(
        (alias.asname or alias.name).partition(".")[0]
        for node, _ in scoped(tree)
        if isinstance(node, ast.Import)
        for alias in node.names
    )


def class_names(base: ast.expr, scope: Scope) -> set[str]:
    """The names of classes that `base` may be an instance of, from annotations and calls around it."""
    found: set[str] = set()
    for holder in scope.functions if isinstance(base, ast.Name) else [scope.cls]:
        arguments = annotated_arguments(holder)
        for node in ast.walk(holder) if holder is not None else ():
            match node:
                case ast.Assign(targets=targets, value=value) if any(same(base, each) for each in targets):
                    kind = arguments.get(value.id) if isinstance(value, ast.Name) else value
                case ast.AnnAssign(target=target, annotation=kind) if same(base, target):
                    pass
                case ast.arg(arg=name, annotation=ast.expr() as kind) if same(base, ast.Name(name)):
                    pass
                case _:
                    continue
            found |= names_in(kind, scope) if kind is not None else set()
    return found


def last_name(base: ast.expr) -> str:
    """`contact.Contact` -> `Contact`."""
    return ast.unparse(base).rpartition(".")[2] if isinstance(base, ast.Name | ast.Attribute) else ""


def annotated_arguments(holder: ast.AST | None) -> dict[str, ast.expr]:
    """The annotations of all arguments within a class or function."""
    nodes = ast.walk(holder) if holder is not None else ()
    return {each.arg: each.annotation for each in nodes if isinstance(each, ast.arg) and each.annotation}


def names_in(kind: ast.expr, scope: Scope) -> set[str]:
    """The classes that an annotation, or the call of a class or of its `__new__`, names."""
    if isinstance(kind, ast.Call):
        kind = kind.func
        if isinstance(kind, ast.Attribute):
            if kind.attr != "__new__":
                return set()
            kind = kind.value
    elif isinstance(kind, ast.Constant) and isinstance(kind.value, str):
        kind = ast.parse(kind.value, mode="eval").body
    names = {each.id for each in ast.walk(kind) if isinstance(each, ast.Name)}
    own = {scope.cls.name} if scope.cls is not None else set()
    return names | (own if names & {"cls", "Self"} else set())


def same(base: ast.expr, other: ast.expr) -> bool:
    """Whether two expressions are the same variable or attribute of `self`, or dataclass field."""
    match base, other:
        case ast.Name(id=one), ast.Name(id=two):
            return one == two
        case ast.Attribute(value=ast.Name(id="self"), attr=one), ast.Name(id=two) | ast.Attribute(
            value=ast.Name(id="self"), attr=two
        ):
            return one == two
    return False


def root(base: ast.expr) -> str:
    while isinstance(base, ast.Attribute):
        base = base.value
    return base.id if isinstance(base, ast.Name) else ""
