"""A registry while it is read: the parts so far, and the functions that the reader of every section needs."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import TypeVar

from msgspec import Struct, field
from msgspec.structs import replace

from lfield.capability.model import (
    Attribute,
    Composition,
    Equivalence,
    Primitive,
    Provider,
    TaxonomyTerm,
    Value,
    Weights,
)
from lfield.capability.registry_reader import messages
from lfield.lang.scanner import KEYWORDS
from lfield.text.message_tables import FindingKind
from lfield.text.source_text import Diagnostics, Span
from lfield.text.suggestions import did_you_mean, listed
from lfield.text.yaml_fields import YamlFields
from lfield.text.yaml_source import YamlEntry

#: Most entries that one section of a registry may have, all files together.
MAX_ENTRIES = 5000

#: Longest name in a registry, in characters.
MAX_NAME = 80

#: Dotted, as in the taxonomy; a name in L that begins small, one as L has it; a type in L; a rule, a need, an
#: agent.
DOTTED = re.compile(r"[a-z][a-z0-9_]*(\.[a-z][a-z0-9_]*)*")
NAME = re.compile(r"[a-z][A-Za-z0-9_]*")
PORTAL = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
TYPE_NAME = re.compile(r"[A-Z][A-Za-z0-9]*")
RULE = re.compile(r"[a-z][a-z0-9]*(-[a-z0-9]+)*")

_EXAMPLES = {
    DOTTED: "skill.security.sentry",
    NAME: "goTo",
    PORTAL: "goTo",
    TYPE_NAME: "GoTo",
    RULE: "grip-and-climb",
}


D = TypeVar("D", Attribute, Primitive)


class RegistryFile(Struct, frozen=True):
    """One file of a registry; that of a mission may override the others."""

    path: Path
    top: YamlFields
    mission: bool


class RegistryBuilder(Struct):
    """The parts read so far, section by section: a section may refer to those that were read before it.

    `aliases` are the other ids of terms, and the ids out of use, each with the present id.
    """

    files: tuple[RegistryFile, ...]
    found: Diagnostics
    terms: dict[str, TaxonomyTerm] = field(default_factory=dict)
    aliases: dict[str, str] = field(default_factory=dict)
    attributes: dict[str, Attribute] = field(default_factory=dict)
    primitives: dict[str, Primitive] = field(default_factory=dict)
    providers: dict[str, Provider] = field(default_factory=dict)
    equivalences: dict[str, Equivalence] = field(default_factory=dict)
    compositions: dict[str, Composition] = field(default_factory=dict)
    agents: dict[str, dict[str, Value]] = field(default_factory=dict)
    weights: Weights = field(default_factory=Weights)
    version: int = 0

    def report(self, message: FindingKind, span: Span, *, hint: str | None = None, **values: object) -> None:
        """Add a finding."""
        self.found.add(message.at(span, hint=hint, **values))

    def set_weights(self, weights: Weights) -> None:
        """Replace the weights by those of a later file."""
        self.weights = weights

    def require_version(self, version: int) -> None:
        """Raise the version of the taxonomy to that of a file."""
        self.version = max(self.version, version)

    def entries(self, section: str) -> Iterator[tuple[RegistryFile, YamlEntry, YamlFields]]:
        """The entries of a section in all files, in their order, up to MAX_ENTRIES."""
        count = 0
        for file in self.files:
            for entry, fields in file.top.section(section).entries():
                count += 1
                if count > MAX_ENTRIES:
                    self.report(messages.TOO_MANY, entry.key_span, limit=MAX_ENTRIES, what=section)
                    return
                yield file, entry, fields

    def check_name(self, name: str, pattern: re.Pattern[str], kind: str, span: Span) -> None:
        """Report a name that is invalid or reserved in L."""
        if len(name) > MAX_NAME or not pattern.fullmatch(name):
            excerpt = name if len(name) <= MAX_NAME else f"{name[:MAX_NAME]}..."
            self.report(messages.BAD_NAME, span, name=excerpt, what=kind, example=_EXAMPLES[pattern])
        elif pattern in (NAME, PORTAL) and name in KEYWORDS:
            self.report(messages.KEYWORD, span, name=name, what=kind)

    def report_duplicate(self, kind: str, name: str, span: Span, first: Span) -> None:
        """Report a second definition of the same name."""
        self.report(messages.DUPLICATE, span, what=kind, name=name, file=first.source.name, line=first.line)

    def report_redefinition(self, kind: str, name: str, span: Span, first: Span) -> None:
        """Report a mission that gives a name of the registry another meaning."""
        self.report(messages.REDEFINED, span, what=kind, name=name, file=first.source.name, line=first.line)

    def define(self, known: dict[str, D], definition: D, kind: str, *, mission: bool) -> None:
        """Add an attribute or a primitive; a mission may repeat a shipped one, but not change it."""
        first = known.get(definition.name)
        if first is None:
            known[definition.name] = definition
        elif not mission:
            self.report_duplicate(kind, definition.name, definition.span, first.span)
        elif replace(definition, span=first.span, meaning=first.meaning) != first:
            self.report_redefinition(kind, definition.name, definition.span, first.span)

    def report_unknown_portal(self, primitive: Primitive, name: str, span: Span) -> None:
        """Report a portal that a primitive does not have."""
        known = primitive.portals
        self.report(
            messages.NOT_ITS_PORTAL,
            span,
            hint=self.similar_name(name, known),
            primitive=primitive.name,
            name=name,
            portals=listed(known),
        )

    def similar_name(self, name: str, known: Collection[str]) -> str | None:
        """`did you mean 'x'?`, or None when no name is similar."""
        return did_you_mean(name[:MAX_NAME], known)

    def term(self, id: str, span: Span) -> str:
        """The canonical id of a mentioned term, '' for an unknown one."""
        if id in self.terms and not self.terms[id].deprecated:
            return id
        if id in self.aliases:
            if id in self.terms:
                self.report(messages.DEPRECATED_TERM, span, id=id, instead=self.aliases[id])
            return self.aliases[id]
        self.report(
            messages.UNKNOWN_TERM, span, hint=self.similar_name(id, (*self.terms, *self.aliases)), id=id
        )
        return ""

    def attribute(self, name: str, span: Span) -> Attribute | None:
        """A mentioned attribute, None if unknown."""
        attribute = self.attributes.get(name)
        if attribute is None:
            self.report(
                messages.UNKNOWN_ATTRIBUTE, span, hint=self.similar_name(name, self.attributes), name=name
            )
        return attribute

    def primitive(self, name: str, span: Span) -> Primitive | None:
        """A mentioned primitive, None if unknown."""
        primitive = self.primitives.get(name)
        if primitive is None and name:
            self.report(
                messages.UNKNOWN_PRIMITIVE, span, hint=self.similar_name(name, self.primitives), name=name
            )
        return primitive
