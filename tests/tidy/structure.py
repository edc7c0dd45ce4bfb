"""Structural rules of STYLE.md on class names, banned names, assignments and constructors.

`python tests/tidy/structure.py` prints the findings of each rule, exceptions included. The rules are pure:
syntax trees in, findings out.
"""

from __future__ import annotations

import ast
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from code_tree import (
    Finding,
    Scope,
    Trees,
    assignments,
    attributes,
    class_names,
    classes,
    is_dataclass,
    is_frozen,
    is_record,
    last_name,
    modules,
    root,
    scoped,
)
from name_rules import Banned, banned_names, banned_names_in_text, lines_of, read_banned

ROOT = Path(__file__).parents[2]
BANNED = Path(__file__).with_name("banned_names.txt")
EXCEPTIONS = Path(__file__).with_name("exceptions.txt")
MOST_ARGUMENTS = 7

#: The two syntax trees of `lang`: the parsed and the checked form of a program have nodes of the same names.
SYNTAX_TREES = ("lfield.lang.syntax", "lfield.lang.tree")


@dataclass(frozen=True, slots=True)
class Allowed:
    """One line of the table of exceptions: rule, file, the name in question, and the reason."""

    rule: str
    file: str
    name: str
    reason: str


# --- public class names -------------------------------------------------------------------------------------


