"""Specs of the ROS package `capabilities` (spec_version 1) as entries of a registry.

    interface            a term below `skill`, and a primitive when any of its services can be a portal
    semantic interface   a term below that of the interface it redefines, and a primitive with its portals,
                         so that whoever serves the special one serves the general one
    provider             a resource type that serves the primitive of what it implements

A ROS interface names the types of its services and actions and does not say what is in them. So only the
services of `std_srvs` become portals; for topics, parameters and actions no portal could stand.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from lfield.capability.importers.draft import Draft, clean, portal_name
from lfield.capability.importers.messages import OTHER_SPEC
from lfield.source import Diagnostics
from lfield.yaml_source import Listing, Mapping, Node, Scalar

Kind = Literal["interface", "semantic", "provider"]

#: The key that only this kind has.
_KINDS: tuple[tuple[str, Kind], ...] = (
    ("implements", "provider"),
    ("redefines", "semantic"),
    ("interface", "interface"),
)

#: Services whose contents are known, as portals; ROS 2 writes `std_srvs/srv/Empty`.
_SERVICES: dict[str, dict[str, Any]] = {
    "std_srvs/Empty": {},
    "std_srvs/Trigger": {"emit": "boolean"},
    "std_srvs/SetBool": {"parameters": {"data": {"type": "boolean"}}, "emit": "boolean"},
}

#: Folders in which a ROS package keeps its specs.
_FOLDERS = ("interfaces", "semantic_interfaces", "providers", "capabilities")

#: Why things stay behind.
_NO_PORTAL = {
    "topics": "a portal is called, it is no stream of messages",
    "actions": "the spec does not say what it takes and gives",
    "parameters": "the constructor's arguments in the deployment take its place",
    "dynamic_parameters": "what can be set while it runs is a portal of its own",
}
_PROVIDER_KEYS = {
    "launch_file": "the deployment says what runs where",
    "depends_on": "a class in L calls what it needs; see 'needs' in a one-to-many rule",
    "remappings": "names of ROS have no meaning in L",
    "nodelet_manager": "nothing is launched",
}
_SPEC_KEYS = ("name", "spec_version", "spec_type", "description")


@dataclass(frozen=True, slots=True)
class Spec:
    """One spec: `package/name`, and its text."""

    file: str
    kind: Kind
    package: str
    name: str
    node: Mapping

    @property
    def description(self) -> str:
        """What it says of itself."""
        return text_of(self.node, "description")

    def refers_to(self, key: str) -> str:
        """The bare name of another spec: of `package/Name`, the Name."""
        return text_of(self.node, key).rpartition("/")[2]


@dataclass(slots=True)
class _Made:
    """What an interface has become; `primitive` is '' when nothing of it can be called."""

    term: str
    primitive: str = ""
    portals: dict[str, dict[str, Any]] = field(default_factory=dict)


def kind_of(node: Node) -> Kind | None:
    """Which spec this is, by what it holds; None when it is none."""
    if not isinstance(node, Mapping) or "spec_version" not in node.entries:
        return None
    return next((kind for key, kind in _KINDS if key in node.entries), None)


def read_spec(path: Path, kind: Kind, node: Mapping, found: Diagnostics) -> Spec | None:
    """The spec in a document; None after a mistake, which is reported."""
    version = node.entries["spec_version"].value
    if not isinstance(version, Scalar) or version.value not in (1, 1.1) or version.value is True:
        found.add(OTHER_SPEC.at(version.span))
        return None
    package, _, name = (text_of(node, "name") or path.stem).rpartition("/")
    if not package and path.parent.name in _FOLDERS:
        package = path.resolve().parent.parent.name
    return Spec(str(path), kind, package, name, node)


def add_specs(specs: Iterable[Spec], draft: Draft) -> None:
    """Add all specs: interfaces first, then what redefines them, then who implements any of them."""
    made: dict[str, _Made] = {}
    by_kind = {kind: [s for s in specs if s.kind == kind] for kind in ("interface", "semantic", "provider")}
    for spec in by_kind["interface"]:
        made.setdefault(spec.name, _add_interface(spec, draft))
    for spec in _after_what_they_redefine(by_kind["semantic"]):
        general = made.get(spec.refers_to("redefines"))
        if general is None:
            draft.note(spec.file, f"it redefines {_named(spec, 'redefines')}, which is in none of the files")
        else:
            made.setdefault(spec.name, _add_semantic(spec, general, draft))
    for spec in by_kind["provider"]:
        _add_provider(spec, made.get(spec.refers_to("implements")), draft)


def _after_what_they_redefine(specs: list[Spec]) -> Iterator[Spec]:
    """Those that redefine others of them come after these; in a circle, in the order of the files."""
    waiting = list(specs)
    while waiting:
        names = {spec.name for spec in waiting}
        ready = [s for s in waiting if s.refers_to("redefines") not in names - {s.name}] or waiting
        yield from ready
        waiting = [spec for spec in waiting if spec not in ready]


# --- interfaces ---------------------------------------------------------------------------------------


def _add_interface(spec: Spec, draft: Draft) -> _Made:
    term = draft.new_term("skill", spec.name, spec.package)
    draft.taxonomy[term] = _said(name=spec.name, meaning=spec.description)
    body = spec.node.entries["interface"].value
    portals: dict[str, dict[str, Any]] = {}
    for section, name, type, meaning in _elements(body):
        known = _SERVICES.get(type.replace("/srv/", "/")) if section == "services" else None
        what = f"{section.removesuffix('s').replace('_', ' ')} '{clean(name)}'" + (
            f" ({clean(type)})" if type else ""
        )
        if known is not None:
            portals[portal_name(name.rpartition("/")[2], portals)] = known | _said(meaning=meaning)
            if type.endswith(("Trigger", "SetBool")):
                draft.note(
                    spec.file, f"{what}: the message of its answer; the portal emits whether it worked"
                )
        else:
            why = _NO_PORTAL.get(section, "the spec does not say what it takes and gives")
            draft.note(spec.file, f"{what}: {why}")
    _note_others(spec, (*_SPEC_KEYS, "interface"), {}, draft)
    if not portals:
        draft.note(spec.file, f"nothing of {clean(spec.name)} can be called: it is a term, and no primitive")
        return _Made(term)
    return _add_primitive(spec, term, portals, draft)


def _add_primitive(spec: Spec, term: str, portals: dict[str, dict[str, Any]], draft: Draft) -> _Made:
    type = draft.new_type(spec.name, spec.package)
    draft.primitives[type] = {"id": term, **_said(meaning=spec.description), "portals": portals}
    return _Made(term, type, portals)


def _elements(body: Node) -> Iterator[tuple[str, str, str, str]]:
    """Section, name, type and description of all that an interface consists of."""
    if not isinstance(body, Mapping):
        return
    for section in body.entries.values():
        groups = [section.value]
        if isinstance(section.value, Mapping) and set(section.value.entries) <= {"requires", "provides"}:
            groups = [entry.value for entry in section.value.entries.values()]
        for group in groups:
            for name, node in _named_nodes(group):
                yield section.key, name, text_of(node, "type"), text_of(node, "description")


def _named_nodes(group: Node) -> Iterator[tuple[str, Node]]:
    if isinstance(group, Mapping):
        yield from ((entry.key, entry.value) for entry in group.entries.values())
    elif isinstance(group, Listing):
        yield from ((str(item.value), item) for item in group.items if isinstance(item, Scalar))


def _add_semantic(spec: Spec, general: _Made, draft: Draft) -> _Made:
    term = draft.new_term(general.term, spec.name, spec.package)
    draft.taxonomy[term] = _said(name=spec.name, meaning=spec.description)
    reasons = {"remappings": "names of ROS have no meaning in L", "global_namespace": "the same"}
    _note_others(spec, (*_SPEC_KEYS, "redefines"), reasons, draft)
    return _add_primitive(spec, term, general.portals, draft) if general.portals else _Made(term)


# --- providers ----------------------------------------------------------------------------------------


def _add_provider(spec: Spec, made: _Made | None, draft: Draft) -> None:
    _note_others(spec, (*_SPEC_KEYS, "implements"), _PROVIDER_KEYS, draft)
    if made is None or not made.primitive:
        why = "which is in none of the files" if made is None else "of which nothing can be called"
        draft.note(spec.file, f"the provider: it implements {_named(spec, 'implements')}, {why}")
        return
    type = draft.new_type(spec.name, f"{spec.package} provider")
    draft.providers[type] = {**_said(meaning=spec.description), "serves": {made.primitive: {}}}
    portals = ", ".join(made.portals)
    draft.note(spec.file, f"how it works: write the resource {type} with the portals {portals} in L")


# --- pieces -------------------------------------------------------------------------------------------


def _note_others(spec: Spec, known: Iterable[str], reasons: dict[str, str], draft: Draft) -> None:
    for key in spec.node.entries:
        if key not in known:
            draft.note(spec.file, f"{clean(key)}: {reasons.get(key, 'a registry has nothing like it')}")


def _named(spec: Spec, key: str) -> str:
    return clean(text_of(spec.node, key)) or "nothing"


def _said(**texts: str) -> dict[str, Any]:
    """Those texts that say something."""
    return {key: clean(text) for key, text in texts.items() if clean(text)}


def text_of(node: Node, key: str) -> str:
    """A text in a mapping, '' when there is none."""
    entry = node.entries.get(key) if isinstance(node, Mapping) else None
    value = entry.value.value if entry is not None and isinstance(entry.value, Scalar) else None
    return value if isinstance(value, str) else ""
