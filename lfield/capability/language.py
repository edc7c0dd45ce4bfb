"""The registry as the compiler's front end sees it: capabilities are types of L (lang.capabilities)."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from functools import cached_property

from lfield.capability import expression
from lfield.capability.expression import Mistake, Scope
from lfield.capability.generate import Served, class_text, prelude
from lfield.capability.model import Provider, Registry
from lfield.capability.program_check import check_against, check_classes
from lfield.capability.shipped import shipped
from lfield.capability.signatures import Signature, signatures_of
from lfield.lang import syntax
from lfield.lang.capabilities import Generated
from lfield.source import Diagnostic, Diagnostics, Source


class RegistryTypes:
    """The capabilities of a registry that is read when the first of them is asked for.

    Reading raises what `read` raises, ProgramError for one.
    """

    def __init__(self, read: Callable[[], Registry]) -> None:
        self._read = read

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
        found = Diagnostics()
        registry, served = self.registry, _served(self.registry, files)
        rules = {rule.name: rule for name in used for rule in served.compositions(name)}
        signatures = signatures_of(files)
        check_against(_fitting(registry, signatures), signatures, found)
        check_classes(replace(registry, compositions=rules), found)
        return found.in_order()

    def mistakes(self, constraint: str) -> Sequence[Mistake]:
        """What is wrong with the text of a condition over attributes."""
        parsed, found = expression.parse(constraint)
        if parsed is None:
            return found
        return expression.check(parsed, Scope.of_offer(self.registry.attributes), "boolean")


def _served(registry: Registry, files: Sequence[syntax.File]) -> Served:
    units = [unit for file in files for unit in file.units]
    resources = {unit.name for unit in units if unit.kind == "resource"}
    return Served(_fitting(registry, signatures_of(files)), resources, {unit.name for unit in units})


def _fitting(registry: Registry, signatures: Mapping[str, Signature]) -> Registry:
    """The registry without what its shipped part says wrongly of the program's resources.

    A program may have a Winch of its own that is none of ours; only a mission's own file must fit.
    """
    ours = {str(path) for path in shipped()}
    providers = {
        name: _fitting_provider(registry, provider, signatures, ours)
        for name, provider in registry.providers.items()
        if provider.type in signatures
    }
    return replace(registry, providers={**registry.providers, **providers})


def _fitting_provider(
    registry: Registry, provider: Provider, signatures: Mapping[str, Signature], ours: Collection[str]
) -> Provider:
    serves = {}
    for name, served in provider.serves.items():
        alone = replace(provider, serves={name: served})
        found = Diagnostics()
        check_against(replace(registry, providers={provider.type: alone}), signatures, found)
        if served.span.source.name not in ours or not found.found:
            serves[name] = served
    return replace(provider, serves=serves)
