"""Access rules of one mission as plain data, and decisions on a person's rights or a portal call. Pure.

For rights and coordinators an access file only restricts: persons have the rights of their certificates, less
those that it removes; coordinators call the portals of their own deployment, less those that it removes.
Without an entry rights are unchanged. Portals are closed to persons, and actions to their assistants, unless
the file opens them. One line decides a call, the most specific: for callers the agent before its type before
`others`, for resources the agent before its type before a capability before `others`.

The reader (`access_file.py`) checks every name against program, deployment and registry, and resolves
capabilities to portals, so a robot needs no registry to apply a rule.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Final, Literal, Protocol

import msgspec
from msgspec.structs import replace

from lfield.authority.identity import Identity, Right, sorted_rights, with_implied
from lfield.capability.model import Registry
from lfield.text.suggestions import listed

#: The name for every person, coordinator or resource without a line of its own.
OTHERS: Final = "others"

#: Kind of the name at the start of a line.
SubjectKind = Literal["agent", "type", "capability", "others", "person"]

#: Rights that a file never removes: a stop makes safe, and the signer of a bundle is checked before it is
#: read.
_NEVER_REMOVED = frozenset({Right.STOP, Right.COMMAND})


class RuleSubject(Protocol):
    """An agent as seen by the rules."""

    @property
    def id(self) -> str:
        """The name in the deployment."""

    @property
    def type(self) -> str:
        """The type in L."""


class PersonRule(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """The maximum rights of one person, or of OTHERS; `line` is its line in the file."""

    name: str
    may: tuple[Right, ...]
    line: int


class PortalRule(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """The portals of some resources that a caller may call; None: all of them.

    For a capability, `serving` has them by the resource types that serve it, under the types' own names.
    """

    kind: SubjectKind
    name: str
    line: int
    portals: tuple[str, ...] | None = None
    serving: dict[str, tuple[str, ...]] = {}

    def is_about(self, resource: RuleSubject) -> bool:
        """Whether the rule applies to a resource."""
        match self.kind:
            case "agent":
                return self.name == resource.id
            case "type":
                return self.name == resource.type
            case "capability":
                return resource.type in self.serving
            case "others" | "person":
                return True

    def allows(self, resource: RuleSubject, portal: str) -> bool:
        """Whether a portal of a resource to which the rule applies may be called."""
        allowed = self.portals_of(resource)
        return allowed is None or portal in allowed

    def portals_of(self, resource: RuleSubject) -> tuple[str, ...] | None:
        """The portals of a resource that may be called, None for all."""
        return self.serving[resource.type] if self.kind == "capability" else self.portals


class CallerRule(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """The calls allowed to one coordinator, a type, one person or OTHERS; without `lines` all."""

    kind: SubjectKind
    name: str
    line: int
    lines: tuple[PortalRule, ...] | None = None

    def is_about(self, coordinator: RuleSubject) -> bool:
        """Whether the rule applies to a coordinator."""
        subject = {"agent": coordinator.id, "type": coordinator.type}.get(self.kind, self.name)
        return self.name == subject

    def deciding(self, resource: RuleSubject) -> list[PortalRule]:
        """The deciding lines for a resource: one, or those of several capabilities; [] when there is none."""
        about = [line for line in self.lines or () if line.is_about(resource)]
        first = min((_ORDER[line.kind] for line in about), default=0)
        return [line for line in about if _ORDER[line.kind] == first]


_ORDER: Mapping[SubjectKind, int] = {"agent": 0, "person": 0, "type": 1, "capability": 2, "others": 3}


class Access(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """The rules of a mission; `file` is the name of their file, '' when there is none.

    `callers` are for coordinators, `calls` for persons. `assistants` are persons whose assistants may act.
    """

    file: str = ""
    people: tuple[PersonRule, ...] = ()
    callers: tuple[CallerRule, ...] = ()
    calls: tuple[CallerRule, ...] = ()
    assistants: tuple[str, ...] = ()

    @property
    def digest(self) -> bytes:
        """SHA-256 of the rules, b"" without a file: all hosts of a mission must have the same."""
        return hashlib.sha256(encode_access(self)).digest() if self.file else b""

    # --- persons --------------------------------------------------------------------------------------

    def restrict(self, identity: Identity) -> Identity:
        """The same person with the rights that the mission leaves. Other kinds of identity are unchanged.

        A person whose certificate has `stop` may stop every mission.
        """
        person = self._person(identity.name) if identity.kind == "person" else None
        if person is None:
            return identity
        return replace(identity, may=identity.may & (with_implied(person.may) | _NEVER_REMOVED))

    def why_not(self, identity: Identity, right: Right) -> str:
        """The rule that removes a person's right, as a sentence; '' when none does."""
        if right not in identity.may or right in self.restrict(identity).may:
            return ""
        person = self._person(identity.name)
        assert person is not None
        granted = sorted_rights(person.may).replace(",", ", ") or "nothing"
        rule = f"{self.file}:{person.line} limits {person.name} to: {granted}"
        return f"{identity} may not {right} in this mission: {rule}"

    def denied_rights(self, identity: Identity) -> dict[Right, str]:
        """The rights that a person loses here, each with a sentence that names the rule."""
        return {right: self.why_not(identity, right) for right in identity.may - self.restrict(identity).may}

    def _person(self, name: str) -> PersonRule | None:
        known = {person.name: person for person in self.people}
        return known.get(name) or known.get(OTHERS)

    # --- portal calls ---------------------------------------------------------------------------------

    def refusal(self, coordinator: RuleSubject, resource: RuleSubject, portal: str) -> str:
        """The reason why a coordinator may not call a portal, as a sentence that names the rule; '' when
        it may.
        """
        caller = self._caller(coordinator)
        if caller is None:
            return ""
        return self._line_refusal(coordinator.id, caller, resource, portal)

    def person_refusal(self, person: str, resource: RuleSubject, portal: str) -> str:
        """The reason why a person may not call a portal, as `refusal`. '' is a user of the host's own
        computer.

        Closed by default: without an entry for the person or OTHERS no portal may be called.
        """
        rules = {rule.name: rule for rule in self.calls}
        caller = (rules.get(person) if person else None) or rules.get(OTHERS)
        if caller is None:
            closed = f"{self.file} has no line in 'calls' for" if self.file else "no access file opens it to"
            person_text = person or "users of this computer"
            return f"{person_text} may not call {resource.id}.{portal}(): {closed} {person_text}"
        return self._line_refusal(person or "a user of this computer", caller, resource, portal)

    def assistant_refusal(self, person: str) -> str:
        """The reason why an assistant of a person may not act, as a sentence; '' when it may."""
        if OTHERS in self.assistants or (person and person in self.assistants):
            return ""
        caller = person or "a user of this computer"
        closed = f"{self.file} does not list" if self.file else "no access file lists"
        return f"an assistant may not act for {caller}: {closed} {caller} in 'assistants'"

    def _line_refusal(self, name: str, caller: CallerRule, resource: RuleSubject, portal: str) -> str:
        """The reason why the line of a caller does not allow a call."""
        if caller.lines is None:
            return ""
        lines = caller.deciding(resource)
        if any(line.allows(resource, portal) for line in lines):
            return ""
        refused = f"{name} may not call {resource.id}.{portal}()"
        if not lines:
            subject = _subject_text(caller, "others" if caller in self.calls else "other coordinators")
            return f"{refused}: {self.file}:{caller.line} lists what {subject} may call, without this portal"
        return f"{refused}: {self.file}:{lines[0].line} allows {_allowed(lines, resource)}"

    def _caller(self, coordinator: RuleSubject) -> CallerRule | None:
        about = [caller for caller in self.callers if caller.is_about(coordinator)]
        return min(about, key=lambda caller: _ORDER[caller.kind], default=None)


