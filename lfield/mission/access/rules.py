"""Who may do what in one mission, as plain data, and what that says of one person or one portal call. Pure.

An access file only ever takes away: persons have what their certificates say, less what it leaves out, and
coordinators call the portals of their own deployment, less what it leaves out. What it says nothing of stays
as it is without it. One line decides of one call, the most specific: of callers the agent's own name before
its type before `others`, of resources the agent's name before its type before a capability before `others`.

The reader (`access_file.py`) has held every name against program, deployment and registry. What a
capability means is written down then, so a robot needs no registry to know what a rule allows.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Final, Literal, Protocol

import msgspec

from lfield.authority.identity import Identity, Right, in_order, with_brought
from lfield.capability.model import Registry
from lfield.text.suggest import listed

#: Whoever, or whatever, no other line names.
OTHERS: Final = "others"

#: What the name at the beginning of a line is.
Kind = Literal["agent", "type", "capability", "others"]

#: What the file never takes away: a stop makes safe, and who signs a bundle is asked before it is read.
_KEPT = frozenset({Right.STOP, Right.COMMAND})


class Known(Protocol):
    """An agent as the rules know it."""

    @property
    def id(self) -> str:
        """Its name in the deployment."""

    @property
    def type(self) -> str:
        """Its type in L."""


class Person(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """What one person may do at most, or OTHERS; `line` is where in the file that stands."""

    name: str
    may: tuple[Right, ...]
    line: int


class Line(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """The portals of some resources that a coordinator may call; None: all of them.

    Of a capability `serving` has them by the resource types that serve it, as those call them.
    """

    kind: Kind
    name: str
    line: int
    portals: tuple[str, ...] | None = None
    serving: dict[str, tuple[str, ...]] = {}

    def is_about(self, resource: Known) -> bool:
        """Whether it says anything of a resource."""
        match self.kind:
            case "agent":
                return self.name == resource.id
            case "type":
                return self.name == resource.type
            case "capability":
                return resource.type in self.serving
            case "others":
                return True

    def allows(self, resource: Known, portal: str) -> bool:
        """Whether a portal of a resource that it is about may be called."""
        allowed = self.of(resource)
        return allowed is None or portal in allowed

    def of(self, resource: Known) -> tuple[str, ...] | None:
        """The portals of a resource that may be called, None for all."""
        return self.serving[resource.type] if self.kind == "capability" else self.portals


class Caller(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """What one coordinator may call, or each of a type, or OTHERS; without `lines` everything."""

    kind: Kind
    name: str
    line: int
    lines: tuple[Line, ...] | None = None

    def is_about(self, coordinator: Known) -> bool:
        """Whether it says what that coordinator may call."""
        wanted = {"agent": coordinator.id, "type": coordinator.type}.get(self.kind, self.name)
        return self.name == wanted

    def deciding(self, resource: Known) -> list[Line]:
        """The lines that decide of a resource: one, or those of several capabilities; [] when none does."""
        about = [line for line in self.lines or () if line.is_about(resource)]
        first = min((_ORDER[line.kind] for line in about), default=0)
        return [line for line in about if _ORDER[line.kind] == first]


_ORDER: Mapping[Kind, int] = {"agent": 0, "type": 1, "capability": 2, "others": 3}


class Access(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """The rules of a mission; `file` is the name of the file they are from, '' when there is none."""

    file: str = ""
    people: tuple[Person, ...] = ()
    callers: tuple[Caller, ...] = ()

    @property
    def digest(self) -> bytes:
        """SHA-256 of the rules, b"" without a file: hosts of one mission must agree on it."""
        return hashlib.sha256(encode_access(self)).digest() if self.file else b""

    # --- persons --------------------------------------------------------------------------------------

    def narrowed(self, who: Identity) -> Identity:
        """The same person with what the mission leaves of their rights. Nobody else has any to lose here.

        Who may `stop` by their certificate may stop every mission.
        """
        person = self._person(who.name) if who.kind == "person" else None
        if person is None:
            return who
        return replace(who, may=who.may & (with_brought(person.may) | _KEPT))

    def why_not(self, who: Identity, right: Right) -> str:
        """Which rule keeps a person from what they may by their certificate, in a sentence; '' when none."""
        if right not in who.may or right in self.narrowed(who).may:
            return ""
        person = self._person(who.name)
        assert person is not None
        gives = in_order(person.may).replace(",", ", ") or "nothing"
        return f"{who} may not {right} in this mission: {self.file}:{person.line} gives {person.name} {gives}"

    def barred(self, who: Identity) -> dict[Right, str]:
        """The rights that a person loses here, each with the sentence that says by which rule."""
        return {right: self.why_not(who, right) for right in who.may - self.narrowed(who).may}

    def _person(self, name: str) -> Person | None:
        known = {person.name: person for person in self.people}
        return known.get(name) or known.get(OTHERS)

    # --- portal calls ---------------------------------------------------------------------------------

    def refusal(self, coordinator: Known, resource: Known, portal: str) -> str:
        """Why a coordinator may not call a portal, in a sentence that names the rule; '' when it may."""
        caller = self._caller(coordinator)
        if caller is None or caller.lines is None:
            return ""
        lines = caller.deciding(resource)
        if any(line.allows(resource, portal) for line in lines):
            return ""
        said = f"{coordinator.id} may not call {resource.id}.{portal}()"
        if not lines:
            return (
                f"{said}: {self.file}:{caller.line} says what {_them(caller)} may call, and it is not there"
            )
        return f"{said}: {self.file}:{lines[0].line} allows {_allowed(lines, resource)}"

    def _caller(self, coordinator: Known) -> Caller | None:
        about = [caller for caller in self.callers if caller.is_about(coordinator)]
        return min(about, key=lambda caller: _ORDER[caller.kind], default=None)


#: The rules of a mission without an access file: there are none.
UNWRITTEN = Access()


def _them(caller: Caller) -> str:
    """Whom an entry is about, for a sentence."""
    if caller.kind == "others":
        return "other coordinators"
    return caller.name if caller.kind == "agent" else f"a {caller.name}"


def _allowed(lines: Sequence[Line], resource: Known) -> str:
    """What the deciding lines leave of a resource, as the end of a sentence."""
    portals = dict.fromkeys(portal for line in lines for portal in line.of(resource) or ())
    if not portals:
        return f"nothing of {resource.id}"
    return f"{listed(f'{portal}()' for portal in portals)} of {resource.id} only"


class Calls:
    """Which portal calls of a team its rules refuse, kept per call: asked before each of them begins.

    `portals` are the names of the program's methods, by index.
    """

    def __init__(self, access: Access, team: Iterable[Known], portals: Sequence[str]) -> None:
        self._access, self._portals = access, portals
        self._team = {agent.id: agent for agent in team}
        self._told: dict[tuple[str, str, int], str] = {}

    def __call__(self, coordinator: str, resource: str, method: int) -> str:
        """Why that call must not begin, '' when it may."""
        call = coordinator, resource, method
        told = self._told.get(call)
        if told is None:
            team = self._team
            told = self._access.refusal(team[coordinator], team[resource], self._portals[method])
            self._told[call] = told
        return told


class Barred:
    """By primitive, why a coordinator may not call an agent for it: by all the portals that serve it.

    Kept for each pair, always as the same mapping. Whoever asks from outside (`''`) calls nothing.
    """

    def __init__(self, access: Access, team: Iterable[Known], registry: Registry) -> None:
        self._access, self._providers = access, registry.providers
        self._team = {agent.id: agent for agent in team}
        self._told: dict[tuple[str, str], Mapping[str, str]] = {}

    def __call__(self, coordinator: str, resource: str) -> Mapping[str, str]:
        """Of an agent of a type that the registry knows."""
        told = self._told.get((coordinator, resource))
        if told is None:
            told = self._told[coordinator, resource] = dict(self._barred(coordinator, resource))
        return told

    def _barred(self, coordinator: str, resource: str) -> Iterator[tuple[str, str]]:
        asker, agent = self._team.get(coordinator), self._team[resource]
        if asker is None:
            return
        for primitive, served in self._providers[agent.type].serves.items():
            ways = served.portals.values()
            if why := next(filter(None, (self._access.refusal(asker, agent, w.target) for w in ways)), ""):
                yield primitive, why


_encoder, _decoder = msgspec.msgpack.Encoder(), msgspec.msgpack.Decoder(Access)


def encode_access(access: Access) -> bytes:
    """The part `access` of a bundle, b"" where there is no file."""
    return _encoder.encode(access) if access.file else b""


def decode_access(data: bytes | memoryview) -> Access:
    """The rules in a part of a bundle. Raises msgspec.DecodeError."""
    return _decoder.decode(data) if data else UNWRITTEN
