"""Reads `mission.access.yaml`: who may do what in a mission, held against its program, team and registry.

```yaml
people:                            # less than their certificates say, never more
  anna: [observe, stop, operate]
  others: [observe, stop]          # everybody else of the team's authority
coordinators:
  survey:                          # this coordinator calls what stands here, and nothing else
    Copter: [takeoff, fly, where]  # of every Copter these portals,
    copter3: [where]               # of this one only where(): its own line counts before its type's
    Lift: all                      # of whoever serves Lift, the portals by which it does
  Relay:                           # each coordinator of this type
    others: all                    # whatever no other line of Relay names
    winch: []
  others: all                      # as it is without a line: all portals of the own deployment
```

Names are those of agents, types and capabilities, in that order where one name is several. What there is not
is an error, all of them at once, each drawn at its place.
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
from lfield.mission.access.rules import OTHERS, Access, Caller, Kind, Line, Person
from lfield.text.source import Diagnostic, Diagnostics, Span
from lfield.text.suggest import did_you_mean, listed
from lfield.text.yaml_fields import Fields
from lfield.text.yaml_source import Entry, Listing, Mapping, Node, Scalar, describe, read
from lfield.vm.agent import Member

#: Everything that could be listed.
ALL = "all"
#: What a person can be left by a mission. Who may sign it is not the mission's to say.
_RIGHTS = tuple(str(right) for right in Right if right is not Right.COMMAND)


def read_access(
    path: Path, team: Sequence[Member], program: Program, registry: Callable[[], Registry]
) -> Access:
    """The rules in a file, of a team that runs a program.

    The `registry` is asked for only where a name is neither an agent nor a type. Raises ProgramError with all
    that is wrong, InputFileError when the file cannot be read.
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
    """What a line is about: its portals, and by resource types what those of a capability are there."""

    kind: Kind
    portals: Collection[str]
    serving: dict[str, dict[str, str]]


