"""The taxonomy for people: the term of an id, the primitives that can be called there, and the tree of
terms.
"""

from __future__ import annotations

from msgspec import Struct

from lfield.capability.model import Primitive, Registry, TaxonomyTerm
from lfield.text.suggestions import did_you_mean


class TreeBranch(Struct, frozen=True):
    """A line of a tree with the lines below it. `mark` is the L type of a primitive that can be called."""

    text: str
    children: tuple[TreeBranch, ...] = ()
    mark: str = ""


def term_of(registry: Registry, id: str) -> TaxonomyTerm | None:
    """The term of an id. Aliases and ids out of use lead to the present one."""
    term = registry.terms.get(id)
    if term is None:
        term = next((t for t in registry.terms.values() if id in t.aliases), None)
    return registry.terms[term.deprecated] if term is not None and term.deprecated else term


def primitives_of(registry: Registry, term: str) -> list[str]:
    """The primitives that can be called at a term."""
    return sorted(p.name for p in registry.primitives.values() if p.id == term)


def primitives_below(registry: Registry, id: str) -> list[Primitive]:
    """The primitives that can be called at a term or below it, in the order of their ids and names."""
    found = [p for p in registry.primitives.values() if f"{p.id}.".startswith(f"{id}.")]
    return sorted(found, key=lambda p: (p.id, p.name))


def terms_below(registry: Registry, id: str) -> list[TaxonomyTerm]:
    """The terms whose parent is a term; with '' those without a parent."""
    return [term for term in registry.terms.values() if term.id.rpartition(".")[0] == id]


def unknown_name(registry: Registry, unknown: str) -> str:
    """A hint about a name that the registry does not contain."""
    known = (
        registry.terms,
        registry.primitives,
        registry.attributes,
        registry.providers,
        registry.equivalences,
        registry.compositions,
    )
    hint = did_you_mean(unknown[:80], [name for names in known for name in names])
    return hint or "'lfield capabilities tree' lists all terms"


def tree(registry: Registry, id: str = "") -> list[TreeBranch]:
    """The taxonomy, or the part below one of its terms; deprecated terms name their replacement."""
    roots = [registry.terms[id]] if id else terms_below(registry, "")
    return [_branch(registry, term, term.id) for term in roots]


def _branch(registry: Registry, term: TaxonomyTerm, name: str) -> TreeBranch:
    description = f"out of use, write {term.deprecated}" if term.deprecated else term.meaning
    below = terms_below(registry, term.id)
    children = tuple(_branch(registry, child, child.id.rpartition(".")[2]) for child in below)
    return TreeBranch(
        f"{name}: {description}" if description else name,
        children,
        ", ".join(primitives_of(registry, term.id)),
    )
