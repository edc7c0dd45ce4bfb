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


def read_taxonomy(draft: RegistryBuilder) -> None:
    """The version, all terms of all files, then the references between them."""
    _read_version(draft)
    replacements: dict[str, Span] = {}
    alias_spans: dict[tuple[str, str], Span] = {}
    for file, entry, fields in draft.entries("taxonomy"):
        term = _term(draft, entry, fields)
        first = draft.terms.get(term.id)
        if first is not None and not file.mission:
            draft.report_duplicate("the term", term.id, entry.key_span, first.span)
            continue
        if term.deprecated:
            replacements[term.id] = fields.value_span("deprecated")
        for alias in term.aliases:
            alias_spans[term.id, alias] = fields.value_span("aliases")
        draft.terms[term.id] = term if first is None else _joined(first, term)
    _check_parents(draft)
    _resolve_aliases(draft, alias_spans)
    _resolve_replacements(draft, replacements)


def _read_version(draft: RegistryBuilder) -> None:
    """Read the version of the taxonomy: a mission's file names the version it was written for."""
    for file in sorted(draft.files, key=lambda file: file.mission):
        required = file.top.integer("taxonomy_version", minimum=1, maximum=1_000_000)
        if not file.mission:
            draft.require_version(required)
        elif required > draft.version:
            span = file.top.value_span("taxonomy_version")
            draft.report(messages.TAXONOMY_VERSION, span, expected=required, version=draft.version)


def _term(draft: RegistryBuilder, entry: YamlEntry, fields: YamlFields) -> TaxonomyTerm:
    draft.check_name(entry.key, DOTTED, "a term", entry.key_span)
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
        draft.check_name(alias, DOTTED, "a term", fields.value_span("aliases"))
    return term


def _joined(ours: TaxonomyTerm, mission: TaxonomyTerm) -> TaxonomyTerm:
    """A term with the additions of a mission."""
    return replace(
        ours,
        name=mission.name or ours.name,
        meaning=mission.meaning or ours.meaning,
        aliases=tuple(dict.fromkeys((*ours.aliases, *mission.aliases))),
        deprecated=mission.deprecated or ours.deprecated,
    )


def _check_parents(draft: RegistryBuilder) -> None:
    for term in draft.terms.values():
        parent = term.id.rpartition(".")[0]
        if parent and parent not in draft.terms:
            hint = draft.similar_name(parent, draft.terms)
            draft.report(messages.NO_PARENT, term.span, hint=hint, id=term.id, parent=parent)


def _resolve_aliases(draft: RegistryBuilder, spans: dict[tuple[str, str], Span]) -> None:
    for term in draft.terms.values():
        for alias in term.aliases:
            in_use_by = alias if alias in draft.terms else draft.aliases.get(alias)
            if in_use_by is not None:
                draft.report(messages.ALIAS_IN_USE, spans[term.id, alias], alias=alias, id=in_use_by)
            else:
                draft.aliases[alias] = term.id


def _resolve_replacements(draft: RegistryBuilder, spans: dict[str, Span]) -> None:
    """Resolve the replacements of terms out of use; an id out of use leads there from now on."""
    for id, span in spans.items():
        term = draft.terms[id]
        instead = draft.aliases.get(term.deprecated, term.deprecated)
        if instead not in draft.terms:
            hint = draft.similar_name(instead, draft.terms)
            draft.report(messages.UNKNOWN_TERM, span, hint=hint, id=term.deprecated)
        elif draft.terms[instead].deprecated:
            draft.report(messages.DEPRECATED_BY_DEPRECATED, span, id=term.deprecated)
        draft.terms[id] = replace(term, deprecated=instead)
    for id in spans:
        draft.aliases[id] = draft.terms[id].deprecated
    for alias, id in draft.aliases.items():
        if id in spans:
            draft.aliases[alias] = draft.terms[id].deprecated