def public_classes(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """Line and name of each public class of a module."""
    for node, scope in scoped(tree):
        if isinstance(node, ast.ClassDef) and scope == Scope() and not node.name.startswith("_"):
            yield node.lineno, node.name


def repeated_classes(trees: Trees) -> list[Finding]:
    """Public class names that occur more than once; a name may occur once in each of the two syntax trees."""
    places: dict[str, list[tuple[str, int]]] = defaultdict(list)
    for file, tree in trees.items():
        for line, name in public_classes(tree):
            places[name].append((file, line))
    found = []
    for name, all_places in sorted(places.items()):
        nodes = {file for file, _ in all_places if module_of(file) in SYNTAX_TREES}
        if len(all_places) - max(0, len(nodes) - 1) > 1:
            problem = f"class {name} is in {', '.join(file for file, _ in all_places)}"
            found += [Finding("class", file, line, name, problem) for file, line in all_places]
    return found


# --- assignments to attributes of other objects -------------------------------------------------------------


def foreign_assignments(trees: Trees) -> list[Finding]:
    """Attributes that are assigned on an object of the project outside its class.

    An object with behaviour is changed only by its class. A helper of the same file counts as part of that
    class, and a record (a dataclass or struct without methods) may be filled within its package. Excluded
    are modules, and objects of libraries: no class of the project declares their attributes. Where
    annotations and calls around the assignment do not give the class of the object, every class that declares
    the attribute counts.
    """
    known = [
        Declared(file, cls, declared | assigned)
        for file, tree in trees.items()
        for cls, declared, assigned in attributes(tree)
    ]
    by_attribute = defaultdict(list)
    for each in known:
        for name in each.attributes:
            by_attribute[name].append(each)
    bases: dict[str, list[str]] = defaultdict(list)
    for each in known:
        bases[each.cls.name] += [name for base in each.cls.bases if (name := last_name(base))]
    found = []
    for file, tree in trees.items():
        imported = modules(tree)
        for line, base, name, scope in assignments(tree):
            owners = by_attribute[name]
            if not owners or root(base) in imported:
                continue
            kinds = {kind for each in class_names(base, scope) for kind in ancestors(each, bases)}
            inferred = [each for each in owners if each.cls.name in kinds]
            if kinds & imported:
                continue  # It is annotated as a class of a library: `ssl.SSLContext`.
            if not inferred and kinds & bases.keys() and kinds - bases.keys():
                continue  # It is inherited from a class of a library.
            if not may_assign(file, scope, inferred or owners, sure=bool(inferred)):
                problem = f"{ast.unparse(base)}.{name} is assigned outside its class"
                found.append(Finding("assignment", file, line, name, problem))
    return found


@dataclass(frozen=True, slots=True)
class Declared:
    """A class of the project and the attributes that it declares."""

    file: str
    cls: ast.ClassDef
    attributes: frozenset[str]


def may_assign(file: str, scope: Scope, owners: list[Declared], *, sure: bool) -> bool:
    """Whether a statement may assign an attribute of an object whose class is one of `owners`.

    Unless `sure`, the class around the statement counts only if no other class declares the attribute.
    """
    others = owners if sure or len(owners) == 1 else [each for each in owners if each.cls is not scope.cls]
    return any(
        each.file == file or (is_record(each.cls) and package_of(each.file) == package_of(file))
        for each in others
    )


def ancestors(name: str, bases: Mapping[str, list[str]]) -> set[str]:
    """The name of a class, and those of its bases."""
    found, left = set(), [name]
    while left:
        if (each := left.pop()) not in found:
            found.add(each)
            left += bases.get(each, ())
    return found


def package_of(file: str) -> str:
    """`lfield/vm/machine.py` -> `lfield/vm`."""
    return "/".join(file.split("/")[:2])


# --- constructors -------------------------------------------------------------------------------------------


def long_constructors(trees: Trees) -> list[Finding]:
    """Constructors that take more than 7 arguments besides `self`.

    For a dataclass or struct that holds behaviour (not frozen, and with methods) its fields without a default
    count. A frozen one is a value and one without methods is a record: their fields are data, however many.
    """
    return [
        Finding("constructor", file, cls.lineno, cls.name, f"{cls.name} takes {count} arguments")
        for file, tree in trees.items()
        for cls in classes(tree)
        if (count := argument_count(cls)) > MOST_ARGUMENTS
    ]


def argument_count(cls: ast.ClassDef) -> int:
    """The number of arguments of a class's constructor; 0 without one of its own."""
    for method in cls.body:
        if isinstance(method, ast.FunctionDef) and method.name == "__init__":
            arguments = method.args
            every = [
                *arguments.posonlyargs,
                *arguments.args,
                *arguments.kwonlyargs,
                arguments.vararg,
                arguments.kwarg,
            ]
            return len([each for each in every if each is not None]) - 1
    if not is_dataclass(cls) or is_frozen(cls) or is_record(cls):
        return 0
    return sum(is_required(each) for each in cls.body)


def is_required(node: ast.stmt) -> bool:
    """Whether a statement of a dataclass is a field that every caller passes."""
    if not isinstance(node, ast.AnnAssign) or "ClassVar" in ast.unparse(node.annotation):
        return False
    words = {each.arg for each in node.value.keywords} if isinstance(node.value, ast.Call) else set()
    return node.value is None or (bool(words) and not words & {"default", "default_factory", "init"})


# --- exceptions and files -----------------------------------------------------------------------------------


def unexplained(findings: Iterable[Finding], allowed: Iterable[Allowed]) -> list[str]:
    """Findings without a line in the table of exceptions."""
    known = {(each.rule, each.file, each.name) for each in allowed}
    return [str(each) for each in findings if (each.rule, each.file, each.name) not in known]


def unneeded(findings: Iterable[Finding], allowed: Iterable[Allowed]) -> list[str]:
    """Exceptions without a finding, repeated exceptions, and exceptions without a reason."""
    found = {(each.rule, each.file, each.name) for each in findings}
    left = []
    for each in allowed:
        key = each.rule, each.file, each.name
        if key not in found or not each.reason:
            left.append(" ".join(key))
        found.discard(key)
    return left


def read_allowed(text: str) -> list[Allowed]:
    """Lines `rule file name reason`."""
    parts = [line.split(maxsplit=3) for line in lines_of(text)]
    return [Allowed(rule, file, name, "".join(reason)) for rule, file, name, *reason in parts]


def module_of(file: str) -> str:
    """`lfield/vm/machine.py` -> `lfield.vm.machine`."""
    return file.removesuffix(".py").replace("/", ".")


def packages() -> list[str]:
    """`lfield` and each driver."""
    return [
        "lfield",
        *sorted(path.relative_to(ROOT).as_posix() for path in (ROOT / "drivers").glob("lfield_*")),
    ]


def named_folders() -> list[str]:
    """The code outside the packages whose names are also checked."""
    return ["sim-adapters", "capabilities", "examples"]


def trees_of(*folders: str) -> Trees:
    """The syntax trees of all files of some folders of the project."""
    paths = sorted(path for folder in folders for path in (ROOT / folder).rglob("*.py"))
    return {p.relative_to(ROOT).as_posix(): ast.parse(p.read_text(encoding="utf-8")) for p in paths}


def findings_of(trees: Trees, others: Trees) -> dict[str, list[Finding]]:
    """The findings of each rule, exceptions included; of `others` only the names are checked."""
    banned = read_banned(BANNED.read_text(encoding="utf-8"))
    within = [{f: tree for f, tree in trees.items() if f.startswith(f"{each}/")} for each in packages()]
    return {
        "class": [each for some in within for each in repeated_classes(some)],
        "name": [*banned_names({**trees, **others}, banned), *_banned_in_texts(banned)],
        "assignment": foreign_assignments(trees),
        "constructor": long_constructors(trees),
    }


def _banned_in_texts(banned: Banned) -> list[Finding]:
    """The banned names in the JavaScript and WebAssembly text of lfield."""
    paths = sorted(path for path in (ROOT / "lfield").rglob("*") if path.suffix in (".js", ".wat"))
    return [
        finding
        for path in paths
        for finding in banned_names_in_text(
            path.relative_to(ROOT).as_posix(), path.read_text(encoding="utf-8"), banned
        )
    ]


def main() -> None:
    """Print all findings and their numbers."""
    found = findings_of(trees_of(*packages()), trees_of(*named_folders()))
    for rule, findings in found.items():
        print(*(f"{rule}: {each}" for each in findings), sep="\n")
    print(*(f"{len(findings)} findings of rule {rule}" for rule, findings in found.items()), sep="\n")


if __name__ == "__main__":
    main()
