"""The registry as plain data: the YAML of `capabilities/` and of a mission, merged and checked.

    Term            a node of the taxonomy: `skill.material_handling.lifting`
    Attribute       a quantity that an offer may state: `payload`, in kg, the more the better
    Primitive       a term that can be called: the L type `Lift` with its portals
    Provider        a resource type that serves primitives, with the portals and attributes it has
    Equivalence     one-to-one: an agent that climbs can also lift, with some loss
    Composition     one-to-many: a grip and a climb together lift, by an L class that combines them

All values are in SI units; the reader converts other units.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Literal

from msgspec import Struct, field

from lfield.capability import condition_tree
from lfield.manifest import Effect, Parameter
from lfield.text.source_text import Source, Span

AttributeType = Literal["real", "int", "boolean", "text", "set"]
Better = Literal["more", "less", "none"]

#: The value of an attribute: a number, a truth, a text, or the members of a set.
Value = float | int | bool | str | frozenset[str]


#: The place of parts that were not read from a file: a bundle has no places.
NO_SPAN = Span(Source("", ""), 0, 0)


class Expression:
    """A condition or value over attributes, parsed and checked (matching/condition_checker.py).

    No dataclass: its form in a bundle is that of condition_encoding.py.
    """

    __slots__ = ("text", "tree")

    def __init__(self, text: str, tree: condition_tree.ConditionExpr) -> None:
        self.text, self.tree = text, tree

    def __repr__(self) -> str:
        return f"Expression({self.text!r})"

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Expression) and (self.text, self.tree) == (other.text, other.tree)

    def __hash__(self) -> int:
        return hash((self.text, self.tree))


class SortKey(Struct, frozen=True):
    """A key to order offers by: a number, the least first, or the most first if it is `descending`."""

    value: Expression
    descending: bool = False


class OfferQuery(Struct, frozen=True):
    """A query: a condition (None: all offers), order keys, and a limit.

    Ties, and queries without keys, are ordered by the ranking; unknown values come last.
    """

    condition: Expression | None = None
    order: tuple[SortKey, ...] = ()
    limit: int | None = None


#: A query for any agent.
ANY_OFFER = OfferQuery()


class TaxonomyTerm(Struct, frozen=True):
    """A node of the taxonomy. `id` is dotted, its parent is the part before the last dot.

    `name` is the term of the thesis, if it has one. `aliases` are other ids that mean the same; a
    deprecated term names its replacement in `deprecated`.
    """

    id: str
    name: str
    meaning: str
    span: Span = NO_SPAN
    aliases: tuple[str, ...] = ()
    deprecated: str = ""


class Attribute(Struct, frozen=True):
    """A quantity in which offers differ.

    `better` is the preferred direction; `typical` is a usual amount, against which fitness is
    measured (in the attribute's unit). `values` are all members a set or a text may have, () for any.
    A `live` attribute changes while the team works: it comes from telemetry, and is valid for `max_age`
    seconds.
    """

    name: str
    type: AttributeType
    span: Span = NO_SPAN
    unit: str = ""
    better: Better = "none"
    typical: float = 1.0
    values: tuple[str, ...] = ()
    live: bool = False
    max_age: float = 10.0
    meaning: str = ""

    def accepts(self, value: Value) -> bool:
        """Whether a foreign value is of the attribute's type."""
        match self.type:
            case "boolean":
                return isinstance(value, bool)
            case "text":
                return isinstance(value, str)
            case "set":
                return isinstance(value, frozenset)
            case _:
                return isinstance(value, int | float) and not isinstance(value, bool)


class Portal(Struct, frozen=True):
    """The canonical signature of a primitive's portal. `result` is an L type or 'void', units are SI."""

    name: str
    parameters: tuple[Parameter, ...] = ()
    result: str = "void"
    unit: str = ""
    effect: Effect = "actuate"
    raises: tuple[str, ...] = ()
    meaning: str = ""


class Primitive(Struct, frozen=True):
    """A capability that can be called: `name` is its type in L, `id` its place in the taxonomy."""

    name: str
    id: str
    portals: Mapping[str, Portal]
    span: Span = NO_SPAN
    meaning: str = ""


class Argument(Struct, frozen=True):
    """One argument of a mapped call: a parameter of the canonical portal, or a constant.

    The passed value is `parameter * factor + offset`, in the unit of the portal that is called. A result is
    converted in the other direction: it is `value * factor + offset` in the canonical unit, where `parameter`
    is ''; otherwise the caller gets the parameter that it gave, or the constant.
    """

    parameter: str = ""
    constant: float | int | bool | str | None = None
    factor: float = 1.0
    offset: float = 0.0


class PortalMap(Struct, frozen=True):
    """The mapping of one canonical portal to the portal `target`, with `arguments` in its order.

    `result` is the conversion of the emitted value; None when nothing is emitted or converted.
    """

    portal: str
    target: str
    arguments: tuple[Argument, ...]
    span: Span = NO_SPAN
    result: Argument | None = None


class LiveAttribute(Struct, frozen=True):
    """An attribute that an agent reports: `value * factor + offset` of `device.quantity`, telemetry.

    `index` is the element of an array quantity: `fc.position[0]` is north. Without a `unit`, factor and
    offset follow from the device's manifest (program_check.py). Without a `device` the value is the result of
    a `portal` of the resource, called `every` so many seconds.
    An attribute that is not live is reported once by a device, for instance its kind.
    """

    attribute: str
    device: str
    quantity: str
    span: Span = NO_SPAN
    factor: float = 1.0
    offset: float = 0.0
    index: int | None = None
    unit: str = ""
    every: float = 1.0

    @property
    def portal(self) -> str:
        """The portal that is called, '' for telemetry."""
        return "" if self.device else self.quantity


class ServedPrimitive(Struct, frozen=True):
    """A primitive as one resource type serves it; its `attributes` count before those of the type.

    `when` is a condition on the agent, for abilities that not every agent of the type has: a copter grips
    only if `tools == gripper`. The `nominal` attributes are usual values, not stated for these robots.
    """

    primitive: str
    portals: Mapping[str, PortalMap]
    span: Span = NO_SPAN
    attributes: Mapping[str, Value] = field(default_factory=dict)
    when: Expression | None = None
    nominal: frozenset[str] = frozenset()


class Provider(Struct, frozen=True):
    """A resource type of L with the primitives that it serves; `nominal` as in ServedPrimitive."""

    type: str
    serves: Mapping[str, ServedPrimitive]
    span: Span = NO_SPAN
    include: str = ""
    meaning: str = ""
    attributes: Mapping[str, Value] = field(default_factory=dict)
    live: Mapping[str, LiveAttribute] = field(default_factory=dict)
    nominal: frozenset[str] = frozenset()


class Equivalence(Struct, frozen=True):
    """One-to-one: every offer of `by` that fulfils `when` also serves `serves`, mapped.

    `loss` from 0 (equal to the primitive itself) up to 1 is the cost of the substitution. The rules that
    follow from the taxonomy (the specific serves the general) are made by the registry, with a loss of 0.
    """

    name: str
    serves: str
    by: str
    portals: Mapping[str, PortalMap]
    span: Span = NO_SPAN
    when: Expression | None = None
    loss: float = 0.0
    meaning: str = ""


class Need(Struct, frozen=True):
    """One part of a composition: any offer of a primitive that fulfils `when`."""

    name: str
    primitive: str
    span: Span = NO_SPAN
    when: Expression | None = None


class Composition(Struct, frozen=True):
    """One-to-many: the parts together serve `serves`, by the L class `through`.

    The class is `coordinator specific`, has the portals of the primitive as public methods, and takes the
    parts in its constructor in the order of `needs`. `where` are conditions over the parts (`grip.robot !=
    climb.robot`); `attributes` are expressions over them for the attributes of the whole (`min(grip.payload,
    climb.payload)`). Parts that are `distinct` have no agent in common.
    """

    name: str
    serves: str
    needs: Mapping[str, Need]
    through: str
    source: Path
    span: Span = NO_SPAN
    where: tuple[Expression, ...] = ()
    distinct: tuple[str, ...] = ()
    attributes: Mapping[str, Expression] = field(default_factory=dict)
    loss: float = 0.0
    meaning: str = ""


class Weights(Struct, frozen=True):
    """The weights of the parts of a cost (matching/ranking.py has the formula); a mission may set its own.

    `attributes` weighs single attributes within the fitness; the weight of any other attribute is 1. `nearby`
    is a usual distance between two of the team, in metres, against which nearness is measured.
    """

    fitness: float = 1.0
    loss: float = 2.0
    part: float = 0.5
    hop: float = 0.1
    near: float = 0.2
    age: float = 0.2
    nearby: float = 50.0
    attributes: Mapping[str, float] = field(default_factory=dict)


class Registry(Struct, frozen=True):
    """The whole registry. Made by `registry_files.read_registry`, which checks that all parts fit.

    `version` is that of the taxonomy: it grows with every change, and no id is ever removed.
    `agents` are the attribute values of single agents of a mission, which count before all others.
    `constraints` are the queries that the program of a mission holds as constants, by their text.
    `digest` changes with every change that affects an answer: hosts of one mission must agree on it.
    """

    terms: Mapping[str, TaxonomyTerm]
    attributes: Mapping[str, Attribute]
    primitives: Mapping[str, Primitive]
    providers: Mapping[str, Provider]
    equivalences: Mapping[str, Equivalence]
    compositions: Mapping[str, Composition]
    agents: Mapping[str, Mapping[str, Value]] = field(default_factory=dict)
    weights: Weights = field(default_factory=Weights)
    version: int = 0
    digest: bytes = b""
    constraints: Mapping[str, OfferQuery] = field(default_factory=dict)