#: The rules of a mission without an access file.
NO_RULES = Access()


def _subject_text(caller: CallerRule, others: str) -> str:
    """The subject of an entry, for a sentence."""
    if caller.kind == "others":
        return others
    return f"a {caller.name}" if caller.kind == "type" else caller.name


def _allowed(lines: Sequence[PortalRule], resource: RuleSubject) -> str:
    """The portals that the deciding lines leave of a resource, as the end of a sentence."""
    portals = dict.fromkeys(portal for line in lines for portal in line.portals_of(resource) or ())
    if not portals:
        return f"no portal of {resource.id}"
    return f"{listed(f'{portal}()' for portal in portals)} of {resource.id} only"


class CallPermissions:
    """Cached decisions on portal calls of a team, queried before each call starts.

    `portals` are the names of the program's methods, by index.
    """

    def __init__(self, access: Access, team: Iterable[RuleSubject], portals: Sequence[str]) -> None:
        self._access, self._portals = access, portals
        self._team = {agent.id: agent for agent in team}
        self._refusals: dict[tuple[str, str, int], str] = {}

    def __call__(self, coordinator: str, resource: str, method: int) -> str:
        """The reason why a call must not start, '' when it may."""
        call = coordinator, resource, method
        reason = self._refusals.get(call)
        if reason is None:
            team = self._team
            reason = self._access.refusal(team[coordinator], team[resource], self._portals[method])
            self._refusals[call] = reason
        return reason


class DeniedPrimitives:
    """By primitive, the reason why a coordinator may not call an agent for it: by all the portals that
    serve it.

    Cached per pair, always as the same mapping. External callers (`''`) call no portals.
    """

    def __init__(self, access: Access, team: Iterable[RuleSubject], registry: Registry) -> None:
        self._access, self._providers = access, registry.providers
        self._team = {agent.id: agent for agent in team}
        self._denials: dict[tuple[str, str], Mapping[str, str]] = {}

    def __call__(self, coordinator: str, resource: str) -> Mapping[str, str]:
        """The denied primitives of an agent of a type in the registry."""
        reason = self._denials.get((coordinator, resource))
        if reason is None:
            reason = self._denials[coordinator, resource] = dict(self._denied(coordinator, resource))
        return reason

    def _denied(self, coordinator: str, resource: str) -> Iterator[tuple[str, str]]:
        asker, agent = self._team.get(coordinator), self._team[resource]
        if asker is None:
            return
        for primitive, served in self._providers[agent.type].serves.items():
            mappings = served.portals.values()
            if reason := next(
                filter(None, (self._access.refusal(asker, agent, w.target) for w in mappings)), ""
            ):
                yield primitive, reason


_encoder, _decoder = msgspec.msgpack.Encoder(), msgspec.msgpack.Decoder(Access)


def encode_access(access: Access) -> bytes:
    """The part `access` of a bundle, b"" without a file."""
    return _encoder.encode(access) if access.file else b""


def decode_access(data: bytes | memoryview) -> Access:
    """The rules in a part of a bundle. Raises msgspec.DecodeError."""
    return _decoder.decode(data) if data else NO_RULES
