"""Conditions and values over attributes, in L's own syntax: `payload >= 2.0 && environment == aerial`.

Operators are && || ! == != < <= > >= + - * / with L's precedence, functions are min, max and abs. A name is
an attribute, or a member that a set or text attribute may have (`aerial`, which can be written as text too);
of every offer `agent`, `robot` and `host` are text attributes as well. In the rule of a composition names
are `need.attribute`, and `distance(need, need)` is in metres. Equality with a set means a common member.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Literal, cast

from msgspec import Struct, field

from lfield.capability import condition_tree
from lfield.capability.condition_tree import Mistake
from lfield.capability.model import Attribute, Expression
from lfield.capability.parameter_units import Conversion, UnitCheck
from lfield.text.source_text import Span
from lfield.text.suggestions import did_you_mean, listed

#: Text attributes that every offer has: the name of its agent, and its robot (host).
IDENTITY = ("agent", "robot", "host")

#: The attributes from which `distance` is computed: metres from the team's common origin.
POSITION = ("north", "east", "down")

_METRES = "m"

#: Functions of numbers with the least and the most arguments they take.
FUNCTIONS: Mapping[str, tuple[int, int]] = {"min": (2, 16), "max": (2, 16), "abs": (1, 1)}

Sort = Literal["number", "boolean", "text", "set", "part", "nothing"]
Expectation = Literal["boolean", "number", "text", "set", "any"]

#: The required kind of an expression for the value of an attribute, by the type of the attribute.
EXPECTATIONS: Mapping[str, Expectation] = {
    "real": "number",
    "int": "number",
    "boolean": "boolean",
    "text": "text",
    "set": "set",
}


class ValueKind(Struct, frozen=True):
    """The kind of an expression: its sort, with all its possible members or texts (() for any).

    The sort of an erroneous part is 'nothing', which is not reported again. `unit` is that of a number, None
    if it may have any.
    """

    sort: Sort
    values: tuple[str, ...] = ()
    unit: str | None = None


_NUMBER, _BOOLEAN, _TEXT = ValueKind("number"), ValueKind("boolean"), ValueKind("text")
_PART, _NOTHING = ValueKind("part"), ValueKind("nothing")


class NameScope(Struct, frozen=True):
    """The meanings of names: bare `names`, and for each of the `needs` of a composition its `members`.

    `parameters` are the sorts of the values that a program passes, by their text in the query; None
    in a compiled query, where names have the sorts in them. With parameters, units are compared.
    """

    names: Mapping[str, ValueKind]
    needs: Collection[str] = ()
    members: Mapping[str, ValueKind] = field(default_factory=dict)
    parameters: Mapping[str, Sort] | None = None

    @staticmethod
    def of_offer(attributes: Mapping[str, Attribute]) -> NameScope:
        """The scope of a constraint, or of the `when` of a rule: the attributes of one offer."""
        return NameScope(_kinds(attributes))

    @staticmethod
    def of_parts(
        attributes: Mapping[str, Attribute], needs: Collection[str], whole: Collection[str] = ()
    ) -> NameScope:
        """The scope of the `where` and `attributes` of a composition: its needs by name.

        A `where` may also name attributes of the `whole`.
        """
        kinds = _kinds(attributes)
        return NameScope({name: kinds[name] for name in whole if name in kinds}, needs, kinds)


def _kinds(attributes: Mapping[str, Attribute]) -> dict[str, ValueKind]:
    kinds = {name: _kind(attribute) for name, attribute in attributes.items()}
    return kinds | dict.fromkeys(IDENTITY, _TEXT)


def _kind(attribute: Attribute) -> ValueKind:
    match attribute.type:
        case "real" | "int":
            return ValueKind("number", unit=attribute.unit)
        case sort:
            return ValueKind(sort, attribute.values)


# --- meaning ------------------------------------------------------------------------------------------


def check_expression(
    expression: Expression,
    scope: NameScope,
    expected: Expectation,
    conversions: dict[condition_tree.ConditionParameter, Conversion] | None = None,
) -> list[Mistake]:
    """The mistakes in the names and types of an expression that shall be `expected`.

    The bare name of a member is replaced in the tree by its text. `conversions` gets those of the parameters.
    """
    checker = _Checker(scope)
    kind = checker.kind(expression.tree)
    is_known = not checker.found and kind.sort != "nothing"
    if is_known and kind.sort != expected and (expected != "any" or kind.sort == "part"):
        should = "a value" if expected == "any" else _sort_text(expected)
        hint = "compare it, as in payload >= 2.0" if expected == "boolean" else ""
        checker.report(expression.tree.span, f"this is {_sort_text(kind.sort)}, not {should}", hint)
    if conversions is not None:
        conversions.update(checker.units.conversions)
    return checker.found


def _sort_text(sort: str) -> str:
    return {"boolean": "true or false", "text": "text", "nothing": "nothing"}.get(sort, f"a {sort}")


class _Checker:
    """One walk over one tree."""

    def __init__(self, scope: NameScope) -> None:
        self._scope = scope
        self.found: list[Mistake] = []
        self.units = UnitCheck(self.report)

    def report(self, place: Span, message: str, hint: str | None = None) -> ValueKind:
        """Add a mistake; returns the kind of an erroneous part."""
        self.found.append(Mistake(place.start, place.end, message, hint or ""))
        return _NOTHING

    def kind(self, tree: condition_tree.ConditionExpr) -> ValueKind:
        """The kind of the value of a tree."""
        match tree:
            case condition_tree.ConditionLiteral(value=value):
                return self._literal(value, tree.span)
            case condition_tree.ConditionName(name=name):
                return self._name(name, tree.span)
            case condition_tree.ConditionMember():
                return self._member(tree)
            case condition_tree.ConditionParameter():
                return self._parameter(tree)
            case condition_tree.ConditionUnary(operator=operator, operand=operand):
                return self._all([operand], _BOOLEAN if operator == "!" else _NUMBER, operator)
            case condition_tree.ConditionBinary():
                return self._binary(tree)
            case condition_tree.ConditionCall():
                return self._call(tree)
            case _:
                return self.report(tree.span, "this is not allowed in a condition over attributes")

    def _literal(self, value: bool | int | float | str | None, place: Span) -> ValueKind:
        match value:
            case None:
                return self.report(place, "null is not a value of an attribute")
            case bool():
                return _BOOLEAN
            case str():
                return _TEXT
            case _:
                return _NUMBER

    def _parameter(self, tree: condition_tree.ConditionParameter) -> ValueKind:
        known = self._scope.parameters
        sort = tree.sort if known is None else known.get(tree.path, "nothing")
        if not sort:
            return self.report(tree.span, "there is no parameter of this name")
        if tree.unit and sort not in ("number", "nothing"):
            return self.report(tree.span, f"this is {_sort_text(sort)}, which has no unit")
        return ValueKind(cast(Sort, sort))

    # --- names ----------------------------------------------------------------------------------------

    def _name(self, name: str, place: Span) -> ValueKind:
        scope = self._scope
        if name in scope.names:
            return scope.names[name]
        if name in scope.needs:
            return _PART
        if name in scope.members:
            parts = listed(f"{need}.{name}" for need in scope.needs)
            return self.report(place, f"'{name}' is ambiguous: several parts have it", f"write {parts}")
        hint = did_you_mean(name, [*scope.names, *scope.needs])
        return self.report(place, f"there is no attribute '{name}'", hint or "text is in double quotes")

    def _member(self, tree: condition_tree.ConditionMember) -> ValueKind:
        scope, owner = self._scope, tree.object
        if not scope.needs:
            return self.report(tree.span, "an attribute has no members", "write its name alone")
        if not isinstance(owner, condition_tree.ConditionName):
            return self.report(tree.span, "this is not a part", "write need.attribute")
        if owner.name not in scope.needs:
            hint = did_you_mean(owner.name, scope.needs) or f"the parts are {listed(scope.needs)}"
            return self.report(owner.span, f"there is no part '{owner.name}'", hint)
        if tree.name not in scope.members:
            message = f"there is no attribute '{tree.name}'"
            return self.report(tree.place, message, did_you_mean(tree.name, scope.members))
        return scope.members[tree.name]

    # --- operators and functions ----------------------------------------------------------------------

    def _binary(self, tree: condition_tree.ConditionBinary) -> ValueKind:
        operands = [tree.left, tree.right]
        match tree.operator:
            case "&&" | "||":
                return self._all(operands, _BOOLEAN, tree.operator)
            case "<" | "<=" | ">" | ">=":
                kind = self._all(operands, _NUMBER, tree.operator)
                return _BOOLEAN if kind.sort == "number" else kind
            case "*" | "/":
                for operand in operands:
                    self.units.convert_alone(operand)
                return self._all(operands, _NUMBER, tree.operator, is_alike=False)
            case "+" | "-":
                return self._all(operands, _NUMBER, tree.operator)
            case "==" | "!=":
                return self._equality(tree)
            case operator:
                return self.report(tree.sign, f"'{operator}' is not an operator of conditions")

    def _all(
        self,
        operands: list[condition_tree.ConditionExpr],
        expected: ValueKind,
        operator: str,
        *,
        is_alike: bool = True,
    ) -> ValueKind:
        """The required kind of all operands; numbers that are alike have the same unit."""
        is_valid = True
        kinds = list[ValueKind]()
        for operand in operands:
            kind = self.kind(operand)
            kinds.append(kind)
            is_valid = is_valid and kind.sort == expected.sort
            if kind.sort not in (expected.sort, "nothing"):
                need = "numbers" if expected is _NUMBER else "booleans"
                self.report(operand.span, f"'{operator}' takes {need}; this is {_sort_text(kind.sort)}")
        if not is_valid:
            return _NOTHING
        if expected is not _NUMBER or not is_alike:
            return expected
        return ValueKind("number", unit=self._common_unit(operands, kinds, operator, expected.unit))

    def _common_unit(
        self,
        operands: Sequence[condition_tree.ConditionExpr],
        kinds: Sequence[ValueKind],
        operator: str,
        needed: str | None = None,
    ) -> str | None:
        """The unit of numbers that are combined; units count in queries with parameters."""
        if self._scope.parameters is None:
            return None
        pairs = [(operand, kind.unit) for operand, kind in zip(operands, kinds, strict=True)]
        return self.units.common_unit(pairs, operator, needed)

    def _equality(self, tree: condition_tree.ConditionBinary) -> ValueKind:
        left = self._or_member(tree.left, tree.right, lambda text: setattr(tree, "left", text))
        right = self._or_member(tree.right, tree.left, lambda text: setattr(tree, "right", text))
        sorts = {left.sort, right.sort}
        if "nothing" in sorts:
            return _NOTHING
        if "part" in sorts:
            return self.report(tree.span, "parts cannot be compared", "compare their agent or robot")
        if len(sorts) > 1 and sorts != {"text", "set"}:
            message = f"'{tree.operator}' compares {_sort_text(left.sort)} with {_sort_text(right.sort)}"
            return self.report(tree.span, message)
        if sorts == {"number"}:
            self._common_unit((tree.left, tree.right), (left, right), tree.operator)
        return _BOOLEAN

    def _or_member(
        self,
        tree: condition_tree.ConditionExpr,
        other: condition_tree.ConditionExpr,
        replace: Callable[[condition_tree.ConditionLiteral], None],
    ) -> ValueKind:
        """The kind of one side of a comparison, which may be a possible member of the `other` side."""
        values = self._declared(other)
        match tree:
            case condition_tree.ConditionName(name=name) if name in values or (
                values and not self._known(name)
            ):
                pass
            case condition_tree.ConditionLiteral(value=str(name)) if values:
                pass
            case _:
                return self.kind(tree)
        if name not in values:
            hint = did_you_mean(name, values) or f"its values are {listed(values)}"
            return self.report(tree.span, f"'{other.span.text}' is never '{name}'", hint)
        replace(condition_tree.ConditionLiteral(tree.span, 1, name))
        return _TEXT

    def _declared(self, tree: condition_tree.ConditionExpr) -> tuple[str, ...]:
        """The permitted values of an attribute; () if they are not restricted, or this is not an
        attribute.
        """
        match tree:
            case condition_tree.ConditionName(name=name) if name in self._scope.names:
                return self._scope.names[name].values
            case condition_tree.ConditionMember(name=name) if name in self._scope.members:
                return self._scope.members[name].values
            case _:
                return ()

    def _known(self, name: str) -> bool:
        return name in self._scope.names or name in self._scope.needs

    def _call(self, tree: condition_tree.ConditionCall) -> ValueKind:
        name = tree.function.span.text
        if name == "distance":
            return self._distance(tree)
        if name not in FUNCTIONS:
            hint = did_you_mean(name, [*FUNCTIONS, "distance"]) or "the functions are min, max and abs"
            return self.report(tree.function.span, f"there is no function '{name}' here", hint)
        minimum, maximum = FUNCTIONS[name]
        if not minimum <= len(tree.arguments) <= maximum:
            count = "1 argument" if minimum == maximum else f"{minimum} to {maximum} arguments"
            return self.report(tree.span, f"{name}() takes {count}, not {len(tree.arguments)}")
        return self._all(tree.arguments, _NUMBER, f"{name}()")

    def _distance(self, tree: condition_tree.ConditionCall) -> ValueKind:
        scope = self._scope
        if not scope.needs:
            return self._distance_to(tree)
        if lacking := [name for name in POSITION if name not in scope.members]:
            return self.report(tree.span, f"distance() needs the attributes {listed(lacking)}")
        parts = [
            a for a in tree.arguments if isinstance(a, condition_tree.ConditionName) and a.name in scope.needs
        ]
        if len(parts) != 2 or len(tree.arguments) != 2:
            return self.report(tree.span, "distance() takes two parts", f"these are {listed(scope.needs)}")
        return _NUMBER

    def _distance_to(self, tree: condition_tree.ConditionCall) -> ValueKind:
        """The kind of a distance from an offer to a place."""
        if lacking := [name for name in POSITION if name not in self._scope.names]:
            return self.report(tree.span, f"distance() needs the attributes {listed(lacking)}")
        if len(tree.arguments) not in (2, 3):
            message = "distance() here takes a place: north, east and optionally down"
            return self.report(tree.span, message, "such as distance(12.0, 4.0), in metres")
        for argument in tree.arguments:
            is_given = isinstance(argument, condition_tree.ConditionParameter)
            if not is_given and not isinstance(argument, condition_tree.ConditionLiteral):
                return self.report(
                    argument.span,
                    "the coordinates of a place are number literals",
                    "such as distance(12.0, 4.0)",
                )
        kind = self._all(tree.arguments, _NUMBER, "distance()", is_alike=False)
        if kind.sort != "number":
            return kind
        self._common_unit(tree.arguments, [kind] * len(tree.arguments), "distance()", _METRES)
        return ValueKind("number", unit=_METRES)
