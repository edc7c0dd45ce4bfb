"""Units in queries with parameters: operands that are added or compared measure the same.

Attributes have the units of the registry, a distance is in metres, a parameter may state its unit, as in
`$mass[g]`. A literal, or a parameter without unit, is in the unit of the other operand.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from lfield import units
from lfield.capability.condition_tree import ConditionExpr, ConditionParameter
from lfield.text.source_text import Span

#: `amount * factor + offset` is a value in the unit that is needed.
Conversion = tuple[float, float]
_SAME: Conversion = (1.0, 0.0)
Report = Callable[[Span, str, str], object]


class UnitCheck:
    """The units of one query. `conversions` are those of parameters that state their unit."""

    def __init__(self, report: Report) -> None:
        self._report = report
        self.conversions: dict[ConditionParameter, Conversion] = {}

    def common_unit(
        self, operands: Sequence[tuple[ConditionExpr, str | None]], operator: str, needed: str | None = None
    ) -> str | None:
        """The unit of operands that must have the same one; None if all may have any."""
        for operand, unit in operands:
            if needed is not None and unit is not None:
                self._compare(operand, unit, needed, operator)
            elif needed is None:
                needed = unit
        for operand, _ in operands:
            if isinstance(operand, ConditionParameter) and operand.unit:
                needed = self._convert(operand, needed)
        return needed

    def convert_alone(self, operand: ConditionExpr) -> None:
        """Converts a parameter in a product to SI."""
        if isinstance(operand, ConditionParameter) and operand.unit:
            self._convert(operand, None)

    def _compare(self, operand: ConditionExpr, unit: str, needed: str, operator: str) -> None:
        if units.conversion(unit, needed) != _SAME:
            message = f"'{operator}' combines {_unit_text(needed)} with {_unit_text(unit)}"
            self._report(operand.span, message, "compare what measures the same")

    def _convert(self, parameter: ConditionParameter, needed: str | None) -> str | None:
        """Record the conversion of a parameter to a unit, or else to SI; returns its unit after that."""
        if not units.is_unit(parameter.unit):
            hint = units.suggestion(parameter.unit)
            self._report(parameter.span, f"there is no unit '{parameter.unit}'", hint)
            return needed
        target = units.in_si(parameter.unit) if needed is None else needed
        conversion = units.conversion(parameter.unit, target)
        if conversion is None:
            unit = _unit_text(parameter.unit)
            message = f"this is in {unit}, and what it is compared with in {_unit_text(target)}"
            self._report(parameter.span, message, "compare what measures the same")
            return needed
        self.conversions[parameter] = conversion
        return target


def _unit_text(unit: str) -> str:
    return unit or "a pure number"
