"""The section `taxonomy`: terms with dotted ids, aliases, and deprecated terms.

```yaml
taxonomy_version: 1
taxonomy:
  skill: {name: Skill, meaning: behaviours that interact with the environment}
  skill.lifting: {meaning: raises a load, aliases: [skill.raising]}
  skill.hoisting: {meaning: an older name, deprecated: skill.lifting}
```
A mission may add terms, add aliases to built-in ones, or deprecate them. The version grows with every change
of the built-in taxonomy; an id is never removed, it becomes an alias or deprecated. So a file for some
version can be read with every later one; `taxonomy_version` is the least version that it needs.
"""

from __future__ import annotations

from msgspec.structs import replace

from lfield.capability.model import TaxonomyTerm
from lfield.capability.registry_reader import messages
from lfield.capability.registry_reader.registry_builder import DOTTED, RegistryBuilder
from lfield.text.source_text import Span
from lfield.text.yaml_fields import YamlFields
from lfield.text.yaml_source import YamlEntry


def read_taxonomy(builder: RegistryBuilder) -> None:
    """The version, all terms of all files, then the references between them."""
    _read_version(builder)
    replacements: dict[str, Span] = {}
    alias_spans: dict[tuple[str, str], Span] = {}
    for file, entry, fields in builder.entries("taxonomy"):
        term = _term(builder, entry, fields)
        first = builder.terms.get(term.id)
        if first is not None and not file.mission:
            builder.report_duplicate("the term", term.id, entry.key_span, first.span)
            continue
        if term.deprecated:
            replacements[term.id] = fields.value_span("deprecated")
        for alias in term.aliases:
            alias_spans[term.id, alias] = fields.value_span("aliases")
        builder.terms[term.id] = term if first is None else _joined(first, term)
    _check_parents(builder)
    _resolve_aliases(builder, alias_spans)
    _resolve_replacements(builder, replacements)


def _read_version(builder: RegistryBuilder) -> None:
    """Read the version of the taxonomy: a mission's file names the version it was written for."""
    for file in sorted(builder.files, key=lambda file: file.mission):
        required = file.top.integer("taxonomy_version", minimum=1, maximum=1_000_000)
        if not file.mission:
            builder.require_version(required)
        elif required > builder.version:
            span = file.top.value_span("taxonomy_version")
            builder.report(messages.TAXONOMY_VERSION, span, expected=required, version=builder.version)


def _term(builder: RegistryBuilder, entry: YamlEntry, fields: YamlFields) -> TaxonomyTerm:
    builder.check_name(entry.key, DOTTED, "a term", entry.key_span)
    term = TaxonomyTerm(
        id=entry.key,
        name=fields.text("name"),
        meaning=fields.text("meaning"),
        span=entry.key_span,
        aliases=fields.texts("aliases"),
        deprecated=fields.text("deprecated"),
    )
    fields.report_unread()
    for alias in term.aliases:
        builder.check_name(alias, DOTTED, "a term", fields.value_span("aliases"))
    return term


def _joined(shipped: TaxonomyTerm, mission: TaxonomyTerm) -> TaxonomyTerm:
    """A term with the additions of a mission."""
    return replace(
        shipped,
        name=mission.name or shipped.name,
        meaning=mission.meaning or shipped.meaning,
        aliases=tuple(dict.fromkeys((*shipped.aliases, *mission.aliases))),
        deprecated=mission.deprecated or shipped.deprecated,
    )


def _check_parents(builder: RegistryBuilder) -> None:
    for term in builder.terms.values():
        parent = term.id.rpartition(".")[0]
        if parent and parent not in builder.terms:
            hint = builder.similar_name(parent, builder.terms)
            builder.report(messages.NO_PARENT, term.span, hint=hint, id=term.id, parent=parent)


def _resolve_aliases(builder: RegistryBuilder, spans: dict[tuple[str, str], Span]) -> None:
    for term in builder.terms.values():
        for alias in term.aliases:
            in_use_by = alias if alias in builder.terms else builder.aliases.get(alias)
            if in_use_by is not None:
                builder.report(messages.ALIAS_IN_USE, spans[term.id, alias], alias=alias, id=in_use_by)
            else:
                builder.aliases[alias] = term.id


def _resolve_replacements(builder: RegistryBuilder, spans: dict[str, Span]) -> None:
    """Resolve the replacements of terms out of use; an id out of use leads there from now on."""
    for id, span in spans.items():
        term = builder.terms[id]
        instead = builder.aliases.get(term.deprecated, term.deprecated)
        if instead not in builder.terms:
            hint = builder.similar_name(instead, builder.terms)
            builder.report(messages.UNKNOWN_TERM, span, hint=hint, id=term.deprecated)
        elif builder.terms[instead].deprecated:
            builder.report(messages.DEPRECATED_BY_DEPRECATED, span, id=term.deprecated)
        builder.terms[id] = replace(term, deprecated=instead)
    for id in spans:
        builder.aliases[id] = builder.terms[id].deprecated
    for alias, id in builder.aliases.items():
        if id in spans:
            builder.aliases[alias] = builder.terms[id].deprecated