class _Reader:
    """One pass over an access file; what is wrong goes to `found`."""

    def __init__(
        self, team: Sequence[Member], program: Program, registry: Callable[[], Registry], found: Diagnostics
    ) -> None:
        self._registry, self._found = registry, found
        self._coordinators = {m.id: m.type for m in team if m.kind == "coordinator"}
        self._resources = {m.id: m.type for m in team if m.kind == "resource"}
        self._portals: dict[str, list[str]] = {type: [] for type in self._resources.values()}
        for method in program.core.methods:
            owner = program.core.classes[method.owner].name
            if method.kind == "portal" and owner in self._portals:
                self._portals[owner].append(method.name)

    def access(self, file: str, node: Node) -> Access:
        """The whole file."""
        top = Fields(node, self._found, "an access file")
        people = tuple(map(self._person, top.section("people").named()))
        callers = tuple(map(self._caller, top.section("coordinators").named()))
        top.done()
        return Access(file, people, callers)

    def _wrong(self, code: str, message: str, span: Span, hint: str) -> None:
        self._found.add(Diagnostic(code, message, span, hint))

    def _is_starred(self, entry: Entry) -> bool:
        """Whether a name is the star by which other files mean everybody, and a finding if it is."""
        if entry.key == "*":
            self._wrong("Y113", "'*' is nobody's name", entry.key_span, f"write {OTHERS}")
        return entry.key == "*"

    def _listed(self, entry: Entry, what: str) -> tuple[Node, ...] | None:
        """The nodes of a list, None for ALL; () and a finding for anything else."""
        node = entry.value
        if isinstance(node, Listing):
            return node.items
        if _word(node) == ALL:
            return None
        hint = f"write [{_word(node)}]" if _word(node) else "[] is none of them"
        self._wrong(
            "Y112", f"'{entry.key}' has {ALL} or a list of {what}, not {describe(node)}", node.span, hint
        )
        return ()

    # --- people ---------------------------------------------------------------------------------------

    def _person(self, entry: Entry) -> Person:
        """A person, and what is left of their rights."""
        name = entry.key
        if not self._is_starred(entry) and not (0 < len(name) <= MAX_NAME and name.isprintable()):
            said = f"nobody's keys have such a name: it has 1 to {MAX_NAME} characters that can be printed"
            self._wrong("Y113", said, entry.key_span, "")
        items = self._listed(entry, "rights")
        rights = Right if items is None else (Right(word) for item in items if (word := self._right(item)))
        return Person(entry.key, tuple(rights), entry.key_span.line)

    def _right(self, node: Node) -> str:
        word, known = _word(node), f"rights here: {listed(_RIGHTS)}"
        if word in _RIGHTS:
            return word
        if word == Right.COMMAND:
            said = "a mission cannot say who may sign it: that is in the certificate alone"
            self._wrong("Y113", said, node.span, known)
        else:
            said = f"there is no right '{word}'" if word else f"a right is a word, not {describe(node)}"
            self._wrong("Y113" if word else "Y112", said, node.span, did_you_mean(word, _RIGHTS) or known)
        return ""

    # --- coordinators ---------------------------------------------------------------------------------

    def _caller(self, entry: Entry) -> Caller:
        """A coordinator, and what it may call."""
        kind, node, line = self._caller_kind(entry), entry.value, entry.key_span.line
        if isinstance(node, Mapping):
            lines = [self._line(below) for below in node.entries.values()]
            return Caller(kind, entry.key, line, tuple(line for line in lines if line is not None))
        if _word(node) != ALL:
            said = f"'{entry.key}' has {ALL}, or resources with their portals, not {describe(node)}"
            self._wrong("Y112", said, node.span, f"as in {entry.key}: {{{self._example}}}")
        return Caller(kind, entry.key, line)

    def _caller_kind(self, entry: Entry) -> Kind:
        if entry.key == OTHERS:
            return OTHERS
        if entry.key in self._coordinators:
            return "agent"
        types = self._coordinators.values()
        if entry.key not in types and not self._is_starred(entry):
            hint = did_you_mean(entry.key, [*self._coordinators, *types])
            hint = hint or f"its coordinators: {listed(self._coordinators)}"
            said = f"the deployment has no coordinator '{entry.key}', and none of such a type"
            self._wrong("Y113", said, entry.key_span, hint)
        return "type"

    @property
    def _example(self) -> str:
        """A line that fits this deployment."""
        return next((f"{type}: [{portals[0]}]" for type, portals in self._portals.items() if portals), "")

    # --- their lines ----------------------------------------------------------------------------------

    def _line(self, entry: Entry) -> Line | None:
        """A resource, and which portals of it may be called; None, and a finding, when there is none."""
        name, line = entry.key, entry.key_span.line
        known = None if self._is_starred(entry) else self._resource(entry)
        if known is None:
            return None
        items = self._listed(entry, "portals")
        portals: Collection[str] = (
            () if items is None else [self._portal(item, name, known) for item in items]
        )
        chosen = None if items is None else tuple(dict.fromkeys(filter(None, portals)))
        if known.kind != "capability":
            return Line(known.kind, name, line, chosen)
        serving = {type: _meant(targets, chosen) for type, targets in known.serving.items()}
        return Line(known.kind, name, line, (), serving)

    def _resource(self, entry: Entry) -> _Resource | None:
        """What a name is."""
        name, resources, types = entry.key, self._resources, self._portals
        if name == OTHERS:
            return _Resource(OTHERS, {portal for portals in types.values() for portal in portals}, {})
        if name in resources:
            return _Resource("agent", types[resources[name]], {})
        if name in types:
            return _Resource("type", types[name], {})
        return self._capability(entry)

    def _capability(self, entry: Entry) -> _Resource | None:
        name, registry = entry.key, self._known
        primitive, providers = registry.primitives.get(name), registry.providers
        if primitive is None:
            hint = did_you_mean(name, [*self._resources, *self._portals, *registry.primitives])
            hint = hint or f"its resources: {listed(self._resources)}"
            said = f"the deployment has no resource '{name}', and there is no such type or capability"
            self._wrong("Y113", said, entry.key_span, hint)
            return None
        serving = {
            type: {portal: way.target for portal, way in providers[type].serves[name].portals.items()}
            for type in self._portals
            if type in providers and name in providers[type].serves
        }
        if not serving:
            said = f"no resource of the deployment serves {name} itself"
            self._wrong("Y113", said, entry.key_span, "what stands in for it has a line by its own name")
        return _Resource("capability", primitive.portals.keys(), serving)

    @cached_property
    def _known(self) -> Registry:
        return self._registry()

    def _portal(self, node: Node, name: str, known: _Resource) -> str:
        """One portal of a list, '' when it is none."""
        word = _word(node)
        if word in known.portals:
            return word
        if not word:
            self._wrong("Y112", f"a portal is a name, not {describe(node)}", node.span, "")
            return ""
        hint = did_you_mean(word, known.portals) or f"its portals: {listed(sorted(known.portals))}"
        whose = "no resource of the deployment has a" if known.kind == OTHERS else f"{name} has no"
        self._wrong("Y113", f"{whose} portal '{word}'", node.span, hint)
        return ""


def _meant(targets: dict[str, str], chosen: tuple[str, ...] | None) -> tuple[str, ...]:
    """The portals by which a type serves some of a capability (None: all of it)."""
    wanted = targets if chosen is None else chosen
    return tuple(dict.fromkeys(targets[portal] for portal in wanted if portal in targets))


def _word(node: Node) -> str:
    """A text, '' for anything else."""
    return node.value if isinstance(node, Scalar) and isinstance(node.value, str) else ""
