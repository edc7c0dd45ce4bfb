"""Reads the access file `mission.access.yaml` and checks it against program, team and registry.

```yaml
people:                            # restricts the rights in their certificates
  anna: [observe, stop, operate]
  others: [observe, stop]          # every other person of the team's authority
coordinators:
  survey:                          # this coordinator may call only the listed portals
    Copter: [takeoff, fly, where]  # these portals of every Copter,
    copter3: [where]               # only where() of this one: the line of an agent takes precedence
    Lift: all                      # the portals of a resource that serve Lift
  Relay:                           # each coordinator of this type
    others: all                    # every resource without another line
    winch: []
    patrol: [start, stop]          # a startable coordinator, which it may start and stop
  others: all                      # the default: all portals of the own deployment
calls:                             # the portals that persons may call; none without a line
  anna: {Copter: [where]}
  others: {copter3: [where]}       # every other person, and users of the host's own computer
assistants: [anna]                 # the persons whose AI assistants may start it and call portals
```

Names are those of agents, types and capabilities, in that order for an ambiguous name. An unknown name is an
error; all errors are reported at once, each at its position.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

from lfield.authority.identity import MAX_NAME, Right
from lfield.bytecode.program import Program
from lfield.capability.model import Registry
from lfield.errors import ProgramError
from lfield.mission.access.access_rules import OTHERS, Access, CallerRule, PersonRule, PortalRule, SubjectKind
from lfield.text.source_text import Diagnostic, Diagnostics, Span
from lfield.text.suggestions import did_you_mean, listed
from lfield.text.yaml_fields import YamlFields
from lfield.text.yaml_source import YamlEntry, YamlList, YamlMapping, YamlNode, YamlScalar, describe, read
from lfield.vm.agent import TeamMember

#: The actions of a coordinator on a startable one.
SEQUENCING_RIGHTS = ("start", "stop")
#: The keyword for all names that could be listed.
ALL = "all"
#: Rights that a mission can leave to a person. The right to sign missions is in the certificate alone.
_RIGHTS = tuple(str(right) for right in Right if right is not Right.COMMAND)


def read_access(
    path: Path, team: Sequence[TeamMember], program: Program, registry: Callable[[], Registry]
) -> Access:
    """The rules in a file, for a team that runs a program.

    `registry` is called only where a name is neither an agent nor a type. Raises ProgramError with all
    errors, InputFileError when the file cannot be read.
    """
    found = Diagnostics()
    node = read(str(path), found)
    access = Access(path.name)
    if node is not None:
        access = _Reader(team, program, registry, found).access(path.name, node)
    if found.errors:
        raise ProgramError(found.errors)
    return access


class _Resource(NamedTuple):
    """The subject of a line: its portals, and for a capability its portals by resource type."""

    kind: SubjectKind
    portals: Collection[str]
    serving: dict[str, dict[str, str]]


class _Reader:
    """One pass over an access file; errors go to `found`."""

    def __init__(
        self,
        team: Sequence[TeamMember],
        program: Program,
        registry: Callable[[], Registry],
        found: Diagnostics,
    ) -> None:
        self._registry, self._found = registry, found
        self._coordinators = {m.id: m.type for m in team if m.kind == "coordinator"}
        self._resources = {m.id: m.type for m in team if m.kind == "resource"}
        self._portals: dict[str, list[str]] = {type: [] for type in self._resources.values()}
        # An action on a coordinator counts as a portal of it.
        startable = {m.id: m.type for m in team if m.is_startable}
        self._resources |= startable
        self._portals |= {type: list(SEQUENCING_RIGHTS) for type in startable.values()}
        for method in program.core.methods:
            owner = program.core.classes[method.owner].name
            if method.kind == "portal" and owner in self._portals:
                self._portals[owner].append(method.name)

    def access(self, file: str, node: YamlNode) -> Access:
        top = YamlFields(node, self._found, "an access file")
        people = tuple(map(self._read_person, top.section("people").named()))
        callers = tuple(map(self._caller, top.section("coordinators").named()))
        calls = tuple(map(self._person_caller, top.section("calls").named()))
        assistants = tuple(dict.fromkeys(top.texts("assistants")))
        top.report_unread()
        return Access(file, people, callers, calls, assistants)

    def _report_error(self, code: str, message: str, span: Span, hint: str) -> None:
        self._found.add(Diagnostic(code, message, span, hint))

    def _is_starred(self, entry: YamlEntry) -> bool:
        """Whether a name is '*', which other file formats use for everyone; reported if it is."""
        if entry.key == "*":
            self._report_error("Y113", "'*' is not a name", entry.key_span, f"write {OTHERS}")
        return entry.key == "*"

    def _list_nodes(self, entry: YamlEntry, expected: str) -> tuple[YamlNode, ...] | None:
        """The nodes of a list, None for ALL; () and a finding for any other node."""
        node = entry.value
        if isinstance(node, YamlList):
            return node.items
        if _text(node) == ALL:
            return None
        hint = f"write [{_text(node)}]" if _text(node) else "[] means none of them"
        self._report_error(
            "Y112",
            f"'{entry.key}' must be {ALL} or a list of {expected}, not {describe(node)}",
            node.span,
            hint,
        )
        return ()

    # --- people ---------------------------------------------------------------------------------------

    def _read_person(self, entry: YamlEntry) -> PersonRule:
        """A person, and the rights that the mission leaves them."""
        self._check_person(entry)
        items = self._list_nodes(entry, "rights")
        rights = (
            Right
            if items is None
            else (Right(name_text) for item in items if (name_text := self._right(item)))
        )
        return PersonRule(entry.key, tuple(rights), entry.key_span.line)

    def _check_person(self, entry: YamlEntry) -> None:
        name = entry.key
        if not self._is_starred(entry) and not (0 < len(name) <= MAX_NAME and name.isprintable()):
            message = f"a person's name has 1 to {MAX_NAME} printable characters"
            self._report_error("Y113", message, entry.key_span, "")

    def _person_caller(self, entry: YamlEntry) -> CallerRule:
        """A person, and the portals that the mission opens to them."""
        self._check_person(entry)
        return self._lines_of(entry, OTHERS if entry.key == OTHERS else "person")

    def _right(self, node: YamlNode) -> str:
        name_text, hint = _text(node), f"rights here: {listed(_RIGHTS)}"
        if name_text in _RIGHTS:
            return name_text
        if name_text == Right.COMMAND:
            message = "a mission cannot grant the right to sign it: that is in the certificate alone"
            self._report_error("Y113", message, node.span, hint)
        else:
            message = (
                f"unknown right '{name_text}'" if name_text else f"a right is a name, not {describe(node)}"
            )
            self._report_error(
                "Y113" if name_text else "Y112", message, node.span, did_you_mean(name_text, _RIGHTS) or hint
            )
        return ""

    # --- coordinators ---------------------------------------------------------------------------------

    def _caller(self, entry: YamlEntry) -> CallerRule:
        """A coordinator, and the portals that it may call."""
        return self._lines_of(entry, self._caller_kind(entry))

    def _lines_of(self, entry: YamlEntry, kind: SubjectKind) -> CallerRule:
        """A caller of that kind, and the portals that it may call."""
        node, line = entry.value, entry.key_span.line
        if isinstance(node, YamlMapping):
            lines = [self._line(below) for below in node.entries.values()]
            return CallerRule(kind, entry.key, line, tuple(line for line in lines if line is not None))
        if _text(node) != ALL:
            message = f"'{entry.key}' must be {ALL}, or resources with their portals, not {describe(node)}"
            self._report_error("Y112", message, node.span, f"as in {entry.key}: {{{self._example}}}")
        return CallerRule(kind, entry.key, line)

    def _caller_kind(self, entry: YamlEntry) -> SubjectKind:
        if entry.key == OTHERS:
            return OTHERS
        if entry.key in self._coordinators:
            return "agent"
        types = self._coordinators.values()
        if entry.key not in types and not self._is_starred(entry):
            hint = did_you_mean(entry.key, [*self._coordinators, *types])
            hint = hint or f"its coordinators: {listed(self._coordinators)}"
            message = f"the deployment has no coordinator '{entry.key}', and none of such a type"
            self._report_error("Y113", message, entry.key_span, hint)
        return "type"

    @property
    def _example(self) -> str:
        """An example line for this deployment."""
        return next((f"{type}: [{portals[0]}]" for type, portals in self._portals.items() if portals), "")

    # --- their lines ----------------------------------------------------------------------------------

    def _line(self, entry: YamlEntry) -> PortalRule | None:
        """A resource, and its portals that may be called; None with a finding when it is unknown."""
        name, line = entry.key, entry.key_span.line
        target = None if self._is_starred(entry) else self._resource(entry)
        if target is None:
            return None
        items = self._list_nodes(entry, "portals")
        portals: Collection[str] = (
            () if items is None else [self._portal(item, name, target) for item in items]
        )
        chosen = None if items is None else tuple(dict.fromkeys(filter(None, portals)))
        if target.kind != "capability":
            return PortalRule(target.kind, name, line, chosen)
        serving = {type: _served_portals(targets, chosen) for type, targets in target.serving.items()}
        return PortalRule(target.kind, name, line, (), serving)

    def _resource(self, entry: YamlEntry) -> _Resource | None:
        """The meaning of a name."""
        name, resources, types = entry.key, self._resources, self._portals
        if name == OTHERS:
            return _Resource(OTHERS, {portal for portals in types.values() for portal in portals}, {})
        if name in resources:
            return _Resource("agent", types[resources[name]], {})
        if name in types:
            return _Resource("type", types[name], {})
        return self._capability(entry)

    def _capability(self, entry: YamlEntry) -> _Resource | None:
        name, registry = entry.key, self._registry_or_empty
        primitive, providers = registry.primitives.get(name), registry.providers
        if primitive is None:
            hint = did_you_mean(name, [*self._resources, *self._portals, *registry.primitives])
            hint = hint or f"its resources: {listed(self._resources)}"
            message = f"the deployment has no resource '{name}', and there is no such type or capability"
            self._report_error("Y113", message, entry.key_span, hint)
            return None
        serving = {
            type: {portal: mapped.target for portal, mapped in providers[type].serves[name].portals.items()}
            for type in self._portals
            if type in providers and name in providers[type].serves
        }
        if not serving:
            message = f"no resource of the deployment serves {name} itself"
            self._report_error(
                "Y113", message, entry.key_span, "add a line for the capability that substitutes it"
            )
        return _Resource("capability", primitive.portals.keys(), serving)

    @cached_property
    def _registry_or_empty(self) -> Registry:
        return self._registry()

    def _portal(self, node: YamlNode, name: str, known: _Resource) -> str:
        """One portal of a list, '' when it is unknown."""
        name_text = _text(node)
        if name_text in known.portals:
            return name_text
        if not name_text:
            self._report_error("Y112", f"a portal is a name, not {describe(node)}", node.span, "")
            return ""
        hint = did_you_mean(name_text, known.portals) or f"its portals: {listed(sorted(known.portals))}"
        whose = "no resource of the deployment has a" if known.kind == OTHERS else f"{name} has no"
        self._report_error("Y113", f"{whose} portal '{name_text}'", node.span, hint)
        return ""


def _served_portals(targets: dict[str, str], chosen: tuple[str, ...] | None) -> tuple[str, ...]:
    """The portals of a type that serve some portals of a capability (None: all)."""
    requested = targets if chosen is None else chosen
    return tuple(dict.fromkeys(targets[portal] for portal in requested if portal in targets))


def _text(node: YamlNode) -> str:
    """A text, '' for any other node."""
    return node.value if isinstance(node, YamlScalar) and isinstance(node.value, str) else ""
