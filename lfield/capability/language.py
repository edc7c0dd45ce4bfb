"""The registry as the compiler's front end sees it: capabilities are types of L (lang.capabilities)."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from functools import cached_property

from lfield.capability import expression
from lfield.capability.expression import Mistake, Scope
from lfield.capability.generate import Served, class_text, prelude
from lfield.capability.model import Registry
from lfield.lang import syntax
from lfield.lang.capabilities import Generated
from lfield.source import Diagnostic, Source


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
        units = [unit for file in files for unit in file.units]
        resources = {unit.name for unit in units if unit.kind == "resource"}
        served = Served(self.registry, resources, {unit.name for unit in units})
        names = served.reached(wanted)
        rules = [rule for name in names for rule in served.compositions(name)]
        return Generated(
            {name: Source(f"{name}.L", class_text(served, name)) for name in names},
            common=(prelude(),),
            files=tuple(dict.fromkeys(rule.source for rule in rules)),
        )

    def misfits(self, files: Sequence[syntax.File]) -> Sequence[Diagnostic]:
        """Where the registry does not fit the units of a program."""
        return []

    def mistakes(self, constraint: str) -> Sequence[Mistake]:
        """What is wrong with the text of a condition over attributes."""
        parsed, found = expression.parse(constraint)
        if parsed is None:
            return found
        return expression.check(parsed, Scope.of_offer(self.registry.attributes), "boolean")
