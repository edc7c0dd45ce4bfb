"""Specs of the ROS package `capabilities` (spec_version 1) as entries of a registry.

    interface            a term below `skill`, and a primitive when any of its services can be a portal
    semantic interface   a term below that of the interface it redefines, and a primitive with its portals,
                         so that whoever serves the special one serves the general one
    provider             a resource type that serves the primitive of what it implements

A ROS interface names the types of its services and actions and does not say what is in them. So only the
services of `std_srvs` become portals; for topics, parameters and actions no portal could stand.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from lfield.capability.importers.draft import Draft, clean, portal_name
from lfield.capability.importers.messages import OTHER_SPEC
from lfield.text.source import Diagnostics
from lfield.text.yaml_source import Listing, Mapping, Node, Scalar

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


@dataclass(frozen=True, slots=True, eq=False)
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
        """The name of another spec, `package/Name` or just `Name`."""
        return text_of(self.node, key)


@dataclass(frozen=True, slots=True)
class _Element:
    """One thing that an interface consists of; `required` when the robot needs it from others."""

    section: str
    name: str
    type: str
    meaning: str
    required: bool

    def __str__(self) -> str:
        kind = self.section.removesuffix("s").replace("_", " ")
        return f"{clean(kind)} '{clean(self.name)}'" + (f" ({clean(self.type)})" if self.type else "")


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


def add_specs(specs: Sequence[Spec], draft: Draft) -> None:
    """Add all specs: interfaces first, then what redefines them, then who implements any of them."""
    made: dict[str, _Made] = {}
    for spec in specs:
        if spec.kind == "interface":
            _keep(made, spec, _add_interface(spec, draft))
    waiting = [spec for spec in specs if spec.kind == "semantic"]
    while ready := [spec for spec in waiting if _find(made, spec.refers_to("redefines"))]:
        waiting = [spec for spec in waiting if spec not in ready]
        for spec in ready:
            general = _find(made, spec.refers_to("redefines"))
            assert general is not None
            _keep(made, spec, _add_semantic(spec, general, draft))
    for spec in waiting:
        draft.note(spec.file, f"it redefines {_named(spec, 'redefines')}, which is in none of the files")
    for spec in specs:
        if spec.kind == "provider":
            _add_provider(spec, _find(made, spec.refers_to("implements")), draft)


def _keep(made: dict[str, _Made], spec: Spec, entry: _Made) -> None:
    """Under its full name, and under its bare one where that is free."""
    made.setdefault(f"{spec.package}/{spec.name}", entry)
    made.setdefault(spec.name, entry)


def _find(made: dict[str, _Made], name: str) -> _Made | None:
    """By the full name; a file whose package is not known is found by its bare one."""
    return made.get(name) or made.get(name.rpartition("/")[2])


# --- interfaces ---------------------------------------------------------------------------------------


def _add_interface(spec: Spec, draft: Draft) -> _Made:
    term = draft.new_term("skill", spec.name, spec.package)
    draft.taxonomy[term] = _said(name=spec.name, meaning=spec.description)
    portals: dict[str, dict[str, Any]] = {}
    for element in _elements(spec.node.entries["interface"].value):
        known = _SERVICES.get(element.type.replace("/srv/", "/")) if element.section == "services" else None
        if known is None or element.required:
            draft.note(spec.file, f"{element}: {_why_not(element)}")
            continue
        portals[portal_name(element.name.rpartition("/")[2], portals)] = {
            **known,
            **_said(meaning=element.meaning),
        }
        if "emit" in known:
            draft.note(spec.file, f"{element}: the text of its answer; the portal emits whether it worked")
    _note_others(spec, (*_SPEC_KEYS, "interface"), {}, draft)
    if not portals:
        draft.note(spec.file, f"nothing of {clean(spec.name)} can be called: it is a term, and no primitive")
        return _Made(term)
    return _add_primitive(spec, term, portals, draft)


def _add_primitive(spec: Spec, term: str, portals: dict[str, dict[str, Any]], draft: Draft) -> _Made:
    type = draft.new_type(spec.name, spec.package)
    draft.primitives[type] = {"id": term, **_said(meaning=spec.description), "portals": portals}
    return _Made(term, type, portals)


def _why_not(element: _Element) -> str:
    if element.section == "services" and element.required:
        return "the robot would call it, and a portal is called on the robot"
    return _NO_PORTAL.get(element.section, "the spec does not say what it takes and gives")


def _elements(body: Node) -> Iterator[_Element]:
    """All that an interface consists of, section by section."""
    if not isinstance(body, Mapping):
        return
    for section in body.entries.values():
        groups = {"provides": section.value}
        if isinstance(section.value, Mapping) and set(section.value.entries) <= {"requires", "provides"}:
            groups = {entry.key: entry.value for entry in section.value.entries.values()}
        for group, nodes in groups.items():
            for name, node in _named_nodes(nodes):
                type, meaning = text_of(node, "type"), text_of(node, "description")
                yield _Element(section.key, name, type, meaning, group == "requires")


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
