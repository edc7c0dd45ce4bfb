"""Capabilities of a registry as types of L: the port through which the front end uses a registry.

A program that names a type no unit declares may mean a capability. Then its class is made from the registry
and read as if it had been included; so are the files of the classes that put several resources together.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Literal, Protocol

from msgspec import Struct

from lfield.lang import syntax, tree
from lfield.text.source_text import Diagnostic, Source

#: The methods that every offer has. The other public methods of a capability's class are its portals.
OFFER_METHODS = frozenset(
    {"agent", "host", "way", "score", "has", "attribute", "text", "age", "source", "found", "note"}
)

Verb = Literal["find", "explain", "teams"]
VERBS: tuple[Verb, ...] = ("find", "explain", "teams")


class ConstraintProblem(Protocol):
    """A mistake in a constraint: its characters from `start` to `end`."""

    @property
    def start(self) -> int:
        """The first character."""

    @property
    def end(self) -> int:
        """The character after the last."""

    @property
    def message(self) -> str:
        """The message, a sentence."""

    @property
    def hint(self) -> str:
        """The correct form, or ''."""


#: The sort of the value of a placeholder in a query; 'nothing' for one that is already reported.
PlaceholderSort = Literal["number", "text", "boolean", "nothing"]


class Placeholder(Struct, frozen=True):
    """`$kg` or `$at[0].north` in a query: characters `start` to `end` of it."""

    path: str
    start: int
    end: int


class QueryPlaceholders(Struct, frozen=True):
    """The placeholders of a query, and those within quotes; or the mistakes in it."""

    placeholders: tuple[Placeholder, ...] = ()
    quoted: tuple[Placeholder, ...] = ()
    mistakes: tuple[ConstraintProblem, ...] = ()


class PlaceholderValue(Struct, frozen=True):
    """A value that a query needs: that of a path, times the factor plus the offset."""

    path: str
    factor: float
    offset: float


class CompiledQuery(Struct, frozen=True):
    """A query with numbers for its placeholders, and their values in this order; or the mistakes."""

    text: str = ""
    values: tuple[PlaceholderValue, ...] = ()
    mistakes: tuple[ConstraintProblem, ...] = ()


class GeneratedClasses(Struct, frozen=True):
    """The classes of capabilities: their texts by name, and their common texts and files.

    `common` are texts that all of them need, `files` hold the classes that put several resources together.
    """

    classes: dict[str, Source]
    common: tuple[Source, ...] = ()
    files: tuple[Path, ...] = ()


class CapabilityTypes(Protocol):
    """A registry for the front end. Used only when a program has an unknown name."""

    def names(self) -> Collection[str]:
        """The capabilities that can be called."""

    def generate(self, expected: Collection[str], files: Sequence[syntax.ParsedFile]) -> GeneratedClasses:
        """The classes of these capabilities and of those they refer to, for a program of these files.

        A capability with the name of a unit of the program is left out.
        """

    def registry_problems(
        self, used: Collection[str], files: Sequence[syntax.ParsedFile]
    ) -> Sequence[Diagnostic]:
        """The mistakes of a registry in relation to a program that uses these, for instance a missing
        portal.
        """

    def mistakes(self, constraint: str) -> Sequence[ConstraintProblem]:
        """The mistakes in the text of a condition over attributes."""

    def placeholders(self, text: str) -> QueryPlaceholders:
        """The placeholders in the text of a condition."""

    def compile_query(self, text: str, sorts: Mapping[str, PlaceholderSort]) -> CompiledQuery:
        """A condition whose placeholders have values of these sorts, by path."""


def is_portal(method: tree.Method) -> bool:
    """Whether a method represents a portal of an offer: a call goes to the resource that serves it."""
    return method.unit.capability and method.public and method.name not in OFFER_METHODS


def parse_query_name(name: str) -> tuple[Verb, str] | None:
    """The verb and the name of the capability, if `name` may be that of a query: `findLift`."""
    for verb in VERBS:
        capability = name.removeprefix(verb)
        if capability != name and capability[:1].isupper():
            return verb, capability
    return None


def unknown_names(files: Sequence[syntax.ParsedFile], known: Collection[str]) -> set[str]:
    """The names of types and queries in some files that are neither known nor declared there."""
    units = [unit for file in files for unit in file.units]
    methods = {method.name for unit in units for method in unit.methods}
    methods.update(function.name for file in files for function in file.functions)
    enums = {enum.name for file in files for enum in file.enums}
    named = {name for file in files for name in file.types}
    queries = (parse_query_name(name) for file in files for name in file.called - methods)
    named.update(query[1] for query in queries if query is not None)
    return named - {unit.name for unit in units} - enums - set(known)
