"""The registry as the compiler's front end sees it: capabilities are types of L (lang.capabilities)."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path

from lfield.capability.condition import Mistake
from lfield.capability.matching import expression
from lfield.capability.matching.expression import Scope
from lfield.capability.model import Provider, Registry
from lfield.capability.reading.reader import is_shipped
from lfield.capability.reading.signatures import signatures_of
from lfield.capability.types.generate import Served, class_text, prelude
from lfield.capability.types.program_check import check_against, check_classes
from lfield.lang import syntax
from lfield.lang.capabilities import Generated
from lfield.text.source import Diagnostic, Diagnostics, Source, Span


class RegistryTypes:
    """The capabilities of a registry that is read when the first of them is asked for.

    Reading raises what `read` raises, ProgramError for one. `own` is the file with what a mission adds.
    """

    def __init__(self, read: Callable[[], Registry], *, own: Path | None = None) -> None:
        self._read, self.own = read, own

    @cached_property
    def registry(self) -> Registry:
        """The registry."""
        return self._read()

    def names(self) -> Collection[str]:
        """The capabilities that can be called."""
        return self.registry.primitives.keys()

    def generate(self, wanted: Collection[str], files: Sequence[syntax.File]) -> Generated:
        """The classes of some capabilities and of all they refer to, for a program of these files."""
        served = _served(self.registry, files)
        names = served.reached(wanted)
        rules = [rule for name in names for rule in served.compositions(name)]
        return Generated(
            {name: Source(f"{name}.L", class_text(served, name)) for name in names},
            common=(prelude(),),
            files=tuple(dict.fromkeys(rule.source for rule in rules)),
        )

    def misfits(self, used: Collection[str], files: Sequence[syntax.File]) -> Sequence[Diagnostic]:
        """Where a mission's registry does not fit the units of its program, or the classes of rules."""
        served = _served(self.registry, files)
        rules = {rule.name: rule for name in used for rule in served.compositions(name)}
        found = Diagnostics()
        check_classes(replace(self.registry, compositions=rules), found)
        told = (d for d in _misfits(self.registry, files) if not is_shipped(d))
        return [*told, *found.in_order()]

    def mistakes(self, constraint: str) -> Sequence[Mistake]:
        """What is wrong with the text of a condition over attributes."""
        parsed, found = expression.parse(constraint)
        if parsed is None:
            return found
        return expression.check(parsed, Scope.of_offer(self.registry.attributes), "boolean")


def _served(registry: Registry, files: Sequence[syntax.File]) -> Served:
    """The ways that a program can have, by what fits of the registry.

    A program may have a Winch of its own that is none of ours: what the registry that we ship says wrongly
    of its resources does not count. Only a mission's own file must fit.
    """
    units = [unit for file in files for unit in file.units]
    resources = {unit.name for unit in units if unit.kind == "resource"}
    wrong = {d.span for d in _misfits(registry, files) if is_shipped(d)}
    if wrong:
        providers = {name: _without(provider, wrong) for name, provider in registry.providers.items()}
        registry = replace(registry, providers=providers)
    return Served(registry, resources, {unit.name for unit in units})


def _misfits(registry: Registry, files: Sequence[syntax.File]) -> list[Diagnostic]:
    """What providers promise wrongly of the resources of a program."""
    found = Diagnostics()
    check_against(registry, signatures_of(files), found)
    return found.in_order()


def _without(provider: Provider, wrong: Collection[Span]) -> Provider:
    """A provider without what it serves by portals with these spans."""
    serves = {
        name: served
        for name, served in provider.serves.items()
        if not any(mapped.span in wrong for mapped in served.portals.values())
    }
    return replace(provider, serves=serves)
