"""Banned names: of modules, classes, functions, parameters, variables, attributes and fields. Pure.

The names of Python files come from their syntax trees. Those of JavaScript and WebAssembly text are found by
the forms of their declarations.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from code_tree import Finding, Trees, nodes


@dataclass(frozen=True, slots=True)
class Banned:
    """Words that no name may contain, banned names, and accepted terms that contain such a word.

    A term that is accepted in some folders or files only has their paths; () means all.
    """

    words: Mapping[str, str]
    names: Mapping[str, str]
    terms: Mapping[str, tuple[str, ...]]

    def instead(self, name: str, file: str = "") -> str | None:
        """The replacement of a name in a file, or None where it may be used."""
        plain = name.strip("_").lower()
        if plain not in self.names and not any(word in self.words for word in plain.split("_")):
            return None
        terms = [term for term, paths in self.terms.items() if not paths or file.startswith(paths)]
        if plain in self.names and plain not in terms:
            return self.names[plain]
        for term in terms:
            plain = re.sub(f"(^|_){term}(_|$)", r"\1\2", plain)
        return next((self.words[word] for word in plain.split("_") if word in self.words), None)


_CAMEL_CASE = re.compile(r"(?<=[a-z0-9])(?=[A-Z])")
_Bound = Iterator[tuple[str, str | None]]


def _class(node: ast.ClassDef) -> _Bound:
    yield "class", _CAMEL_CASE.sub("_", node.name)


def _function(node: ast.FunctionDef | ast.AsyncFunctionDef) -> _Bound:
    # Test names are sentences and may contain these words.
    if not node.name.startswith("test_"):
        yield "function", node.name


def _name(node: ast.Name) -> _Bound:
    if not isinstance(node.ctx, ast.Load):
        yield "variable", node.id


def _attribute(node: ast.Attribute) -> _Bound:
    if not isinstance(node.ctx, ast.Load):
        yield "attribute", node.attr


#: The nodes that bind a name. Fields of dataclasses and members of enumerations are variables of a class.
_BINDING: Mapping[type[ast.AST], Callable[..., Iterable[tuple[str, str | None]]]] = {
    ast.ClassDef: _class,
    ast.FunctionDef: _function,
    ast.AsyncFunctionDef: _function,
    ast.Name: _name,
    ast.Attribute: _attribute,
    ast.arg: lambda node: [("parameter", node.arg)],
    ast.keyword: lambda node: [("keyword argument", node.arg)],
    ast.MatchAs: lambda node: [("variable", node.name)],
    ast.MatchStar: lambda node: [("variable", node.name)],
    ast.MatchMapping: lambda node: [("variable", node.rest)],
    ast.ExceptHandler: lambda node: [("variable", node.name)],
    ast.alias: lambda node: [("import", node.asname)],
}


def named(file: str, tree: ast.Module) -> Iterator[tuple[int, str, str]]:
    """Line, kind and name of the module, or of its package, and of every name that a file binds."""
    path = Path(file)
    yield 1, "module", path.parent.name if path.stem == "__init__" else path.stem
    for node in nodes(tree):
        if (bound := _BINDING.get(type(node))) is not None:
            for kind, name in bound(node):
                if name is not None:
                    yield getattr(node, "lineno", 1), kind, name


#: Declarations by the suffix of a file: variables, functions, parameters, methods, properties of a component.
_DECLARATIONS = {
    ".js": re.compile(
        r"\b(?:const|let|function)\s+(\w+)|^\s+(?:async )?(\w+)\([^)]*\) \{$|\bthis\.(\w+)|^\s+(\w+):"
        r"|\((\w+)[,)]"
    ),
    ".wat": re.compile(r"\$(\w+)"),
}


def banned_names_in_text(file: str, text: str, banned: Banned) -> list[Finding]:
    """Banned names that a file of JavaScript or WebAssembly text declares, in the order of its lines."""
    found = []
    for number, line in enumerate(text.splitlines(), start=1):
        for match in _DECLARATIONS[Path(file).suffix].finditer(line):
            name = next(filter(None, match.groups()))
            instead = banned.instead(_CAMEL_CASE.sub("_", name), file)
            if instead is not None:
                problem = f"{name} is not a term of the field; use {instead}"
                found.append(Finding("name", file, number, name, problem))
    return found


def banned_names(trees: Trees, banned: Banned) -> list[Finding]:
    """Banned names, in the order of files and lines."""
    return [
        Finding("name", file, line, name.replace("_", "") if kind == "class" else name, problem)
        for file, tree in trees.items()
        for line, kind, name in sorted(named(file, tree))
        if (instead := banned.instead(name, file)) is not None
        and (problem := f"{kind} {name} is not a term of the field; use {instead}")
    ]


def read_banned(text: str) -> Banned:
    """Lines `word W instead`, `name N instead` and `term T [PATH...]`."""
    rows = [line.split(maxsplit=2) for line in lines_of(text)]
    words, names = ({row[1]: row[2] for row in rows if row[0] == kind} for kind in ("word", "name"))
    terms = {row[1]: tuple(" ".join(row[2:]).split()) for row in rows if row[0] == "term"}
    return Banned(words, names, terms)


def lines_of(text: str) -> list[str]:
    """Lines that are neither empty nor a comment."""
    return [line for line in text.splitlines() if line.strip() and not line.startswith("#")]
