"""The registry for the front end of the compiler: capabilities are types of L (lang.capability_port)."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from functools import cached_property
from pathlib import Path

from msgspec.structs import replace

from lfield.capability.condition_compiler import read_query
from lfield.capability.condition_tree import Mistake
from lfield.capability.model import Registry
from lfield.capability.program_types.class_generator import UsableRealisations, class_text, prelude
from lfield.capability.program_types.program_check import check_against, check_classes, satisfied
from lfield.capability.program_types.query_compiler import numbered_query, read_placeholders
from lfield.capability.registry_reader.registry_files import is_shipped
from lfield.capability.registry_reader.unit_signatures import Signature, signatures_of
from lfield.lang import syntax
from lfield.lang.capability_port import CompiledQuery, GeneratedClasses, PlaceholderSort, QueryPlaceholders
from lfield.text.source_text import Diagnostic, Diagnostics, Source


class RegistryTypes:
    """The capabilities of a registry that is read at the first look-up.

    Reading raises the exceptions of `read`, such as ProgramError. `own` is the file with the additions of a
    mission.
    """

    def __init__(self, read: Callable[[], Registry], *, own: Path | None = None) -> None:
        self._read, self.own = read, own

    @cached_property
    def registry(self) -> Registry:
        return self._read()

    def names(self) -> Collection[str]:
        """The capabilities that can be called."""
        return self.registry.primitives.keys()

    def generate(self, requested: Collection[str], files: Sequence[syntax.ParsedFile]) -> GeneratedClasses:
        """The classes of some capabilities and of all they refer to, for a program of these files."""
        served = _served(self.registry, signatures_of(files))
        names = served.reached(requested)
        rules = [rule for name in names for rule in served.compositions(name)]
        return GeneratedClasses(
            {name: Source(f"{name}.L", class_text(served, name)) for name in names},
            common=(prelude(),),
            files=tuple(dict.fromkeys(rule.source for rule in rules)),
        )

    def registry_problems(
        self, used: Collection[str], files: Sequence[syntax.ParsedFile]
    ) -> Sequence[Diagnostic]:
        """The mistakes of a mission's registry in relation to the units of its program, or the classes of
        rules.
        """
        units, found = signatures_of(files), Diagnostics()
        served = _served(self.registry, units)
        rules = {rule.name: rule for name in used for rule in served.compositions(name)}
        check_against(self.registry, units, found)
        promised = [mistake for mistake in found.found if not is_shipped(mistake)]
        of_rules = Diagnostics()
        check_classes(replace(self.registry, compositions=rules), of_rules)
        return [*promised, *of_rules.found]

    def mistakes(self, constraint: str) -> Sequence[Mistake]:
        """The mistakes in the text of a condition over attributes."""
        return read_query(constraint, self.registry.attributes)[1]

    def placeholders(self, text: str) -> QueryPlaceholders:
        """The placeholders in the text of a condition."""
        return read_placeholders(text)

    def compile_query(self, text: str, sorts: Mapping[str, PlaceholderSort]) -> CompiledQuery:
        """A condition whose placeholders have values of these sorts, by path."""
        return numbered_query(text, sorts, self.registry.attributes)


def _served(registry: Registry, units: Mapping[str, Signature]) -> UsableRealisations:
    """The realisations that a program with these units can have."""
    resources = {name for name, unit in units.items() if unit.kind == "resource"}
    return UsableRealisations(satisfied(registry, units), resources, units.keys())
