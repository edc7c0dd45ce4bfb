"""Reads a registry: files in, one checked `Registry` or every mistake in any of them out.

A file of a registry is YAML with any of these sections, each described in the module that reads it:

    registry: 1         the version of the format; every file has it
    taxonomy            taxonomy.py             terms as a tree, and its version
    attributes, ranking attributes.py           the attributes of offers, and their weights
    primitives          primitives.py           the primitives and their portals
    providers, agents   providers.py            resource types and their primitives; values of single agents
    equivalences        rules.py                which primitives substitute for others

Sections refer to those above them, in any file. All files are equal, and a name is defined once; only a
mission's own file, `NAME.capabilities.yaml` in the folder of `NAME.dL`, may override others.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path

from msgspec import Struct
from msgspec.structs import replace

import lfield
from lfield.capability.model import Composition, Expression, Registry, TaxonomyTerm
from lfield.capability.registry_reader import messages
from lfield.capability.registry_reader.attributes import read_attributes, read_ranking
from lfield.capability.registry_reader.primitives import read_primitives
from lfield.capability.registry_reader.providers import read_agents, read_providers
from lfield.capability.registry_reader.registry_builder import RegistryBuilder, RegistryFile
from lfield.capability.registry_reader.rule_checks import check_cycles, check_ways
from lfield.capability.registry_reader.rule_reader import read_rules, subsumptions
from lfield.capability.registry_reader.taxonomy_reader import read_taxonomy
from lfield.errors import ProgramError
from lfield.text.source_text import Diagnostic, Diagnostics
from lfield.text.yaml_fields import YamlFields
from lfield.text.yaml_source import YamlScalar, read

#: The registry file of a driver's package, in the parent of its folder `L`, for the resource types in that
#: folder.
DRIVER_FILE = "capabilities.yaml"

#: The version of the format.
VERSION = 1

#: Fields that do not affect any answer.
_IGNORED = frozenset({"span", "meaning", "digest", "constraints"})
#: Not part of the digest: names and meanings of terms, and the paths of class sources, which differ between
#: hosts.
_IGNORED_OF = {TaxonomyTerm: _IGNORED | {"name"}, Composition: _IGNORED | {"source"}}


def read_registry(
    files: Sequence[Path] | None = None,
    *,
    mission: Path | None = None,
    agents: Collection[str] | None = None,
    libraries: Sequence[Path] = (),
) -> Registry:
    """The registry in some files, those that come with lfield when none are given, and in a mission's own.

    `agents` are the agents of the deployment, `libraries` the files of installed drivers. Raises ProgramError
    with all mistakes in all files, and InputFileError for a file that cannot be read.
    """
    registry, found = check_files(files, mission=mission, agents=agents, libraries=libraries)
    if registry is None:
        raise ProgramError([d for d in found if d.severity == "error"])
    return registry


def check_files(
    files: Sequence[Path] | None = None,
    *,
    mission: Path | None = None,
    agents: Collection[str] | None = None,
    libraries: Sequence[Path] = (),
) -> tuple[Registry | None, list[Diagnostic]]:
    """The registry, None when there are errors, and all findings with warnings; as `read_registry`."""
    found = Diagnostics()
    paths = [(path, False) for path in (*(shipped() if files is None else files), *libraries)]
    if mission is not None:
        paths.append((mission, True))
    opened = (_open(path, is_mission, found) for path, is_mission in paths)
    builder = RegistryBuilder(tuple(file for file in opened if file is not None), found)
    _read_sections(builder, agents)
    return (None if found.errors else _registry(builder)), found.in_order()


def _open(path: Path, mission: bool, found: Diagnostics) -> RegistryFile | None:
    """A file with its version checked; None when it is not YAML."""
    node = read(str(path), found)
    if node is None:
        return None
    top = YamlFields(node, found, "a registry")
    version = top.node("registry")
    if not isinstance(version, YamlScalar) or (type(version.value), version.value) != (int, VERSION):
        found.add(messages.VERSION.at(version.span if version is not None else top.span))
    return RegistryFile(path, top, mission)


def _read_sections(builder: RegistryBuilder, agents: Collection[str] | None) -> None:
    """All sections in the order in which they refer to one another."""
    read_taxonomy(builder)
    read_attributes(builder)
    read_primitives(builder)
    read_providers(builder)
    read_rules(builder)
    read_agents(builder, agents)
    read_ranking(builder)
    for file in builder.files:
        file.top.report_unread()
    builder.equivalences.update(subsumptions(builder.primitives))
    check_cycles(builder)
    check_ways(builder)


def _registry(builder: RegistryBuilder) -> Registry:
    registry = Registry(
        terms=builder.terms,
        attributes=builder.attributes,
        primitives=builder.primitives,
        providers=builder.providers,
        equivalences=builder.equivalences,
        compositions=builder.compositions,
        agents=builder.agents,
        weights=builder.weights,
        version=builder.version,
    )
    return replace(registry, digest=digest(registry))


# --- the registry that comes with lfield ---------------------------------------------------------------


def shipped_folder() -> Path:
    """The folder of the registry files; their classes in L are in its folder `L`."""
    package = Path(lfield.__file__).resolve().parent
    installed = package / "registry"
    return installed if installed.is_dir() else package.parent / "capabilities"


def is_shipped(finding: Diagnostic) -> bool:
    """Whether a finding is about a file that comes with lfield or with a driver."""
    path = Path(finding.span.source.name)
    return path.parent == shipped_folder() or path.name == DRIVER_FILE


def shipped() -> list[Path]:
    """The files of the registry that comes with lfield, by name."""
    return sorted(shipped_folder().glob("*.yaml"))


# --- the digest ----------------------------------------------------------------------------------------


def digest(registry: Registry) -> bytes:
    """SHA-256 over the registry: the same on every host whose registry gives the same answers.

    Comments, meanings, places, paths and the order of files do not count.
    """
    text = json.dumps(_canonical(registry), sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).digest()


def _canonical(value: object) -> object:
    """A value as JSON has it. Mappings are sorted later; of needs the order counts, as in arguments."""
    if isinstance(value, Expression):
        return value.text
    if isinstance(value, Composition):
        return [list(value.needs), _record(value)]
    if isinstance(value, Struct):
        return _record(value)
    if isinstance(value, Mapping):
        return {key: _canonical(item) for key, item in value.items()}
    if isinstance(value, frozenset):
        return sorted(value)
    return [_canonical(item) for item in value] if isinstance(value, tuple) else value


def _record(value: Struct) -> dict[str, object]:
    ignored = _IGNORED_OF.get(type(value), _IGNORED)
    names = (name for name in value.__struct_fields__ if name not in ignored)
    return {name: _canonical(getattr(value, name)) for name in names}
